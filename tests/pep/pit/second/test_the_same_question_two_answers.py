"""One question has one answer, after any other question and however far a thing is away."""

from dataclasses import replace
from itertools import permutations

import numpy as np
import pytest
from pep.pit import Box, MoveJ, MoveL, Robot, Thing, assess
from pep.pit.assessment.assessment import Assessment
from pep.pit.scene.pairs import pairs_of
from pep.pit.search.engine import chosen
from pep.pit.second.collision_model import STAGES
from pep.pit.second.second_engine import SecondWorld
from tests.pep.pit.lines import random_line
from tests.pep.pit.scenes import CELL, NOTHING, ROBOT, SEED, empty, random_move, random_scene

PATIENT = replace(CELL, time_limit_s=60.0)


def ask(motion, scene, robot=ROBOT):
    return assess(robot, scene, motion, PATIENT, perception_age_s=0.1, touch=NOTHING, seed=SEED)


def with_box(half, center):
    return replace(empty(), objects=(*empty().objects, Thing("box", "rigid", Box(center, (half,) * 3), 0.0)))


def moved(start, by=0.2):
    return MoveJ(start, tuple(round(q + by, 2) for q in start), 0.5, 1.4)


# Each of these was answered once and was ENGINES_DISAGREE the other time.
FAR = [
    (with_box(12.0, (-1.8, -1.7, -38.1)), moved((-1.12, -1.5, -0.02, 1.05, 1.4, 0.62))),
    (with_box(12.0, (-2.5, -2.6, -28.5)), moved((-0.01, -1.5, 0.4, 0.78, -1.29, 1.39))),
    (with_box(6.0, (2.4, -1.9, -55.7)), moved((1.08, -1.5, -1.35, -1.05, -0.19, -0.88))),
    (with_box(12.0, (2.0, -2.0, -27.3)), moved((1.14, -1.5, -0.55, 0.19, 1.11, 1.07))),
]


@pytest.mark.parametrize("at", range(len(FAR)))
def test_a_large_box_far_below_the_base_is_answered_and_again_the_same(at):
    scene, motion = FAR[at]
    STAGES.of.cache_clear()
    first, second = ask(motion, scene), ask(motion, scene)
    assert isinstance(first, Assessment), first
    assert told(first) == told(second)


def told(answer):
    """All of an answer, bit by bit."""
    if not isinstance(answer, Assessment):
        return answer
    return answer.reading(), answer.index.hex(), answer.clearance_m.hex(), answer.certificate.rows


def test_no_answer_depends_on_what_was_asked_before():
    """Five questions of one kind of scene in every order, on stages and arrays that the one before has used."""
    rng = np.random.default_rng(25)
    asked = [FAR[0], FAR[1]]
    asked += [(random_scene(rng, things=1, regions=1), random_move(rng)) for _ in range(2)]
    asked.append((random_scene(rng, things=1, regions=1), random_line(rng)))
    assert isinstance(asked[-1][1], MoveL)
    alone = []
    for scene, motion in asked:
        STAGES.of.cache_clear()
        alone.append(told(ask(motion, scene)))
    for order in list(permutations(range(len(asked))))[::7]:
        for which in order:
            scene, motion = asked[which]
            assert told(ask(motion, scene)) == alone[which], order


@pytest.mark.parametrize("seed", range(4))
def test_what_coal_measures_is_exact_and_the_same_each_time(seed):
    """Boxes of 0.1 m to 13 m, up to 30 m away, beside the kernel's distances, which are closed forms."""
    rng, robot = np.random.default_rng([26, seed]), Robot.load("ur3e")
    for _ in range(40):
        half = 10 ** rng.uniform(-1, 1.1, 3)
        way, turn = rng.standard_normal(3), rng.standard_normal(4)
        center = way / np.linalg.norm(way) * (np.linalg.norm(half) + 10 ** rng.uniform(-1, 1))
        box = Box(tuple(center.tolist()), tuple(half.tolist()), tuple((turn / np.linalg.norm(turn)).tolist()))
        scene = replace(empty(), objects=(Thing("box", "rigid", box, 0.0),))
        start = tuple(rng.uniform(-2, 2, 6).tolist())
        pairs = pairs_of(robot, scene, CELL, grown_m=0.0)
        exact = chosen().path(robot, moved(start)).clearance_at(pairs, 0, np.arange(len(pairs)))
        world = SecondWorld(robot, scene, pairs)
        found, again = (world.ask(np.array(start), np.zeros(6))[0] for _ in range(2))
        assert (found == again).all()
        assert np.abs(found - exact).max() <= 1e-7
