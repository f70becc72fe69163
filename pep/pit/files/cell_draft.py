"""Draft of a cell file out of a world file, and a signed cell as such a file again (PHY-68).

The world file has metres and kilograms; what is signed has whole micrometres and grams, each number rounded once.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

from capabilities.statements import cell as statement
from capabilities.statements.claims import Name, Url
from capabilities.values import form
from capabilities.values.errors import CapabilityError
from capabilities.values.units import Unit, si
from pep.pit.files import contradictions
from pep.pit.files import world_forms as forms
from pep.pit.files.faults import Fault, nearest, quoted, told
from pep.pit.files.old_files import HEAD, renewed_draft
from pep.pit.files.plain_file import FileError, formed
from pep.pit.files.scene_file import shape_in
from pep.pit.geometry.shape import shape_of, stated
from pep.pit.scene import survey
from pep.pit.scene.scene import CELL_FILE

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from pep.pit.geometry.shape import Vector
    from pep.pit.scene.scene import Scene

MALFORMED: Final = "DRAFT_MALFORMED"
BACKDATED_S: Final = 60  # ours
"""A file is in force from a minute before it was signed, since two machines' clocks differ a little."""
DAY_S: Final = 86_400  # s
PLACE: Final = "cell"
_PARTS: Final[dict[str, Any]] = {
    "name": Name,
    "author": Name,
    "audience": Url,
    "tool": Name,
    "objects": statement.Surveyed,
    "zones": statement.Zone,
    "contacts": statement.Contact,
    "outputs": statement.Output,
    "sensors": Name,
}
"""Members of the signed file that are read one by one, so that every fault is told."""
CAUSES: Final = {"a wrong form": "a name has letters A to Z, digits and ._:@/|+=~%-, and begins with a letter or digit"}
HINTS: Final = {
    survey.SurveyFault.OUT_OF_REACH: "over 10 m from the base; millimetres are divided by 1000",
    survey.SurveyFault.BASE_OUTSIDE_WORKSPACE: "the base, (0, 0, 0), is outside",
    survey.SurveyFault.CONTACT_AMBIGUOUS: "observed, and the name of something that stands there",
    survey.SurveyFault.CONTACT_WITH_NOTHING: "no such object",
    survey.SurveyFault.CONTACT_IN_HARD_ZONE: "touched in a zone that nothing may enter",
}


def statement_of(value: object, *, at: int, days: int) -> statement.Cell:
    """Cell that a draft's value spells, ready to be signed.

    Args:
        value: of a world file, or of an old draft.
        at: seconds since the epoch.
        days: days for which it is in force.

    Raises:
        FileError: with every fault; its reason is `DRAFT_MALFORMED`, or a code of `pep.pit.SurveyFault` where the
            draft has its form and contradicts itself.
    """
    try:
        draft = formed(forms.DRAFT, renewed_draft(value), place="file", elsewhere=forms.BELONGS).cell
    except FileError as error:
        raise _malformed(error.faults) from None
    found = tuple(contradictions.of_cell(draft, PLACE))
    if found:
        raise _malformed(found)
    claims = _claims(draft) | {"not_before": at - BACKDATED_S, "not_after": at - BACKDATED_S + days * DAY_S}
    found = tuple(_unstated(claims))
    if found:
        raise _malformed(found)
    try:
        made = statement.from_claims(claims)
    except CapabilityError as error:
        raise FileError(MALFORMED, PLACE, error.detail) from error
    found = tuple(_contradicted(made))
    if found:
        raise FileError.of(found)
    return made


def value_of_cell(cell: statement.Cell, *, robot: str | None = None) -> dict[str, Any]:
    """Value of the world file that, signed, gives this cell again; its times are the signature's.

    Args:
        cell: a signed cell, or one to be signed.
        robot: the model that a draft names; it is not signed.
    """
    area = cell.workspace
    surveyed: dict[str, Any] = {
        "name": cell.name,
        "author": cell.author,
        "audience": cell.audience,
        **({} if robot is None else {"robot": robot}),
        "tool": cell.tool,
        "payload_kg": forms.UNKNOWN if cell.payload_g is None else si(cell.payload_g, Unit.GRAM),
        "sensors": list(cell.sensors),
    }
    if area is not None:
        surveyed["workspace"] = {"low_m": _metres(area.low_um), "high_m": _metres(area.high_um)}
    surveyed["objects"] = [{"name": o.name, "kind": o.kind, **spelled(shape_of(o.shape))} for o in cell.objects]
    surveyed["zones"] = [
        {"name": z.name, **({} if z.tier is None else {"tier": int(z.tier)}), **spelled(shape_of(z.shape))}
        for z in cell.zones
    ]
    surveyed["contacts"] = [
        {"object": c.object, "by": c.by, **({"observed": True} if c.observed else {})} for c in cell.contacts
    ]
    surveyed["outputs"] = [{"pin": o.number, "name": o.name, "tier": int(o.tier)} for o in cell.outputs]
    return HEAD | {"cell": surveyed}


