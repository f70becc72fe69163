"""PHY-50: the highest speed at which the rest holds, and the arm's safety on its way down to it."""

import itertools
import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from pep.pit.assessment.course_remaining import rests_of
from pep.pit.assessment.slider_search import paced, steps
from pep.pit.assessment.straight_remaining import RemainingRun, slowed
from pep.pit.base.motion import profile_of
from pep.pit.path.straight_path import GRID
from pep.pit.robot.twist import Twist, turn_of
from pep.pit.scene.pairs import pairs_of
from pep.pit.search.question import as_run
from pep.pit.second.second_engine import SecondWorld
from policies.evidence.evidence import ImpactFault
from tests.model.pit.engine import NUMPY
from tests.model.pit.path import NumpyPath
from tests.pep.pit import twin
from tests.pep.pit.scenes import CELL, HOME, NOTHING, ROBOT, SEED, along, at_time, empty, random_move, tcp
from tests.pep.pit.search.test_soundness import dense_index

from pep.pit import (
    CellError,
    CellParameters,
    GripperMove,
    JointLeg,
    JointPath,
    LineLeg,
    LinePath,
    MoveJ,
    MoveL,
    OutputSet,
    Pace,
    Person,
    Region,
    Remaining,
    ServoJ,
    SpeedJ,
    SpeedL,
    Sphere,
    Zone,
    assess,
    remaining,
    standing_adult,
)

AGE = 0.1
PATIENT = replace(
    CELL, watch_time_limit_s=30.0, time_limit_s=30.0, pacing_time_limit_s=30.0
)  # the tests share the machine
LEFT, RIGHT = (-2.0, *HOME[1:]), (0.6, *HOME[1:])
FAST = MoveJ(LEFT, RIGHT, 0.9, 1.4)


def left(scene, move, share=0.0, authorised=1000, *, running=1.0, cell=PATIENT, age=AGE, at=None, **more):
    return remaining(
        ROBOT,
        scene,
        move,
        cell,
        at_rad=along(move, share) if at is None else at,
        authorised_milli=authorised,
        perception_age_s=age,
        touch=NOTHING,
        running=running,
        **more,
    )


def somebody(distance, bearing=0.0):
    """A person at this distance from the base, towards where the sweep ends."""
    x, y, _ = tcp(RIGHT)
    way = math.atan2(y, x) + bearing
    return replace(empty(), people=(standing_adult(distance * math.cos(way), distance * math.sin(way)),))


def at_fraction(move, fraction):
    """The same move with its time stretched: what the slider makes of it."""
    return replace(
        move,
        speed_rad_s=move.speed_rad_s * fraction,
        acceleration_rad_s2=move.acceleration_rad_s2 * fraction**2,
    )


def test_the_slower_one_is_named_the_nearer_somebody_is():
    found = [left(somebody(distance), FAST, 0.15) for distance in (2.1, 1.75, 1.65, 1.6, 1.2)]
    assert [answer.holds for answer in found] == [True, False, False, False, False]
    assert found[0].pace == Pace(1.0, 1000)
    assert found[-1].pace is None
    fractions = [answer.pace.fraction for answer in found[:-1]]
    assert fractions == sorted(fractions, reverse=True)
    assert len(set(fractions)) == 4
    assert all(answer.cause == "person" and answer.index_milli > 1000 for answer in found[1:])
    assert all(answer.pace.index_milli <= 1000 for answer in found[:-1])


def test_only_the_sliders_own_settings_are_named():
    seen = {left(somebody(d), FAST, 0.15).pace.fraction for d in np.arange(1.57, 1.8, 0.02)}
    assert len(seen) > 5
    assert all(math.isclose(f / CELL.slider_step, round(f / CELL.slider_step)) for f in seen)
    assert min(seen) >= CELL.slowest_fraction
    assert steps(CELL, above=0.0, below=1.0)[:2] == [0.1, 0.15]
    assert steps(CELL, above=0.3, below=0.45) == [0.35, 0.4]
    assert steps(CELL, above=0.9, below=0.95) == []


def index_of(scene, move):
    """The verdict's index of a whole motion in thousandths, or None when it is a violation."""
    answer = assess(ROBOT, scene, move, PATIENT, perception_age_s=AGE, touch=NOTHING, seed=SEED)
    return None if answer.violations else answer.reading().index_milli


