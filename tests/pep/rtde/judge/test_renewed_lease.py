"""A lease that is renewed while its program works: motions begun, decisions under way, and open streams."""

import asyncio
from dataclasses import replace

import pytest
from capabilities.values.scope import Range, Tier
from pep.rtde.judge.lease_bounds import LeaseBounds
from policies.words.reason_table import Reason
from tests.pep.kit import reading
from tests.pep.rtde.judge.test_leased_judge import MOVE, SERVO, SLOW, moving, streamed
from tests.pep.rtde.leased import HERE, LIMITS, THERE, leased_scope, played, until

from capabilities.keys import keys
from pep.base.operations import SERVO_JOINT
from pep.rtde.command import command_values as v

pytestmark = [pytest.mark.e2e, pytest.mark.clause("LSD-10")]  # as its siblings: real time, real threads

MANDATE, KEY = "ab" * 16, keys.generate()


def drawn(house, **scope):
    """The holder with another token of the mandate."""
    at = house.clock.wall_s()
    return house.agent(scope=leased_scope(at, **scope), mandate_id=MANDATE, key=KEY)


def renew(house, lease, **scope):
    """Another token in the place of the lease's own."""
    lease.credentials = house.credentials(drawn(house, **scope))


@pytest.fixture
def house(house):
    house.holder = drawn(house)
    return house


def test_a_move_goes_on_across_a_renewal_and_the_old_tokens_revocation(house):
    async def during(judge, held):
        first = held.lease.credentials.chain
        renew(house, held.lease)
        house.feed.revoke("token", first.token_id)
        house.feed.revoke("hop", first.leaf.hop_id)

    outcome = moving(house, v.MoveJ(THERE, 0.5, 1.4, True), during)
    assert (outcome["outcome"], outcome["result"]["outcome"]) == ("done", "reached")
    assert house.arm.stops == []


@pytest.mark.parametrize(
    ("scope", "reason"),
    [
        ({"speed_high": 99_999}, "LIMIT_EXCEEDED_BY_REQUEST"),
        ({"without": ("move_joint",)}, "NOT_GRANTED"),
        ({"ceiling": Tier.NO_EFFECT}, "ABOVE_CEILING"),
    ],
)
def test_a_move_that_the_newer_token_does_not_permit_is_stopped_as_for_lost_authority(house, scope, reason):
    async def during(judge, held):
        renew(house, held.lease, **scope)

    outcome = moving(house, SLOW, during)
    assert outcome["result"]["outcome"] == "authority_lost"
    assert outcome["watch"]["reason"] == reason
    assert house.arm.stops == [reason]
    assert house.arm.q < 0.2


def test_the_revocation_of_the_mandate_stops_the_arm(house):
    async def during(judge, held):
        renew(house, held.lease)
        house.feed.revoke("mandate", MANDATE)

    outcome = moving(house, SLOW, during)
    assert (outcome["result"]["outcome"], outcome["watch"]["reason"]) == ("authority_lost", "REVOKED")


def decided(house, command, scope, *, revoked=False):
    """Answers to a command during whose assessment the lease is renewed."""
    held = house.held(command)

    def before():
        house.physics.before = lambda: None
        first = held.lease.credentials.chain
        renew(house, held.lease, **scope)
        if revoked:
            house.feed.revoke("token", first.token_id)

    house.physics.before = before

    async def scenario(judge):
        judge.judge(held)
        await until(lambda: held.answers and (not held.forwarded or house.outcomes()))

    played(house, scenario)
    return held.answers


def test_what_is_decided_while_the_lease_is_renewed_is_sent_only_as_the_newer_token_permits_it(house):
    assert decided(house, MOVE, {"speed_high": 100_000}) == [Reason.LIMIT_EXCEEDED_BY_REQUEST]
    assert house.arm.q == 0.0
    hops = [record["body"]["evidence"]["chain"] for record in house.records("decision")]
    assert len(hops) == 2, "by each token once"


def test_what_the_older_token_no_longer_permits_is_decided_afresh_by_the_newer_one(house):
    assert decided(house, MOVE, {}, revoked=True) == ["forward"]
    effects = [record["body"]["decision"]["effect"] for record in house.records("decision")]
    assert effects == ["DENY", "PERMIT"]


def test_an_output_is_not_switched_by_a_token_that_another_has_replaced(house, monkeypatch):
    """Nothing watches an output: what is sent is asked about just before."""
    from pep.rtde.command import io_commands as io

    append = house.journal.append
    held = house.held(io.SetDigitalOutputs(io.Bank.STANDARD, 1, 1))

    def renewing(kind, body):
        record = append(kind, body)
        monkeypatch.undo()
        asyncio.run_coroutine_threadsafe(renewed(), loop()).result(5)
        return record

    async def renewed():
        renew(house, held.lease, without=("set_digital_output",))

    loops = []

    def loop():
        return loops[0]

    monkeypatch.setattr(house.journal, "append", renewing)

    async def scenario(judge):
        loops.append(asyncio.get_running_loop())
        judge.judge(held)
        await until(lambda: held.answers)

    played(house, scenario)
    assert held.answers == [Reason.NOT_GRANTED]


