"""A slice of `make soundness`, and that each of its checks sees what it is there to see."""

from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("mujoco", reason="MuJoCo is not installed")

from evaluation.bench.pit.ruler import REACH_M, Least, Ruler
from pep.pit import MoveJ, Person, Region, Scene, Sphere, Thing, assess
from pep.pit.motion import profile_of
from pep.pit.pairs import pairs_of
from pep.pit.path import GRID, Path
from pep.pit.checker import Verified
from policies.evidence import ImpactFault
from tests.pit import campaign, dense, twin
from tests.pit.corruption import Corrupted
from tests.pit.scenes import CELL, NOTHING, ROBOT, SEED, random_move, random_scene, sweep, with_glass, with_person

SLICE = 40


def test_p9_a_slice_of_the_campaign_meets_every_claim():
    found = campaign.piece(7, 0, SLICE)
    assert found.failed == []
    assert found.counts["trials"] == found.counts["certificates"] == SLICE
    assert found.counts["corrupted"] == SLICE // campaign.CORRUPT_EACH
    assert found.counts["compared"] > 0.9 * SLICE
    assert found.counts["clearances"] > 0.8 * SLICE
    assert found.counts["index is no whole number"] > 0.2 * SLICE
    assert found.counts["samples"] > 100 * SLICE
    assert found.most["index below a sample"] <= campaign.UNDER
    assert 0 < found.most["clearance below the samples, mm"] <= 0.2


# ---- each check, broken once


def lying(monkeypatch, change):
    """`assess` answers what `change` makes of its answer."""
    monkeypatch.setattr(campaign, "assess", lambda **asked: change(assess(**asked)))


@pytest.fixture(autouse=True)
def not_thorough(monkeypatch):
    monkeypatch.setattr(campaign, "THOROUGH", 301)


def complaints(count=4):
    return " ".join(campaign.piece(7, 0, count).failed)


@pytest.mark.parametrize(
    ("change", "seen"),
    [
        (lambda a: replace(a, index=a.index - 0.05), ", sampled "),
        (lambda a: replace(a, index=min(4.0, a.index + 0.05)), "sampled no more than"),
        (lambda a: replace(a, index=a.index - 0.05), "no certificate"),
        (lambda a: ImpactFault("PHYSICS_FAULT", "no answer in time"), "a fault"),
    ],
)
def test_an_index_that_is_not_the_sampled_one_is_seen(monkeypatch, change, seen):
    lying(monkeypatch, change)
    assert seen in complaints()


def test_a_violation_that_is_not_told_is_seen(monkeypatch):
    lying(monkeypatch, lambda a: replace(a, violations=()))
    monkeypatch.setattr(campaign, "certified", lambda *a: None)  # of such an answer no proof is found, after long
    monkeypatch.setattr(campaign, "drawn", lambda seed, number: campaign.asked(through(), sweep()))
    assert "violations {'person'}" in complaints(1)


def through():
    from tests.pit.scenes import tcp

    return Scene(people=(Person("p", ((Region.TORSO, Sphere(tuple(tcp().tolist()), 0.1)),)),))


@pytest.mark.parametrize(
    ("change", "seen"),
    [
        (lambda least: Least(least.proven + 3e-4, least.attained), "clearance"),
        (lambda least: Least(least.proven - 3e-4, least.attained), "sampled no less than"),
    ],
)
def test_a_clearance_that_is_not_the_sampled_one_is_seen(monkeypatch, change, seen):
    true = Ruler.least
    monkeypatch.setattr(Ruler, "least", lambda self, move: change(true(self, move)))
    assert seen in complaints()


def test_a_certificate_that_is_not_verified_and_a_corrupted_one_that_is_are_seen(monkeypatch):
    true = campaign.verify
    monkeypatch.setattr(campaign, "verify", lambda text: true(text[:-1]))
    assert "not verified" in complaints(2)
    verdict = Verified(index=1.0, tier=1, rows=1, question="", model="", scene="")
    monkeypatch.setattr(campaign, "verify", lambda text: verdict)
    assert "not verified" in complaints(1)  # a verdict on another answer
    monkeypatch.setattr(campaign, "corrupted", lambda text, rng: Corrupted("a seal on nothing", text))
    monkeypatch.setattr(campaign, "verify", true)
    assert "a seal on nothing: Verified" in complaints(1)


def test_what_breaks_in_a_trial_is_a_failure_of_that_trial(monkeypatch):
    monkeypatch.setattr(campaign, "document", lambda *a, **k: 1 / 0)
    assert "trial 1: ZeroDivisionError" in complaints(2)


# ---- the ledger


def test_a_run_goes_on_where_it_was_ended(tmp_path, monkeypatch):
    done, ledger = [], tmp_path / "ledger"

    class Here:
        """Does at once what a pool would do."""

        def __init__(self, *args, **more):
            pass

        def __enter__(self):
            return self

        def __exit__(self, *error):
            return False

        def submit(self, work, *args):
            done.append(args)
            ended = campaign_future()
            ended.set_result(work(*args))
            return ended

    monkeypatch.setattr(campaign, "ProcessPoolExecutor", Here)
    monkeypatch.setattr(campaign, "trial", lambda seed, number: one_trial(number))
    monkeypatch.setattr(campaign, "SHARE", 10)
    more = {"ledger": ledger, "workers": 1, "told": lambda whole: None}
    part = campaign.run(5, 0, 20, until=float("inf"), **more)
    whole = campaign.run(5, 0, 40, until=float("inf"), **more)
    assert [first for _, first, _ in done] == [0, 10, 20, 30]
    assert (part.counts["trials"], whole.counts["trials"]) == (20, 40)
    assert (part.most["number"], whole.most["number"]) == (19, 39)
    assert whole.failed == ["13"]
    monkeypatch.setattr(campaign, "sources", lambda: "others")
    assert campaign.run(5, 0, 10, until=float("-inf"), **more).counts["trials"] == 0
    assert campaign.run(6, 0, 10, until=float("inf"), **more).counts["trials"] == 10
    assert campaign.run(7, 0, 10, until=float("-inf"), **more).counts["trials"] == 0