def cases(seed, wanted):
    """Random motions under way, too fast for a person near their end, and not at some lower speed.

    Each is a scene, move, share, authorised index and pace.
    """
    rng = np.random.default_rng(seed)
    for _ in range(200):
        if wanted == 0:
            return
        move, share, fraction = random_move(rng, 2.0), float(rng.uniform(0, 0.5)), float(rng.uniform(0.2, 0.9))
        away = rng.standard_normal(3)
        place = tcp(move.target) + away / np.linalg.norm(away) * rng.uniform(0.35, 0.9)
        hand = Person("p", ((Region(rng.choice(list(Region))), Sphere(tuple(place.tolist()), 0.05)),))
        scene = replace(empty(), people=(hand,))
        authorised = index_of(scene, at_fraction(move, fraction))
        if authorised is None or left(scene, move, share, authorised, running=None).holds:
            continue
        pace = left(scene, move, share, authorised).pace
        if pace is not None:
            wanted -= 1
            yield scene, move, share, authorised, pace
    raise AssertionError("too few")


@pytest.mark.parametrize("seed", range(6))
def test_at_that_speed_it_is_what_is_said_of_the_slowed_motion(seed):
    """The index at the named speed is the slow motion's, never above the authorised one; one more step is."""
    for scene, move, share, authorised, pace in cases(100 + seed, 3):
        slow = at_fraction(move, pace.fraction)
        told = left(scene, slow, share, authorised, running=None)
        assert told.holds
        assert told.index_milli <= pace.index_milli <= authorised
        above = pace.fraction + CELL.slider_step
        if above < 1 - 1e-9:
            assert not left(scene, at_fraction(move, above), share, authorised, running=None).holds


def person_index(scene, path, profile, times):
    """Highest index of people at these times of a profile, from the other engine and the slow twin."""
    pairs = pairs_of(ROBOT, scene, CELL, grown_m=0.0)
    world, mass = SecondWorld(ROBOT, scene, pairs), ROBOT.moving_mass_kg / 2 + ROBOT.tool.mass_kg
    who = [(p, region) for p in scene.people for region, _ in p.regions for _ in range(ROBOT.world_bodies)]
    worst = 1.0
    for t in times:
        clearance, speed = world.ask(*at_time(path, profile, t))
        for (person, region), d, v in zip(who, clearance, speed, strict=False):
            reach = 0.10 if person.limbs_tracked else 0.85
            harm = twin.harm_speed(str(region), mass)
            worst = max(worst, twin.person(d - 0.055, d, v, harm, age=AGE, omega=profile.peak_rad_s, c=reach))
    return worst


@pytest.mark.parametrize("seed", range(6))
def test_no_sample_on_the_way_down_to_it_is_above_what_was_authorised(seed):
    """The arm goes on at full speed until the last moment; the other engine and the slow twin sample it."""
    for scene, move, share, authorised, pace in cases(200 + seed, 2):
        path, fast = NumpyPath(ROBOT, move), profile_of(move)
        slow = slowed(fast, pace.fraction)
        began_s = fast.time_of(share)
        late_s = min(began_s + CELL.slowing_s(1.0) + CELL.reaction_s, fast.duration_s)
        whole = replace(scene, objects=())
        assert 1000 * person_index(whole, path, fast, np.linspace(began_s, late_s, 60)) <= authorised + 1
        on_s = slow.time_of(fast.at(late_s)[0])
        assert 1000 * person_index(whole, path, slow, np.linspace(on_s, slow.duration_s, 60)) <= authorised + 1
        geometric, _, violated = dense_index(scene, at_fraction(move, pace.fraction), samples=80, since=share)
        assert 1000 * geometric <= authorised + 1
        assert not violated


def test_slowing_does_not_help_who_is_reached_before_it_takes_hold():
    """A hand ahead would do at the lowest speed, but the arm can reach it at full speed first."""
    at_once = replace(PATIENT, slider_delay_s=0.0, slider_change_per_s=1e6, reaction_s=CELL.reaction_s)
    told = []
    for ahead in np.linspace(0.0, 0.6, 13):
        x, y, z = tcp(along(FAST, 0.3 + ahead))
        hand = Person("p", ((Region.HAND, Sphere((2.4 * x, 2.4 * y, z), 0.05)),))
        scene = replace(empty(), people=(hand,))
        ahead_only = replace(FAST, start=along(FAST, 0.29))
        crawl = index_of(scene, at_fraction(ahead_only, CELL.slowest_fraction))
        answers = [left(scene, FAST, 0.3, crawl, cell=cell) for cell in (PATIENT, at_once)]
        assert not any(answer.holds for answer in answers)
        told.append([answer.pace is not None for answer in answers])
    assert [False, False] in told, "it is where the arm is"
    assert [False, True] in told, "a slider that acted at once would do"
    assert [True, True] in told, "far enough ahead"
    assert [True, False] not in told


