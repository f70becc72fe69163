"""Files of earlier forms, spelled with the words of the world file: one table of old names.

Three forms came before: `ztpm-scene/1` (the same words under another form), the draft of a cell file (whole
micrometres and grams, all members at the top), and the simulated sensor's scene (people as x_m and y_m, shapes by
`type`).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

from capabilities.statements.observation import PPM
from capabilities.values.units import Unit, si
from pep.pit.files.faults import Fault, named, told
from pep.pit.files.plain_file import FileError
from pep.pit.files.world_forms import FORM, SHAPES, UNKNOWN

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

OLD_SCENE: Final = "ztpm-scene/1"
HEAD: Final = {"form": FORM, "frame": "base"}
SI_NAMES: Final[Mapping[str, str]] = {"_um": "_m", "_ppm": "", "_g": "_kg"}
"""Ending of each old member that is a whole number of a small unit, and its ending in SI."""
_PER_SI: Final = {"_um": Unit.MICROMETRE.per_si, "_ppm": PPM, "_g": Unit.GRAM.per_si}
WORDS: Final[Mapping[str, str]] = {"number": "pin"}
"""Old members of the same meaning and unit."""
LISTS: Final = ("objects", "zones", "contacts", "outputs")


def renewed_scene(value: object) -> object:
    """A question's scene in the words of the world file."""
    return value | {"form": FORM} if isinstance(value, dict) and value.get("form") == OLD_SCENE else value


def renewed_draft(value: object) -> object:
    """A draft in the words of the world file.

    One with a form or a cell is such a file already.

    Raises:
        FileError: `PARAMETERS_WRONG` for an old draft with two units, or with parts of its units.
    """
    if not isinstance(value, dict) or "form" in value or "cell" in value:
        return renewed_scene(value)
    mixed = tuple(_mixed(value, value, ()))
    if mixed:
        raise FileError.of(mixed)
    cell = {name: [] for name in LISTS} | {"payload_kg": UNKNOWN} | _in_si(value)
    if "payload_g" in value:
        cell["payload_kg"] = si(value["payload_g"], Unit.GRAM)
    for name in LISTS:
        if isinstance(cell[name], list):
            cell[name] = [_shaped(row) for row in cell[name]]
    return HEAD | {"cell": cell}


def renewed_shown(value: object) -> object:
    """A simulated sensor's scene in the words of the world file."""
    if not isinstance(value, dict) or "form" in value or "view" in value:
        return renewed_scene(value)
    view = dict(value)
    for name, one, read in (("people", "person", _standing), ("objects", "object", _shaped)):
        if isinstance(view.get(name), list):
            view[name] = [{"id": one} | read(row) if isinstance(row, dict) else row for row in view[name]]
    return HEAD | {"view": view}


def _mixed(value: object, whole: object, way: tuple[object, ...]) -> Iterator[Fault]:
    """Places of an old draft with a number that is not whole, or in another unit."""
    for key, each in value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ():
        at = (*way, key)
        unit = next((unit for unit in SI_NAMES if str(key).endswith(unit)), "")
        name = named(whole, at)
        if str(key).endswith(("_m", "_kg")):
            what = "units are mixed: this draft is in micrometres and grams; write it in metres under a [cell]"
            yield Fault("PARAMETERS_WRONG", ".".join(map(str, at)), told(name, what))
        elif unit and not all(type(number) is int for number in _numbers(each)):
            yield Fault("PARAMETERS_WRONG", ".".join(map(str, at)), told(name, "whole numbers of this unit"))
        else:
            yield from _mixed(each, whole, at)


def _numbers(value: object) -> Iterator[object]:
    if isinstance(value, list):
        for each in value:
            yield from _numbers(each)
    else:
        yield value


def _in_si(value: Any) -> Any:
    """The value with its small units as SI units, under their names."""
    if isinstance(value, list):
        return [_in_si(each) for each in value]
    if not isinstance(value, dict):
        return value
    found = {}
    for key, each in value.items():
        unit = next((unit for unit in SI_NAMES if key.endswith(unit)), None)
        if unit is None:
            found[WORDS.get(key, key)] = _in_si(each)
        else:
            found[key.removesuffix(unit) + SI_NAMES[unit]] = _divided(each, _PER_SI[unit])
    return found


def _divided(value: Any, by: int) -> Any:
    return [_divided(each, by) for each in value] if isinstance(value, list) else value / by


def _shaped(row: Any) -> Any:
    """A thing with its shape under the shape's own word."""
    shape = row.get("shape") if isinstance(row, dict) else None
    if not isinstance(shape, dict):
        return row
    word = shape.get("form", shape.get("type"))
    if word not in SHAPES or word in row:
        return row
    inner = {key: each for key, each in shape.items() if key not in ("form", "type")}
    return {key: each for key, each in row.items() if key != "shape"} | {word: inner}


def _standing(row: dict[str, Any]) -> dict[str, Any]:
    """A person who is told by their place."""
    place = {key: each for key, each in row.items() if key in ("x_m", "y_m", "facing_rad")}
    return {key: each for key, each in row.items() if key not in place} | ({"standing_adult": place} if place else {})
