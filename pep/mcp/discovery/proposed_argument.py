"""Declarations proposed for one argument of a tool, from its JSON schema: the one that says most first.

Each is a value of a `[tool.NAME.arguments]` table, as docs/guard.md has them, with notes on what it rests on. Which of
them the guard takes is asked of the guard's own checks (`pep.mcp.discovery.proposed_tool`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from fractions import Fraction
from typing import TYPE_CHECKING, Any, Final, TypeAlias

from capabilities.values.units import INT_LIMIT
from capabilities.values.well_formed import LIST_LENGTH
from pep.base.declaration import ELEMENTS
from pep.base.stated_values import is_whole
from pep.mcp.discovery.guessed_unit import guess_units, name_words
from pep.mcp.schema_types import DEPTH, referenced, types_of

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence

Toml: TypeAlias = "str | dict[str, Any]"
"""One declaration as a table of TOML has it."""

FREE_BYTES: Final = 4_096
"""Ours: most bytes of a free value that is proposed."""
NULL_BYTES: Final = 4
"""The canonical JSON of null."""
LIST_MOST: Final = 64
"""Ours: greatest length of a list whose schema states none."""
COUNT_MOST: Final = 100
"""Ours: greatest integer where the schema states none, the least one being 0: narrow, so that a person looks."""
OWN_SCALE: Final = 1_000
"""Ours: scale of a number whose unit nothing tells."""
SAID_TYPES: Final = 3
"""Types that are named; of more an argument is of nearly any."""
PATH_WORDS: Final = frozenset(
    {"path", "paths", "file", "files", "filename", "filepath", "dir", "directory", "directories", "folder"}
)
URL_WORDS: Final = frozenset({"url", "urls", "uri", "uris", "href", "link"})
CODE_WORDS: Final = frozenset({"code", "command", "cmd", "script", "program", "sql", "shell", "expression"})
PLACE_WORDS: Final = frozenset(
    {"to", "cc", "bcc", "recipient", "recipients", "email", "address", "channel", "webhook", "phone", "iban"}
)

_ANY_TEXT: Final = "any JSON but a text passes: only its size is limited, and a text is refused"
_PATH: Final = (
    'name directories: under = ["/..."], root = "/" follows links; a relative path is refused, "text" takes it'
)
_URL: Final = 'name origins: under = ["https://..."]; one with a query is refused, "text" takes it'
_CODE: Final = "a text that may be run: nothing in it is limited"
_PLACE: Final = "if the effect goes there, add destination = true"


@dataclass(frozen=True, slots=True)
class ProposedArgument:
    """Declaration that is proposed for one argument.

    Attributes:
        name: of the argument.
        stated: its value in the table.
        notes: what it rests on.
        review: what a person has to look at before it is used.
        missing: why no declaration fits; "" where one does.
    """

    name: str
    stated: Toml = field(default_factory=dict)
    notes: tuple[str, ...] = ()
    review: tuple[str, ...] = ()
    missing: str = ""


def proposed_arguments(
    name: str, schema: Mapping[str, Any], *, root: Any, needed: bool, said: str
) -> Sequence[ProposedArgument]:
    """Proposals for an argument, the one that says most first; the last may be one that is `missing`.

    Args:
        name: of the argument.
        schema: of it.
        root: schema of the tool.
        needed: whether a call has to give it.
        said: words of the tool's own description about it.
    """
    own = schema.get("description")
    spoken = {**schema, "description": f"{own if isinstance(own, str) else ''}\n{said}"}
    found = list(_of(name, spoken, root, needed=needed))
    if needed or "default" in schema:
        return found
    always = "the schema states no default: each call has to give it"
    return [each if each.missing else replace(each, notes=(*each.notes, always)) for each in found]


def _of(name: str, schema: Mapping[str, Any], root: Any, *, needed: bool) -> Iterator[ProposedArgument]:
    ways: dict[str, Callable[[str, Mapping[str, Any]], Iterator[ProposedArgument]]] = {
        "boolean": _flag,
        "string": _text,
        "integer": _integer,
        "number": _number,
        "array": _list,
    }
    stated = str(schema.get("type"))
    way = ways.get(stated)
    if way is not None:
        yield from way(name, schema)
    if stated in {"array", "object", "null"}:
        bytes_most = NULL_BYTES if stated == "null" else FREE_BYTES
        yield _free(name, "of any members: only its size is limited", bytes_most)
    elif way is None and types_of(schema, root) == {"string"}:
        yield from _text(name, _followed(schema, root))
    elif way is None:
        yield _several(name, schema, root, needed=needed)


def _followed(schema: Mapping[str, Any], root: Any) -> Mapping[str, Any]:
    """The schema with all that its references say; what it says itself goes before."""
    for _ in range(DEPTH):
        target = referenced(schema, root)
        if not isinstance(target, dict):
            break
        schema = {**target, **{key: each for key, each in schema.items() if key != "$ref"}}
    return schema


def _several(name: str, schema: Mapping[str, Any], root: Any, *, needed: bool) -> ProposedArgument:
    """The proposal for an argument whose type is not stated as one word."""
    types = types_of(schema, root)
    said = " or ".join(sorted(types)) if len(types) <= SAID_TYPES else "nearly any type"
    if "string" not in types:
        return _free(name, f"of {said}: only its size is limited", NULL_BYTES if types == {"null"} else FREE_BYTES)
    if types == {"string", "null"}:
        if needed:
            return ProposedArgument(name, missing="text or null: an argument of two types cannot be declared")
        why = "text or null cannot be declared: only null passes, as where it is left out"
        return _free(name, why, NULL_BYTES)
    return _free(name, f"of {said}: {_ANY_TEXT}", FREE_BYTES)


def _free(name: str, why: str, most_bytes: int) -> ProposedArgument:
    return ProposedArgument(name, {"kind": "free", "most_bytes": most_bytes}, review=(why,))


# --- one value -------------------------------------------------------------------------------------------------------


def _flag(name: str, _schema: Mapping[str, Any]) -> Iterator[ProposedArgument]:
    yield ProposedArgument(name, "flag")


def _text(name: str, schema: Mapping[str, Any]) -> Iterator[ProposedArgument]:
    chosen = [schema["const"]] if "const" in schema else schema.get("enum")
    words = set(name_words(name))
    if isinstance(chosen, list) and chosen and all(isinstance(each, str) for each in chosen):
        yield ProposedArgument(name, {"kind": "text", "one_of": list(dict.fromkeys(chosen))})
        yield ProposedArgument(name, "text", review=("its set of words cannot be declared: every text passes",))
        return
    if schema.get("format") in {"uri", "url"} or words & URL_WORDS:
        yield ProposedArgument(name, {"kind": "url"}, review=(_URL,))
    elif words & PATH_WORDS:
        yield ProposedArgument(name, {"kind": "path"}, review=(_PATH,))
    review = (_CODE,) if words & CODE_WORDS else (_PLACE,) if words & PLACE_WORDS else ()
    if words & (URL_WORDS | PATH_WORDS) or schema.get("format") in {"uri", "url"}:
        review = (*review, "it says a place, and its default is none in the one spelling: every text passes")
    yield ProposedArgument(name, "text", review=review)


def _integer(name: str, schema: Mapping[str, Any]) -> Iterator[ProposedArgument]:
    chosen = [schema["const"]] if "const" in schema else schema.get("enum")
    if isinstance(chosen, list) and chosen and all(map(is_whole, chosen)):
        yield ProposedArgument(name, {"one_of": list(dict.fromkeys(chosen)), "integer": True})
    low, high, review = _range(schema, scale=1, least=0, most=COUNT_MOST)
    yield ProposedArgument(name, {"low": low, "high": high, "unit": "count", "integer": True}, review=review)


def _number(name: str, schema: Mapping[str, Any]) -> Iterator[ProposedArgument]:
    said = " ".join(each for key in ("title", "description") if isinstance(each := schema.get(key), str))
    units = guess_units(name, said)
    notes: tuple[str, ...] = ()
    doubts: tuple[str, ...] = ()
    if units:
        unit, scale = units[0].unit, units[0].scale
        notes = (f"unit {unit}, {scale} of which make one: from {units[0].said}",)
        if len(units) > 1:
            doubts = ("its unit is in doubt: " + ", but ".join(f"{each.unit} from {each.said}" for each in units),)
    else:
        unit, scale = _own_unit(name), OWN_SCALE
        doubts = (f"nothing tells its unit: {unit}, {scale} of which make one, is a stand-in",)
    low, high, review = _range(schema, scale=scale, least=-1, most=1)
    stated = {"low": low, "high": high, "unit": unit, "scale": scale}
    yield ProposedArgument(name, stated, notes=notes, review=(*doubts, *review))


def _own_unit(name: str) -> str:
    spelled = "_".join(name_words(name)).lstrip("0123456789_")
    return f"x-{spelled[:31].rstrip('_') or 'unit'}"


def _range(schema: Mapping[str, Any], *, scale: int, least: int, most: int) -> tuple[int, int, tuple[str, ...]]:
    """Bounds in integers of the unit, and what is to review.

    Args:
        schema: of a number.
        scale: so many of the unit make one of the schema's numbers.
        least: proposed where the schema states none, in its numbers.
        most: likewise.
    """
    low, high = _edge(schema, "inimum", scale, math.ceil, 1), _edge(schema, "aximum", scale, math.floor, -1)
    review: tuple[str, ...] = ()
    if low is None or high is None:
        missing = " and ".join(word for word, edge in (("least", low), ("greatest", high)) if edge is None)
        review = (f"the schema states no {missing} value: this one is ours, and narrow",)
    if low is None:
        low = min(least * scale, least * scale if high is None else high)
    if high is None:
        high = max(most * scale, low)
    default = _exact(schema.get("default"))
    if default is not None and not low <= default * scale <= high:
        low, high = min(low, math.floor(default * scale)), max(high, math.ceil(default * scale))
        review = (*review, "widened to let the schema's own default pass")
    return max(low, -INT_LIMIT), min(high, INT_LIMIT), review


def _edge(schema: Mapping[str, Any], end: str, scale: int, inward: Callable[[Fraction], int], step: int) -> int | None:
    """One bound in integers of the unit, the tighter of the schema's two ways to state it."""
    found: list[int] = []
    if (stated := _exact(schema.get(f"m{end}"))) is not None:
        found.append(inward(stated * scale))
    exclusive = schema.get(f"exclusiveM{end}")
    if exclusive is True and stated is not None:  # draft 4: a flag beside the bound
        exclusive = schema.get(f"m{end}")
    if (beyond := _exact(exclusive)) is not None:
        edge = inward(beyond * scale)
        found.append(edge + step if edge == beyond * scale else edge)
    if not found:
        return None
    return max(found) if step > 0 else min(found)