@pytest.mark.parametrize("change", [{"slider_delay_s": 1.0}, {"slider_change_per_s": 0.5}, {"reaction_s": 1.0}])
def test_a_slider_that_takes_longer_allows_less(change):
    scene = somebody(1.65)
    assert left(scene, FAST, 0.3).pace is not None
    answer = left(scene, FAST, 0.3, cell=replace(PATIENT, **change))
    assert not answer.holds
    assert answer.pace is None


def test_an_arm_that_is_slow_already_is_asked_at_that_speed():
    scene = somebody(1.65)
    pace = left(scene, FAST, 0.15).pace
    slow = left(scene, FAST, 0.15, running=pace.fraction)
    assert slow.holds
    assert slow.pace.fraction == pace.fraction
    assert slow.cause == ""
    nearer = left(somebody(1.6), FAST, 0.15, running=pace.fraction)
    assert not nearer.holds
    assert nearer.pace.fraction < pace.fraction
    free = left(empty(), FAST, 0.15, running=pace.fraction)
    assert (free.holds, free.pace) == (True, Pace(1.0, 1000))
    farther = left(somebody(1.7), FAST, 0.15, running=pace.fraction)
    assert pace.fraction < farther.pace.fraction < 1.0
    assert farther.pace.fraction == left(somebody(1.7), FAST, 0.15).pace.fraction


@settings(max_examples=25, deadline=None)
@given(
    distance=st.floats(1.45, 1.9),
    share=st.floats(0.0, 0.95),
    running=st.floats(0.05, 1.0),
    authorised=st.integers(1000, 2400),
)
def test_what_holds_at_a_speed_holds_at_every_lower_one(distance, share, running, authorised):
    scene = somebody(distance)
    fast, slow = (left(scene, FAST, share, authorised, running=r) for r in (running, running / 2))
    assert slow.holds or not fast.holds
    for answer in (fast, slow):
        if answer.pace is not None:
            assert answer.pace.index_milli <= authorised
            assert left(scene, at_fraction(FAST, answer.pace.fraction), share, authorised, running=None).holds
    if fast.holds:
        assert fast.pace.fraction >= running
    elif fast.pace is not None:
        assert fast.pace.fraction < running


def test_what_no_speed_mends_is_said_without_one():
    for scene, at, cause in [
        (None, None, "perception"),
        (empty(), (0.0, 0.3, *HOME[2:]), "off_path"),
        (replace(empty(), people=(standing_adult(*(1.2 * tcp()[:2])),)), None, "person"),
    ]:
        answer = left(scene, FAST, 0.1, at=at)
        assert (answer.holds, answer.pace, answer.cause) == (False, None, cause)


def test_a_violation_far_ahead_stops_it():
    x, y, _ = tcp(RIGHT)
    scene = replace(empty(), people=(standing_adult(1.2 * x, 1.2 * y),))
    answer = left(scene, FAST, 0.0, 3999)
    assert (answer.holds, answer.pace) == (False, None)


def test_who_cannot_slow_down_is_told_no_speed():
    scene = somebody(1.65)
    assert left(scene, FAST, 0.15, running=None).pace is None
    held = SpeedJ(LEFT, (0.5, 0, 0, 0, 0, 0), 1.4, 2.0)
    for motion in (
        held,
        ServoJ(HOME, (0.0,) * 6, HOME, 0.002, 0.1),
        SpeedL(HOME, (0.05, 0, 0, 0, 0, 0), 0.5, 0.5),
        GripperMove(HOME, 0.05, 0.05, 70.0),
        OutputSet(3, True),
    ):
        at = LEFT if motion is held else HOME
        assert left(empty(), motion, at=at, authorised=4000, running=0.5).pace is None
    # A held speed is judged as fast as it may be, whatever is said of the slider.
    beside = left(somebody(1.65), held, at=LEFT, running=0.1)
    assert beside == left(somebody(1.65), held, at=LEFT, running=None)


