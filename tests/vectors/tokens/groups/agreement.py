"""[TOK-12]: Biscuit's own authorizer at the corners of a scope, for scopes that are the token's and for others."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

from capabilities.values.errors import FaultCode
from capabilities.values.scope import Grant, Limit, OneOf, Range, Scope, Tier
from capabilities.values.units import Parameter, Unit
from tests.vectors.tokens.cases import Case, Faulty, Group, Permitted, group
from tests.vectors.tokens.ordinary import (
    NOW,
    Q0,
    SLOWER,
    SMALL,
    SPEED,
    authority,
    hop,
    one_operation,
    stating,
)
from tests.vectors.tokens.sealing import seal

OWN = "The scope of the token itself"
WHOLE = replace(
    SMALL,
    grants=one_operation(
        Limit(Parameter("n", Unit.COUNT), Range(0, 9)), Limit(Parameter("m", Unit.COUNT), OneOf(frozenset({3, 4, 8})))
    ),
)
GO = {"object": "arm", "operation": "go", "values": [], "base_tier": 0}
MOST = 2**53 - 1


def claim(title: str, claimed: Scope, agreed: bool, token: Any = OWN, request: dict[str, Any] = GO) -> Case:
    """Case of a claim on the lines of Biscuit's authorizer: they are those of this scope, or not."""
    expected = Permitted() if agreed else Faulty(FaultCode.ENGINES_DISAGREE, "TOK-12")
    return Case(title, "TOK-12", token, expected, request=request, claimed=claimed)


def bounds(n: Range | OneOf | None = None, m: OneOf | Range | None = None, *more: Limit) -> Scope:
    limits = list(WHOLE.grants[0].limits)
    limits[0] = limits[0] if n is None else Limit(limits[0].parameter, n)
    limits[1] = limits[1] if m is None else Limit(limits[1].parameter, m)
    return replace(WHOLE, grants=one_operation(*limits, *more))


def one_of(*values: int) -> OneOf:
    return OneOf(frozenset(values))


def permitted(title: str, scope: Scope, values: list[tuple[str, Unit, int]], **more: Any) -> Case:
    stated = [{"name": name, "unit": str(unit), "value": value} for name, unit, value in values]
    return Case(title, "TOK-12", lambda: authority(scope), Permitted(), {}, {**GO, "values": stated, **more})


def raw(*statements: str) -> Callable[[], Any]:
    """A Biscuit of the root key that is of no profile: step 12 is asked alone."""
    return lambda: seal(stating(*statements))


CONTEXT = f"check if req_ctx($time, $tier), $time >= {SMALL.not_before}, $time < {SMALL.not_after}, $tier <= 1"
NOTHING = replace(SMALL, grants=one_operation())
N = Parameter("n", Unit.COUNT)