def _exact(value: object) -> Fraction | None:
    """The number as its shortest decimal says it; None for what is no finite number."""
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not math.isfinite(value):
        return None
    return Fraction(repr(value))


# --- lists -----------------------------------------------------------------------------------------------------------


def _list(name: str, schema: Mapping[str, Any]) -> Iterator[ProposedArgument]:
    items = schema.get("items")
    if not isinstance(items, dict):
        return
    kind, least, most = str(items.get("type")), _length(schema, "minItems"), _length(schema, "maxItems")
    if kind not in {"boolean", "string", "integer", "number"}:
        return
    ways = {"boolean": _flag, "string": _text, "integer": _integer, "number": _number}
    spoken = {key: schema[key] for key in ("title", "description") if key in schema}
    for one in ways[kind](name, {**spoken, **items}):
        if kind == "number" and least is not None and least == most and 1 <= least <= ELEMENTS:
            yield replace(one, stated={**_table(one.stated), "elements": least})
            continue
        length = [least or 0, LIST_MOST if most is None else most]
        review = one.review
        if most is None:
            length[1] = max(length)
            review = (*review, f"the schema states no greatest length: {length[1]} is ours")
        yield replace(one, stated={**_table(one.stated), "list": length}, review=review)


def _length(schema: Mapping[str, Any], key: str) -> int | None:
    stated = schema.get(key)
    return min(stated, LIST_LENGTH) if is_whole(stated) and isinstance(stated, int) and stated >= 0 else None


def _table(stated: Toml) -> dict[str, Any]:
    return {"kind": stated} if isinstance(stated, str) else stated