def test_lines_and_paths_are_slowed_like_joint_moves():
    """A hand beyond the end of each; the slowed motion itself holds, and the motion itself does not."""
    middle = along(FAST, 0.5)
    path = JointPath(LEFT, (JointLeg(middle, 0.9, 1.4), JointLeg(RIGHT, 0.9, 1.4)))
    slow_path = JointPath(LEFT, tuple(JointLeg(leg.target, 0.9 * 0.5, 1.4 * 0.25) for leg in path.legs))
    at = along(FAST, 0.1)
    answer = left(somebody(1.65), path, at=at)
    assert not answer.holds
    assert CELL.slowest_fraction <= answer.pace.fraction < 1
    assert answer.pace.fraction >= 0.5 or not left(somebody(1.65), slow_path, at=at, running=None).holds

    at_once = replace(PATIENT, slider_delay_s=0.0, slider_change_per_s=1e6, reaction_s=0.0)
    start = HOME
    pose = forward(start)
    target = (pose[0], pose[1] + 0.3, pose[2], *pose[3:])
    hand = Person("p", ((Region.HAND, Sphere((target[0], target[1] + 0.75, target[2]), 0.05)),))
    scene = replace(empty(), people=(hand,))
    for line, half in (
        (MoveL(start, target, 0.4, 1.2), MoveL(start, target, 0.2, 0.3)),
        (LinePath(start, (LineLeg(target, 0.4, 1.2),)), LinePath(start, (LineLeg(target, 0.2, 0.3),))),
    ):
        authorised = index_of(scene, half)
        answer = left(scene, line, at=start, authorised=authorised, cell=at_once)
        assert not answer.holds
        assert 0.5 <= answer.pace.fraction < 1
        assert answer.pace.index_milli <= authorised
        assert left(scene, line, at=start, authorised=authorised).pace is None, "the arm is too near for a real slider"


def forward(q):
    twist = Twist.between(ROBOT, q, (0.0,) * 6)
    return (*twist.position.tolist(), *turn_of(twist.rotation).tolist())


def test_time_that_runs_out_ends_the_search_not_the_answer():
    scene = somebody(1.65)
    ticks = itertools.count()
    slow_clock = replace(PATIENT, pacing_time_limit_s=CELL.pacing_time_limit_s)
    answer = left(scene, FAST, 0.15, cell=slow_clock, clock=lambda: 0.02 * next(ticks))
    assert not isinstance(answer, ImpactFault)
    assert (answer.holds, answer.pace) == (False, None)
    # One that goes on as it is goes on, though nobody had the time to look for more.
    ticks = itertools.count()
    answer = left(empty(), FAST, 0.15, running=0.3, cell=slow_clock, clock=lambda: 0.02 * next(ticks))
    assert (answer.holds, answer.pace) == (True, Pace(0.3, 1000))


@pytest.mark.parametrize("running", [0.0, -0.5, 1.0001, math.nan, math.inf, "1", (1.0,)])
def test_a_fraction_that_is_none_is_a_fault(running):
    answer = left(empty(), FAST, 0.1, running=running)
    assert isinstance(answer, ImpactFault)


@pytest.mark.parametrize(
    "change",
    [
        {"slider_delay_s": math.nan},
        {"slider_change_per_s": 0.0},
        {"slider_step": 0.0},
        {"slider_step": 0.005},
        {"slider_step": 1.5},
        {"slowest_fraction": 0.0},
        {"slowest_fraction": 1.1},
        {"restore_gain": 0.0},
        {"restore_dwell_s": -1.0},
    ],
)
def test_a_cell_whose_slider_cannot_be_is_refused(change):
    assert replace(CELL, **change).defect() is not None
    text = "\n".join(f"{name} = {value}" for name, value in change.items())
    with pytest.raises(CellError):
        CellParameters.from_toml(text)


class Scripted:
    """Rest as a test says it, with the questions to it."""

    def __init__(self, *, at, near=True):
        self.highest, self.near_holds, self.asked, self.check_time = at, near, [], None

    def prepare(self, scene, age_s, touch):
        return None

    def at(self, fraction):
        self.asked.append(fraction)
        holds = fraction <= self.highest
        return Remaining(holds, 1000 + round(100 * fraction), "" if holds else "person")

    def near(self, fraction, seconds):
        self.asked.append((fraction, seconds))
        return Remaining(self.near_holds, 1234, "" if self.near_holds else "person")


