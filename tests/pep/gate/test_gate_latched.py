"""The gate of a latched robot: nothing of it moves or switches, under any authority; reading goes on."""

import asyncio
from dataclasses import replace

import pytest
from capabilities.values.scope import Tier
from policies.evidence.model import Effect
from policies.words.reason_table import Reason
from tests.pep.kit import Rig

pytestmark = pytest.mark.clause("LSD-21")
LATCH = "1a" * 16
SPEEDS = {"qd_rad_s": [0.1, 0, 0, 0, 0, 0], "acceleration_rad_s2": 1.0, "duration_s": 0.2}


@pytest.fixture
def rig(tmp_path):
    rig = Rig(tmp_path)
    yield rig
    rig.gate.close()
    rig.journal.close()


def asked(rig, tool="move_joint", arguments=None, **options):
    return asyncio.run(rig.gate.run(rig.call(rig.agent(**options), tool, arguments), rig.effect)).decision


ACTS = {
    "move_joint": None,
    "speed_joint": SPEEDS,
    "gripper_activate": None,
    "gripper_move": {"width_m": 0.05, "speed_m_s": 0.1, "force_n": 40.0},
    "set_digital_output": {"pin": 1, "value": True},
}


@pytest.mark.parametrize("tool", ACTS)
def test_no_act_of_a_latched_robot_is_permitted_and_each_is_told_the_latch(rig, tool):
    rig.latch_id = LATCH
    decision = asked(rig, tool, ACTS[tool])
    assert (decision.effect, decision.reason, decision.primitive) == (Effect.DENY, Reason.ROBOT_LATCHED, "TEA-5")
    assert decision.findings[0].detail == {"latch_id": LATCH}
    assert (rig.sent, rig.physics.asked, rig.slot.holder) == ([], 0, None)
    (record,) = rig.records("decision")
    assert record["body"]["decision"]["reason"] == "ROBOT_LATCHED"
    assert record["body"]["decision"]["findings"][0]["detail"] == {"latch_id": LATCH}


def test_cleared_it_is_decided_as_before(rig):
    rig.latch_id = LATCH
    assert asked(rig).effect is Effect.DENY
    rig.latch_id = None
    assert asked(rig).effect is Effect.PERMIT


def test_reading_goes_on(rig):
    rig.latch_id = LATCH
    assert asked(rig, "read_state").effect is Effect.PERMIT


def test_no_policy_takes_it_away(rig):
    kept = tuple(policy for policy in rig.policies.policies if policy.id != "readiness")
    rig.policies = replace(rig.policies, policies=kept)
    rig.build()
    rig.latch_id = LATCH
    assert asked(rig).reason is Reason.ROBOT_LATCHED


def test_a_stranger_is_not_told_of_it(rig):
    rig.latch_id = LATCH
    holder = rig.agent()
    rig.feed.revoke("agent", holder.name)
    decision = asyncio.run(rig.gate.run(rig.call(holder), rig.effect)).decision
    assert (decision.effect, decision.reason) == (Effect.DENY, Reason.REVOKED)


def test_a_permit_names_the_tier_that_its_latch_would_have(rig):
    given = []

    async def effect(permit):
        given.append(permit.tier)
        return await rig.effect(permit)

    asyncio.run(rig.gate.run(rig.call(rig.agent()), effect))
    assert given == [Tier.REVERSIBLE]
