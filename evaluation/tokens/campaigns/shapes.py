"""Shapes of valid tokens with parameters of every kind, from the smallest to those at the profile's bounds."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

from capabilities.values.chain import EvidenceKind
from capabilities.values.scope import (
    Budget,
    Each,
    Flags,
    Grant,
    Limit,
    OneOf,
    Range,
    Restriction,
    Scope,
    Stems,
    Tier,
    Words,
)
from capabilities.values.units import INT_LIMIT, DeclaredUnit, ListOf, Parameter, Sort, Unit
from evaluation.tokens.campaigns.issuer import AT, ATTESTED_AT, CELLS, SPONSOR, chain_of

if TYPE_CHECKING:
    from collections.abc import Iterator

    from evaluation.tokens.campaigns.issuer import Issuer

JOINTS: Final = tuple(Parameter(f"q{i}", Unit.MICRORADIAN) for i in range(6))
SPEED: Final = Parameter("speed", Unit.MICRORADIAN_PER_SECOND)
FORCE: Final = Parameter("force", Unit.MILLINEWTON)
_AGENTS: Final = tuple(f"agent-{n}" for n in range(9))

SMALL: Final = Scope(
    grants=(Grant("r", "s"),),
    ceiling=Tier.NO_EFFECT,
    audiences=frozenset({CELLS[0]}),
    delegates=frozenset(),
    depth=0,
    not_before=ATTESTED_AT,
    not_after=AT + 900,
)
MOVE: Final = Grant(
    "ur3e",
    "move_joint",
    (*(Limit(joint, Range(-6_283_185, 6_283_185)) for joint in JOINTS), Limit(SPEED, Range(1, 1_000_000))),
)
GRIP: Final = Grant(
    "ur3e",
    "gripper_move",
    (Limit(Parameter("width", Unit.MICROMETRE), Range(0, 85_000)), Limit(FORCE, OneOf(frozenset({10, 20, 40})))),
)
READ: Final = Grant("ur3e", "read_state")
STOP: Final = Grant("ur3e", "stop")
WIDE: Final = Scope(
    grants=(GRIP, MOVE, READ, STOP),
    ceiling=Tier.HIGH_CONSEQUENCE,
    audiences=frozenset(CELLS),
    delegates=frozenset({*_AGENTS, "role:planner"}),
    depth=8,
    not_before=ATTESTED_AT,
    not_after=AT + 3_000,
)


def _set(size: int) -> OneOf:
    return OneOf(frozenset(7 * n - 200 for n in range(size)))


OF_EVERY_KIND: Final = (
    Limit(Parameter("flag", Sort.FLAG), Flags(frozenset({False, True}))),
    Limit(Parameter("title", Sort.TEXT), Stems(frozenset({"ab", "é"}), "")),
    Limit(Parameter("name", Sort.TEXT), Words(frozenset({"read", "write"}))),
    Limit(Parameter("file", Sort.PATH), Stems(frozenset({"/srv", "/home/x"}), "/")),
    Limit(Parameter("page", Sort.URL), Stems(frozenset({"https://a.example"}), "/")),
    Limit(Parameter("body", Sort.FREE), Range(1, 4_096)),
    Limit(Parameter("pressure", DeclaredUnit("x-bar", 1_000)), Range(0, 900)),
    Limit(Parameter("files", ListOf(Sort.PATH)), Each(Stems(frozenset({"/srv"}), "/"), 0, 9)),
    Limit(Parameter("counts", ListOf(Unit.COUNT)), Each(OneOf(frozenset({1, 5})), 1, 2)),
)
_FIRST_BUDGETS: Final = (Budget("", CELLS[0], 60, 10), Budget("pressure", CELLS[0], 3_600, INT_LIMIT))
_KINDS: Final = replace(
    SMALL,
    grants=(Grant("r", "s", OF_EVERY_KIND, _FIRST_BUDGETS), STOP),
    delegates=frozenset({_AGENTS[1]}),
    depth=1,
)
LESS_OF_EVERY_KIND: Final = Restriction(
    grants=(
        Grant(
            "r",
            "s",
            (
                Limit(Parameter("flag", Sort.FLAG), Flags(frozenset({False}))),
                Limit(Parameter("title", Sort.TEXT), Words(frozenset({"abc"}))),
                Limit(Parameter("file", Sort.PATH), Stems(frozenset({"/srv/a"}), "/")),
                Limit(Parameter("files", ListOf(Sort.PATH)), Each(Stems(frozenset({"/srv/a"}), "/"), 1, 5)),
            ),
            (Budget("", CELLS[0], 20, 3), *_FIRST_BUDGETS[1:]),
        ),
    )
)


def _limited(*bounds: Range | OneOf) -> Scope:
    limits = tuple(Limit(Parameter(f"p{i}", Unit.COUNT), bound) for i, bound in enumerate(bounds))
    return replace(SMALL, grants=(Grant("r", "s", limits),))


_FIRST: Final = {
    "smallest": SMALL,
    "one range": _limited(Range(0, 1)),
    "one set": _limited(OneOf(frozenset({1, 5}))),
    "four operations": WIDE,
    "64 operations": replace(WIDE, grants=tuple(Grant("r", f"s{n:02}") for n in range(64))),
    "32 parameters": _limited(*(Range(-n, n) for n in range(32))),
    "a set of 64": _limited(_set(64)),
    "largest integers": _limited(Range(-INT_LIMIT, INT_LIMIT), OneOf(frozenset({-INT_LIMIT, INT_LIMIT}))),
    "64 delegates": replace(WIDE, delegates=frozenset(f"agent-{n}" for n in range(64))),
    "every kind": _KINDS,
    "longest names": replace(
        SMALL,
        grants=(Grant("o" * 256, "p" * 256),),
        audiences=frozenset({CELLS[0], "https://a.example/" + "b" * 238}),
        delegates=frozenset({"d" * 256}),
        depth=1,
    ),
}


@dataclass(frozen=True, slots=True)
class Issued:
    """Tokens of every shape by name, and every token that was issued on the way."""

    shapes: dict[str, bytes]
    all: frozenset[bytes]


def issue(issuer: Issuer) -> Issued:
    """Every shape, each of which verifies."""
    shapes: dict[str, bytes] = {}
    everything: set[bytes] = set()
    for name, family in _families(issuer):
        shapes[name] = family[-1]
        everything.update(family)
    for token in everything:
        chain_of(issuer.verifier(), token)
    return Issued(shapes, frozenset(everything))


def _families(issuer: Issuer) -> Iterator[tuple[str, list[bytes]]]:
    for name, scope in _FIRST.items():
        yield name, [issuer.mint(scope)]
    person = SPONSOR.subject
    yield "a long purpose", [issuer.mint(SMALL, issuer.holder("first", person, purpose="“größer” " * 34))]
    jwt = issuer.holder("first", person, kind=EvidenceKind.JWT)
    yield "a platform's word", [issuer.mint(replace(SMALL, ceiling=Tier.SAFETY_CRITICAL), jwt)]
    yield "a hop that drops an audience", descend(issuer, [Restriction(audiences=frozenset(CELLS[:2]))])
    yield "a hop in every kind", descend(issuer, [LESS_OF_EVERY_KIND], first=_KINDS)
    yield "a hop by role", descend(issuer, [Restriction(ceiling=Tier.REVERSIBLE)], role="planner")
    for depth in (1, 2, 3, 4, 6, 8):
        yield f"{depth} hops", descend(issuer, [tighter(n) for n in range(1, depth + 1)])


def tighter(hop: int) -> Restriction:
    """A hop that narrows three limits, the delegates and the window, and keeps three operations."""
    limits = (
        Limit(JOINTS[0], Range(-5_000_000 + hop, 5_000_000 - hop)),
        Limit(JOINTS[3], Range(-1_000 + hop, 1_000 - hop)),
        Limit(SPEED, Range(1, 500_000 - hop)),
    )
    return Restriction(
        grants=(Grant("ur3e", "move_joint", limits), READ, STOP),
        delegates=frozenset(_AGENTS[hop + 1 :]),
        not_after=WIDE.not_after - hop,
    )


def descend(issuer: Issuer, restrictions: list[Restriction], *, role: str = "", first: Scope = WIDE) -> list[bytes]:
    """The first token, by default the widest, and one more for each restriction, each a hop below the one before."""
    verifier, family = issuer.verifier(), [issuer.mint(first)]
    for n, restriction in enumerate(restrictions, 1):
        chain = chain_of(verifier, family[-1])
        agent = f"of-a-role-{n}" if role else _AGENTS[n]
        hop = issuer.holder(agent, chain.leaf.agent, role=role)
        attester = "attester-2" if n % 2 else "attester"
        family.append(issuer.delegate(family[-1], chain, hop, restriction, attester=attester))
    return family