@pytest.mark.parametrize("running", [1.0, 0.62, 0.3])
def test_the_way_down_lasts_until_it_could_be_stopped_instead(running):
    """The time that the slider may take, and the reaction of the watch that sees it did not."""
    slider = Scripted(at=0.2)
    answer = paced(slider, CELL, running, spare=lambda: None)
    assert answer.pace == Pace(0.2, 1234)
    assert slider.asked[:2] == [running, (running, CELL.slider_delay_s + running / 4.0 + CELL.reaction_s)]
    assert paced(Scripted(at=0.2, near=False), CELL, running, spare=lambda: None).pace is None


@given(running=st.floats(0.05, 1.0), highest=st.floats(0.0, 1.0), step=st.sampled_from([0.01, 0.05, 0.07, 0.3]))
def test_the_highest_setting_is_found_with_few_questions(running, highest, step):
    cell = replace(CELL, slider_step=step)
    slider = Scripted(at=highest)
    answer = paced(slider, cell, running, spare=lambda: None)
    known = [round(k * step, 9) for k in range(1, round(1 / step) + 1) if k * step >= cell.slowest_fraction - 1e-9]
    if running <= highest:
        best = max([running, *(f for f in [*known, 1.0] if running < f <= highest)])
    else:
        best = max((f for f in known if f <= highest and f < running - 1e-9), default=None)
    found = None if answer.pace is None else answer.pace.fraction
    assert found == pytest.approx(best, abs=1e-6)
    assert len(slider.asked) <= 3 + 2 * math.ceil(math.log2(1 / step + 2))


@pytest.mark.parametrize("at", [0.3, 0.4443, 0.5, 0.61])
def test_what_can_just_be_reached_is_looked_at_to_its_end(at):
    """A hard zone that the fingers graze: inside what can be reached in time, or just beyond it."""
    x, y, z = tcp(along(FAST, at))
    press = replace(empty(), zones=(Zone("press", Sphere((x, y, z), 0.01), None),))
    rest = RemainingRun(
        ROBOT, as_run(FAST, PATIENT), PATIENT, at_rad=along(FAST, 0.1), authorised_milli=4000, check_time=int
    )
    assert rest.prepare(press, AGE, NOTHING) is None
    for seconds in np.linspace(0.01, 1.6, 160):
        reached = rest.until(1.0, seconds) / GRID
        if reached > at:
            assert not rest.near(1.0, seconds).holds, (reached, seconds)
        elif reached < at - 0.1:
            assert rest.near(1.0, seconds).holds, (reached, seconds)
    assert not rest.at(1.0).holds


def test_a_line_that_is_stretched_asks_less_of_the_arm():
    pose = forward(HOME)
    line = MoveL(HOME, (pose[0], pose[1] + 0.1, *pose[2:]), 0.4, 8.0)
    half = replace(line, speed_m_s=0.2, acceleration_m_s2=2.0)
    authorised = index_of(empty(), half)
    assert index_of(empty(), line) > authorised
    assert left(empty(), line, at=HOME, authorised=authorised, running=0.5).holds


def test_both_engines_name_the_same_speed(monkeypatch):
    asked = [(somebody(distance), share) for distance in (1.55, 1.65, 1.75) for share in (0.1, 0.4, 0.7)]
    decided = [left(scene, FAST, share) for scene, share in asked]
    monkeypatch.setattr("pep.pit.assessment.straight_remaining.chosen", lambda: NUMPY)
    plain = [left(scene, FAST, share) for scene, share in asked]
    for one, other in zip(decided, plain, strict=True):
        assert (one.holds, one.pace, one.cause) == (other.holds, other.pace, other.cause)
        assert abs(one.index_milli - other.index_milli) <= 1
    assert len({answer.pace for answer in decided}) > 3


def test_what_can_be_reached_of_a_path_may_be_on_its_next_leg():
    x, y, z = tcp(along(FAST, 0.3))
    press = replace(empty(), zones=(Zone("press", Sphere((x, y, z), 0.01), None),))
    path = JointPath(LEFT, (JointLeg(along(FAST, 0.15), 0.9, 1.4), JointLeg(RIGHT, 0.9, 1.4)))
    rests = rests_of(
        ROBOT, path, PATIENT, at_rad=along(FAST, 0.1), authorised_milli=4000, age_s=AGE, check_time=lambda: None
    )
    assert rests.prepare(press, AGE, NOTHING) is None
    assert rests.near(1.0, 0.01).holds
    assert rests.near(1.0, 1.0) == Remaining(holds=False, index_milli=4000, cause="zone")
    assert not rests.at(0.1).holds
