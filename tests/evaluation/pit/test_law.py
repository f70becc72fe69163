"""The study of the index's law: the referee against motions whose end is plain, and the counts of a result."""

import math
from dataclasses import replace

import pytest
from evaluation.pit.approach import AGE_S, Judged, MotionReferee
from evaluation.pit.law import Drawn, LawResult, calm_rad_s, embedded_cell, last_line, study, tables
from pep.pit import Box, Capsule, CellParameters, MoveJ, Robot, Scene, Thing, adult_at_distance, assess

CELL = CellParameters()
ROBOT = Robot.load("ur3e", tool=CELL.tool)
POSTURE = (-1.62, 1.25, -1.2, -1.57, 0.0)
FRONT_RAD = math.atan2(-0.131, -0.272)


def sweep(speed_rad_s, start=-1.0, target=1.0):
    return MoveJ((start, *POSTURE), (target, *POSTURE), speed_rad_s, 3.0)


def standing(far_m):
    return Scene(people=(adult_at_distance(far_m, bearing_rad=FRONT_RAD),))


GLASS = Scene(
    objects=(Thing("glass", "fragile", Capsule((-0.272, -0.131, 0.03), (-0.272, -0.131, 0.1), 0.035), 0.015),)
)


@pytest.mark.parametrize("scene", [Scene(), GLASS, standing(0.9)])
def test_the_sampled_law_is_that_of_the_shipped_engine_and_approach_is_never_above_it(scene):
    judged = MotionReferee(ROBOT, scene, CELL).judged(sweep(1.05))
    certified = assess(ROBOT, scene, sweep(1.05), CELL, perception_age_s=AGE_S, touch=frozenset(), seed=b"")
    assert certified.index - 0.02 <= judged.whole <= certified.index
    assert 1.0 <= judged.approach <= judged.mixed <= judged.whole


def test_a_person_far_away_is_out_of_reach_and_one_nearby_is_not():
    assert not MotionReferee(ROBOT, standing(2.0), CELL).judged(sweep(0.5)).person
    assert MotionReferee(ROBOT, standing(0.5), CELL).judged(sweep(0.5)).person


def test_a_person_is_reached_by_a_fast_arm_at_a_distance_where_a_slow_one_has_stopped():
    """The way is the same: what differs is how long the stop takes."""
    referee = MotionReferee(ROBOT, standing(1.2), CELL)
    assert [referee.judged(sweep(speed)).person for speed in (0.2, 3.0)] == [False, True]


def test_a_joint_that_stops_later_than_another_one_touches_what_the_way_itself_does_not():
    """Shoulder and elbow together carry the tool over the slab; the elbow alone would carry it down."""
    slab = Thing("slab", "rigid", Box((-0.4, -0.13, 0.1), (0.25, 0.2, 0.02)), 0.0)
    referee = MotionReferee(ROBOT, Scene(objects=(slab,)), CELL)
    moves = [
        MoveJ((0.0, -1.62, 1.25, -1.2, -1.57, 0.0), (0.0, -1.22, 0.85, -1.2, -1.57, 0.0), speed, 8.0)
        for speed in (0.1, 3.0)
    ]
    assert not any(referee.touches_on_its_way(move) for move in moves)
    assert [referee.judged(move).thing for move in moves] == [False, True]


def test_more_uncertainty_never_lowers():
    plain, more = (MotionReferee(ROBOT, GLASS, CELL, more_m=m).judged(sweep(1.05)) for m in (0.0, 0.002))
    assert more.whole > plain.whole
    assert more.approach > plain.approach


def test_a_way_that_leads_into_a_thing_is_seen():
    post = Scene(objects=(Thing("post", "rigid", Capsule((-0.272, -0.131, 0.0), (-0.272, -0.131, 0.4), 0.03), 0.0),))
    assert MotionReferee(ROBOT, post, CELL).touches_on_its_way(sweep(0.5))
    with pytest.raises(ValueError, match="nowhere"):
        MotionReferee(ROBOT, post, CELL).judged(sweep(0.5, target=-1.0))


def test_a_sweep_along_the_table_leaves_tier_1_by_its_whole_speed_alone():
    cell = embedded_cell()
    referee = MotionReferee(ROBOT, cell.surveyed, cell)
    assert 1.8 < calm_rad_s(referee, "whole") < 1.95
    assert calm_rad_s(referee, "approach") == 3.0


def test_counts_are_by_tier_and_by_what_the_referee_says():
    judged = Judged(2.5, 1.0, 2.5, 0.1, person=False, thing=False)
    drawn = [
        Drawn("person", "sweep", sweep(1.0), each, 2.6)
        for each in (judged, replace(judged, person=True), replace(judged, whole=1.9, approach=1.9, thing=True))
    ]
    result = LawResult({}, drawn, 0, 1, 1.0, {})
    names = "benign", "benign_tier_2_up", "benign_asked", "missed_person", "missed_thing"
    assert [result.counts("whole")[name] for name in names] == [1, 1, 1, 0, 1]
    assert [result.counts("approach")[name] for name in names] == [1, 0, 0, 1, 1]
    assert [result.counts("certified", "person")[name] for name in names] == [1, 1, 1, 0, 0]
    assert len(result.to_json()["missed_by_approach_alone"]) == 1
    assert [table.row_count for table in tables(result)] == [0, 20, 0]
    assert "of 1 benign" in last_line(result)


@pytest.mark.campaign
def test_a_seed_draws_the_same_study():
    one, other = (study(4, seed=7, told=lambda _: None) for _ in range(2))
    assert one.drawn == other.drawn
    assert sum(not each.judged.hazardous for each in one.drawn) == 4
    assert set(one.paper) == {"C0", "C1", "C2"}
    assert one.paper["C1"]["approach"] < one.paper["C1"]["whole"] < 2
