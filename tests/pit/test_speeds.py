"""Held joint speeds, whose path ends where the stop after them ends, and digital outputs."""

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from pep.pit import CellError, CellParameters, MoveJ, Output, OutputSet, SpeedJ, Sphere, Thing, assess
from pep.pit.motion import Profile, profile_of
from pep.pit.pairs import pairs_of
from pep.pit.path import Path
from pep.pit.question import as_run
from policies.evidence import ImpactFault
from tests.pit.scenes import (
    CELL,
    HOME,
    NOTHING,
    ROBOT,
    SEED,
    empty,
    random_move,
    random_scene,
    tcp,
    with_glass,
    with_person,
)
from tests.pit.test_soundness import dense_index

NAN, INF = math.nan, math.inf
PROFILES = st.builds(Profile, st.floats(1e-3, 6), st.floats(1e-3, 6), st.floats(1e-2, 40), st.floats(1e-2, 40))


def ask(motion, scene=None, cell=CELL, age=0.1):
    return assess(
        ROBOT, empty() if scene is None else scene, motion, cell, perception_age_s=age, touch=NOTHING, seed=SEED
    )


@settings(max_examples=200, deadline=None)
@given(profile=PROFILES, share=st.floats(0, 1))
def test_a_lopsided_profile_is_one_motion_along_the_path_and_in_time(profile, share):
    s, rate = profile.at(share * profile.duration_s)
    peak = profile.peak_rad_s / profile.way_rad
    assert profile.rate(np.array([s]))[0] == pytest.approx(rate, rel=1e-5, abs=1e-5 * peak)
    assert profile.time_of(s) == pytest.approx(share * profile.duration_s, rel=1e-6, abs=1e-6 * profile.duration_s)
    assert profile.at(profile.duration_s)[0] == pytest.approx(1)
    times = np.linspace(0, profile.duration_s, 4001)
    assert np.trapezoid([profile.at(t)[1] for t in times], times) == pytest.approx(1, rel=5e-3)


@settings(max_examples=100, deadline=None)
@given(profile=PROFILES, a=st.floats(0, 1), b=st.floats(0, 1))
def test_supremum_of_the_rate_of_a_lopsided_profile(profile, a, b):
    low, high = min(a, b), max(a, b)
    dense = profile.rate(np.linspace(low, high, 500)).max()
    bound = profile.highest_rate(np.array([low]), np.array([high]))[0]
    assert dense <= bound * (1 + 1e-12)
    assert bound <= dense * 1.15 + 0.05 * profile.peak_rad_s / profile.way_rad


@settings(max_examples=60, deadline=None)
@given(
    qd=st.tuples(*[st.floats(-1, 1) for _ in range(6)]).filter(lambda v: max(map(abs, v)) > 1e-3),
    acceleration=st.floats(0.05, 10),
    duration=st.floats(0.01, 3),
)
def test_the_run_is_what_a_drive_does_step_by_step(qd, acceleration, duration):
    """Integrated in small steps: ramp, hold, the delay of the stop, the stop; no parts of the closed form are shared."""
    run = as_run(SpeedJ(HOME, qd, acceleration, duration), CELL)
    profile = profile_of(run)
    lead = max(map(abs, qd))
    step = (duration + 0.06) / 20_000
    v, way, t = 0.0, 0.0, 0.0
    while t < duration + 0.06:
        before = v
        v = min(lead, v + acceleration * step)
        way += 0.5 * (before + v) * step
        t += step
    peak = v
    way += peak * peak / (2 * 8.0)
    assert profile.way_rad == pytest.approx(way, rel=2e-3, abs=1e-6)
    assert profile.peak_rad_s == pytest.approx(peak, rel=2e-3)
    assert profile.duration_s == pytest.approx(t + peak / 8.0, rel=2e-3)
    moved = np.array(run.target) - np.array(HOME)
    assert moved == pytest.approx(np.array(qd) / lead * way, rel=2e-3, abs=1e-6)


@pytest.mark.parametrize("seed", range(4))
def test_certified_is_above_every_sample_and_close(seed):
    rng = np.random.default_rng(800 + seed)
    scene = random_scene(rng, things=3, regions=2)
    start = random_move(rng).start
    motion = SpeedJ(
        start, tuple(rng.uniform(-1, 1, 6).tolist()), float(rng.uniform(0.5, 3)), float(rng.uniform(0.1, 1))
    )
    answer = ask(motion, scene)
    geometric, demands, violated = dense_index(scene, as_run(motion, CELL))
    assert answer.index >= geometric - 1e-9
    assert answer.index <= max(geometric, demands) + 0.03
    assert set(answer.violations) >= violated


def test_the_way_includes_the_stop():
    """A thing just beyond where the hold ends is met by the delay and the stop alone."""
    motion = SpeedJ(HOME, (0.8, 0, 0, 0, 0, 0), 10.0, 0.5)
    held_until = 0.8 * 0.5
    beyond = tcp((held_until + 0.33, *HOME[1:]))
    post = Thing("post", "rigid", Sphere(tuple(beyond.tolist()), 0.01), 0.0)
    scene = replace(empty(), objects=(post,))
    assert as_run(motion, CELL).target[0] == pytest.approx(0.8 * 0.56 + 0.8**2 / 16, abs=0.04)
    gentle = replace(CELL, stop_deceleration_rad_s2=25.0, stop_delay_s=1e-6)
    assert ask(motion, scene).index > ask(motion, scene, gentle).index
    near_limit = SpeedJ((6.2, *HOME[1:]), (0.7, 0, 0, 0, 0, 0), 10.0, 0.1)
    assert ask(near_limit).violations == ("joint_limit",)
    assert ask(near_limit, cell=gentle).violations == ()