def drafted(base: Mapping[str, Any], seen: Scene) -> dict[str, Any]:
    """Value of a draft: a cell's value, and the objects that sensors show, as ones that stand there.

    Args:
        base: the `cell` of a world file; numbers of the physics engine are left out.
        seen: surveyed objects of it are not taken again.
    """
    things = [thing for thing in seen.objects if thing.source != CELL_FILE]
    rows = [{"name": each.id, "kind": each.kind, **spelled(each.shape)} for each in things]
    cell = {name: each for name, each in base.items() if name in forms.SURVEYED and each is not None}
    return HEAD | {"cell": cell | {"objects": [*cell.get("objects", []), *rows]}}


def spelled(shape: Any) -> dict[str, Any]:
    """A shape as a world file spells it, under its word; what has its default is left out."""
    word = type(shape).__name__.lower()
    members = {name: getattr(shape, name) for name in shape.__dataclass_fields__ if name != "__pydantic_config__"}
    plain = {
        name: each
        for name, each in members.items()
        if not (name == "quaternion" and tuple(each) == (1.0, 0.0, 0.0, 0.0))
    }
    if word == "convex" and not shape.radius_m:
        del plain["radius_m"]
    return {word: {name: _listed(each) for name, each in plain.items()}}


def _listed(value: Any) -> Any:
    return [_listed(each) for each in value] if isinstance(value, tuple) else value


def _metres(point_um: tuple[int, int, int]) -> list[float]:
    return [si(each, Unit.MICROMETRE) for each in point_um]


def _micrometres(point_m: Vector) -> list[int]:
    return [round(each * Unit.MICROMETRE.per_si) for each in point_m]


def _claims(draft: Any) -> dict[str, Any]:
    """The signed file's members but its times."""
    area, payload = draft.workspace, draft.payload_kg
    return {
        "name": draft.name,
        "author": draft.author,
        "audience": draft.audience,
        "tool": draft.tool,
        "payload_g": None if payload in (None, forms.UNKNOWN) else round(payload * Unit.GRAM.per_si),
        "workspace": None
        if area is None
        else {"low_um": _micrometres(area.low_m), "high_um": _micrometres(area.high_m)},
        "objects": [
            {"name": each.name, "kind": each.kind, "shape": form.plain(stated(shape_in(each)))}
            for each in draft.objects
        ],
        "zones": [
            {"name": each.name, "tier": each.tier, "shape": form.plain(stated(shape_in(each)))} for each in draft.zones
        ],
        "contacts": [{"object": c.object, "by": c.by, "observed": c.observed} for c in draft.contacts],
        "outputs": [{"number": o.pin, "name": o.name, "tier": o.tier} for o in draft.outputs],
        "sensors": list(draft.sensors),
    }


def _unstated(claims: dict[str, Any]) -> Iterator[Fault]:
    """Faults of members that no signed file can have, one by one."""
    for member, kind in _PARTS.items():
        value = claims[member]
        for row, each in enumerate(value) if isinstance(value, list) else ((None, value),):
            try:
                form.read(kind, each)
            except form.FormError as error:
                at = f"{PLACE}.{member}" if row is None else f"{PLACE}.{member}.{row}"
                name = str(each.get("name", each.get("object", "")) if isinstance(each, dict) else each)
                inner = error.place.removeprefix("shape.").replace("_um", "_m")
                yield Fault(
                    MALFORMED,
                    ".".join(part for part in (at, inner) if part),
                    told(quoted(name), CAUSES.get(error.cause, error.cause)),
                )


def _contradicted(cell: statement.Cell) -> Iterator[Fault]:
    objects = sorted(thing.name for thing in cell.objects)
    places = {
        **{each.name: f"{PLACE}.zones.{row}" for row, each in enumerate(cell.zones)},
        **{each.name: f"{PLACE}.objects.{row}" for row, each in enumerate(cell.objects)},
    }
    touched = {each.object: f"{PLACE}.contacts.{row}.object" for row, each in enumerate(cell.contacts)}
    for error in survey.contradictions(cell):
        hint = HINTS.get(error.code, error.detail)
        if error.code is survey.SurveyFault.CONTACT_WITH_NOTHING:
            hint = f"{hint}; {nearest(error.detail, objects)}"
        name = error.detail.split(" in ")[0].split(": ")[0]
        place = (touched if error.code.startswith("CONTACT") else places).get(name, f"{PLACE}.{name}")
        yield Fault(str(error.code), place, told(quoted(error.detail), hint))


def _malformed(found: tuple[Fault, ...]) -> FileError:
    return FileError.of([Fault(MALFORMED, each.place.removeprefix("file."), each.what) for each in found])
