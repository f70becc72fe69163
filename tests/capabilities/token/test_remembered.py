"""Memory of one token is never told of another: tokens that differ in one thing, in every order."""

from __future__ import annotations

import sys
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import pytest
from capabilities.values.bounds import one_of
from capabilities.values.caps import DEFAULT
from capabilities.values.chain import Chain
from capabilities.values.errors import Fault
from capabilities.values.scope import Grant, Limit, Range, Restriction, Tier
from capabilities.values.units import Unit
from tests.capabilities.world import (
    CELL,
    GRIPPER,
    JOINTS,
    MOVE,
    NOW,
    OTHER_CELL,
    QUIETER,
    READ,
    SCOPE,
    SLOWER,
    SPEED,
    STOP,
    TRUST,
    Forge,
    add_hop,
    check,
    mint_root,
)

from capabilities.token import static_verification

pytestmark = pytest.mark.clause("VFY-2")

SCOPES = (
    SCOPE,
    replace(SCOPE, not_before=NOW - 59),
    replace(SCOPE, not_after=NOW + 2_999),
    replace(SCOPE, ceiling=Tier.CONSEQUENTIAL),
    replace(SCOPE, audiences=frozenset({CELL})),
    replace(SCOPE, delegates=frozenset({"robotic"})),
    replace(SCOPE, depth=1),
    replace(SCOPE, grants=(GRIPPER, MOVE, STOP)),
    replace(SCOPE, grants=(GRIPPER, MOVE, replace(READ, operation="read_stats"), STOP)),
    replace(
        SCOPE, grants=(GRIPPER, replace(MOVE, limits=(*MOVE.limits[:2], Limit(SPEED, Range(1, 999_999)))), READ, STOP)
    ),
    replace(
        SCOPE,
        grants=(GRIPPER, replace(MOVE, limits=(*MOVE.limits[:2], Limit(SPEED, one_of(1, 5)))), READ, STOP),
    ),
    replace(
        SCOPE,
        grants=(
            GRIPPER,
            replace(
                MOVE,
                limits=(*MOVE.limits[:2], Limit(replace(SPEED, kind=Unit.MICROMETRE_PER_SECOND), Range(1, 1_000_000))),
            ),
            READ,
            STOP,
        ),
    ),
)
RESTRICTIONS = (
    SLOWER,
    replace(SLOWER, grants=(STOP,)),
    replace(SLOWER, grants=(replace(MOVE, limits=(Limit(SPEED, Range(1, 499_999)),)), READ, STOP)),
    replace(SLOWER, grants=(replace(MOVE, limits=(Limit(JOINTS[0], Range(1, 500_000)),)), READ, STOP)),
    replace(SLOWER, not_after=NOW + 1_999),
    Restriction(not_after=NOW + 2_000, ceiling=Tier.REVERSIBLE),
    Restriction(not_before=NOW - 1, ceiling=Tier.REVERSIBLE),
    Restriction(ceiling=Tier.REVERSIBLE),
    Restriction(audiences=frozenset({OTHER_CELL, CELL}), delegates=frozenset({"vision"})),
    Restriction(audiences=frozenset({CELL})),
)
WIDER = (
    Restriction(not_after=NOW + 3_001, ceiling=Tier.REVERSIBLE),
    Restriction(grants=(replace(MOVE, limits=(Limit(SPEED, Range(1, 1_000_001)),)), READ, STOP)),
    Restriction(grants=(Grant("ur3e", "stop_all"),)),
    Restriction(grants=(GRIPPER, MOVE, READ, STOP)),
    Restriction(audiences=frozenset({"https://cell.example/other"})),
)


def linear(restriction: Restriction) -> Restriction:
    """The same restriction, its speed in the unit of the last scope."""
    speed = Limit(replace(SPEED, kind=Unit.MICROMETRE_PER_SECOND), Range(1, 500_000))
    return replace(restriction, grants=(replace(MOVE, limits=(speed,)), READ, STOP))


