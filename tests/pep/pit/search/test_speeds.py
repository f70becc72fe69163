"""PHY-7: a ratio by a speed is proven within 0.005 above the index that the motion attains."""

import hashlib
import json
from dataclasses import replace

import numpy as np
import pytest
import rfc8785
from pep.pit.base.motion import profile_of
from pep.pit.base.tier import HIGHEST, ratio_index
from pep.pit.path.straight_path import GRID
from pep.pit.proof.proof_document import document
from pep.pit.search.arm_limits import speed_shares
from pep.pit.search.engine import chosen
from pep.pit.search.question import as_run
from pep.pit.search.surface_speeds import CUTS_MOST, INDEX_WITHIN
from tests.model.pit.demands import Demands
from tests.model.pit.path import NumpyPath
from tests.pep.pit.scenes import CELL, HOME, NOTHING, ROBOT, SEED, empty

from pep.pit import MoveJ, SpeedJ, assess
from pep.pit.checker import Code, Unverified, Verified, verify

mujoco = pytest.importorskip("mujoco", reason="MuJoCo is not installed")

from tests.pep.pit.campaign import dense  # noqa: E402 - it needs MuJoCo

pytestmark = pytest.mark.long

BY_SPEED = ("tcp_speed", "elbow_speed", "momentum")
COARSE, FINE, ROUNDS = 801, 41, 4


def fast(rng):
    """A move whose speeds may come near their limits; some never leave the ramps."""
    start = np.array(HOME) + rng.uniform(-0.6, 0.6, 6)
    way = float(rng.choice([0.4, 1.0, 2.5])) * rng.uniform(-1, 1, 6)
    speed, acceleration = float(rng.uniform(1.0, 3.1)), float(rng.uniform(2.0, 5.0))
    if rng.random() < 0.2:
        return SpeedJ(
            tuple(start.tolist()), tuple((way * speed / 3).tolist()), acceleration, float(rng.uniform(0.2, 1.0))
        )
    return MoveJ(tuple(start.tolist()), tuple((start + way).tolist()), speed, acceleration)


def limited(rng, move):
    """Cell whose limits are near the move's values: every band of the index, and either side of each tier."""
    robot, run = ROBOT, as_run(move, CELL)
    profile = profile_of(run)
    most = Demands(NumpyPath(robot, run), CELL).surface_speed_m_s(profile)
    share = speed_shares(robot, CELL)
    tcp, elbow, momentum = (share @ most).tolist()
    aim = rng.uniform(0.74, 1.02, 3)
    return replace(
        CELL,
        tcp_speed_limit_m_s=CELL.tcp_speed_limit_m_s * tcp / aim[0],
        elbow_speed_limit_m_s=CELL.elbow_speed_limit_m_s * max(elbow, 1e-3) / aim[1],
        momentum_limit_kg_m_s=CELL.momentum_limit_kg_m_s * momentum / aim[2],
    )


def sampled(move, cell):
    """Each ratio as MuJoCo sees it: many instants, then finer ones about the fastest of every point."""
    world = dense.World(ROBOT, empty(), move, cell, 0.1, NOTHING)
    whole = world.run.timing.duration_s
    world.look(np.linspace(0, whole, COARSE))
    width = whole / (COARSE - 1)
    for _ in range(ROUNDS):
        best = world.times[world.shots.points.argmax(axis=0)]
        world.look(np.unique(np.clip(np.add.outer(best, np.linspace(-width, width, FINE)).ravel(), 0, whole)))
        width *= 2 / (FINE - 1)
    return world.ratios()


@pytest.mark.parametrize("seed", range(12))
def test_a_ratio_of_speeds_is_within_the_resolution_of_what_is_sampled(seed):
    rng = np.random.default_rng([76, seed])
    decided = 0
    for _ in range(4):
        move = fast(rng)
        cell = limited(rng, move)
        run = as_run(move, cell)
        seen = sampled(move, cell)
        kernel, twin = chosen().demands(chosen().path(ROBOT, run), cell), Demands(NumpyPath(ROBOT, run), cell)
        profile = profile_of(run)
        for demands, intervals in ((kernel, kernel.intervals(profile)[0]), (twin, twin.speeds(profile).low)):
            proven = {each.name: each for each in demands.ratios(profile)}
            assert len(intervals) <= CUTS_MOST
            for name in BY_SPEED:
                assert proven[name].ratio >= seen[name] - 1e-9, name
                above = proven[name].index - dense.ratio_law(seen[name])
                assert above <= INDEX_WITHIN + 1e-4, (name, above, proven[name].ratio, seen[name])
                decided += proven[name].index > 1
    assert decided > 4


def test_the_intervals_tile_the_path_and_their_speeds_are_bounds():
    rng = np.random.default_rng(77)
    finer = 0
    for _ in range(20):
        move = fast(rng)
        cell = limited(rng, move)
        run = as_run(move, cell)
        profile, path = profile_of(run), NumpyPath(ROBOT, run)
        speeds = Demands(path, cell).speeds(profile)
        assert speeds.low[0] == 0
        assert speeds.high[-1] == GRID
        assert (speeds.low[1:] == speeds.high[:-1]).all()
        finer += len(set((speeds.high - speeds.low).tolist())) > 1
        at, known = path.nodes(np.linspace(0, GRID, 4001).astype(np.int64))
        rate = profile.rate(np.linspace(0, GRID, 4001).astype(np.int64) / GRID)
        met = ((known.speed[at] + path.layout.radius * known.spin[at]) * rate[:, None]).max(axis=0)
        assert (met <= speeds.most_m_s + 1e-12).all()
    assert finer > 10


def test_a_calm_motion_needs_no_more_than_the_first_intervals():
    run = as_run(MoveJ(HOME, (HOME[0] + 1.0, *HOME[1:]), 0.3, 1.0), CELL)
    speeds = Demands(NumpyPath(ROBOT, run), CELL).speeds(profile_of(run))
    assert len(set((speeds.high - speeds.low).tolist())) == 1


@pytest.mark.parametrize("seed", range(10))
def test_a_tightened_ratio_is_proven_by_its_certificate(seed):
    """The checker recomputes the bound on the document's own intervals; on coarser ones it does not hold."""
    rng = np.random.default_rng([78, seed])
    move = fast(rng)
    cell = limited(rng, move)
    asked = {"robot": ROBOT, "scene": empty(), "motion": move, "cell": cell, "perception_age_s": 0.1, "touch": NOTHING}
    answer = assess(**asked, seed=SEED)
    text = document(answer, **asked)
    verdict = verify(text)
    assert isinstance(verdict, Verified), verdict
    assert verdict.index == answer.index
    assert (
        answer.index
        >= max(
            ratio_index(r.ratio)
            for r in Demands(NumpyPath(ROBOT, as_run(move, cell)), cell).ratios(profile_of(as_run(move, cell)))
        )
        - 1e-9
    )
    if answer.index == HIGHEST:  # beyond a limit nothing is higher
        return
    coarse = json.loads(text)
    coarse["proof"]["cut"] = "0"
    del coarse["digest"]
    refused = verify(rfc8785.dumps(coarse | {"digest": hashlib.sha256(rfc8785.dumps(coarse)).hexdigest()}))
    assert (type(refused), getattr(refused, "code", None)) == (Unverified, Code.FLOOR_EXCEEDS)
