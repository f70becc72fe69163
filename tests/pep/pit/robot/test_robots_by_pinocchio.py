"""Motions of every shipped arm against pinocchio and coal, which sample them every 8 ms: nothing sampled is worse.

The plain suite tries a few of each arm; with `--campaign` 160 each, and the figures are printed.
"""

from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from evaluation.pit.question import Question
from evaluation.pit.ruler import REACH_M, Ruler
from evaluation.pit.sampled import pose_of
from evaluation.pit.truth import ready
from evaluation.pit.workload import joints
from pep.pit.proof.proof_document import document
from pep.pit.scene.pairs import pairs_of
from pep.pit.search.engine import chosen

from pep.pit import (
    Assessment,
    Box,
    Capsule,
    CellParameters,
    MoveJ,
    MoveL,
    Robot,
    Scene,
    Sphere,
    Thing,
    adult_at_distance,
    assess,
)
from pep.pit.checker import Verified, verify

ARMS = ("ur3e", "ur5e", "ur10e", "ur16e")
FEW, ALL = 8, 160
LINES = 4
"""Every fourth motion is a line of the tool."""
CLEAR = 0.7
"""Share of motions whose way is clear of things."""
HOME = np.array((0.0, -1.62, 1.25, -1.20, -1.57, 0.0))
CELL = CellParameters(objects=(), time_limit_s=60.0)
ROUNDING_M = 1e-6
ROUNDING = 1e-6
EXCESS = 0.05
"""By how much an index may be above the samples: the search's own 0.02, and what 8 ms hide."""
MOST_M = 0.006
"""By how much a proven clearance may be below the samples: what 8 ms at 1.4 m/s hide."""
PAIR_KINDS = {"person", "rigid", "fragile", "self"}


def shape_of(rng, reach_m):
    """A ball, a capsule or a box somewhere about the arm."""
    way = rng.standard_normal(3)
    x, y, z = (way / np.linalg.norm(way) * rng.uniform(0.4, 1.3) * reach_m + (0, 0, 0.15)).tolist()
    match rng.integers(3):
        case 0:
            return Sphere((x, y, z), float(rng.uniform(0.02, 0.08)))
        case 1:
            dx, dy, dz = rng.uniform(-0.1, 0.1, 3).tolist()
            return Capsule((x - dx, y - dy, z - dz), (x + dx, y + dy, z + dz), float(rng.uniform(0.015, 0.06)))
        case _:
            turn = rng.standard_normal(4)
            half = tuple(rng.uniform(0.02, 0.1, 3).tolist())
            return Box((x, y, z), half, tuple((turn / np.linalg.norm(turn)).tolist()))


def least_of(robot, scene, move):
    """Least clearance on the way that is proven, of things and people alone."""
    pairs = pairs_of(robot, scene, CELL, grown_m=0.0)
    things = sum(len(p.regions) for p in scene.people) + len(scene.solid_shapes)
    return Ruler(chosen(), robot, CELL, pairs, np.arange(things * robot.world_bodies)).least(move).proven


def drawn(robot, rng, *, line):
    """One motion among six things and, every other time, a person."""
    reach = float(np.linalg.norm(robot.offsets[1:], axis=1).sum())
    things = tuple(Thing(f"thing{k}", "rigid", shape_of(rng, reach), CELL.object_uncertainty_m) for k in range(6))
    people = (adult_at_distance(float(rng.uniform(0.8, 1.6)) * reach, bearing_rad=float(rng.uniform(-3, 3))),)
    scene = Scene(objects=things, people=people if rng.random() < 0.5 else ())
    low, high = 0.95 * np.array(robot.position_ranges_rad)
    start = np.clip(HOME + rng.uniform(-0.8, 0.8, 6), low, high)
    if line:
        start = HOME + rng.uniform(-0.3, 0.3, 6)
        x, y, z, *turn = pose_of(robot, joints(start))
        dx, dy, dz = rng.uniform(-0.15, 0.15, 3).tolist()
        motion = MoveL(joints(start), (x + dx, y + dy, z + dz, *turn), float(rng.uniform(0.1, 0.5)), 1.2)
    else:
        target = np.clip(start + rng.uniform(-1.5, 1.5, 6), low, high)
        motion = MoveJ(joints(start), joints(target), float(rng.uniform(0.2, 1.5)), 1.4)
        if rng.random() < CLEAR:
            scene = replace(
                scene, objects=tuple(t for t in things if least_of(robot, Scene(objects=(t,)), motion) > 0.005)
            )
    return Question(robot, scene, motion, CELL)


