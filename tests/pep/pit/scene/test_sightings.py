"""PHY-23: the source of each thing and its age. An older sighting never counts less."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from msgspec import structs
from pep.perception.sensor_frames import Look, SensorFrame, SensorStatus
from pep.pit.assessment.remaining import Remaining, remaining
from pep.pit.proof.proof_document import document
from pep.pit.robot.kinematics import link_frames
from pep.pit.scene.scene import CELL_FILE, SIGHTING_AGE_LIMIT_S
from pep.pit.scene.view import view_of
from tests.pep.pit.scenes import (
    CELL,
    FRONT,
    HOME,
    NOTHING,
    ROBOT,
    SEED,
    aged,
    empty,
    random_move,
    random_scene,
    sweep,
    tcp,
    with_convex,
    with_person,
)

from capabilities.statements import observation as wire
from pep.pit import Assessment, GripperMove, Sphere, Thing, adult_at_distance, assess, gripped, scene_observed
from pep.pit.checker import Unverified, Verified, verify

PATIENT = replace(CELL, time_limit_s=60.0)  # a slow machine is no fault here
RESOLUTION = 0.01  # of the certified index (PHY-9)
AGE = 0.1
LIMIT = CELL.perception_age_limit_s


def ask(scene, move=None, age=AGE, cell=PATIENT):
    move = sweep(0.5, 1.0) if move is None else move
    answer = assess(ROBOT, scene, move, cell, perception_age_s=age, touch=NOTHING, seed=SEED)
    assert isinstance(answer, Assessment), answer
    return answer


def person(distance=1.6, age_s=0.0, source="camera"):
    return replace(adult_at_distance(distance, bearing_rad=FRONT), age_s=age_s, source=source)


def with_sighting(age_s, distance=1.6):
    return replace(empty(), people=(person(distance, age_s),))


def glass(age_s, source="camera"):
    x, y, _ = tcp()
    return Thing("glass", "fragile", Sphere((x, y + 0.3, 0.06), 0.05), CELL.object_uncertainty_m, source, age_s)


# ---- age


def test_p3_a_person_not_seen_for_a_while_may_have_walked_on():
    """0.2 s at 1.6 m/s are as 0.32 m nearer, but for the violation, which is of the old place."""
    scene = with_sighting(0.2)
    walked = ask(scene)
    vaguer = ask(with_sighting(0.0), cell=replace(PATIENT, person_uncertainty_m=CELL.person_uncertainty_m + 0.32))
    assert walked.index == pytest.approx(vaguer.index, abs=RESOLUTION)
    assert walked.index > ask(with_sighting(0.0)).index + 0.1
    assert walked.perception == "fresh"


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 10**6), st.integers(0, 5), st.sampled_from([0.0, 0.05, 0.2, 0.5, 0.9]))
def test_p3_an_older_sighting_never_lowers(seed, which, age):
    """P3 of each object alone: growing one sighting's age never lowers the index, the tier or the violations."""
    rng = np.random.default_rng([2300, seed])
    scene = aged(rng, with_convex(rng, random_scene(rng, things=2, regions=2, zones=0)))
    move = random_move(rng, float(rng.choice([0.3, 1.0])))
    at = which % len(scene.seen)
    before = scene.seen[at].age_s
    answers = [ask(scene, move, age)]
    for later in sorted(float(x) for x in before + rng.choice([0.01, 0.1, 0.3, 0.45, 2.0, 50.0], 2, replace=False)):
        older = list(scene.seen)
        older[at] = replace(older[at], age_s=later)
        many = len(scene.people)
        answers.append(ask(replace(scene, people=tuple(older[:many]), objects=tuple(older[many:])), move, age))
    for less, more in zip(answers, answers[1:], strict=False):
        assert more.index >= less.index - RESOLUTION
        assert set(more.violations) >= set(less.violations)


@pytest.mark.parametrize("kind", ["person", "thing"])
def test_what_was_not_seen_within_the_limit_is_as_in_a_stale_view(kind):
    def scene(age_s):
        seen = {"people": (person(3.0, age_s),)} if kind == "person" else {"objects": (glass(age_s),)}
        return replace(empty(), **seen)

    for age_s, stale in ((LIMIT - AGE - 0.01, False), (LIMIT - AGE + 0.01, True), (20.0, True)):
        answer = ask(scene(age_s))
        assert (answer.tier >= 3) is stale
        assert answer.perception == ("stale" if stale else "fresh")
        told = [each for each in answer.contributions if each.kind == "perception"]
        assert [each.source for each in told] == (["camera"] if stale else [])


def test_an_object_within_the_limit_keeps_its_uncertainty():
    assert ask(replace(empty(), objects=(glass(0.3),))).index == ask(replace(empty(), objects=(glass(0.0),))).index


def test_the_limit_is_of_the_whole_age():
    late = with_sighting(0.3, 3.0)
    assert view_of(late, 0.1, CELL).perception == "fresh"
    assert view_of(late, 0.21, CELL).perception == "stale"
    assert view_of(replace(late, complete=False), 0.1, CELL).perception == "missing"
    assert view_of(late, 0.6, CELL).grown_m == pytest.approx(0.96)


