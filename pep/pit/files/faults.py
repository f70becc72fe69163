"""Faults of a file's value: each wrong place, the name of the thing there, and the words that exist."""

from __future__ import annotations

import json
from dataclasses import dataclass
from difflib import get_close_matches
from typing import TYPE_CHECKING, Any, Final, TypeVar

from pydantic import TypeAdapter, ValidationError

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

T = TypeVar("T")

FAULTS_TOLD: Final = 64  # ours: who mends so many runs the check again
WORDS_TOLD: Final = 16  # ours: a line of a screen; of more members the nearest ones are told
NAME_TOLD: Final = 48  # ours: characters of a name in a sentence
NAMES: Final = ("name", "id", "object")
"""Members that name a thing, in the order in which they are looked for."""
WRONG_FRAME: Final = "FRAMES_MISMATCH"
WRONG: Final = "PARAMETERS_WRONG"
EXTRA: Final = frozenset({"extra_forbidden", "unexpected_keyword_argument"})
MISSING, NO_WORD = "missing", "literal_error"
"""Kinds of pydantic's errors that are told in words of our own."""
UNITS: Final[Mapping[str, str]] = {"_mm": "1000", "_um": "1000000", "_cm": "100", "_g": "1000"}
"""Endings of members in other units, and the number by which they are divided."""


@dataclass(frozen=True, slots=True)
class Fault:
    """One wrong place of a file: its code, the place, and the fault there in words."""

    reason: str
    place: str
    what: str


def read(form: TypeAdapter[T], value: object, *, place: str, elsewhere: Mapping[str, str]) -> T | tuple[Fault, ...]:
    """The value in its declared form, or every fault of it.

    Args:
        form: strict, without further members.
        value: plain.
        place: name of the value in a fault.
        elsewhere: members that another use of the file has, and that use.
    """
    try:
        # Over JSON text, where a list is a tuple's only spelling.
        return form.validate_json(json.dumps(value, allow_nan=False))
    except ValidationError as error:
        found = error.errors(include_url=False, include_input=True, include_context=True)[:FAULTS_TOLD]
        schema = form.json_schema()
        told_ones = [_fault(schema, value, place, each, elsewhere) for each in found]
        return tuple({each.place: each for each in reversed(told_ones)}.values())[::-1]


def named(value: object, way: Sequence[object]) -> str:
    """Innermost name of a thing on the way to a place, quoted; "" where nothing there has one."""
    found = ""
    for step in (*way, None):
        if isinstance(value, dict):
            found = next((str(value[key]) for key in NAMES if isinstance(value.get(key), str)), found)
        try:
            value = value[step]  # type: ignore[index]  # anything that is no container ends the way
        except (KeyError, IndexError, TypeError):
            break
    return quoted(found) if found else ""


def quoted(name: str) -> str:
    """A name in quotation marks, cut to a length that a sentence bears."""
    return f"'{name[:NAME_TOLD]}'"


def told(name: str, what: str) -> str:
    """A fault in words, with the thing's name before it."""
    return f"{name}: {what}" if name else what


def nearest(word: object, words: Sequence[str]) -> str:
    """Sentence with the words that exist, the nearest one first."""
    close = get_close_matches(str(word)[:NAME_TOLD], words, n=1, cutoff=0.6)  # difflib's own
    stem = next((str(word).removesuffix(unit) + "_m" for unit in UNITS if str(word).endswith(unit)), "")
    if not close and stem in words:
        close = [stem]
    few = len(words) <= WORDS_TOLD
    near = get_close_matches(str(word)[:NAME_TOLD], words, n=5, cutoff=0.3)  # ours: a line of words at most
    listed = sorted(words) if few else [] if close else near
    there = f"there are {', '.join(listed)}" if listed else ""
    return "; ".join(part for part in (f"did you mean {close[0]}?" if close else "", there) if part)


def _fault(schema: Mapping[str, Any], value: object, place: str, error: Any, elsewhere: Mapping[str, str]) -> Fault:
    way = error["loc"] if error["type"] in (MISSING, *EXTRA) else _reached(value, error["loc"])
    reason = WRONG_FRAME if way[-1:] == ("frame",) else WRONG
    where = ".".join([place, *(str(part) for part in way)])
    return Fault(
        reason,
        where,
        told(named(value, way[:-1] if error["type"] == MISSING else way), _said(schema, error, elsewhere)),
    )


def _reached(value: Any, way: Sequence[object]) -> tuple[object, ...]:
    """The way without what pydantic adds behind its last step: the alternative that it tried."""
    for count, step in enumerate(way):
        if isinstance(value, dict):
            value = value.get(step, value)  # a step that is no member is the word of an alternative
        elif isinstance(value, list):
            value = value[step] if isinstance(step, int) and step < len(value) else value
        else:
            return tuple(way[:count])
    return tuple(way)


def _said(schema: Mapping[str, Any], error: Any, elsewhere: Mapping[str, str]) -> str:
    way, kind = error["loc"], error["type"]
    if kind in EXTRA:
        word = str(way[-1])
        if word in elsewhere:
            return f"{word} belongs to {elsewhere[word]}"
        ratio = next((by for unit, by in UNITS.items() if word.endswith(unit)), "")
        unit = f" (another unit: divide by {ratio})" if ratio else ""
        return f"no such member{unit}; {nearest(word, sorted(set(_members(schema, [schema], way[:-1]))))}"
    if kind == NO_WORD:
        expected = error["ctx"]["expected"]
        close = get_close_matches(
            str(error["input"])[:NAME_TOLD], [w.strip("' ") for w in expected.replace(" or ", ",").split(",")], 1
        )
        return f"one of {expected}" + (f"; did you mean {close[0]}?" if close else "")
    if kind == MISSING:
        return "is missing"
    said = str(error["msg"])
    return said[:1].lower() + said[1:]


def _members(schema: Mapping[str, Any], nodes: Sequence[Any], way: Sequence[object]) -> Iterator[str]:
    """Members that exist at a place, by the schema."""
    whole = list(_whole(schema, nodes))
    if not way:
        for node in whole:
            yield from node.get("properties", {})
        return
    step, left = way[0], way[1:]
    if isinstance(step, int):
        inner = [node["items"] for node in whole if "items" in node]
        yield from _members(schema, inner, left)
        return
    inner = [node["properties"][step] for node in whole if step in node.get("properties", {})]
    # A step of a union by a word (the kind of a motion) is no member.
    yield from _members(schema, inner or nodes, left)


def _whole(schema: Mapping[str, Any], nodes: Sequence[Any]) -> Iterator[Mapping[str, Any]]:
    """These nodes with references followed and alternatives side by side."""
    for node in nodes:
        if "$ref" in node:
            yield from _whole(schema, [schema["$defs"][node["$ref"].rpartition("/")[2]]])
        for several in ("anyOf", "oneOf"):
            yield from _whole(schema, node.get(several, ()))
        yield node