def tried(name, count, seed):
    """Counts and greatest differences of so many motions of this arm; each is checked."""
    robot, counts = Robot.load(name), Counter()
    most = {
        "index below a sample": -np.inf,
        "index above the samples": -np.inf,
        "clearance below the samples, mm": -np.inf,
    }
    number = -1
    while counts["motions"] < count:
        number += 1
        rng = np.random.default_rng([seed, number, len(name), ARMS.index(name)])
        question = drawn(robot, rng, line=number % LINES == LINES - 1)
        asked = {"perception_age_s": 0.1, "touch": frozenset()}
        answer = assess(robot, question.scene, question.motion, CELL, **asked, seed=b"seed")
        if not isinstance(answer, Assessment):
            assert answer.reason == "UNPROVEN" and isinstance(question.motion, MoveL), answer  # noqa: PT018
            counts["lines without a proof, drawn again"] += 1
            continue
        truth, where = ready(question), f"{name}, seed {seed}, motion {number}"
        counts["motions"] += 1
        counts[f"tier {int(answer.tier)}"] += 1
        most["index below a sample"] = max(most["index below a sample"], truth.index - answer.index)
        assert answer.index >= min(truth.index, 4.0) - ROUNDING, where
        kinds = {str(c.kind) for c in answer.contributions[:1]}
        if not answer.violations and kinds <= PAIR_KINDS and isinstance(question.motion, MoveJ):
            most["index above the samples"] = max(most["index above the samples"], answer.index - truth.index)
            assert answer.index - truth.index <= EXCESS, where
        if isinstance(question.motion, MoveJ):
            pairs = pairs_of(robot, question.scene, CELL, grown_m=0.0)
            least = Ruler(chosen(), robot, CELL, pairs, np.arange(len(pairs))).least(question.motion)
            if least.proven < REACH_M and truth.nearest > 0:  # of bodies that overlap coal measures something else
                counts["clearances"] += 1
                assert least.proven <= truth.nearest + ROUNDING_M, where
                below = truth.nearest - least.proven
                most["clearance below the samples, mm"] = max(most["clearance below the samples, mm"], 1000 * below)
                assert below <= MOST_M, where
        proof = document(answer, robot=robot, scene=question.scene, motion=question.motion, cell=CELL, **asked)
        verdict = verify(proof)
        assert isinstance(verdict, Verified), where
        assert verdict.index == answer.index, where
    return counts, most


@pytest.mark.parametrize("name", ARMS)
def test_nothing_that_pinocchio_samples_is_worse_than_the_answer(name):
    counts, _ = tried(name, FEW, 2026)
    assert counts["clearances"] >= 1


@pytest.mark.campaign
@pytest.mark.parametrize("name", ARMS)
def test_of_many_motions_none_is_worse(name):
    counts, most = tried(name, ALL, 2027)
    print(name, dict(counts), {key: round(value, 4) for key, value in most.items()})  # noqa: T201
    assert counts["clearances"] >= ALL // 5


def test_a_model_with_thinner_capsules_is_found_out():
    """Samples of the real arm are nearer than what is proven of a thinner one."""
    robot, rng = Robot.load("ur5e"), np.random.default_rng(1)
    question = drawn(robot, rng, line=False)
    model = robot.model
    thin = replace(model, capsules=tuple(replace(c, radius_m=c.radius_m - 0.01) for c in model.capsules))
    other = Robot.from_model(thin, tool=robot.tool.name)
    pairs = pairs_of(other, question.scene, CELL, grown_m=0.0)
    least = Ruler(chosen(), other, CELL, pairs, np.arange(len(pairs))).least(question.motion)
    assert least.proven > ready(question).nearest + ROUNDING_M