def forget() -> None:
    for name in [name for name in sys.modules if name.startswith("capabilities")]:
        for member in list(vars(sys.modules[name]).values()):
            if hasattr(member, "cache_clear"):
                member.cache_clear()


@pytest.fixture(scope="module")
def tokens() -> list[bytes]:
    root = mint_root()
    lent = add_hop(root, "robotic", SLOWER)
    return [
        *(mint_root(scope) for scope in SCOPES),
        *(add_hop(root, "robotic", taken) for taken in RESTRICTIONS),
        *(Forge.hop(root, taken) for taken in WIDER),
        *(add_hop(lent, "vision", taken) for taken in (QUIETER, replace(QUIETER, ceiling=Tier.REVERSIBLE))),
        add_hop(
            mint_root(SCOPES[-1]), "robotic", linear(SLOWER)
        ),  # the numbers of the first hop of all, in another unit
        Forge.authority(replace(SCOPE, grants=(STOP, READ))),
        Forge.authority(replace(SCOPE, audiences=frozenset({CELL.upper()}))),
        Forge.authority(replace(SCOPE, not_after=SCOPE.not_before)),
    ]


@pytest.fixture(scope="module")
def alone(tokens) -> list[Chain | Fault]:
    found = []
    for token in tokens:
        forget()
        found.append(check(token))
    return found


def test_the_tokens_differ(tokens, alone):
    assert len(set(tokens)) == len(tokens)
    whole = [found for found in alone if isinstance(found, Chain)]
    assert len({found.scope for found in whole}) == len(whole) == len(SCOPES) + len(RESTRICTIONS) + 3


@pytest.mark.parametrize("step", [1, -1, 3])
def test_one_after_another_they_are_what_they_are_alone(tokens, alone, step):
    forget()
    order = sorted(range(len(tokens)), key=lambda place: (place * step) % len(tokens))
    for place in (*order, *order):
        assert check(tokens[place]) == alone[place]


def test_at_once_they_are_what_they_are_alone(tokens, alone):
    forget()
    with ThreadPoolExecutor(max_workers=4) as pool:
        assert list(pool.map(check, [*tokens, *tokens[::-1]] * 4)) == [*alone, *alone[::-1]] * 4


def test_agreement_is_remembered_apart_for_checks_of_every_form():
    """The form has the stated conditions and grants, and each parameter's kind of bound, but no numbers."""
    root = mint_root()

    def form(taken: Restriction) -> str:
        token = add_hop(root, "robotic", taken)
        found = static_verification.read(token, TRUST, DEFAULT, digest=b"")
        assert isinstance(found, static_verification.StaticVerification)
        return found.form

    taken = Restriction(grants=SLOWER.grants)
    stated = [
        replace(taken, not_before=start, not_after=end, ceiling=ceiling)
        for start in (None, NOW - 50)
        for end in (None, NOW + 900)
        for ceiling in (None, Tier.CONSEQUENTIAL)
    ]
    forms = [form(each) for each in (*stated, Restriction(ceiling=Tier.CONSEQUENTIAL), Restriction(grants=(STOP,)))]
    assert len(set(forms)) == len(forms)
    assert form(replace(stated[-1], not_after=NOW + 901, ceiling=Tier.REVERSIBLE)) == forms[7]


def test_a_bound_of_the_verifier_is_asked_again(tokens, alone):
    """The same names and grants, first under wide caps, then under narrow ones."""
    forget()
    assert check(tokens[0]) == alone[0]
    for narrow in ({"grants": 3}, {"parameters": 2}, {"one_of": 2}, {"text_bytes": 10}):
        assert isinstance(check(tokens[0], caps=replace(DEFAULT, **narrow)), Fault), narrow
    assert check(tokens[0]) == alone[0]
    long = mint_root(replace(SCOPE, delegates=frozenset({"d" * 60})))
    for most, good in ((60, True), (59, False), (60, True)):
        assert isinstance(check(long, caps=replace(DEFAULT, text_bytes=most)), Chain) is good
