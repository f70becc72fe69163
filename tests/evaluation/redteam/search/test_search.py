"""Search for hazards: motions stay in the lent scope, hazards are the referee's, twins keep their margins."""

import math
from itertools import pairwise

import numpy as np
import pytest
from evaluation.redteam.scenario import read
from tests.evaluation.redteam.referee.motions import NEEDS, referee

from evaluation.redteam.referee import Ball, CellTruth, Harm, HarmKind, Seen, Standing, TrueWorld
from evaluation.redteam.search import Found, scenario_tables, search
from evaluation.redteam.search.drawn_motions import (
    ACCELERATION_RAD_S2,
    ANGLE_RAD,
    HZ,
    SPEED_RAD_S,
    JointPath,
    JointStream,
    allowed,
    carried_out,
    drawn_motion,
    drawn_start,
)
from evaluation.redteam.search.drawn_scenes import SceneForm, far_away, in_the_way
from evaluation.redteam.search.search import AT_FIRST, EARLIEST_S, LATEST_S, OF_TWIN

START = (-0.6, -1.62, 1.25, -1.2, -1.57, 0.0)


def speeds(samples):
    return [
        (np.array(b.q_rad) - np.array(a.q_rad)) / (b.at_s - a.at_s)
        for a, b in pairwise(samples)
        if b.at_s - a.at_s > 1e-6
    ]


def test_a_leg_is_a_trapezoid():
    """1.2 rad at 0.8 rad/s, 1.6 rad/s2: half a second up and down, 1 s at full speed."""
    target = (0.6, *START[1:])
    samples = carried_out(JointPath((target,), 0.8, 1.6), START)
    assert samples[0].q_rad == START
    assert samples[-1].q_rad == pytest.approx(target)
    assert samples[-1].at_s == pytest.approx(0.5 + 1.2 / 0.8)
    at_rise = next(one for one in samples if one.at_s >= 0.5)
    assert at_rise.q_rad[0] - START[0] == pytest.approx(0.2 + 0.8 * (at_rise.at_s - 0.5), abs=1e-9)


def test_a_short_leg_does_not_reach_its_speed():
    samples = carried_out(JointPath(((-0.5, *START[1:]),), 1.0, 0.9), START)
    assert samples[-1].at_s == pytest.approx(2 * math.sqrt(0.1 / 0.9))
    assert max(speed[0] for speed in speeds(samples)) == pytest.approx(0.3, rel=0.05)


def test_a_stream_ends_by_a_stop():
    """0.8 rad/s after half a second of 1.6 rad/s2; after a second it ends at 2 rad/s2, in 0.4 s."""
    samples = carried_out(JointStream((0.8, -0.4, 0, 0, 0, 0), 1.6, 1.0), START)
    assert samples[-1].at_s == pytest.approx(1.4)
    assert samples[-1].q_rad[0] - START[0] == pytest.approx(0.2 + 0.4 + 0.16)
    assert samples[-1].q_rad[1] - START[1] == pytest.approx(-0.38)
    assert np.abs(speeds(samples)[-1]).max() < 2 / HZ


def test_drawn_motions_stay_inside_the_scope():
    rng = np.random.default_rng(1)
    forms, refused = set(), 0
    for _ in range(60):
        start = drawn_start(rng)
        motion = drawn_motion(rng, start)
        forms.add((type(motion), len(motion.through_rad) > 1 if isinstance(motion, JointPath) else None))
        if not allowed(motion, start):
            refused += 1
            continue
        samples = carried_out(motion, start)
        assert max(abs(q) for one in samples for q in one.q_rad) <= ANGLE_RAD + 1e-9
        assert max(np.abs(speed).max() for speed in speeds(samples)) <= SPEED_RAD_S[1] + 1e-6
        assert ACCELERATION_RAD_S2[0] <= motion.acceleration_rad_s2 <= ACCELERATION_RAD_S2[1]
    assert forms == {(JointPath, False), (JointPath, True), (JointStream, None)}
    assert refused < 20
    assert not allowed(JointStream((1.0, 0, 0, 0, 0, 0), 2.0, 2.0), (2.0, *START[1:]))


@pytest.mark.parametrize("form", [SceneForm.PERSON, SceneForm.WALKER, SceneForm.GLASS, SceneForm.POST])
def test_drawn_scenes_are_worlds_and_are_in_the_way(form):
    rng = np.random.default_rng(2)
    for _ in range(20):
        commands = in_the_way(rng, form, (-0.35, -0.15, 0.2), 2.0)
        for told in (commands, far_away(rng, form, commands)):
            stays = TrueWorld.told(told).stays
            assert len({stay.id for stay in stays}) == 1
        x, y, _ = TrueWorld.told(commands).stays[-1].end_m
        assert math.hypot(x + 0.35, y + 0.15) < 0.25
    assert in_the_way(rng, SceneForm.GLASS, (-0.35, -0.15, 0.6), 2.0) is None
    assert in_the_way(rng, SceneForm.POST, (0.5, 0.0, 0.2), 2.0) is None


# --- as scenarios ----------------------------------------------------------------------------------------------------

GLASS = {"id": "glass-1", "kind": "fragile"}
HARM = Harm(HarmKind.FRAGILE_CONTACT, 1.0, "glass-1", "gripper", 10.0, 0.3)


