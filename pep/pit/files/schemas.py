"""The published JSON schemas of world, motion and trajectory files, made of the forms that read them."""

from __future__ import annotations

from typing import Any, Final

from pydantic import TypeAdapter

from pep.pit.files import motion_file, trajectory_file, world_forms

DIALECT: Final = "https://json-schema.org/draft/2020-12/schema"
ALTERNATIVES: Final = frozenset({*world_forms.SHAPES, "regions", "standing_adult", "adult_at_distance"})
"""Members of which exactly one is given, wherever more than one of them stands in a form."""
USES: Final = {
    "SceneFile": world_forms.SCENE_FILE,
    "CellFile": world_forms.DRAFT_FILE,
    "ShownFile": world_forms.SHOWN_FILE,
}
"""Forms of a world file: scene of a question, draft to sign, scene of a simulated sensor."""


def world_schema(use: str | None = None) -> dict[str, Any]:
    """Schema of world files, for any use or for one of `USES`."""
    scene, draft, shown = USES.values()
    made = _published(
        TypeAdapter(scene | draft | shown), world_forms.FORM, "A cell, what is seen in it, held and granted"
    )
    if use is None:
        return made
    return {**{key: made[key] for key in ("$schema", "$id", "$defs")}, "$ref": f"#/$defs/{use}"}


def motion_schema() -> dict[str, Any]:
    """Schema of `pep.pit.files.motion_file`."""
    return _published(motion_file.ADAPTER, motion_file.FORM, "One motion")


def trajectory_schema() -> dict[str, Any]:
    """Schema of `pep.pit.files.trajectory_file`, but for CSV."""
    return _published(trajectory_file.ADAPTER, trajectory_file.FORM, "One timed trajectory, as others write it")


def _published(adapter: TypeAdapter[Any], form: str, title: str) -> dict[str, Any]:
    made = adapter.json_schema()
    for each in made["$defs"].values():
        members = [name for name in each.get("properties", {}) if name in ALTERNATIVES]
        if len(members) > 1:
            each["oneOf"] = [{"properties": {name: {"not": {"type": "null"}}}, "required": [name]} for name in members]
    return {"$schema": DIALECT, "$id": f"urn:{form.replace('/', ':')}", **made, "title": title}