@pytest.mark.parametrize("age_s", [math.nan, math.inf, -0.1, SIGHTING_AGE_LIMIT_S + 1])
@pytest.mark.parametrize("kind", ["person", "thing"])
def test_an_age_that_is_none_is_refused(kind, age_s):
    scene = with_sighting(age_s) if kind == "person" else replace(empty(), objects=(glass(age_s),))
    answer = assess(ROBOT, scene, sweep(), CELL, perception_age_s=AGE, touch=NOTHING, seed=SEED)
    assert not isinstance(answer, Assessment)
    assert answer.reason == "PERCEPTION_INVALID"


def test_a_watch_stops_when_somebody_has_not_been_seen_for_too_long():
    def left(age_s):
        return remaining(
            ROBOT, with_sighting(age_s, 3.0), sweep(0.5, 1.0), replace(CELL, watch_time_limit_s=60.0),
            at_rad=sweep().start, authorised_milli=2000, perception_age_s=AGE, touch=NOTHING,
        )  # fmt: skip

    assert left(0.1).holds
    late = left(1.0)
    assert isinstance(late, Remaining)
    assert (late.holds, late.index_milli, late.cause) == (False, 3000, "perception")


def test_a_gripper_move_minds_it_too():
    move = GripperMove(HOME, 0.02, 0.05, 20.0)
    assert ask(with_sighting(0.0, 3.0), move).tier < 3 <= ask(with_sighting(2.0, 3.0), move).tier


def test_what_was_seen_long_ago_between_the_fingers_is_no_known_part():
    rotation, origin = (each[0, -1] for each in link_frames(ROBOT, np.array([HOME])))
    at = tuple((origin + rotation @ np.array(ROBOT.tool.tcp_m)).tolist())
    part = Thing("part", "rigid", Sphere(at, 0.02), 0.003, "camera", 0.2)
    assert gripped(ROBOT, HOME, (part,), CELL).object == "part"
    assert gripped(ROBOT, HOME, (replace(part, age_s=LIMIT + 0.01),), CELL) is None


# ---- who says so


def test_each_contribution_tells_who_says_so():
    scene = replace(
        with_person(0.9), people=(person(0.9, source="left"),), objects=(*empty().objects, glass(0.0, "right"))
    )
    told = {each.object.split("/")[0]: each.source for each in ask(scene).contributions if each.link}
    assert told["glass"] == "right"
    assert {source for name, source in told.items() if name not in ("glass", "table")} == {"left"}
    vague = replace(PATIENT, surveyed_uncertainty_m=0.6)
    low = ask(vague.surveyed, sweep(0.5, 1.0), cell=vague)
    table = [each for each in low.contributions if each.object == "table"]
    assert table
    assert {each.source for each in table} == {CELL_FILE}


def frame(sensor, *, people=(), objects=()):
    return wire.Observation(sensor, "0" * 32, 1, 0, "0" * 64, True, people, objects)  # noqa: FBT003


def test_several_sensors_each_keep_their_word():
    body = wire.ObservedPerson("p", (("head", wire.Sphere((1_500_000, 0, 1_000_000), 100_000)),), 120)
    thing = wire.ObservedObject("table", "rigid", wire.Sphere((0, 900_000, 0), 50_000))
    scene = scene_observed(
        (frame("left", people=(body,)), frame("right", people=(structs.replace(body, age_ms=0),), objects=(thing,))),
        CELL, complete=True,
    )  # fmt: skip
    assert [(each.id, each.source, each.age_s) for each in scene.people] == [("p", "left", 0.12), ("p", "right", 0.0)]
    assert [(each.id, each.source) for each in scene.objects] == [("table", CELL_FILE), ("seen/table", "right")]
    assert scene.oldest() == scene.people[0]


def test_a_look_is_as_old_as_its_oldest_sighting():
    body = wire.ObservedPerson("p", (("head", wire.Sphere((0, 0, 0), 1)),), 120)
    thing = wire.ObservedObject("t", "rigid", wire.Sphere((0, 0, 0), 1), 300)
    frames = [
        SensorFrame(frame("a", people=(body,)), 1000, 10, None),
        SensorFrame(frame("b", objects=(thing,)), 950, 5, None),
    ]
    look = Look(tuple(SensorStatus(each.observation.sensor, each, None) for each in frames), 1000)
    assert look.age_ms(1000) == 55
    assert look.sighting_age_ms(1000) == 355
    assert Look((SensorStatus("a", None, None),), 1000).sighting_age_ms(1000) is None


# ---- the proof


def test_a_younger_claim_is_not_what_was_proven():
    """A text that makes a late sighting younger proves another question."""
    scene, move = with_sighting(0.25), sweep(0.5, 1.0)
    answer = ask(scene, move)
    question = {
        "robot": ROBOT,
        "scene": scene,
        "motion": move,
        "cell": PATIENT,
        "perception_age_s": AGE,
        "touch": NOTHING,
    }
    verdict = verify(document(answer, **question))
    assert isinstance(verdict, Verified)
    other = with_sighting(0.24)
    assert verdict.scene != other.digest
    assert isinstance(
        verify(document(answer, **question).replace((0.25).hex().encode(), (0.3).hex().encode())), Unverified
    )