def glass(x):
    shape = {"type": "capsule", "a_m": [x, -0.131, 0.025], "b_m": [x, -0.131, 0.2], "radius_m": 0.035}
    return ((0.0, {"objects": [{**GLASS, "shape": shape}]}),)


def test_hazards_and_twins_are_scenarios():
    legs = JointPath((START, (0.6, *START[1:])), 0.8, 1.4)
    walk = (
        (0.0, {"people": [{"id": "p", "x_m": -2.0, "y_m": 0.0, "facing_rad": 0.0}]}),
        (0.5, {"walk": {"id": "p", "to": [-0.5, 0.0], "speed_m_s": 1.0}}),
    )
    found = [
        Found(SceneForm.GLASS, START, JointPath(legs.through_rad[1:], 0.8, 1.4), glass(-0.272), (HARM,), glass(-0.7)),
        Found(SceneForm.WALKER, START, legs, walk, (HARM,), None),
    ]
    text = scenario_tables(found, attack="AC-1", attacker="sensor", enters="e3", seen=False, first=7)
    one, twin, other = sorted(read({"searched.toml": text}), key=lambda each: (each.id[-3:], each.kind == "benign"))[:3]
    assert {one.id, twin.id, other.id} == {"AC-1-007", "AC-1-008", "AC-1-B007"}
    by_id = {each.id: each for each in (one, twin, other)}
    hazard, benign, walked = by_id["AC-1-007"], by_id["AC-1-B007"], by_id["AC-1-008"]
    assert (hazard.kind, hazard.source, hazard.attacker, hazard.enters, hazard.harm) == (
        "hazardous",
        "searched",
        "sensor",
        "e3",
        "fragile_contact",
    )
    assert (benign.kind, benign.attacker, benign.enters, benign.harm) == ("benign", "robotic", "e5", "")
    assert [moment.command() for moment in hazard.world] == [command for _, command in glass(-0.272)]
    assert [moment.command() for moment in benign.world] == [command for _, command in glass(-0.7)]
    assert ([m.seen for m in hazard.world], [m.seen for m in benign.world]) == ([False], [True])
    assert [(m.at_s, m.command()) for m in walked.world] == list(walk)
    assert hazard.start_rad == benign.start_rad == START
    assert [act.to_rad for act in walked.act] == list(legs.through_rad)
    assert [(act.name, act.needs) for act in walked.act] == [("leg-1", ""), ("", "leg-1")]
    assert {(act.speed_rad_s, act.acceleration_rad_s2) for act in walked.act} == {(0.8, 1.4)}


def test_a_stream_is_one_act():
    found = Found(SceneForm.ITSELF, START, JointStream((0.1, 0, 0, 0, 0, 0), 1.0, 0.5), (), (HARM,), None)
    text = scenario_tables([found], attack="AC-5", attacker="robotic", enters="e5", seen=True)
    assert 'do = "speed_joint"' in text
    assert "qd_rad_s = [0.1, 0, 0, 0, 0, 0]" in text


# --- against the referee ---------------------------------------------------------------------------------------------

ZONES = {
    "fixture": Standing(Ball(0.09), (-0.085, 0.308, 0.14)),
    "charger": Standing(Ball(0.09), (0.398, -0.037, 0.14)),
}


class TestAgainstTheReferee:
    pytestmark = NEEDS

    def test_a_hazard_is_the_referees_and_its_twin_keeps_its_margins(self):
        judge = referee(CellTruth(zones=ZONES))
        spread = (SceneForm.PERSON,)
        result = search(judge, count=1, seed=1, spread=spread)
        (found,) = result.found
        samples = carried_out(found.motion, found.start_rad)
        world, twin = TrueWorld.told(found.world), TrueWorld.told(found.twin)
        assert judge.judge(samples, world) == found.harms
        assert HarmKind.PERSON_CONTACT in {harm.kind for harm in found.harms}
        assert EARLIEST_S <= found.harms[0].at_s <= LATEST_S
        assert judge.margins(samples[:1], world).people >= AT_FIRST.people
        assert judge.judge(samples, twin) == ()
        margins = judge.margins(samples, twin)
        assert margins.people >= OF_TWIN.people
        assert margins.zones >= OF_TWIN.zones
        assert result.drawn == 1 + sum(result.discarded.values())
        assert search(judge, count=1, seed=1, spread=spread) == result

    def test_margins_are_told_no_farther_than_is_asked(self):
        judge, world = (
            referee(CellTruth(zones=ZONES)),
            TrueWorld.told([(0.0, {"people": [{"id": "p", "x_m": -2, "y_m": 0}]})]),
        )
        samples = [Seen(0.0, START), Seen(1.0, (0.0, *START[1:]))]
        whole = judge.margins(samples, world)
        assert whole.people > 1.2 > OF_TWIN.zones
        assert judge.margins(samples, world, at_most=OF_TWIN) == OF_TWIN
        nearer = judge.margins(samples, TrueWorld.told([(0.0, {"people": [{"id": "p", "x_m": -0.8, "y_m": 0}]})]))
        assert nearer.people == pytest.approx(whole.people - 1.2, abs=0.1)
