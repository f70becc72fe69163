"""One policy out of its table, and the numbers of a set out of theirs."""

from __future__ import annotations

import re
from dataclasses import fields
from typing import TYPE_CHECKING, Final

from capabilities.statements.people.latch import LatchCause
from capabilities.values import text as forms
from capabilities.values.scope import Tier
from capabilities.values.text import NAME
from policies.decision.combine import AllOf, Always, AnyOf, Check, Not, Predicate
from policies.decision.policy import Object, Policy, Subject
from policies.decision.table import Table, table_of, word_of
from policies.evidence.model import Effect, Obligation, ObligationKind, Point
from policies.primitives.catalog import ROWS
from policies.words.errors import PolicyError, PolicyFault
from policies.words.parameters import PARAMETERS, Parameters

if TYPE_CHECKING:
    from policies.primitives.base import Primitive

DEPTH_LIMIT: Final = 16
"""Levels of a predicate."""
PARTY: Final = re.compile(forms.REGISTERED, re.ASCII)
"""Agent or sponsor, as the identity provider registers it."""
OPERATION: Final = re.compile(forms.OPERATION, re.ASCII)
NONE: Final = "none"
PARTS: Final = ("subject", "object", "predicate", "ep", "effect", "obligation", "pit_bound")
"""Parts of a policy's table, beside its id."""
LATCH: Final = ("latch", "latch_on")
"""Members of a set that say after which stops a robot waits for a person."""
PERSON: Final = "person"
LATCHING: Final = frozenset(LatchCause) - {LatchCause.UNREADABLE}
"""Stops that a set may name. A file of a latch that cannot be read latches in any case."""


def parameters_of(table: Table) -> Parameters:
    """Parameters of a set: the stated ones, else the defaults."""
    table.expect(optional=tuple(PARAMETERS))
    return Parameters(**{key: table.integer(key, PARAMETERS[key].low, PARAMETERS[key].high) for key in table.content})


def latch_of(top: Table) -> frozenset[LatchCause]:
    """Stops after which a robot waits for a person: those of `latch_on`, or all; none without `latch = "person"`.

    Raises:
        PolicyError: `UNKNOWN_VALUE` for another word, `MISSING_KEY` for `latch_on` alone.
    """
    stated = top.text("latch") if "latch" in top.content else NONE
    if stated not in (NONE, PERSON):
        raise PolicyError(PolicyFault.UNKNOWN_VALUE, "latch", f"{NONE} or {PERSON}")
    if "latch_on" in top.content and stated == NONE:
        raise PolicyError(PolicyFault.MISSING_KEY, "latch", f"latch_on wants latch = {PERSON!r}")
    if stated == NONE:
        return frozenset()
    named = top.words("latch_on", LatchCause) if "latch_on" in top.content else LATCHING
    if not named <= LATCHING:
        raise PolicyError(PolicyFault.UNKNOWN_VALUE, "latch_on", ", ".join(sorted(LATCHING)))
    return named


def policy_of(table: Table, parameters: Parameters) -> Policy:
    """One 7-tuple. Every part is stated; none has a default."""
    table.expect("id", *PARTS)
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
            effect=word_of(table.content["effect"], table.place("effect"), Effect),
            obligations=frozenset(Obligation(kind) for kind in table.words("obligation", ObligationKind)),
            pit_bound=_pit_bound(table),
        )
    except PolicyError as error:
        # an error that only the whole policy shows is named by its part; here its place becomes known
        if error.where.startswith(table.where):
            raise
        raise PolicyError(error.code, table.place(error.where), error.detail) from error


def _pit_bound(table: Table) -> Tier | None:
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
            Always() if value == "always" else Check(_primitive(Table({"primitive": value}, where), parameters, where))
        )
    table = table_of(value, where)
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


def _primitive(table: Table, parameters: Parameters, where: str) -> Primitive:
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