AGREEMENT = group(
    "agreement",
    "Step 12: at each corner and one step beyond each line. With `claimed`, that scope is asked about in place of the token's.",
    claim(OWN, WHOLE, agreed=True, token=lambda: authority(WHOLE)),
    claim("An upper end too high", bounds(Range(0, 10)), agreed=False),
    claim("An upper end too low", bounds(Range(0, 8)), agreed=False),
    claim("A lower end too low", bounds(Range(-1, 9)), agreed=False),
    claim("A lower end too high", bounds(Range(1, 9)), agreed=False),
    claim("A set for a range", bounds(one_of(0, 9)), agreed=False),
    claim("A member too many", bounds(m=one_of(3, 4, 7, 8)), agreed=False),
    claim("A member too few at the end", bounds(m=Range(3, 4)), agreed=True),
    claim("A member too few beside another", bounds(m=one_of(3, 8)), agreed=False),
    claim("A range over the gaps of a set is seen at its ends alone", bounds(m=Range(3, 8)), agreed=True),
    claim("A later end of the window", replace(WHOLE, not_after=WHOLE.not_after + 1), agreed=False),
    claim("An earlier end of the window", replace(WHOLE, not_after=WHOLE.not_after - 1), agreed=False),
    claim("A later start of the window", replace(WHOLE, not_before=WHOLE.not_before + 1), agreed=False),
    claim("An earlier start of the window", replace(WHOLE, not_before=WHOLE.not_before - 1), agreed=False),
    claim("A higher ceiling", replace(WHOLE, ceiling=Tier.CONSEQUENTIAL), agreed=False),
    claim("A lower ceiling", replace(WHOLE, ceiling=Tier.NO_EFFECT), agreed=False),
    claim("A parameter more", bounds(None, None, Limit(Parameter("k", Unit.COUNT), Range(0, 1))), agreed=False),
    claim("A parameter less", replace(WHOLE, grants=one_operation(WHOLE.grants[0].limits[0])), agreed=False),
    claim(
        "Another operation",
        replace(WHOLE, grants=one_operation(*WHOLE.grants[0].limits, name="other")),
        agreed=False,
        request={**GO, "operation": "other"},
    ),
    claim(
        "Another object",
        replace(WHOLE, grants=one_operation(*WHOLE.grants[0].limits, object="leg")),
        agreed=False,
        request={**GO, "object": "leg"},
    ),
    claim(
        "Names and units are nothing to Biscuit",
        replace(
            WHOLE,
            grants=one_operation(
                *(Limit(Parameter(f"x{i}", Unit.GRAM), x.bound) for i, x in enumerate(WHOLE.grants[0].limits))
            ),
        ),
        agreed=True,
    ),
    claim(
        "Other audiences, delegates and depth are nothing to Biscuit",
        replace(WHOLE, audiences=frozenset({"http://a.example"}), delegates=frozenset(), depth=0),
        agreed=True,
    ),
    claim(
        "A token that checks no operation",
        NOTHING,
        agreed=False,
        token=raw(CONTEXT, 'check if req($o, $p) or req("arm", "go")'),
    ),
    claim("A token that checks nothing but the context", NOTHING, agreed=False, token=raw(CONTEXT)),
    claim(
        "A token that takes a parameter more",
        NOTHING,
        agreed=False,
        token=raw(CONTEXT, 'check if req("arm", "go") or req("arm", "go", $x)'),
    ),
    claim(
        "A token that takes a parameter less",
        replace(SMALL, grants=one_operation(Limit(N, Range(0, 9)))),
        agreed=False,
        token=raw(CONTEXT, 'check if req("arm", "go", $n), $n >= 0, $n <= 9 or req("arm", "go")'),
    ),
    claim(
        "A token that checks no time",
        NOTHING,
        agreed=False,
        token=raw('check if req("arm", "go")', "check if req_ctx($t, $k), $k <= 1"),
    ),
    claim(
        "A token that checks no start",
        NOTHING,
        agreed=False,
        token=raw('check if req("arm", "go")', f"check if req_ctx($t, $k), $t < {SMALL.not_after}, $k <= 1"),
    ),
    claim(
        "A token that checks no tier",
        NOTHING,
        agreed=False,
        token=raw(
            'check if req("arm", "go")', f"check if req_ctx($t, $k), $t >= {SMALL.not_before}, $t < {SMALL.not_after}"
        ),
    ),
    claim(
        "A token that checks the same in other words",
        NOTHING,
        agreed=True,
        token=raw(
            'check if req("arm", "go"), req_ctx($t, $k), $k < 2',
            f"check if req_ctx($t, $k), $t + 1 > {SMALL.not_before}, $t <= {SMALL.not_after - 1}",
        ),
    ),
    claim(
        "A token that brings a request of its own",
        NOTHING,
        agreed=False,
        token=raw('req("arm", "go")', 'check if req("arm", "go")', CONTEXT),
    ),
    claim("A token that refuses everything", NOTHING, agreed=False, token=raw("check if false")),
    Case(
        "More facts than may be",
        "TOK-12",
        raw(
            *(f"n({i})" for i in range(20)),
            "p($a, $b, $c) <- n($a), n($b), n($c)",
            'check if req("arm", "go")',
            CONTEXT,
        ),
        Faulty(FaultCode.LIMIT_EXCEEDED, "TOK-12"),
        {},
        GO,
        NOTHING,
    ),
    Case(
        "More iterations than may be",
        "TOK-12",
        raw(*(f"n{i + 1}($a) <- n{i}($a)" for i in range(250)), "n0(0)", 'check if req("arm", "go")', CONTEXT),
        Faulty(FaultCode.LIMIT_EXCEEDED, "TOK-12"),
        {},
        GO,
        NOTHING,
    ),
    permitted("No parameters", NOTHING, []),
    permitted(
        "A range of one number", replace(SMALL, grants=one_operation(Limit(N, Range(5, 5)))), [("n", Unit.COUNT, 5)]
    ),
    permitted(
        "A range of all numbers",
        replace(SMALL, grants=one_operation(Limit(N, Range(-MOST, MOST)))),
        [("n", Unit.COUNT, MOST)],
    ),
    permitted(
        "A set with neighbours",
        replace(SMALL, grants=one_operation(Limit(N, one_of(-1, 0, 1, 3)))),
        [("n", Unit.COUNT, 0)],
    ),
    permitted(
        "A set of the largest and the smallest number",
        replace(SMALL, grants=one_operation(Limit(N, one_of(-MOST, MOST)))),
        [("n", Unit.COUNT, -MOST)],
    ),
    permitted("A ceiling of zero", replace(NOTHING, ceiling=Tier.NO_EFFECT), []),
    permitted("A ceiling of three", replace(NOTHING, ceiling=Tier.HIGH_CONSEQUENCE), [], base_tier=3),
    permitted("A window of one second", replace(NOTHING, not_before=NOW, not_after=NOW + 1), []),
    permitted(
        "Names of texts that Biscuit knows by itself",
        replace(SMALL, grants=(Grant("resource", "write"),)),
        [],
        object="resource",
        operation="write",
    ),
    permitted(
        "Operations of two arities",
        replace(SMALL, grants=(Grant("arm", "go"), Grant("leg", "go", (Limit(N, Range(0, 1)),)))),
        [],
    ),
    Case(
        "A set that a hop laid over a range",
        "TOK-12",
        lambda: hop(
            authority(),
            replace(
                SLOWER, grants=(Grant("ur3e", "move_joint", (Limit(Q0, one_of(0, 5)), Limit(SPEED, one_of(7, 9)))),)
            ),
        ),
        Permitted(),
        {},
        {
            "object": "ur3e",
            "operation": "move_joint",
            "values": [
                {"name": "q0", "unit": "urad", "value": 5},
                {"name": "q1", "unit": "urad", "value": -3},
                {"name": "speed", "unit": "urad_s", "value": 7},
            ],
            "base_tier": 3,
        },
    ),
)

GROUPS: tuple[Group, ...] = (AGREEMENT,)
