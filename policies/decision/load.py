"""Loader from strict TOML to a policy set: an unknown, missing or bad member is refused with code and place.

A set that loads can decide. Nothing is filled in silently but the parameters' defaults, and those are printed by `ztpm
policy check`.
"""

from __future__ import annotations

import math
import re
import tomllib
from dataclasses import dataclass, fields
from enum import StrEnum
from importlib import resources
from typing import TYPE_CHECKING, Final, TypeVar

from capabilities.values import text as forms
from capabilities.values.characters import shown
from capabilities.values.invisible import INVISIBLE
from capabilities.values.scope import Tier
from capabilities.values.text import NAME
from policies.decision.combine import AllOf, Always, AnyOf, Check, Not, Predicate
from policies.decision.policy import Object, Policy, PolicySet, Subject
from policies.evidence.model import Effect, Obligation, ObligationKind, Point
from policies.primitives.catalog import ROWS
from policies.words.errors import PolicyError, PolicyFault
from policies.words.parameters import PARAMETERS, Parameters

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from policies.primitives.base import Primitive

FORMAT: Final = 1
"""The form of the text that is read here; a text that states none is of this form."""
TEXT_LIMIT: Final = 262_144
"""Most characters of a policy set: a person could still read them."""
DEPTH_LIMIT: Final = 16
"""Levels of a predicate."""
MEMBER_LIMIT: Final = 256
"""Members of any list."""
NAME_LIMIT: Final = 128
"""Characters of a name."""
SHIPPED: Final = ("paper-default", "strict", "tools")
"""The sets that come with the package."""

PARTY: Final = re.compile(forms.REGISTERED, re.ASCII)
"""Agent or sponsor, as the identity provider registers it."""
OPERATION: Final = re.compile(forms.OPERATION, re.ASCII)
ANY: Final = "any"
NONE: Final = "none"
V = TypeVar("V", bound=StrEnum)


def load_shipped(name: str) -> PolicySet:
    """The shipped set of that name.

    Raises:
        PolicyError: `UNKNOWN_SET` when no such set is shipped.
    """
    if name not in SHIPPED:
        raise PolicyError(PolicyFault.UNKNOWN_SET, "name")
    return load(resources.files("policies").joinpath("sets", f"{name}.toml").read_text(encoding="utf-8"))


def load(text: str) -> PolicySet:
    """The policy set that `text` states.

    Args:
        text: TOML; `policies/sets/paper-default.toml` shows every key.

    Raises:
        PolicyError: with the fault and the place in the text.
    """
    if not isinstance(text, str):
        raise PolicyError(PolicyFault.WRONG_TYPE, "text")
    if len(text) > TEXT_LIMIT:
        raise PolicyError(PolicyFault.TOO_LARGE, "text", f"over {TEXT_LIMIT} characters")
    try:
        document = tomllib.loads(text)
    except (tomllib.TOMLDecodeError, RecursionError, ValueError) as error:
        raise PolicyError(PolicyFault.NOT_TOML, "text", str(error)[:NAME_LIMIT]) from error
    top = _Table(document, "")
    top.expect("name", "version", "policy", optional=("format", "parameters"))
    if "format" in document and top.integer("format", 0, 2**31 - 1) != FORMAT:
        raise PolicyError(PolicyFault.UNKNOWN_FORMAT, "format", f"this version reads {FORMAT}")
    parameters = _parameters(top)
    tables = top.list("policy")
    policies = tuple(_policy(_table(entry, f"policy[{i}]"), parameters) for i, entry in enumerate(tables))
    name, version = top.text("name"), top.integer("version", 1, 2**31 - 1)
    return PolicySet(name, version, policies, parameters)


