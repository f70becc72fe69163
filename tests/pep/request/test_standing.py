"""Standing of a permitted request: what a token that takes the place of its own has to permit."""

from dataclasses import replace

import pytest
from capabilities.values.scope import Grant, Tier
from tests.pep.kit import Rig, full_scope

from capabilities.keys import keys
from pep.base.operations import TOUCH
from pep.request import standing

pytestmark = pytest.mark.clause("LSD-10")

MANDATE = "ab" * 16


class House:
    """A permitted move, and the tokens of its holder."""

    def __init__(self, tmp):
        self.rig, self.key = Rig(tmp), keys.generate()
        self.first = self.now = self.drawn(lifetime_s=60)
        call = replace(self.rig.call(None, credentials=self.first), renewed=lambda: self.now)
        self.standing = self.of(call)

    def of(self, call, *, tier=Tier.REVERSIBLE, touch=frozenset()):
        clock = self.rig.clock
        return standing.StandingAuthority(call, self.rig.authority, lease_ms=2_000, tier=tier, touch=touch, clock=clock)

    def call(self):
        return replace(self.rig.call(None, credentials=self.first), renewed=lambda: self.now)

    def drawn(self, *, touching=(), without="", **scope):
        """Credentials with another token of the mandate."""
        full = full_scope(self.rig.clock.wall_s(), **scope)
        grants = (*full.grants, *(Grant(thing, TOUCH) for thing in touching))
        kept = tuple(sorted((g for g in grants if g.operation != without), key=lambda g: (g.object, g.operation)))
        holder = self.rig.agent(key=self.key, mandate_id=MANDATE, scope=replace(full, grants=kept))
        return self.rig.credentials(holder)


@pytest.fixture
def house(tmp_path):
    house = House(tmp_path)
    yield house
    house.rig.gate.close()
    house.rig.journal.close()


def code(fault):
    return None if fault is None else str(fault.code)


def test_the_end_of_the_first_token_is_no_end_once_another_is_there(house):
    house.rig.clock.advance(45_000)
    house.now = house.drawn(lifetime_s=60)
    house.rig.clock.advance(30_000)
    assert code(house.standing()) is None
    house.now = house.first
    assert code(house.standing()) == "EXPIRED"


@pytest.mark.parametrize(("kind", "whose"), [("token", "token_id"), ("hop", "hop_id")])
def test_the_revocation_of_the_first_token_is_no_end_either_but_that_of_the_newest_is(house, kind, whose):
    def named(credentials):
        return getattr(credentials.chain if kind == "token" else credentials.chain.leaf, whose)

    house.now = house.drawn()
    house.rig.feed.revoke(kind, named(house.first))
    assert code(house.standing()) is None
    house.rig.feed.revoke(kind, named(house.now))
    assert code(house.standing()) == "REVOKED"


def test_the_revocation_of_the_mandate_is_the_end(house):
    house.now = house.drawn()
    house.rig.feed.revoke("mandate", MANDATE)
    assert code(house.standing()) == "REVOKED"


def test_a_view_that_is_too_old_is_the_end(house):
    house.now = house.drawn()
    house.rig.feed.age_ms = 2_001
    assert code(house.standing()) == "REVOCATION_VIEW_STALE"


@pytest.mark.parametrize(
    ("less", "reason"),
    [
        ({"speed_high": 500_000}, None),  # the very speed of the request
        ({"speed_high": 499_999}, "LIMIT_EXCEEDED_BY_REQUEST"),
        ({"without": "move_joint"}, "NOT_GRANTED"),
        ({"without": "move_path"}, None),
        ({"ceiling": Tier.REVERSIBLE}, None),
        ({"ceiling": Tier.NO_EFFECT}, "ABOVE_CEILING"),
    ],
)
def test_a_newer_token_has_to_permit_what_was_decided(house, less, reason):
    house.now = house.drawn(**less)
    assert code(house.standing()) == reason
    house.now = house.drawn()
    assert code(house.standing()) is None, "each token is compared by itself"


@pytest.mark.parametrize("tier", [Tier.CONSEQUENTIAL, Tier.HIGH_CONSEQUENCE])
def test_it_has_to_permit_the_tier_that_was_decided_and_not_the_class_alone(house, tier):
    stands = house.of(house.call(), tier=tier)
    house.now = house.drawn(ceiling=tier)
    assert code(stands()) is None
    house.now = house.drawn(ceiling=Tier(tier - 1))
    assert code(stands()) == "ABOVE_CEILING"


def test_it_has_to_permit_all_that_may_be_touched(house):
    stands = house.of(house.call(), touch=frozenset({"table"}))
    house.now = house.drawn(touching=("shelf", "table"))
    assert code(stands()) is None
    house.now = house.drawn(touching=("shelf",))
    assert code(stands()) == "NOT_GRANTED"


def test_a_token_is_compared_once_and_verified_each_time(house, monkeypatch):
    compared, verifier = [], house.rig.authority.verifier
    check = type(verifier).check_request

    def counted(*arguments, **named):
        compared.append(1)
        return check(*arguments, **named)

    monkeypatch.setattr(type(verifier), "check_request", counted)
    house.now = house.drawn()
    assert [code(house.standing()) for _ in range(3)] == [None] * 3
    assert len(compared) == 1
    house.rig.clock.advance(700_000)
    assert code(house.standing()) == "EXPIRED"


def test_without_credentials_nothing_stands(house):
    from pep.request.authority import NOBODY

    house.now = NOBODY
    assert code(house.standing()) == "TOKEN_MISSING"


def test_a_call_that_nobody_renews_stands_by_its_own_token(house):
    stands = house.of(replace(house.call(), renewed=None))
    house.now = house.drawn(without="move_joint")
    assert code(stands()) is None
    house.rig.clock.advance(61_000)
    assert code(stands()) == "EXPIRED"
