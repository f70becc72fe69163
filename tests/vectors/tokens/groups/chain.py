"""[TOK-6], items 4 to 9, and the lifetimes of [TOK-7]: a hop continues the hop before it and narrows it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

from capabilities.token import hop_rules
from capabilities.values import algebra
from capabilities.values.caps import DEFAULT
from capabilities.values.chain import EvidenceKind
from capabilities.values.errors import FaultCode
from capabilities.values.scope import Grant, Limit, OneOf, Range, Restriction, Scope, Tier
from capabilities.values.units import Parameter, Unit
from tests.vectors.tokens.cases import Accepted, Case, Faulty, Group, Made, faults, group
from tests.vectors.tokens.ordinary import (
    CELL,
    FORCE,
    LESS,
    MOVE,
    NOW,
    Q0,
    Q1,
    READ,
    SCOPE,
    SLOWER,
    SMALL,
    SPEED,
    STOP,
    WIDTH,
    authority,
    hop,
    hop_id_of,
)
from tests.vectors.tokens.sealing import raw_of

BROKEN, WIDER = FaultCode.CHAIN_BROKEN, FaultCode.NOT_NARROWER


def below(restriction: Restriction = LESS, *, parent: Scope = SMALL, **other: Any) -> Callable[[], Made]:
    """A hop below an ordinary authority block of this scope."""
    return lambda: hop(authority(parent), restriction, parent=parent, **other)


def third(**other: Any) -> Callable[[], Made]:
    """A second hop, below `robotic`."""
    return lambda: hop(hop(authority(), SLOWER), LESS, **{"agent": "vision", **other})


def child_of(parent: Scope, **stated: Any) -> Scope:
    """Scope of a child, said by hand: every stated dimension, the others kept, one hop less."""
    return replace(parent, **{"depth": parent.depth - 1, **stated})


ONE = replace(SMALL, depth=1)
NONE = replace(SMALL, depth=0)
ROLES = replace(SMALL, delegates=frozenset({"role:planner", "role:x", "planner"}))

HOLDERS = group(
    "holders",
    "Who may be the next holder, under which key, at which place.",
    faults(
        BROKEN,
        "TOK-6",
        {
            "Index one in the authority block": lambda: authority(SMALL, index=1),
            "Index minus one in the authority block": lambda: authority(SMALL, index=-1),
            "Index zero in a hop": below(index=0),
            "The next index but one": below(index=2),
            "Index one in the second hop": third(index=1),
            "The agent of the authority block again": lambda: hop(
                authority(replace(SMALL, delegates=frozenset({"orchestrator"}))),
                Restriction(ceiling=Tier.NO_EFFECT),
                parent=SMALL,
                agent="orchestrator",
                key=raw_of("robotic"),
                hop_id=hop_id_of("robotic"),
            ),
            "The key of the authority block again": below(key=raw_of("orchestrator")),
            "The hop id of the authority block again": below(hop_id=hop_id_of("orchestrator")),
            "The agent of a hop again": lambda: hop(
                hop(authority(), replace(SLOWER, delegates=frozenset({"robotic"}))),
                LESS,
                agent="robotic",
                key=raw_of("other"),
                hop_id=hop_id_of("other"),
            ),
            "The key of a hop again": third(key=raw_of("robotic")),
            "The hop id of a hop again": third(hop_id=hop_id_of("robotic")),
            "The key of the first holder in the second hop": third(key=raw_of("orchestrator")),
        },
    ),
    faults(
        FaultCode.KEY_WRONG_ROLE,
        "TOK-6",
        {
            **{
                f"The {role} key as a holder's": lambda role=role: authority(SMALL, key=raw_of(role))
                for role in ("root", "attester", "feed", "registry", "ledger")
            },
            "The key of another attester as a delegate's": below(key=raw_of("attester-2")),
            "The root key as a delegate's": below(key=raw_of("root")),
        },
    ),
    Case(
        "A holder that has become an attester",
        "TOK-6",
        below(),
        Faulty(FaultCode.KEY_WRONG_ROLE, "TOK-6"),
        {"trust": "robotic attests"},
    ),
    faults(
        FaultCode.TOO_MANY_HOPS,
        "TOK-6",
        {
            "No depth is left": below(parent=NONE),
            "No depth is left below a hop": lambda: hop(
                hop(authority(ONE), LESS, parent=ONE), Restriction(delegates=frozenset()), parent=ONE, agent="vision"
            ),
            "A hop stated that none may follow": lambda: hop(
                hop(authority(SCOPE), replace(SLOWER, depth=0)), LESS, agent="vision"
            ),
        },
    ),
    faults(
        FaultCode.DELEGATE_NOT_ALLOWED,
        "TOK-6",
        {
            "A delegate that is not named": below(agent="eve"),
            "A delegate in other letters": below(agent="Robotic"),
            "A delegate with more behind its name": below(agent="robotic2"),
            "A role that is not named": below(agent="eve", role="boss", parent=ROLES),
            "A role in other letters": below(agent="eve", role="Planner", parent=ROLES),
            "An agent that has the name of a role": below(agent="x", parent=ROLES),
            "A role that has the name of an agent": below(
                agent="eve", role="robotic", parent=replace(SMALL, delegates=frozenset({"robotic"}))
            ),
            "A delegate that an earlier hop left out": lambda: hop(
                hop(authority(), replace(SLOWER, delegates=frozenset({"gripper"}))), LESS, agent="vision"
            ),
            "Nobody is named": lambda: hop(authority(replace(SMALL, delegates=frozenset())), LESS, parent=SMALL),
        },
    ),
    Case(
        "A delegate by its role",
        "TOK-6",
        below(agent="eve", role="planner", parent=ROLES),
        Accepted(child_of(ROLES, ceiling=Tier.NO_EFFECT)),
    ),
    Case(
        "A delegate by its name, its role not named",
        "TOK-6",
        below(agent="planner", role="boss", parent=ROLES),
        Accepted(child_of(ROLES, ceiling=Tier.NO_EFFECT)),
    ),
    Case("The last hop that depth allows", "TOK-6", below(parent=ONE), Accepted(child_of(ONE, ceiling=Tier.NO_EFFECT))),
)


# --- narrowing -------------------------------------------------------------------------------------------------------------


def move(*limits: Limit) -> Restriction:
    return Restriction(grants=(Grant("ur3e", "move_joint", limits),))


def grip(*limits: Limit) -> Restriction:
    return Restriction(grants=(Grant("ur3e", "gripper_move", limits),))


def moved(**bounds: Any) -> tuple[Grant, ...]:
    """`move_joint` alone with these bounds, the others kept."""
    limits = tuple(Limit(x.parameter, bounds.get(x.parameter.name, x.bound)) for x in MOVE.limits)
    return (Grant("ur3e", "move_joint", limits),)


def gripped(**bounds: Any) -> tuple[Grant, ...]:
    found = next(grant for grant in SCOPE.grants if grant.operation == "gripper_move")
    return (
        Grant(
            "ur3e",
            "gripper_move",
            tuple(Limit(x.parameter, bounds.get(x.parameter.name, x.bound)) for x in found.limits),
        ),
    )


CLOSE = Scope(
    (Grant("arm", "go", (Limit(Parameter("n", Unit.COUNT), OneOf(frozenset({1, 2, 3, 7}))),)),),
    Tier.REVERSIBLE,
    frozenset({CELL}),
    frozenset({"robotic"}),
    2,
    NOW - 60,
    NOW + 600,
)


def close(bound: Range | OneOf) -> Restriction:
    return Restriction(grants=(Grant("arm", "go", (Limit(Parameter("n", Unit.COUNT), bound),)),))


def closed(bound: Range | OneOf) -> Scope:
    return child_of(CLOSE, grants=close(bound).grants)


def narrower(title: str, restriction: Restriction, **left: Any) -> Case:
    """A hop below the ordinary scope, accepted; `left` is what it leaves, by hand."""
    expected = child_of(SCOPE, **left)
    assert algebra.stated(SCOPE, restriction) == expected, title
    return Case(title, "TOK-6", below(restriction, parent=SCOPE), Accepted(expected))


def wider(title: str, restriction: Restriction, parent: Scope = SCOPE, **other: Any) -> Case:
    return Case(title, "TOK-6", below(restriction, parent=parent, **other), Faulty(WIDER, "TOK-6"))


def signature(*limits: tuple[str, int]) -> Restriction:
    """A restriction that states an operation over other parameters."""
    return Restriction(
        grants=(Grant("ur3e", "stop", tuple(Limit(Parameter(n, Unit.COUNT), Range(0, top)) for n, top in limits)),)
    )


NARROWING = group(
    "narrowing",
    "Each dimension of a hop: wider, the same, and less.",
    wider("Nothing stated", Restriction()),
    wider("Only depth and window stated", Restriction(depth=1, not_before=NOW - 50, not_after=NOW + 9)),
    wider("The same ceiling", Restriction(ceiling=SCOPE.ceiling)),
    wider("The same grants", Restriction(grants=tuple(Grant(g.object, g.operation) for g in SCOPE.grants))),
    wider(
        "The same limits",
        Restriction(grants=tuple(g if g == MOVE else Grant(g.object, g.operation) for g in SCOPE.grants)),
    ),
    wider("The same audiences and delegates", Restriction(audiences=SCOPE.audiences, delegates=SCOPE.delegates)),
    wider("A higher ceiling", replace(SLOWER, ceiling=Tier.SAFETY_CRITICAL), evidence="jwt"),
    wider("Another audience", replace(SLOWER, audiences=frozenset({"http://127.0.0.1:9002/mcp"}))),
    wider("An audience more", replace(SLOWER, audiences=SCOPE.audiences | {"http://127.0.0.1:9002/mcp"})),
    wider("Another delegate", replace(SLOWER, delegates=frozenset({"eve"}))),
    wider("An agent for a role", replace(SLOWER, delegates=frozenset({"planner"}))),
    wider("Another role", replace(SLOWER, delegates=frozenset({"role:boss"}))),
    wider("The same depth", replace(SLOWER, depth=SCOPE.depth)),
    wider("More depth", replace(SLOWER, depth=SCOPE.depth + 1)),
    wider("A later end", replace(SLOWER, not_after=SCOPE.not_after + 1)),
    wider("An earlier start", replace(SLOWER, not_before=SCOPE.not_before - 1)),
    wider("No time left", replace(SLOWER, not_before=NOW + 2_000)),
    wider("An end before the start", replace(SLOWER, not_before=NOW + 2_001)),
    wider("A window before the parent's", replace(SLOWER, not_before=NOW - 90, not_after=NOW - 80)),
    wider("An operation that the parent lacks", Restriction(grants=(Grant("ur3e", "set_payload"),))),
    wider("An object that the parent lacks", Restriction(grants=(Grant("ur5e", "stop"),))),
    wider("An operation more", Restriction(grants=(READ, Grant("ur3e", "set_payload"), STOP))),
    wider("A parameter more", signature(("n", 1)), parent=replace(SCOPE, grants=(READ,))),
    Case(
        "A parameter more than the parent's operation",
        "TOK-6",
        below(
            Restriction(grants=(STOP,)), parent=SCOPE, texts=lambda checks: [checks[0].replace('"stop"', '"stop", $v0')]
        ),
        Faulty(WIDER, "TOK-6"),
    ),
    Case(
        "A parameter less than the parent's operation",
        "TOK-6",
        below(move(), parent=SCOPE, texts=lambda checks: [checks[0].replace(", $v2", "")]),
        Faulty(WIDER, "TOK-6"),
    ),
    wider("A higher upper end", move(Limit(SPEED, Range(1, 1_000_001)))),
    wider("A lower lower end", move(Limit(SPEED, Range(0, 1_000_000)))),
    wider("A range beside the parent's", move(Limit(SPEED, Range(2_000_000, 2_000_001)))),
    wider("A set with a member outside the range", move(Limit(SPEED, OneOf(frozenset({1, 1_000_001}))))),
    wider("A set with another member", grip(Limit(FORCE, OneOf(frozenset({10, 30}))))),
    wider("A set with a member more", grip(Limit(FORCE, OneOf(frozenset({10, 20, 30, 40}))))),
    wider("A range over the gaps of a set", grip(Limit(FORCE, Range(10, 40)))),
    wider("A shorter range with one step out of a set", close(Range(2, 4)), parent=CLOSE),
    wider("A range with one step out of a set", close(Range(1, 4)), parent=CLOSE),
    wider("One limit narrower and one wider", move(Limit(Q0, Range(0, 1)), Limit(SPEED, Range(0, 1)))),
    wider(
        "Wider than the hop before though not than the first",
        move(Limit(SPEED, Range(1, 500_001))),
        parent=replace(SCOPE, grants=moved(speed=Range(1, 500_000))),
    ),
    Case(
        "A limit that an earlier hop had tightened",
        "TOK-6",
        lambda: hop(hop(authority(), SLOWER), move(Limit(SPEED, Range(1, 500_001))), agent="vision"),
        Faulty(WIDER, "TOK-6"),
    ),
    Case(
        "An operation that an earlier hop had dropped",
        "TOK-6",
        lambda: hop(hop(authority(), SLOWER), grip(Limit(WIDTH, Range(0, 1))), agent="vision"),
        Faulty(WIDER, "TOK-6"),
    ),
    narrower(
        "A grant less",
        Restriction(grants=tuple(Grant(g.object, g.operation) for g in SCOPE.grants[1:])),
        grants=SCOPE.grants[1:],
    ),
    narrower("One grant left", Restriction(grants=(STOP,)), grants=(STOP,)),
    narrower("A lower upper end", move(Limit(SPEED, Range(1, 999_999))), grants=moved(speed=Range(1, 999_999))),
    narrower(
        "A higher lower end",
        move(Limit(Q1, Range(-2_999_999, 3_000_000))),
        grants=moved(q1=Range(-2_999_999, 3_000_000)),
    ),
    narrower(
        "A limit alone is strictly less",
        Restriction(
            grants=tuple(
                Grant(g.object, g.operation, (Limit(SPEED, Range(2, 1_000_000)),) if g == MOVE else ())
                for g in SCOPE.grants
            )
        ),
        grants=tuple(moved(speed=Range(2, 1_000_000))[0] if g == MOVE else g for g in SCOPE.grants),
    ),
    narrower(
        "A set within a range",
        move(Limit(SPEED, OneOf(frozenset({1, 1_000_000})))),
        grants=moved(speed=OneOf(frozenset({1, 1_000_000}))),
    ),
    narrower(
        "A set within a set",
        grip(Limit(FORCE, OneOf(frozenset({10, 40})))),
        grants=gripped(force=OneOf(frozenset({10, 40}))),
    ),
    narrower("A range of one member of a set", grip(Limit(FORCE, Range(20, 20))), grants=gripped(force=Range(20, 20))),
    Case(
        "A range of the members of a set",
        "TOK-6",
        below(close(Range(1, 3)), parent=CLOSE),
        Accepted(closed(Range(1, 3))),
    ),
    Case(
        "A set of all that a range has",
        "TOK-6",
        below(close(OneOf(frozenset({1, 2, 3}))), parent=closed(Range(1, 3))),
        Faulty(FaultCode.CHAIN_BROKEN, "TOK-6"),
    ),
    narrower("A lower ceiling", Restriction(ceiling=Tier.CONSEQUENTIAL), ceiling=Tier.CONSEQUENTIAL),
    narrower("An audience less", Restriction(audiences=frozenset({CELL})), audiences=frozenset({CELL})),
    narrower(
        "A delegate less", Restriction(delegates=SCOPE.delegates - {"vision"}), delegates=SCOPE.delegates - {"vision"}
    ),
    narrower("No delegate", Restriction(delegates=frozenset()), delegates=frozenset()),
    narrower(
        "The very same window stated",
        replace(LESS, not_before=SCOPE.not_before, not_after=SCOPE.not_after),
        ceiling=Tier.NO_EFFECT,
    ),
    narrower(
        "A window of one second",
        replace(LESS, not_before=NOW, not_after=NOW + 1),
        ceiling=Tier.NO_EFFECT,
        not_before=NOW,
        not_after=NOW + 1,
    ),
    narrower("One hop less of depth stated", replace(LESS, depth=SCOPE.depth - 1), ceiling=Tier.NO_EFFECT),
    narrower("No depth left over", replace(LESS, depth=0), ceiling=Tier.NO_EFFECT, depth=0),
    Case(
        "A limit that a hop in between did not state",
        "TOK-6",
        lambda: hop(
            hop(authority(), replace(LESS, delegates=frozenset({"vision"}))),
            move(Limit(SPEED, Range(5, 6))),
            agent="vision",
        ),
        Accepted(
            child_of(
                SCOPE, depth=2, ceiling=Tier.NO_EFFECT, delegates=frozenset({"vision"}), grants=moved(speed=Range(5, 6))
            )
        ),
    ),
)


# --- evidence and lifetimes ------------------------------------------------------------------------------------------------

TOP = replace(SMALL, ceiling=Tier.SAFETY_CRITICAL)
HIGH = replace(SMALL, ceiling=Tier.HIGH_CONSEQUENCE)
HOUR = 3_600
DAY = 86_400


def lasting(seconds: int, attested: int = NOW - 10, *, started: int = NOW - 60) -> Scope:
    """A scope whose end lies so long after this attestation."""
    return replace(SMALL, not_before=started, not_after=attested + seconds)


EVIDENCE = group(
    "evidence",
    "What the kind of evidence carries: a ceiling and a lifetime; and the lifetime of the whole.",
    faults(
        FaultCode.HOP_NOT_ATTESTED,
        "TOK-6",
        {
            "Tier four on the word of a key": lambda: authority(TOP),
            **{
                f"Tier four on evidence of kind {kind}": lambda kind=kind: authority(TOP, evidence=kind)
                for kind in ("bearer", "x509", "release")
            },
            "Tier four kept below a platform's word": lambda: hop(
                authority(TOP, evidence="jwt"), Restriction(delegates=frozenset()), parent=TOP
            ),
            "Tier four stated below a platform's word": lambda: hop(
                authority(TOP, evidence="jwt"),
                Restriction(ceiling=Tier.SAFETY_CRITICAL, delegates=frozenset()),
                parent=TOP,
            ),
        },
    ),
    Case("Tier three on the word of a key", "TOK-6", lambda: authority(HIGH), Accepted(HIGH)),
    Case("Tier four on a platform's word", "TOK-6", lambda: authority(TOP, evidence="jwt"), Accepted(TOP)),
    Case(
        "Tier three on the word of a key below a platform's",
        "TOK-6",
        lambda: hop(authority(TOP, evidence="jwt"), Restriction(ceiling=Tier.HIGH_CONSEQUENCE), parent=TOP),
        Accepted(child_of(TOP, ceiling=Tier.HIGH_CONSEQUENCE)),
    ),
    Case(
        "A platform's word below another keeps tier four",
        "TOK-6",
        lambda: hop(authority(TOP, evidence="jwt"), Restriction(delegates=frozenset()), parent=TOP, evidence="jwt"),
        Accepted(child_of(TOP, delegates=frozenset())),
    ),
    Case(
        "A platform's word does not bring a tier back",
        "TOK-6",
        lambda: hop(authority(HIGH), replace(LESS, ceiling=Tier.SAFETY_CRITICAL), parent=HIGH, evidence="jwt"),
        Faulty(WIDER, "TOK-6"),
    ),
    *(
        Case(
            f"As long as evidence of kind {kind} lasts",
            "TOK-7",
            lambda kind=kind: authority(lasting(hop_rules.longest_s(kind, DEFAULT)), evidence=kind),
            Accepted(lasting(hop_rules.longest_s(kind, DEFAULT))),
        )
        for kind in EvidenceKind
    ),
    faults(
        FaultCode.LIFETIME_TOO_LONG,
        "TOK-7",
        {
            **{
                f"A second longer than evidence of kind {kind} lasts": lambda kind=kind: authority(
                    lasting(hop_rules.longest_s(kind, DEFAULT) + 1), evidence=kind
                )
                for kind in EvidenceKind
            },
            "A hop that keeps a window longer than its own evidence": lambda: hop(
                authority(lasting(HOUR)), LESS, parent=SMALL, at=NOW - 11
            ),
            "A hop on old evidence of a platform": lambda: hop(
                authority(lasting(HOUR)), LESS, parent=SMALL, at=NOW - 11, evidence="jwt"
            ),
            "A first hop that outlives its evidence above a short one": lambda: hop(
                authority(lasting(HOUR + 1)), replace(LESS, not_after=NOW + 60), parent=SMALL
            ),
            "A second longer than a day": lambda: authority(lasting(HOUR, started=NOW - 10 + HOUR - DAY - 1)),
        },
    ),
    Case(
        "A whole day",
        "TOK-7",
        lambda: authority(lasting(HOUR, started=NOW - 10 + HOUR - DAY)),
        Accepted(lasting(HOUR, started=NOW - 10 + HOUR - DAY)),
    ),
    Case(
        "A hop as long as its own evidence lasts",
        "TOK-7",
        lambda: hop(authority(lasting(HOUR)), replace(LESS, not_after=NOW - 11 + HOUR), parent=SMALL, at=NOW - 11),
        Accepted(child_of(SMALL, ceiling=Tier.NO_EFFECT, not_after=NOW - 11 + HOUR)),
    ),
    Case(
        "Attested long after it was issued",
        "TOK-7",
        lambda: hop(authority(lasting(HOUR)), LESS, parent=SMALL, at=NOW),
        Accepted(child_of(lasting(HOUR), ceiling=Tier.NO_EFFECT)),
    ),
)

GROUPS: tuple[Group, ...] = (HOLDERS, NARROWING, EVIDENCE)
