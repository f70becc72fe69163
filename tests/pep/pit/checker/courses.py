"""Random questions of every curved form and of paths, their proofs, and motions that are not proven to their end."""

from __future__ import annotations

import json
from dataclasses import dataclass, replace

import numpy as np
import pinocchio
from pep.pit.proof.proof_document import document
from tests.pep.pit.lines import placed, pose_of, random_hold, random_line, random_servo, random_start, random_way
from tests.pep.pit.scenes import CELL, HOME, NOTHING, ROBOT, SEED, random_bounds, random_move, random_scene

from pep.pit import (
    Assessment,
    Capsule,
    Contact,
    GrippedObject,
    JointLeg,
    JointPath,
    LineLeg,
    LinePath,
    MoveL,
    Person,
    Region,
    ServoJ,
    SpeedL,
    Sphere,
    assess,
)

PART = GrippedObject("part", Capsule((0.0, 0.0, 0.18), (0.0, 0.05, 0.2), 0.03), 0.4, blunt=True)
PATIENT = replace(CELL, time_limit_s=60.0)  # other work on the machine is no part of these questions


def shifted(pose, way):
    return (*(np.array(pose[:3]) + way).tolist(), *pose[3:])


def far_line(rng):
    """Mostly one that leaves what the arm reaches."""
    start = random_start(rng, 1.0)
    way = rng.standard_normal(3)
    return MoveL(start, shifted(pose_of(start), way / np.linalg.norm(way) * rng.uniform(0.5, 2.0)), 0.2, 1.0)


def across(rng):
    """Through the arm's own axis, where joints would have to be too fast."""
    start = (*HOME[:1], *(np.array(HOME[1:5]) + rng.uniform(-0.2, 0.2, 4)).tolist(), 0.0)
    x, y, _ = pose_of(start)[:3]
    way = np.array([-x, -y, 0.0]) * rng.uniform(1.6, 2.0) + rng.uniform(-0.02, 0.02, 3)
    return MoveL(start, shifted(pose_of(start), way), float(rng.uniform(0.2, 1.0)), 2.0)


def to_a_limit(rng):
    """Of the first joint."""
    start = (float(rng.choice([-1, 1]) * rng.uniform(5.9, 6.25)), *random_start(rng, 0.3)[1:])
    x, y, _ = pose_of(start)[:3]
    way = np.array([-y, x, 0.0]) * rng.uniform(-0.8, 0.8)
    return MoveL(start, shifted(pose_of(start), way), 0.2, 1.0)


def beyond_a_limit(rng):
    """From beyond the range of the first joint."""
    return MoveL((float(rng.choice([-6.3, 6.3])), *HOME[1:]), pose_of(HOME), 0.2, 1.0)


def about_itself(rng, turns=(0.3, 1.0, 2.5, 3.0)):
    """A turn of the tool."""
    start = random_start(rng, 0.3)
    position, rotation = placed(start)
    axis = rng.standard_normal(3)
    turn = pinocchio.exp3(axis / np.linalg.norm(axis) * rng.choice(turns))
    return MoveL(start, (*position.tolist(), *pinocchio.log3(turn @ rotation).tolist()), 0.1, 1.0)


def half_round(rng):
    """A turn of the tool of which nobody knows which way round it goes."""
    return about_itself(rng, (3.133, 3.138, 3.1415))


def short_line(rng):
    start = random_start(rng)
    way = rng.standard_normal(3)
    return MoveL(start, shifted(pose_of(start), way * 10 ** rng.uniform(-10, -3)), 0.2, 1.0)


def any_hold(rng):
    velocity = rng.uniform(-0.3, 0.3, 6) * rng.integers(0, 2, 6)
    return SpeedL(
        random_start(rng, 1.0), tuple(velocity.tolist()), float(rng.uniform(0.2, 5)), float(rng.uniform(0.05, 2))
    )


def line_path(rng):
    """Two to four lines; sometimes one of no length, or one that leads too far."""
    first = random_line(rng)
    legs, pose = [LineLeg(first.target, first.speed_m_s, first.acceleration_m_s2)], first.target
    for _ in range(int(rng.integers(1, 4))):
        match rng.integers(6):
            case 0:
                pass
            case 1:
                pose = shifted(pose, rng.uniform(-1, 1, 3))
            case _:
                pose = shifted(pose, random_way(rng, 0.08)[0])
        legs.append(LineLeg(pose, float(rng.uniform(0.02, 0.4)), float(rng.uniform(0.3, 2))))
    return LinePath(first.start, tuple(legs))


