"""[TOK-11]: a request against the effective scope, and who drew the line."""

from __future__ import annotations

from typing import Any

from capabilities.values.errors import FaultCode
from capabilities.values.scope import Grant, Limit, OneOf, Range, Restriction, Tier
from tests.vectors.tokens.cases import Case, Faulty, Group, Permitted, Refused, group
from tests.vectors.tokens.ordinary import (
    CELL,
    FORCE,
    LESS,
    NOW,
    Q0,
    READ,
    SLOWER,
    SMALL,
    SPEED,
    STOP,
    WIDTH,
    authority,
    hop,
)
from tests.vectors.tokens.sealing import Sealed

CHAIN = "A move inside every limit of four hops"
GRIP = "A grip inside every limit"
KNOWN = {"q0": "urad", "q1": "urad", "speed": "urad_s", "width": "um", "force": "mN"}


def four() -> Sealed:
    """Token of four hops: alice -> orchestrator -> robotic -> vision -> gripper.

    Speed to 500000 from robotic on; q0 inside, speed from 5 and tier 2 from vision on; gripper has less audience.
    """
    token = hop(authority(), SLOWER)
    quieter = Restriction(
        grants=(
            Grant("ur3e", "move_joint", (Limit(Q0, Range(-1_000, 2_000)), Limit(SPEED, Range(5, 500_000)))),
            READ,
        ),
        delegates=frozenset({"gripper"}),
        ceiling=Tier.CONSEQUENTIAL,
    )
    token = hop(token, quieter, agent="vision")
    return hop(token, Restriction(audiences=frozenset({CELL}), delegates=frozenset()), agent="gripper")


def gripping() -> Sealed:
    """Token with a set of forces at the first hop, and {10, 40} from the second.

    The width becomes a set, then a range.
    """
    token = hop(
        authority(),
        Restriction(
            grants=(
                Grant(
                    "ur3e",
                    "gripper_move",
                    (Limit(WIDTH, OneOf(frozenset({5, 6, 7, 100}))), Limit(FORCE, OneOf(frozenset({10, 40})))),
                ),
                STOP,
            )
        ),
    )
    return hop(
        token, Restriction(grants=(Grant("ur3e", "gripper_move", (Limit(WIDTH, Range(5, 7)),)),)), agent="vision"
    )


def values(**given: Any) -> list[dict[str, Any]]:
    return [{"name": name, "unit": KNOWN.get(name, "count"), "value": value} for name, value in given.items()]


def asks(
    operation: str, given: list[dict[str, Any]], tier: int = 1, thing: str = "ur3e", **more: Any
) -> dict[str, Any]:
    return {"object": thing, "operation": operation, "values": given, "base_tier": tier, **more}


def move(q0: Any = 0, q1: Any = 0, speed: Any = 5, tier: int = 1, **more: Any) -> dict[str, Any]:
    return asks("move_joint", values(q0=q0, q1=q1, speed=speed), tier, **more)


def grip(width: int = 5, force: int = 10) -> dict[str, Any]:
    return asks("gripper_move", values(width=width, force=force))


def yes(title: str, request: dict[str, Any], token: Any = CHAIN) -> Case:
    return Case(title, "TOK-11", token, Permitted(), request=request)


def no(title: str, request: dict[str, Any], code: FaultCode, hop: int, token: Any = CHAIN, **of: Any) -> Case:
    return Case(title, "TOK-11", token, Refused(code, hop, of), request=request)


def over(
    title: str, request: dict[str, Any], hop: int, name: str, value: int, bound: Any, nearest: int, token: Any = CHAIN
) -> Case:
    stated = {"low": bound[0], "high": bound[1]} if isinstance(bound, tuple) else {"one_of": bound}
    of = {"parameter": name, "value": value, "unit": KNOWN[name], "bound": stated, "nearest": nearest}
    return no(title, request, FaultCode.LIMIT_EXCEEDED_BY_REQUEST, hop, token, **of)


def wrong(title: str, given: list[dict[str, Any]], operation: str = "move_joint") -> Case:
    return no(title, asks(operation, given), FaultCode.PARAMETERS_WRONG, 0)


GOOD = values(q0=0, q1=0, speed=5)
NOT_GRANTED, ABOVE = FaultCode.NOT_GRANTED, FaultCode.ABOVE_CEILING