def test_a_stream_goes_on_across_a_renewal_inside_both_scopes(house):
    narrow = {"servo_joint": {**LIMITS["servo_joint"], "q0": Range(0, 300_000)}}

    async def during(steps):
        lease = house.leased
        renew(house, lease, limits=narrow)
        assert steps.follow((0.2999994, *HERE[1:])) is None
        assert steps.step(SERVO) is None
        assert steps.follow((0.3000004, *HERE[1:])) is Reason.LIMIT_EXCEEDED_BY_REQUEST

    house.leased = None
    made = house.lease

    def remembered(holder=None):
        house.leased = made(holder)
        return house.leased

    house.lease = remembered
    streamed(house, SERVO, during)
    assert house.outcomes()[0]["result"]["outcome"] == "stopped"
    assert house.arm.stops[0] is Reason.LIMIT_EXCEEDED_BY_REQUEST


def test_a_value_that_stands_outside_of_the_newer_scope_is_stopped_without_another_word(house):
    narrow = {"servo_joint": {**LIMITS["servo_joint"], "q0": Range(0, 300_000)}}
    leases, made = [], house.lease

    def remembered(holder=None):
        leases.append(made(holder))
        return leases[0]

    house.lease = remembered

    async def during(steps):
        assert steps.follow((0.31, *HERE[1:])) is None  # the request that opened it is inside both
        await asyncio.sleep(0.02)
        assert house.arm.stops == []
        renew(house, leases[0], limits=narrow)

    streamed(house, SERVO, during)
    assert house.outcomes()[0]["result"]["outcome"] == "stopped"
    assert house.arm.stops[0] is Reason.LIMIT_EXCEEDED_BY_REQUEST


def test_a_command_that_waits_for_people_is_decided_by_the_newer_token_after_their_answer(house):
    house.physics.answer = reading(3, 2_500)
    held = house.held(MOVE)

    async def scenario(judge):
        judge.judge(held)
        await until(lambda: held.answers)
        (ask_id,) = house.issuer.asks
        first = held.lease.credentials.chain
        renew(house, held.lease)
        house.feed.revoke("token", first.token_id)
        text = house.issuer.asks[ask_id]
        house.issuer.cast(ask_id, house.people["bob"].vote(text, at=house.clock.wall_s()))
        await house.asking.pull()
        await until(lambda: len(held.answers) == 2)
        if held.forwarded:
            await until(house.outcomes)

    played(house, scenario)
    assert held.answers == ["defer", "forward"], "approvals are bound to the mandate"


# ---- bounds alone


class Holder:
    """Owner whose credentials a test changes."""

    def __init__(self, credentials):
        self.credentials = credentials


def numbers(q0):
    return (q0, *HERE[1:], 0.002, 0.1, 300.0)


@pytest.fixture
def bounds(house):
    """Bounds of a servo stream, and who holds the lease."""
    credentials = house.credentials(house.holder)
    holder = Holder(credentials)
    return LeaseBounds(SERVO_JOINT, credentials.chain.scope.find("ur3e", "servo_joint"), holder, credentials), holder


def of(house, low, high):
    limits = {"servo_joint": {**LIMITS["servo_joint"], "q0": Range(low, high)}}
    return house.credentials(drawn(house, limits=limits))


def test_bounds_are_those_of_the_opening_and_of_the_newest_token(house, bounds):
    asked, holder = bounds
    assert asked.outside(numbers(0.5)) is None
    holder.credentials = of(house, 0, 300_000)
    assert asked.outside(numbers(0.5)) is Reason.LIMIT_EXCEEDED_BY_REQUEST
    assert asked.outside(numbers(0.3)) is None
    holder.credentials = of(house, -300_000, 400_000)
    assert asked.outside(numbers(0.35)) is None, "of the newest, not of all in between"
    holder.credentials = house.credentials(drawn(house, without=("servo_joint",)))
    assert asked.outside(numbers(0.1)) is Reason.NOT_GRANTED
    holder.credentials = replace(holder.credentials, chain=None)
    assert asked.outside(numbers(0.1)) is Reason.NOT_GRANTED


def test_a_wider_token_widens_no_stream_that_is_open(house):
    narrow = of(house, 0, 300_000)
    holder = Holder(narrow)
    asked = LeaseBounds(SERVO_JOINT, narrow.chain.scope.find("ur3e", "servo_joint"), holder, narrow)
    holder.credentials = house.credentials(drawn(house))
    assert asked.outside(numbers(0.31)) is Reason.LIMIT_EXCEEDED_BY_REQUEST
    assert asked.outside(numbers(0.3)) is None


def test_a_stream_that_is_begun_after_a_renewal_has_the_newer_bounds_from_its_first_value(house):
    first = house.credentials(house.holder)
    holder = Holder(of(house, 0, 300_000))
    asked = LeaseBounds(SERVO_JOINT, first.chain.scope.find("ur3e", "servo_joint"), holder, first)
    assert asked.outside(numbers(0.31)) is Reason.LIMIT_EXCEEDED_BY_REQUEST
