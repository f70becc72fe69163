"""Picture that an ask carries: right, bounded, the same each time, and around the arm at every instant."""

from __future__ import annotations

import math
import random
from dataclasses import replace

import numpy as np
import pytest
from capabilities.statements.people import picture as wire
from pep.pit.files.scene_file import Situation
from pep.pit.picture.picture import picture
from pep.pit.picture.postures import route_of
from pep.pit.picture.shown_form import BOX_FACES, shown_text
from tests.pep.pit.scenes import CELL, HOME, NOTHING, ROBOT, SEED, random_convex, sweep, tcp, with_person

from pep.pit import (
    BlendedPath,
    Capsule,
    GripperMove,
    JointLeg,
    JointPath,
    JointTrajectory,
    LineLeg,
    LinePath,
    MoveJ,
    MoveL,
    OutputSet,
    SpeedJ,
    SpeedL,
    Thing,
    adult_at_distance,
    assess,
)

pytestmark = pytest.mark.clause("STM-25")

POSE = (-0.2, -0.25, 0.25, 2.2206, 2.2206, 0.0)
THERE, BACK = (0.2, *HOME[1:]), (0.2, -1.4, *HOME[2:])
TURNS = JointPath(HOME, (JointLeg(THERE, 1.0, 2.0), JointLeg(HOME, 1.0, 2.0), JointLeg(BACK, 0.5, 1.0)))
MOTIONS = {
    "a joint move": sweep(),
    "a fast one": sweep(speed=3.0, acceleration=12.0),
    "there and back": TURNS,
    "a line": MoveL(HOME, POSE, 0.25, 1.2),
    "lines": LinePath(HOME, (LineLeg(POSE, 0.25, 1.2), LineLeg((*tcp().tolist(), *POSE[3:]), 0.25, 1.2))),
    "joint speeds": SpeedJ(HOME, (0.3, -0.2, 0.1, 0.4, 0.5, -0.6), 1.0, 0.5),
    "a tool speed": SpeedL(HOME, (0.0, 0.0, 0.05, 0.0, 0.0, 0.0), 0.5, 0.4),
    "a trajectory": JointTrajectory((0.0, 1.0, 2.0, 3.0), (HOME, THERE, HOME, BACK), ()),
    "fingers": GripperMove(HOME, 0.05, 0.1, 20),
}


PATIENT = replace(CELL, time_limit_s=60.0)
"""The cell, with time for a machine that does much else."""


def where(scene=None):
    return Situation(PATIENT, with_person(0.6) if scene is None else scene, 0.05, None, NOTHING)


def answer(motion, scene=None):
    situation = where(scene)
    return assess(ROBOT, situation.scene, motion, PATIENT, perception_age_s=0.05, touch=NOTHING, seed=SEED)


def text_of(motion, scene=None):
    return shown_text(ROBOT, where(scene), motion, answer(motion, scene))


def farthest_um(shown, motion):
    """Greatest distance of any part, at any of many instants, from the nearest of the drawn postures."""
    route = route_of(ROBOT, motion, CELL, perception_age_s=0.1)
    drawn = np.array([each.ends_um for each in shown.postures], dtype=float).reshape(len(shown.postures), -1, 2, 3)
    farthest = 0.0
    for posture in route.postures(np.linspace(0, route.duration_s, 1_501).tolist()):
        ends = np.array([(part.a_m, part.b_m) for part in posture.parts]) * 1e6
        apart = np.linalg.norm(drawn - ends, axis=3).max(axis=2)  # a point between two ends is no farther than one
        farthest = max(farthest, float(apart.min(axis=0).max()))
    return farthest


@pytest.mark.parametrize("name", MOTIONS)
def test_widened_by_its_margin_it_holds_the_arm_at_every_instant(name):
    motion = MOTIONS[name]
    situation = where()
    drawn = picture(ROBOT, situation, motion, answer(motion))
    shown = wire.read(shown_text(ROBOT, situation, motion, answer(motion)))
    farthest = farthest_um(shown, motion)
    assert farthest <= shown.margin_um
    assert len(drawn.postures) == len(shown.postures)
    # a bound that is far off shows nobody where the arm is
    assert shown.margin_um <= 12 * farthest + 2_000


def test_it_begins_at_the_start_ends_at_the_end_and_marks_where_it_decides():
    shown = wire.read(text_of(sweep()))
    first, last = shown.postures[0], shown.postures[-1]
    assert first.at_ms == 0
    assert first.tcp_um == tuple(round(each * 1e6) for each in tcp(sweep().start))
    assert last.tcp_um == pytest.approx([round(each * 1e6) for each in tcp(sweep().target)], abs=2)
    assert {part.kind for part in shown.parts} == {"base", "arm", "tool"}
    nearest = shown.places[0]
    assert (nearest.kind, nearest.object.split("/")[0]) == (
        "person",
        answer(sweep()).contributions[0].object.split("/")[0],
    )
    apart = math.dist(nearest.on_link_um, nearest.on_object_um)
    assert apart == pytest.approx(nearest.clearance_um, abs=2_000)
    assert any(body.name == nearest.object and body.kind == "person" for body in shown.bodies)


def test_the_same_question_gives_the_same_bytes():
    assert text_of(sweep()) == text_of(sweep())
    assert wire.digest_of(text_of(sweep())) != wire.digest_of(text_of(sweep(speed=0.9)))
    assert len(text_of(sweep())) < 65_536


def test_a_cut_corner_and_a_led_arm_claim_no_margin():
    path = BlendedPath(HOME, (JointLeg(THERE, 1.0, 2.0, 0.02), JointLeg(BACK, 1.0, 2.0)))
    assert wire.read(text_of(path)).margin_um == wire.UNKNOWN_UM
    still = MoveJ(HOME, HOME, 1.0, 1.0)
    led = wire.read(shown_text(ROBOT, where(), still, None))
    assert (led.margin_um, len(led.postures), led.places) == (wire.UNKNOWN_UM, 1, ())


def test_an_act_without_the_arm_has_none():
    assert shown_text(ROBOT, where(), OutputSet(3, True), None) is None


def test_a_crowded_cell_is_shown_within_the_bound_and_people_before_things():
    rng = random.Random(7)
    place = lambda: (rng.uniform(2, 5), rng.uniform(2, 5), rng.uniform(0.2, 1))
    hulls = [random_convex(np.random.default_rng(k), np.array(place())) for k in range(20)]
    things = tuple(
        Thing(f"thing-{k}-{'x' * 60}", "rigid", hulls[k % 20] if k % 2 else Capsule(place(), place(), 0.05), 0.01)
        for k in range(240)
    )
    people = tuple(
        replace(adult_at_distance(1.0 + k / 10, bearing_rad=k / 5), id=f"person-{k}-{'y' * 40}") for k in range(32)
    )
    crowd = replace(CELL.surveyed, objects=things, people=people)
    still = MoveJ(HOME, HOME, 1.0, 1.0)
    text = shown_text(ROBOT, where(crowd), still, None)
    assert len(text) <= wire.PICTURE_BYTES
    shown = wire.read(text)
    assert {body.name.split("/")[0] for body in shown.bodies if body.kind == "person"} == {each.id for each in people}
    assert shown.omitted + len(shown.bodies) == len(things) + sum(len(each.regions) for each in people)


def test_a_box_that_stands_for_a_hull_is_seen_from_outside():
    corners = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=float)
    for a, b, c in np.array(BOX_FACES).reshape(-1, 3):
        across = np.cross(corners[b] - corners[a], corners[c] - corners[a])
        assert across @ (corners[a] - 0.5) > 0
    assert len(BOX_FACES) == 36
