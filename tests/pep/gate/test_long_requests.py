"""Longest request that there is, a trajectory of 256 points with speeds: decided, recorded and asked whole."""

import asyncio
import json
from dataclasses import replace

import pytest
from pep.world.timed_request import arguments_of
from policies.evidence.model import Effect
from policies.words.reason_table import Reason
from tests.pep.kit import Rig, reading

from pep.pit import JointTrajectory

pytestmark = pytest.mark.clause("LSD-24")

START = (0.0, -1.62, 1.25, -1.2, -1.57, 0.0)
LONGEST = JointTrajectory(
    tuple(0.05 * n for n in range(256)),
    tuple((0.0123456 * (n % 7), *START[1:5], -0.654321) for n in range(256)),
    tuple((0.0,) * 6 for _ in range(256)),
)


@pytest.fixture
def rig(tmp_path):
    rig = Rig(tmp_path)
    yield rig
    rig.gate.close()
    rig.journal.close()


@pytest.mark.parametrize(
    ("speeds", "impact", "effect", "reason"),
    [
        (True, reading(1, 900), Effect.PERMIT, Reason.PERMITTED),
        (False, reading(3, 2_500), Effect.DEFER, Reason.TIER_NEEDS_APPROVAL),
        # More than 16 KiB of numbers nobody can be asked about.
        (True, reading(3, 2_500), Effect.DENY, Reason.STATEMENT_MALFORMED),
    ],
)
def test_one_decision_and_one_record_of_all_of_it(rig, speeds, impact, effect, reason):
    arguments = arguments_of(LONGEST if speeds else replace(LONGEST, speeds=()))
    arguments |= {"speed_rad_s": 1.0, "acceleration_rad_s2": 4.0}
    rig.physics.answer = impact
    call = rig.call(rig.agent(), "follow_trajectory", arguments)
    answer = asyncio.run(rig.gate.run(call, rig.effect))
    assert (answer.decision.effect, answer.decision.reason) == (effect, reason)
    (record,) = rig.records("decision")
    (q0,) = (each[2] for each in record["body"]["request"]["values"] if each[0] == "q0")
    assert len(q0) == 256
    assert len(json.dumps(record["body"])) < 100_000
    assert len(rig.sent) == (effect is Effect.PERMIT)
    assert ("ask" in record["body"]) == (effect is Effect.DEFER)


def test_a_bound_of_one_joint_is_of_each_of_its_angles(rig):
    """The angle in the middle alone is outside of what the token allows."""
    arguments = arguments_of(LONGEST) | {"speed_rad_s": 1.0, "acceleration_rad_s2": 4.0}
    arguments["times_s"] = [0.1 * n for n in range(256)]
    call = rig.call(rig.agent(), "follow_trajectory", arguments)
    answer = asyncio.run(rig.gate.run(call, rig.effect))
    assert (answer.decision.effect, answer.decision.reason) == (Effect.DENY, Reason.LIMIT_EXCEEDED_BY_REQUEST)
    assert rig.physics.asked == 0, "what is cheap is asked first"
