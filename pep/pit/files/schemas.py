"""The published JSON schemas of scene and motion files, made of the forms that read them."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

from pep.pit.files import motion_file, scene_file

if TYPE_CHECKING:
    from pydantic import TypeAdapter

DIALECT: Final = "https://json-schema.org/draft/2020-12/schema"
ALTERNATIVES: Final = frozenset({*scene_file.SHAPES, "regions", "standing_adult", "adult_at_distance"})
"""Members of which exactly one is given, wherever more than one of them stands in a form."""


def scene_schema() -> dict[str, Any]:
    """Schema of `pep.pit.files.scene_file`."""
    schema = _published(scene_file.ADAPTER, scene_file.FORM, "A cell, what was seen in it, what is held and granted")
    schema["$defs"]["CellParameters"]["required"] = ["objects"]
    return schema


def motion_schema() -> dict[str, Any]:
    """Schema of `pep.pit.files.motion_file`."""
    return _published(motion_file.ADAPTER, motion_file.FORM, "One motion")


def _published(adapter: TypeAdapter[Any], form: str, title: str) -> dict[str, Any]:
    made = adapter.json_schema()
    for each in made["$defs"].values():
        members = [name for name in each.get("properties", {}) if name in ALTERNATIVES]
        if len(members) > 1:
            each["oneOf"] = [{"properties": {name: {"not": {"type": "null"}}}, "required": [name]} for name in members]
    return {"$schema": DIALECT, "$id": f"urn:{form.replace('/', ':')}", **made, "title": title}