def test_like_a_move_of_the_same_way():
    speed = SpeedJ(HOME, (0.5, 0, 0, 0, 0, 0), 8.0, 1.0)
    run = as_run(speed, CELL)
    for scene in (empty(), with_glass(), with_person()):
        move = MoveJ(run.start, run.target, 0.5, 8.0)
        assert ask(speed, scene).index == pytest.approx(ask(move, scene).index, abs=0.02)


def test_a_slower_one_is_named_and_true():
    fast = ask(SpeedJ((-0.3, *HOME[1:]), (2.0, 0, 0, 0, 0, 0), 5.0, 0.3), with_glass())
    assert fast.tier == 3
    lower = fast.lower_tier_speed
    assert 0.3 < lower < 2.0
    assert ask(SpeedJ((-0.3, *HOME[1:]), (lower, 0, 0, 0, 0, 0), 5.0, 0.3), with_glass()).tier < 3


def test_no_speed_is_no_motion_and_asking_too_much_is_tier_four():
    still = ask(SpeedJ(HOME, (0.0,) * 6, 1.0, 1.0), with_person())
    assert (still.tier, still.index) == (0, 0)
    assert ask(SpeedJ(HOME, (3.2, 0, 0, 0, 0, 0), 1.0, 0.01)).tier == 4
    assert ask(SpeedJ(HOME, (3.2, 0, 0, 6.0, 0, 0), 1.0, 0.01)).tier == 4
    assert ask(SpeedJ(HOME, (0.1, 0, 0, 0, 0, 0), 41.0, 0.01)).tier == 4


@pytest.mark.parametrize(
    ("motion", "reason"),
    [
        (SpeedJ(HOME, (NAN, 0, 0, 0, 0, 0), 1.0, 1.0), "NOT_FINITE"),
        (SpeedJ((INF, *HOME[1:]), (0.1,) * 6, 1.0, 1.0), "NOT_FINITE"),
        (SpeedJ(HOME, (0.1,) * 5, 1.0, 1.0), "PARAMETERS_WRONG"),
        (SpeedJ(HOME, (0.1,) * 6, NAN, 1.0), "NOT_FINITE"),
        (SpeedJ(HOME, (0.1,) * 6, 1.0, INF), "NOT_FINITE"),
        (SpeedJ(HOME, (0.1,) * 6, 0.0, 1.0), "OUT_OF_RANGE"),
        (SpeedJ(HOME, (0.1,) * 6, 1.0, 0.0), "OUT_OF_RANGE"),
        (SpeedJ(HOME, (0.1,) * 6, 1.0, -1.0), "OUT_OF_RANGE"),
        (SpeedJ(HOME, (1e-9,) * 6, 1.0, 1.0), "OUT_OF_RANGE"),
        (SpeedJ(HOME, None, 1.0, 1.0), "PHYSICS_FAULT"),
        (OutputSet(True, True), "PARAMETERS_WRONG"),
        (OutputSet(1.0, True), "PARAMETERS_WRONG"),
        (OutputSet(1, 1), "PARAMETERS_WRONG"),
        (OutputSet("1", True), "PARAMETERS_WRONG"),
    ],
)
def test_nonsense_is_a_fault(motion, reason):
    answer = ask(motion)
    assert isinstance(answer, ImpactFault)
    assert answer.reason == reason


def test_huge_requests_end_in_an_answer():
    for qd, acceleration, duration in ((1.0, 1.0, 1e300), (1e300, 1.0, 1.0), (1.0, 1e300, 1.0), (1e300, 1e300, 1e300)):
        answer = ask(SpeedJ(HOME, (qd, 0, 0, 0, 0, 0), acceleration, duration))
        assert isinstance(answer, ImpactFault) or answer.tier == 4


# ---- outputs

WIRED = replace(
    CELL, outputs=tuple(Output(pin, tier, f"wire {pin}") for pin, tier in ((0, 0), (1, 1), (4, 2), (8, 3), (17, 4)))
)


@pytest.mark.parametrize(("pin", "tier"), [(0, 0), (1, 1), (4, 2), (8, 3), (17, 4)])
@pytest.mark.parametrize("scene", [None, with_person()])
def test_an_output_has_its_declared_tier(pin, tier, scene):
    answer = ask(OutputSet(pin, True), scene, WIRED)
    assert (answer.tier, answer.index, answer.violations, answer.start) == (tier, tier, (), ())
    assert [c.kind for c in answer.contributions] == (["output"] if tier else [])
    reading = answer.reading()
    assert (reading.index_milli, reading.start_urad) == (1000 * tier, ())


@pytest.mark.parametrize("pin", [2, 16, -1, 99])
def test_an_undeclared_output_is_tier_three(pin):
    answer = ask(OutputSet(pin, False), cell=WIRED)
    assert (answer.tier, answer.index) == (3, 3.0)
    assert answer.contributions[0].kind == "undeclared_output"


def test_outputs_are_read_strictly():
    text = '[[outputs]]\npin = 3\ntier = 2\nname = "conveyor"\n'
    assert CellParameters.from_toml(text).outputs == (Output(3, 2, "conveyor"),)
    for bad in (
        text.replace("pin = 3", "pin = 18"),
        text.replace("tier = 2", "tier = 5"),
        text.replace("pin = 3", 'pin = "3"'),
        text + text,
        text + text.replace("pin = 3", "pin = 4"),
        text + "colour = 1\n",
    ):
        with pytest.raises(CellError):
            CellParameters.from_toml(bad)
    for bad in (
        '[[parts]]\nobject = "a"\nmass_kg = 0.0\n',
        '[[parts]]\nobject = "a"\nmass_kg = 1.0\n[[parts]]\nobject = "a"\nmass_kg = 2.0\n',
    ):
        with pytest.raises(CellError):
            CellParameters.from_toml(bad)