def joint_path(rng):
    """Two to four joint moves; sometimes one of no length, or one beyond a limit."""
    start = at = random_move(rng, 0.5).start
    legs = []
    for _ in range(int(rng.integers(2, 5))):
        match rng.integers(8):
            case 0:
                pass
            case 1:
                at = (*at[:5], 6.5)
            case _:
                at = tuple((np.array(at) + rng.uniform(-0.5, 0.5, 6)).clip(-6, 6).tolist())
        legs.append(JointLeg(at, float(rng.uniform(0.1, 2)), float(rng.uniform(0.5, 4))))
    return JointPath(start, tuple(legs))


def uneven_hold(rng):
    """A tool that both moves and turns: nobody says how the two grow together."""
    velocity = rng.uniform(0.02, 0.1, 6) * rng.choice([-1, 1], 6)
    return SpeedL(random_start(rng, 0.2), tuple(velocity.tolist()), 1.0, 0.2)


def calm_servo(rng):
    """A small step of a stream, from rest."""
    return ServoJ(HOME, (0.0,) * 6, tuple((np.array(HOME) + rng.uniform(-1, 1, 6) * 1e-3).tolist()), 0.002, 0.1)


def elsewhere(rng):
    """To a pose that the arm has, and seldom along a line that it can go."""
    return MoveL(random_start(rng, 1.5), pose_of(random_start(rng, 2.0)), 0.2, 1.0)


FORMS = {
    "line": random_line, "hold": random_hold, "servo": random_servo, "line path": line_path, "joint path": joint_path,
    "limit": to_a_limit, "turn": about_itself, "short": short_line, "any hold": any_hold, "elsewhere": elsewhere,
    "calm servo": calm_servo, "beyond": beyond_a_limit, "met": random_line,
}  # fmt: skip
UNPROVEN = {"far": far_line, "across": across, "uneven": uneven_hold, "half": half_round}


def random_question(rng, form):
    """A motion of this form in a random scene, with all that a question may have beside it."""
    motion = (FORMS | UNPROVEN)[form](rng)
    scene = random_scene(
        rng, things=int(rng.integers(0, 5)), regions=int(rng.integers(0, 4)), zones=int(rng.integers(0, 3))
    )
    scene = random_bounds(rng, scene, 0.25)
    if form == "met":
        x, y, z = motion.target[:3]
        scene = replace(scene, people=(*scene.people, Person("met", ((Region.HAND, Sphere((x, y, z), 0.05)),))))
    robot, cell, touch = ROBOT, PATIENT, NOTHING
    if rng.random() < 0.25:
        robot = ROBOT.holding(PART)
    if rng.random() < 0.25:
        cell = replace(cell, payload_kg=1.0, stop_deceleration_rad_s2=4.0, rigid_band_m=0.05)
    if rng.random() < 0.3 and scene.objects:
        cell = replace(cell, contacts=tuple(Contact(o.id, "tool") for o in scene.objects))
        touch = frozenset(o.id for o in scene.objects)
    age = None if rng.random() < 0.1 else float(rng.choice([0.05, 0.1, 0.4, 0.7]))
    return {
        "robot": robot, "scene": scene, "motion": motion, "cell": cell, "perception_age_s": age, "touch": touch,
    }  # fmt: skip


@dataclass(frozen=True)
class Written:
    """A question, its answer and the proof of it."""

    question: dict
    answer: Assessment
    text: bytes

    @property
    def top(self):
        return json.loads(self.text)


def written(question):
    """Question with its answer and proof; None where the answer is a fault."""
    answer = assess(**question, seed=SEED)
    return Written(question, answer, document(answer, **question)) if isinstance(answer, Assessment) else None


def courses_of(top):
    """Every course of a document, with the proof that it is in."""
    legs = [leg["proof"] for leg in top["proof"]["legs"]] if "legs" in top["proof"] else [top["proof"]]
    return [leg for leg in legs if "course" in leg]
