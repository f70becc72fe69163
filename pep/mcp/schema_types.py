"""Types of JSON values that a tool's schema lets an argument have."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from collections.abc import Iterable

EVERY: Final = frozenset({"null", "boolean", "integer", "number", "string", "array", "object"})
DEPTH: Final = 8
"""Ours: references and alternatives are followed so far; beyond it any type is assumed."""
STEPS: Final = 1_000
"""Ours: most parts of one schema that are read; beyond them likewise."""


def types_of(schema: Any, root: Any) -> frozenset[str]:
    """Types that the schema lets a value have; every one where it does not say.

    Args:
        schema: of the value.
        root: the whole schema, in which references are looked up.
    """
    return _Reading(root).of(schema, DEPTH)


def members_of(schema: Any, root: Any) -> tuple[Any, ...]:
    """Schemas of the members of a list; none where the schema does not say it of each list.

    Args:
        schema: of the value.
        root: the whole schema, in which references are looked up.
    """
    return _Reading(root).members(schema, DEPTH)


class _Reading:
    """One reading of a schema, which ends: alternatives that refer to each other are endless."""

    def __init__(self, root: Any) -> None:
        self._root = root
        self._left = STEPS

    def of(self, schema: Any, depth: int) -> frozenset[str]:
        self._left -= 1
        if not isinstance(schema, dict) or depth < 1 or self._left < 0:
            return EVERY
        found = EVERY
        if (target := referenced(schema, self._root)) is not None:
            found &= self.of(target, depth - 1)
        stated = schema.get("type")
        if isinstance(stated, str):
            found &= {stated}
        elif isinstance(stated, list):
            found &= {each for each in stated if isinstance(each, str)}
        if "const" in schema:
            found &= _of_values([schema["const"]])
        if isinstance(schema.get("enum"), list):
            found &= _of_values(schema["enum"])
        for way in ("anyOf", "oneOf"):
            if isinstance(schema.get(way), list):
                found &= frozenset().union(*(self.of(each, depth - 1) for each in schema[way]))
        if isinstance(schema.get("allOf"), list):
            for each in schema["allOf"]:
                found &= self.of(each, depth - 1)
        return found

    def members(self, schema: Any, depth: int) -> tuple[Any, ...]:
        self._left -= 1
        if not isinstance(schema, dict) or depth < 1 or self._left < 0:
            return ()
        if "items" in schema:
            return (schema["items"],)
        if (target := referenced(schema, self._root)) is not None:
            return self.members(target, depth - 1)
        for way in ("anyOf", "oneOf", "allOf"):
            if isinstance(schema.get(way), list):
                lists = [each for each in schema[way] if "array" in self.of(each, depth - 1)]
                found = [self.members(each, depth - 1) for each in lists]
                return tuple(one for each in found for one in each) if all(found) else ()
        return ()


def referenced(schema: Any, root: Any) -> Any:
    """The part of the whole schema that this one refers to; None where it refers to none."""
    reference = schema.get("$ref") if isinstance(schema, dict) else None
    if not isinstance(reference, str) or not reference.startswith("#/"):
        return None
    found = root
    for step in reference[2:].split("/"):
        key = step.replace("~1", "/").replace("~0", "~")
        if not isinstance(found, dict) or key not in found:
            return None
        found = found[key]
    return found


def _of_values(values: Iterable[Any]) -> frozenset[str]:
    return frozenset(_type_of(each) for each in values)


def _type_of(value: Any) -> str:
    match value:
        case None:
            return "null"
        case bool():
            return "boolean"
        case int():
            return "integer"
        case float():
            return "number"
        case str():
            return "string"
        case list():
            return "array"
        case _:
            return "object"