@dataclass(frozen=True, slots=True)
class _Table:
    """A TOML table with its place, read strictly."""

    content: Mapping[str, object]
    where: str

    def place(self, key: str) -> str:
        return f"{self.where}.{key}" if self.where else key

    def expect(self, *required: str, optional: tuple[str, ...] = ()) -> None:
        """Exactly these keys."""
        for key in self.content:
            if key not in required and key not in optional:
                raise PolicyError(PolicyFault.UNKNOWN_KEY, self.place(key))
        for key in required:
            if key not in self.content:
                raise PolicyError(PolicyFault.MISSING_KEY, self.place(key))

    def text(self, key: str) -> str:
        return _text(self.content[key], self.place(key))

    def list(self, key: str) -> list[object]:
        return _list(self.content[key], self.place(key))

    def table(self, key: str) -> _Table:
        return _table(self.content[key], self.place(key))

    def integer(self, key: str, low: int, high: int) -> int:
        """An integer from `low` to `high`, both included."""
        value, where = self.content[key], self.place(key)
        if isinstance(value, float) and not math.isfinite(value):
            raise PolicyError(PolicyFault.NOT_FINITE, where)
        if isinstance(value, bool) or not isinstance(value, int):
            raise PolicyError(PolicyFault.WRONG_TYPE, where, "an integer is wanted")
        if not low <= value <= high:
            raise PolicyError(PolicyFault.OUT_OF_RANGE, where, f"{low} to {high}")
        return value

    def names(self, key: str, form: re.Pattern[str]) -> frozenset[str] | None:
        """A set of names of a form, or None for the word `any`."""
        return None if self.content[key] == ANY else self.exactly(key, form)

    def exactly(self, key: str, form: re.Pattern[str]) -> frozenset[str]:
        """A set of names of a form."""
        return frozenset(_distinct(self.content[key], self.place(key), lambda value, at: _name(value, at, form)))

    def words(self, key: str, kind: type[V]) -> frozenset[V]:
        """A set of members of a closed enum."""
        return frozenset(_distinct(self.content[key], self.place(key), lambda value, where: _word(value, where, kind)))


def _text(value: object, where: str) -> str:
    if not isinstance(value, str):
        raise PolicyError(PolicyFault.WRONG_TYPE, where, "a text is wanted")
    if not 0 < len(value) <= NAME_LIMIT or not value.isprintable() or not INVISIBLE.isdisjoint(value):
        raise PolicyError(PolicyFault.OUT_OF_RANGE, where, f"1 to {NAME_LIMIT} printable characters")
    return value


def _name(value: object, where: str, form: re.Pattern[str]) -> str:
    name = _text(value, where)
    if name == ANY:
        raise PolicyError(PolicyFault.NAME_MALFORMED, where, f'"{ANY}" stands alone, in no list')
    if form.fullmatch(name) is None:
        raise PolicyError(PolicyFault.NAME_MALFORMED, where, f"{shown(name)} is not of the form {form.pattern}")
    return name


def _list(value: object, where: str) -> list[object]:
    if not isinstance(value, list):
        raise PolicyError(PolicyFault.WRONG_TYPE, where, "a list is wanted")
    if not value:
        raise PolicyError(PolicyFault.EMPTY, where)
    if len(value) > MEMBER_LIMIT:
        raise PolicyError(PolicyFault.TOO_LARGE, where, f"over {MEMBER_LIMIT} members")
    return value


def _table(value: object, where: str) -> _Table:
    if not isinstance(value, dict):
        raise PolicyError(PolicyFault.WRONG_TYPE, where, "a table is wanted")
    return _Table(value, where)


def _word(value: object, where: str, kind: type[V]) -> V:
    word = _text(value, where)
    if word not in {str(member) for member in kind}:
        raise PolicyError(PolicyFault.UNKNOWN_VALUE, where, f"one of {', '.join(kind)}")
    return kind(word)


M = TypeVar("M")


def _distinct(value: object, where: str, read: Callable[[object, str], M]) -> list[M]:
    """A list's members, none twice."""
    members: list[M] = []
    for i, entry in enumerate(_list(value, where)):
        member = read(entry, f"{where}[{i}]")
        if member in members:
            raise PolicyError(PolicyFault.DUPLICATE_VALUE, f"{where}[{i}]")
        members.append(member)
    return members