def campaign_future():
    from concurrent.futures import Future

    return Future()


def one_trial(number):
    found = campaign.Figures()
    found.counts["trials"] += 1
    found.reach("number", number)
    if number == 13:
        found.failed.append("13")
    return found


# ---- the sampling engine beside the numpy engine, and its laws beside the slow twin


def by_numpy(path, profile, pairs, times):
    """Clearance and surface speed of every pair at these times, each of shape (times, pairs)."""
    every = np.arange(len(pairs))
    places = [(round(s * GRID), rate) for s, rate in map(profile.at, times)]
    clearance = np.array([path.clearance_at(pairs, key, every) for key, _ in places])
    return clearance, np.array([path.rush_at(pairs, key, every) * rate for key, rate in places])


@pytest.mark.parametrize("seed", range(4))
def test_places_clearances_and_speeds_are_those_of_the_numpy_engine(seed):
    rng = np.random.default_rng([41, seed])
    scene, move = random_scene(rng, things=6, regions=4, zones=2), random_move(rng)
    world = dense.World(ROBOT, scene, move, CELL, 0.1, NOTHING)
    times = np.linspace(0, world.run.timing.duration_s, 21)
    world.look(times, at_least_m=0.5)
    pairs, profile = pairs_of(ROBOT, scene, CELL, grown_m=0.0), profile_of(move)
    assert world.run.timing.duration_s == pytest.approx(profile.duration_s, rel=1e-12)
    clearance, speed = by_numpy(Path(ROBOT, move), profile, pairs, times)
    things = len(world.shapes) * len(world.moving)
    mine = np.concatenate([world.clear_thing[0][:, :, world.moving].reshape(len(times), -1), world.clear_own[0]], 1)
    rushing = np.concatenate([np.tile(world.speed[0][:, world.moving], len(world.shapes)), world.own_speed[0]], 1)
    near = np.isfinite(mine)
    assert near[:, :things].any()
    assert near[:, things:].any()
    # MuJoCo calls a box shallower than it is once a body's axis is inside it: then only that they meet is compared.
    apart = near & (clearance > -pairs.radii + 1e-6)
    assert np.abs(mine - clearance)[apart].max() <= 2e-6
    assert (mine[near & ~apart] < 0).all()
    assert (clearance[:, :things][~near[:, :things]] > 0.5 - 1e-6).all()
    assert np.abs(rushing - speed).max() <= 1e-5


def test_laws_are_the_twins():
    rng = np.random.default_rng(42)
    for _ in range(300):
        d, v, age, omega, z = rng.uniform(-0.2, 2), rng.uniform(1e-3, 2), rng.uniform(0, 0.5), rng.uniform(0, 3), 0.055
        stop = dense.Stop.of(CELL, age, omega)
        index = dense.person_law(d, v, z=z, harm=0.8, reach=0.1, cell=CELL, stop=stop)
        assert index == pytest.approx(twin.person(d - z, d, v, 0.8, age=age, omega=omega), abs=1e-9)
        for band in (0.02, 0.25):
            index = dense.thing_law(d, v, z=z, band=band, stop=stop)
            assert index == pytest.approx(twin.thing(d - z, v, band, omega=omega), abs=1e-9)
        index = dense.zone_law(d, v, z=z, band=0.02, tier=3, stop=stop)
        assert index == pytest.approx(twin.zone(d - z, v, 3, omega=omega), abs=1e-9)
    for ratio, index in {0.5: 1, 0.75: 1, 0.825: 1.5, 0.9: 2, 0.95: 2.5, 1.0: 3, 1.001: 4}.items():
        assert dense.ratio_law(ratio) == pytest.approx(index)


@pytest.mark.parametrize("scene", [with_glass(), with_person(0.9)])
def test_ratios_are_below_the_proven_ones_and_near(scene):
    from pep.pit.parameters import Demands

    move = sweep(2.0, 3.0)
    world = dense.World(ROBOT, scene, move, CELL, 0.1, NOTHING)
    world.look(np.linspace(0, world.run.timing.duration_s, 401))
    proven = {r.name: r.ratio for r in Demands(Path(ROBOT, move), CELL).ratios(profile_of(move))}
    for name, ratio in world.ratios().items():
        assert proven[name] * 0.95 - 0.01 <= ratio <= proven[name] + 1e-9, name


def test_the_ruler_measures_what_is_sampled_and_nothing_beyond_its_reach():
    rows = np.arange(ROBOT.world_bodies)
    reached = []
    for x in np.linspace(0.3, 1.8, 16).tolist():
        scene = Scene(objects=(Thing("ball", "rigid", Sphere((x, 0.1, 0.3), 0.05), 0.0),))
        pairs, path = pairs_of(ROBOT, scene, CELL, grown_m=0.0), Path(ROBOT, sweep())
        least = Ruler(campaign.chosen(), ROBOT, CELL, pairs, rows).least(sweep())
        keys = np.linspace(0, GRID, 801).astype(int).tolist()
        sampled = min(float(path.clearance_at(pairs, key, rows).min()) for key in keys)
        assert least.proven <= sampled + 1e-9
        reached.append(np.isfinite(least.attained))
        if reached[-1]:
            assert 0 <= least.attained - least.proven <= 2e-4
            assert sampled - least.proven <= 3e-4  # what 801 samples can miss
        else:
            assert least.proven == REACH_M
    assert set(reached) == {True, False}