REQUESTS = group(
    "requests",
    "Requests inside and just outside; a refusal names the hop that drew the line, the bound and what is nearest.",
    yes(CHAIN, move(), four),
    yes("Every parameter at its lower end", move(-1_000, -3_000_000, 5)),
    yes("Every parameter at its upper end", move(2_000, 3_000_000, 500_000)),
    yes("An operation without parameters", asks("read_state", [])),
    yes("At the ceiling", move(tier=2)),
    yes("With no tier at all", move(tier=0)),
    yes("In the last second", move(time=NOW + 1_999)),
    no("Another object", move(thing="ur5e"), NOT_GRANTED, 0),
    no("An operation that nobody ever granted", asks("set_payload", []), NOT_GRANTED, 0),
    no("An operation in other letters", asks("Read_state", []), NOT_GRANTED, 0),
    no("Object and operation exchanged", asks("ur3e", [], thing="read_state"), NOT_GRANTED, 0),
    no("An operation that the second hop dropped", asks("gripper_move", values(width=5, force=10)), NOT_GRANTED, 1),
    no("An operation that the third hop dropped", asks("stop", []), NOT_GRANTED, 2),
    no("An operation that is not granted, with a tier above", asks("stop", [], 4), NOT_GRANTED, 2),
    wrong("No parameters", []),
    wrong("A parameter too few", GOOD[:2]),
    wrong("A parameter too many", values(q0=0, q1=0, speed=5, force=1)),
    wrong("A parameter twice", [*GOOD, GOOD[2]]),
    wrong("Parameters in another order", [GOOD[1], GOOD[0], GOOD[2]]),
    wrong("A parameter of another name", [*GOOD[:2], {**GOOD[2], "name": "Speed"}]),
    wrong("A parameter of another unit", [*GOOD[:2], {**GOOD[2], "unit": "urad"}]),
    wrong("A fraction", values(q0=0, q1=0, speed=5.5)),
    wrong("A text", values(q0=0, q1=0, speed="5")),
    wrong("A boolean", values(q0=0, q1=0, speed=True)),
    wrong("Null", values(q0=0, q1=0, speed=None)),
    wrong("A parameter for an operation that has none", values(q0=0), "read_state"),
    wrong("A parameter too few beside one out of bounds", values(q0=9_999_999, q1=0)),
    over("A step above what the second hop set", move(speed=500_001), 1, "speed", 500_001, (5, 500_000), 500_000),
    over("A step below what the third hop set", move(speed=4), 2, "speed", 4, (5, 500_000), 5),
    over("A step above what the third hop set", move(q0=2_001), 2, "q0", 2_001, (-1_000, 2_000), 2_000),
    over("A step below the lower end of the third hop", move(q0=-1_001), 2, "q0", -1_001, (-1_000, 2_000), -1_000),
    over(
        "A step above what the first hop set",
        move(q1=3_000_001),
        0,
        "q1",
        3_000_001,
        (-3_000_000, 3_000_000),
        3_000_000,
    ),
    over(
        "A step below what the first hop set",
        move(q1=-3_000_001),
        0,
        "q1",
        -3_000_001,
        (-3_000_000, 3_000_000),
        -3_000_000,
    ),
    over("Far above", move(speed=2**53 - 1), 1, "speed", 2**53 - 1, (5, 500_000), 500_000),
    over("Far below", move(speed=-(2**53) + 1), 2, "speed", -(2**53) + 1, (5, 500_000), 5),
    over("The first of two that are out of bounds", move(q0=9_999, speed=0), 2, "q0", 9_999, (-1_000, 2_000), 2_000),
    over("Out of bounds with a tier above", move(q0=9_999, tier=4), 2, "q0", 9_999, (-1_000, 2_000), 2_000),
    no("A tier above the ceiling of the third hop", move(tier=3), ABOVE, 2),
    no("The highest tier", move(tier=4), ABOVE, 2),
    no(
        "A tier above the ceiling of the first hop",
        asks("stop", [], 4),
        ABOVE,
        0,
        lambda: hop(authority(), SLOWER),
    ),
    Case(
        "At the end of the window", "TOK-11", CHAIN, Faulty(FaultCode.EXPIRED, "TOK-11"), request=move(time=NOW + 2_000)
    ),
    Case("Before the window", "TOK-11", CHAIN, Faulty(FaultCode.NOT_YET_VALID, "TOK-11"), request=move(time=NOW - 61)),
    Case(
        "Too late for what is not granted",
        "TOK-11",
        CHAIN,
        Faulty(FaultCode.EXPIRED, "TOK-11"),
        request=asks("stop", [], time=NOW + 2_000),
    ),
    yes(GRIP, grip(), gripping),
    yes("The last member of a set", grip(7, 40), GRIP),
    over("Between the members of a set", grip(force=24), 1, "force", 24, [10, 40], 10, GRIP),
    over("In the middle of two members", grip(force=25), 1, "force", 25, [10, 40], 10, GRIP),
    over("Nearer to the higher member", grip(force=26), 1, "force", 26, [10, 40], 40, GRIP),
    over("A member that the second hop took away", grip(force=20), 1, "force", 20, [10, 40], 10, GRIP),
    over("Below every member", grip(force=-9), 1, "force", -9, [10, 40], 10, GRIP),
    over("Above every member", grip(force=41), 1, "force", 41, [10, 40], 40, GRIP),
    over("Above a range that was made of a set", grip(width=8), 2, "width", 8, (5, 7), 7, GRIP),
    over("Below a range that was made of a set", grip(width=4), 2, "width", 4, (5, 7), 5, GRIP),
    over(
        "Outside the set of the first hop, kept since",
        grip(force=30),
        0,
        "force",
        30,
        [10, 20, 40],
        20,
        lambda: hop(authority(), LESS),
    ),
    no(
        "The ceiling that the only hop after the first set",
        asks("read_state", []),
        ABOVE,
        1,
        lambda: hop(authority(SMALL), LESS, parent=SMALL),
    ),
)

GROUPS: tuple[Group, ...] = (REQUESTS,)