def _parameters(top: _Table) -> Parameters:
    """Parameters of the set: the stated ones, else the defaults."""
    if "parameters" not in top.content:
        return Parameters()
    table = top.table("parameters")
    table.expect(optional=tuple(PARAMETERS))
    return Parameters(**{key: table.integer(key, PARAMETERS[key].low, PARAMETERS[key].high) for key in table.content})


def _policy(table: _Table, parameters: Parameters) -> Policy:
    """One 7-tuple. Every part is stated; none has a default."""
    table.expect("id", "subject", "object", "predicate", "ep", "effect", "obligation", "pit_bound")
    subject, thing = table.table("subject"), table.table("object")
    subject.expect("agents", "sponsors")
    thing.expect("ids", "operations", optional=("without",))
    try:
        return Policy(
            id=table.text("id"),
            subject=Subject(subject.names("agents", PARTY), subject.names("sponsors", PARTY)),
            object=Object(
                thing.names("ids", NAME),
                thing.names("operations", OPERATION),
                thing.exactly("without", OPERATION) if "without" in thing.content else frozenset(),
            ),
            predicate=_predicate(table.content["predicate"], table.place("predicate"), parameters, depth=0),
            points=table.words("ep", Point),
            effect=_word(table.content["effect"], table.place("effect"), Effect),
            obligations=frozenset(Obligation(kind) for kind in table.words("obligation", ObligationKind)),
            pit_bound=_pit_bound(table),
        )
    except PolicyError as error:
        # an error that only the whole policy shows is named by its part; here its place becomes known
        if error.where.startswith(table.where):
            raise
        raise PolicyError(error.code, table.place(error.where), error.detail) from error


def _pit_bound(table: _Table) -> Tier | None:
    """A tier 0 to 4, or None for the word `none`."""
    if table.content["pit_bound"] == NONE:
        return None
    return Tier(table.integer("pit_bound", min(Tier), max(Tier)))


def _predicate(value: object, where: str, parameters: Parameters, *, depth: int) -> Predicate:
    """A primitive's id, `{primitive, its parameters}`, `{all}`, `{any}`, `{not}`, or the word `always`."""
    if depth >= DEPTH_LIMIT:
        raise PolicyError(PolicyFault.TOO_DEEP, where)
    if isinstance(value, str):
        return (
            Always() if value == "always" else Check(_primitive(_Table({"primitive": value}, where), parameters, where))
        )
    table = _table(value, where)
    if "primitive" in table.content:
        return Check(_primitive(table, parameters, table.place("primitive")))
    if len(table.content) != 1:
        raise PolicyError(
            PolicyFault.EMPTY if not table.content else PolicyFault.UNKNOWN_KEY, where, "one of all, any, not"
        )
    (key,) = table.content
    match key:
        case "all" | "any":
            parts = tuple(
                _predicate(part, f"{table.place(key)}[{i}]", parameters, depth=depth + 1)
                for i, part in enumerate(table.list(key))
            )
            return AllOf(parts) if key == "all" else AnyOf(parts)
        case "not":
            return Not(_predicate(table.content[key], table.place(key), parameters, depth=depth + 1))
        case _:
            raise PolicyError(PolicyFault.UNKNOWN_KEY, table.place(key))


def _primitive(table: _Table, parameters: Parameters, where: str) -> Primitive:
    """The primitive with the values stated beside it, else the set's."""
    name = table.text("primitive")
    if name not in ROWS:
        raise PolicyError(PolicyFault.UNKNOWN_PRIMITIVE, where, name)
    row = ROWS[name]
    table.expect("primitive", optional=tuple(f.name for f in fields(row.decides)))
    values = {
        p.name: table.integer(p.name, p.low, p.high) if p.name in table.content else getattr(parameters, p.name)
        for p in row.parameters
    }
    try:
        return row.make(**values)
    except PolicyError as error:
        raise PolicyError(error.code, where, error.detail) from error
