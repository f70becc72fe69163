"""Steps of streams: a bound never under `assess` or sampling, and `assess` where it is not enough."""

import math
import os
from dataclasses import replace

import numpy as np
import pinocchio
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from pep.base.stop_model import patience_s
from pep.pit.assessment.assessment import Assessment
from pep.pit.assessment.stream import CONFIRMED_OF, Bounded, Stream
from pep.pit.scene.separation import stopping
from pep.pit.search.speed_envelope import stream_envelope
from pep.pit.second.second_engine import SecondWorld
from policies.evidence.evidence import ImpactFault
from tests.pep.pit.lines import AGE, Sampled
from tests.pep.pit.scenes import (
    CELL,
    HOME,
    NOTHING,
    ROBOT,
    SEED,
    empty,
    random_scene,
    random_shape,
    tcp,
    with_glass,
    with_person,
)
from tests.pep.pit.search.test_held_tool_speeds import DELAY, A, servoed

from pep.pit import (
    Capsule,
    Contact,
    GrippedObject,
    MoveJ,
    Person,
    Region,
    Scene,
    ServoJ,
    SpeedJ,
    SpeedL,
    Sphere,
    StaticObject,
    Thing,
    Workspace,
    Zone,
    assess,
)

DRAWS = int(os.environ.get("ZTPM_STEPS", "60"))  # a campaign asks for more
PATIENT = replace(CELL, time_limit_s=60.0)  # a loaded machine that runs other tests meanwhile
ANY = 4000
REACTION = stopping(CELL, perception_age_s=AGE, joint_speed_rad_s=0).reaction_s
STILL = (0.0,) * 6
SLOW = (0.05, 0.0, 0.02, 0.0, 0.0, -0.1)


class Clock:
    def __init__(self):
        self.now = 100.0

    def __call__(self):
        return self.now


def stream(scene, at=HOME, *, age=AGE, cell=PATIENT, robot=ROBOT, touch=NOTHING, clock=None):
    made = Stream(robot, cell, touch=touch, clock=Clock() if clock is None else clock)
    made.see(scene, age_s=age, at_rad=at)
    return made


def whole(motion, scene, *, age=AGE, cell=PATIENT, robot=ROBOT, touch=NOTHING):
    """The answer of `assess` to the same step."""
    if isinstance(motion, SpeedJ):
        motion = stream_envelope(motion, cell, under_way=True)
    return assess(robot, scene, motion, cell, perception_age_s=age, touch=touch, seed=SEED)


def asked(made, motion, authorised_milli=ANY):
    return made.step(motion, authorised_milli=authorised_milli, seed=SEED)


def servo(start=HOME, qd=SLOW, jump=None, lookahead=0.1):
    jump = tuple(0.1 * v for v in qd) if jump is None else jump
    return ServoJ(start, qd, tuple(q + j for q, j in zip(start, jump)), 0.002, lookahead)


def speeds(start=HOME, qd=SLOW, acceleration=2.0, duration=0.1):
    return SpeedJ(start, qd, acceleration, duration)


def drawn(rng, fastest=0.6):
    """A step of either kind, some of them slow, some of one joint alone, some of which bend."""
    start = np.array(HOME) + rng.uniform(-0.8, 0.8, 6)
    qd = rng.uniform(-1, 1, 6) * fastest * float(rng.choice([0.01, 0.1, 0.5, 1.0]))
    if rng.random() < 0.2:
        qd *= np.eye(6)[5]
    start, now = tuple(start.tolist()), tuple(qd.tolist())
    if rng.random() < 0.5:
        return speeds(start, now, float(rng.uniform(0.5, 12)), float(rng.uniform(0.01, 0.5)))
    bent = qd + rng.uniform(-1, 1, 6) * fastest * float(rng.choice([0.0, 0.01, 0.3]))
    lookahead = float(rng.uniform(0.03, 0.2))
    return servo(start, now, tuple((lookahead * bent).tolist()), lookahead)


def sped(motion, step=0.004):
    """Joint speeds from here on until nobody ends them any more, then the stop."""
    q, qd = np.array(motion.start), np.array(motion.qd_rad_s)
    held = motion.duration_s + patience_s(A) + DELAY
    found = [(q + t * qd, qd) for t in np.arange(0, held, step)]
    lead, q = float(np.abs(qd).max()), q + held * qd
    return found + [(q + qd * lead * (1 - left * left) / (2 * A), qd * left) for left in np.linspace(1, 0, 12)]


# ---- the bound is one


@settings(max_examples=DRAWS)
@given(seed=st.integers(0, 2**32 - 1))
def test_a_bound_is_never_under_what_the_whole_question_proves(seed):
    rng = np.random.default_rng(seed)
    scene, motion = random_scene(rng, things=3, regions=2), drawn(rng)
    bound, full = asked(stream(scene, motion.start), motion), whole(motion, scene)
    if isinstance(bound, Bounded):
        assert isinstance(full, Assessment), full
        assert bound.index >= full.index
        assert bound.tier >= full.tier
        assert not full.violations
    else:
        assert (type(bound), getattr(bound, "index", None)) == (type(full), getattr(full, "index", None))


@pytest.mark.long
@settings(max_examples=DRAWS // 2)
@given(seed=st.integers(0, 2**32 - 1))
def test_a_bound_is_never_under_what_sampling_finds(seed):
    rng = np.random.default_rng(seed)
    scene, motion = random_scene(rng, things=2, regions=2), drawn(rng)
    bound = asked(stream(scene, motion.start), motion)
    assume(isinstance(bound, Bounded))
    instants = servoed(motion, rng, REACTION) if isinstance(motion, ServoJ) else sped(motion)
    truth = Sampled(scene)
    for q, qd in instants:
        truth.look(q, qd, omega=max(float(np.abs(each).max()) for _, each in instants))
    assert not truth.violated
    assert bound.index >= truth.worst


def test_far_from_everything_a_step_is_settled_as_motion():
    for motion in (servo(), speeds()):
        found = asked(stream(empty()), motion, 1000)
        assert isinstance(found, Bounded)
        assert (found.tier, found.index, found.contact_ratio) == (1, 1.0, 0.0)
        assert found.tcp_speed_m_s >= whole(motion, empty()).tcp_speed_m_s * 0.99
        assert found.perception_age_s == AGE


def test_a_step_is_settled_only_at_or_below_what_is_authorised():
    scene = with_person(0.9)
    for motion in (servo(), speeds()):
        made = stream(scene)
        bound = asked(made, motion)
        assert 1 < bound.index < 3
        milli = math.ceil(bound.index * 1000)
        assert asked(made, motion, milli) == bound
        assert isinstance(asked(made, motion, milli - 2), Assessment)
        assert asked(made, motion, 1000).index == whole(motion, scene).index


def test_the_tier_is_the_same_on_what_a_cell_asks():
    rng, settled = np.random.default_rng(7), 0
    for _ in range(40):
        motion = drawn(rng, fastest=0.3)
        scene = with_person(float(rng.uniform(0.6, 1.4)), bearing=float(rng.uniform(-3, 3)))
        full = whole(motion, scene)
        if isinstance(full, Assessment) and not full.violations:
            settled += isinstance(asked(stream(scene, motion.start), motion, int(full.tier) * 1000), Bounded)
    assert settled >= 32


def test_a_resting_arm_that_is_told_to_stay_does_nothing():
    for motion in (servo(qd=STILL), speeds(qd=STILL)):
        for age in (AGE, 3.0):
            found, full = asked(stream(with_person(0.4), age=age), motion, 0), whole(motion, with_person(0.4), age=age)
            assert isinstance(found, Bounded)
            assert (found.index, found.tier) == (full.index, full.tier) == (0, 0)


def test_torque_is_at_least_what_is_sampled_of_it():
    rng, counted = np.random.default_rng(8), 0
    for payload in (0.0, 0.4):
        cell = replace(PATIENT, payload_kg=payload)
        for _ in range(DRAWS // 2):
            start = (0.0, float(rng.uniform(-0.6, -0.1)), float(rng.uniform(-0.4, 0.4)), -1.2, -1.57, 0.0)
            qd = tuple((rng.uniform(-0.2, 0.2, 6) * (0.1, 1, 1, 0.1, 0.1, 0.1)).tolist())
            motion = speeds(start, qd, acceleration=float(rng.uniform(6, 18)))
            bound = asked(stream(Scene(), start, cell=cell), motion)
            if isinstance(bound, Bounded):
                full = whole(motion, Scene(), cell=cell)
                assert bound.index >= full.index
                counted += any(c.kind == "torque" for c in full.contributions)
    assert counted > DRAWS // 12


@pytest.mark.parametrize(
    ("motion", "kind"),
    [
        (servo(qd=(2.9, 0, 0, 0, 0, 0)), "joint_speed"),
        (speeds(qd=(2.9, 0, 0, 0, 0, 0)), "joint_speed"),
        (speeds(qd=(0.4, 0, 0, 0, 0, 0), acceleration=35.0), "acceleration"),
    ],
)
def test_what_the_arm_is_asked_for_counts(motion, kind):
    full = whole(motion, Scene())
    assert [c.kind for c in full.contributions][:1] == [kind]
    assert asked(stream(Scene()), motion, 1000).index == full.index
    wide = asked(stream(Scene()), motion)
    assert wide.index >= full.index > 1


def test_a_joint_limit_ahead_is_for_the_whole_question():
    edge = (6.2, *HOME[1:])
    for motion in (servo(edge, (0.3, 0, 0, 0, 0, 0)), speeds(edge, (0.3, 0, 0, 0, 0, 0))):
        found = asked(stream(empty(), edge), motion)
        assert (type(found), found.violations) == (Assessment, ("joint_limit",))


def test_what_may_be_violated_is_never_settled_at_once():
    met = Person("p", ((Region.HAND, Sphere(tuple(map(float, tcp())), 0.05)),))
    room = Workspace((-0.3, -0.3, -0.3), (0.3, 0.3, 1.0))
    press = Zone("press", Sphere(tuple(map(float, tcp())), 0.05), None)
    thing = replace(empty(), objects=(Thing("part", "rigid", Sphere(tuple(map(float, tcp())), 0.05), 0.01),))
    zoned = replace(empty(), zones=(press,))
    for scene in (replace(empty(), people=(met,)), replace(empty(), workspace=room), zoned, thing):
        for motion in (servo(), speeds()):
            found = asked(stream(scene), motion)
            assert isinstance(found, Assessment)
            assert found.violations or found.index >= 3  # or it leads away


# ---- views


def test_a_new_view_counts_from_the_next_step_on():
    made = stream(empty())
    assert asked(made, servo(), 1000).tier == 1
    made.see(with_person(0.5), age_s=AGE, at_rad=HOME)
    near = asked(made, servo(), 1000)
    assert (type(near), near.tier) == (Assessment, whole(servo(), with_person(0.5)).tier)
    assert near.tier > 1
    made.see(empty(), age_s=AGE, at_rad=HOME)
    assert asked(made, servo(), 1000).tier == 1


@pytest.mark.parametrize("motion", [servo(), speeds()])
def test_a_view_grows_old_between_steps(motion):
    clock = Clock()
    made = stream(with_person(1.6), clock=clock, age=0.4)
    assert asked(made, motion).perception_age_s == 0.4
    clock.now += 0.05
    fresh = asked(made, motion)
    assert fresh.index < 3
    clock.now += 0.06  # beyond the limit of 0.5 s
    for milli in (ANY, 1000):
        stale = asked(made, motion, milli)
        assert stale.index >= 3
        assert stale.index >= whole(motion, with_person(1.6), age=0.51).index
    assert stale.perception == "stale"
    clock.now += 3600
    assert asked(made, motion).index >= whole(motion, with_person(1.6), age=3600.51).index


def test_whom_nobody_saw_for_so_long_may_have_come_near_a_fast_arm():
    scene, qd = with_person(1.4), (0.8, 0.0, 0.0, 0.0, 0.0, 0.0)
    for motion in (servo(qd=qd), speeds(qd=qd)):
        full = whole(motion, scene, age=0.9)
        assert full.index > 3.05
        assert asked(stream(scene, age=0.9), motion).index >= full.index


def test_older_views_and_sightings_never_lower_a_bound():
    found, clock = [], Clock()
    made = stream(with_person(1.0), clock=clock)
    for _ in range(12):
        found.append(asked(made, servo()).index)
        clock.now += 0.06
    assert found == sorted(found)
    person = replace(with_person(1.0).people[0], age_s=0.3)
    late = replace(with_person(1.0), people=(person,))
    for scene, age in ((late, 0.1), (late, 0.3), (replace(late, complete=False), 0.1)):
        bound = asked(stream(scene, age=age), servo())
        assert bound.index >= whole(servo(), scene, age=age).index
        assert (bound.index >= 3) == (age == 0.3 or not scene.complete)


def test_without_a_view_there_is_the_floor_of_a_missing_one():
    made = Stream(ROBOT, PATIENT, touch=NOTHING, clock=Clock())
    for told in (
        lambda: None,
        lambda: made.see(None, age_s=None, at_rad=HOME),
        lambda: made.see(empty(), age_s=None, at_rad=HOME),
    ):
        told()
        bound, full = asked(made, servo(), 3000), asked(made, servo(), 1000)
        assert (type(bound), bound.index, bound.perception_age_s) == (Bounded, 3.0, None)
        assert (full.perception, full.index) == ("missing", 3.0)


def test_a_clock_that_goes_back_is_no_clock():
    clock = Clock()
    made = stream(empty(), clock=clock)
    clock.now -= 1.0
    assert asked(made, servo()).reason == "PERCEPTION_INVALID"

    def broken():
        raise OSError("no clock")

    assert asked(Stream(ROBOT, PATIENT, touch=NOTHING, clock=broken), servo()).reason == "PHYSICS_FAULT"


@pytest.mark.parametrize("age", [math.nan, math.inf, -0.1])
def test_an_age_that_is_none_is_a_fault(age):
    assert asked(stream(empty(), age=age), servo()).reason == "PERCEPTION_INVALID"


def test_what_no_view_may_be_is_the_answer_to_each_step_until_the_next():
    bad = replace(empty(), objects=(Thing("t", "rigid", Sphere((math.nan, 0, 0), 0.1), 0.0),))
    made = stream(bad)
    for _ in range(2):
        assert asked(made, servo()).reason == "PERCEPTION_INVALID"
    made.see(empty(), age_s=AGE, at_rad=(math.nan, *HOME[1:]))
    assert asked(made, servo()).reason == "NOT_FINITE"
    made.see(empty(), age_s=AGE, at_rad=HOME[1:])
    assert asked(made, servo()).reason == "PARAMETERS_WRONG"
    made.see("a view", age_s=AGE, at_rad=HOME)
    assert asked(made, servo()).reason == "PHYSICS_FAULT"
    made.see(empty(), age_s=AGE, at_rad=HOME)
    assert isinstance(asked(made, servo()), Bounded)


def test_nonsense_about_the_cell_the_tool_or_the_grant_is_a_fault():
    for made in (
        stream(empty(), cell=replace(PATIENT, warn_band_m=math.nan)),
        stream(empty(), cell=replace(PATIENT, tool="bare")),
        stream(empty(), touch="table"),
        stream(empty(), robot=None),
    ):
        assert asked(made, servo()).reason == "PHYSICS_FAULT"


# ---- steps that are none


BAD = [math.nan, math.inf, -math.inf, 1e308, -1e308, "0.1", None, 1j, [0.1], 10**400]


@pytest.mark.parametrize("motion", [servo(), speeds()], ids=["servo", "speed"])
def test_every_number_of_a_step_that_is_none_is_answered_as_the_whole_question_answers_it(motion):
    made = stream(empty())
    for name in motion.__slots__:
        value = getattr(motion, name)
        for bad in BAD:
            for spoilt in [(*value[:k], bad, *value[k + 1 :]) for k in range(6)] if isinstance(value, tuple) else [bad]:
                found = asked(made, replace(motion, **{name: spoilt}))
                assert isinstance(bad, float) or isinstance(found, ImpactFault), (name, bad)
                if isinstance(found, Bounded):
                    with np.errstate(over="ignore", invalid="ignore"):
                        assert found.index >= whole(replace(motion, **{name: spoilt}), empty()).index


@pytest.mark.parametrize(
    "change",
    [
        {"start": HOME[:5]},
        {"start": (*HOME, 0.0)},
        {"qd_rad_s": ()},
        {"start": "012345"},
        {"start": tuple(map(str, HOME))},
        {"start": None},
    ],
)
def test_a_step_of_another_form_is_a_fault(change):
    for motion in (servo(), speeds()):
        assert isinstance(asked(stream(empty()), replace(motion, **change)), ImpactFault)


@pytest.mark.parametrize("rate", [0.0, -0.1, 1e-7])
def test_rates_below_the_least_are_refused(rate):
    for motion in (
        replace(servo(), period_s=rate),
        replace(servo(), lookahead_s=rate),
        replace(speeds(), acceleration_rad_s2=rate),
        replace(speeds(), duration_s=rate),
    ):
        assert asked(stream(empty()), motion).reason == "OUT_OF_RANGE"
    assert asked(stream(empty()), speeds(qd=(1e-7, 0, 0, 0, 0, 0))).reason == "OUT_OF_RANGE"


def test_a_jump_that_no_arm_can_follow_is_refused():
    assert asked(stream(empty()), servo(jump=(0.5, 0, 0, 0, 0, 0))).reason == "ROBOT_LIMIT"


@pytest.mark.parametrize("motion", [MoveJ(HOME, HOME, 1.0, 1.0), SpeedL(HOME, STILL, 1.0, 1.0), None, "step"])
def test_what_is_no_step_is_a_fault(motion):
    assert asked(stream(empty()), motion).reason == "PARAMETERS_WRONG"


@pytest.mark.parametrize("milli", [math.nan, -1, None, "1000"])
def test_an_authority_that_is_none_settles_nothing(milli):
    assert not isinstance(asked(stream(empty()), servo(), milli), Bounded)


# ---- what is held, touched, or no simple shape


def test_what_is_held_and_seen_in_the_gripper_is_no_obstacle_and_elsewhere_it_is():
    robot = ROBOT.holding(GrippedObject("stick", Capsule((0.0, 0.0, 0.16), (0.0, 0.0, 0.24), 0.015), 0.3, blunt=True))
    data = robot.pinocchio.createData()
    pinocchio.forwardKinematics(robot.pinocchio, data, np.array(HOME))
    ends = [tuple(data.oMi[6].act(np.array((0.0, 0.0, z))).tolist()) for z in (0.16, 0.24)]
    seen = Thing("stick", "rigid", Capsule(*ends, 0.015), 0.01)
    scene = replace(empty(), objects=(*empty().objects, seen))
    for motion in (servo(), speeds()):
        made = stream(scene, robot=robot)
        assert isinstance(asked(made, motion, 1000), Bounded)
        away = replace(motion, start=(1.0, *HOME[1:]))
        if isinstance(away, ServoJ):
            away = replace(away, target=(1.0 + 0.005, *HOME[1:]))
        for each, milli in ((away, ANY), (replace(motion, start=(0.12, *HOME[1:])), ANY)):
            found = asked(made, each, milli)
            assert isinstance(found, ImpactFault) or found.index >= whole(each, scene, robot=robot).index
    # Nobody told of it: what was surveyed under that name stays.
    known = replace(PATIENT, objects=(*PATIENT.objects, StaticObject("stick", "rigid", capsule=Capsule(*ends, 0.015))))
    blind = stream(None, age=None, robot=robot, cell=known)
    assert asked(blind, servo()).index >= whole(servo(), None, age=None, robot=robot, cell=known).index


def test_a_gentle_touch_that_is_granted_is_settled_at_two():
    down = (0.0, -1.486, 2.164, -2.2488, -1.57, 0.0)
    cell = replace(PATIENT, contacts=(Contact("table", "tool"),))
    for qd, settled in (((0.0, 0.0, 0.0, 0.0, 0.0, 0.02), True), ((0.3, 0.0, 0.0, 0.0, 0.0, 0.0), False)):
        for motion in (servo(down, qd), speeds(down, qd)):
            granted = stream(empty(), down, cell=cell, touch=frozenset({"table"}))
            bound, full = asked(granted, motion, 2000), whole(motion, empty(), cell=cell, touch=frozenset({"table"}))
            assert isinstance(bound, Bounded) is settled
            assert bound.index >= full.index
            accident = asked(stream(empty(), down, cell=cell), motion, 2000)
            assert (type(accident), accident.tier) == (Assessment, 3)


def test_polytopes_are_bounded_by_what_is_around_them():
    settled = 0
    for seed in range(12):
        rng = np.random.default_rng(seed)
        wedge = Thing("wedge", "rigid", random_shape(rng, "v"), 0.01)
        scene = replace(empty(), objects=(*empty().objects, wedge))
        motion = drawn(rng, fastest=0.3)
        bound, full = asked(stream(scene, motion.start), motion), whole(motion, scene)
        assert getattr(bound, "index", bound) >= getattr(full, "index", full), (motion, bound, full)
        settled += isinstance(bound, Bounded)
    assert settled > 6


def test_workspace_zones_and_fragile_things_are_bounded():
    base = replace(with_glass(), workspace=Workspace((-0.7, -0.7, -0.3), (0.7, 0.7, 1.0)))
    for seed in range(30):
        rng = np.random.default_rng(seed)
        extra = random_scene(rng, things=1, regions=1, zones=2)
        scene = replace(base, people=extra.people, zones=extra.zones, objects=(*base.objects, *extra.objects))
        motion = drawn(rng, fastest=0.3)
        bound, full = asked(stream(scene, motion.start), motion), whole(motion, scene)
        assert isinstance(bound, ImpactFault) or bound.index >= full.index


# ---- the second engine, and an installation without the first


REAL = SecondWorld.ask_all


def nearer(world, places):
    """An engine to which everything is a metre nearer."""
    clearance, speed = REAL(world, places)
    return clearance - 1.0, speed


def test_a_disagreement_about_a_view_is_the_answer_until_the_next(monkeypatch):
    made = stream(empty())
    with monkeypatch.context() as broken:
        broken.setattr(SecondWorld, "ask_all", nearer)
        made.see(empty(), age_s=AGE, at_rad=HOME)
    for _ in range(2):
        assert asked(made, servo()).reason == "ENGINES_DISAGREE"
    made.see(empty(), age_s=AGE, at_rad=HOME)
    assert isinstance(asked(made, servo()), Bounded)


def test_every_so_many_steps_the_second_engine_is_asked_where_the_step_begins(monkeypatch):
    made, calls = stream(with_person(0.9)), []

    def told(world, places):
        calls.append(places)
        return REAL(world, places)

    with monkeypatch.context() as watched:
        watched.setattr(SecondWorld, "ask_all", told)
        for _ in range(CONFIRMED_OF):
            assert isinstance(asked(made, servo()), Bounded)
    ((at, moving),) = calls[0]
    assert len(calls) == 1
    assert (tuple(at), tuple(moving)) == (HOME, SLOW)
    with monkeypatch.context() as broken:
        broken.setattr(SecondWorld, "ask_all", nearer)
        for _ in range(CONFIRMED_OF - 1):
            assert isinstance(asked(made, servo()), Bounded)
        assert asked(made, servo()).reason == "ENGINES_DISAGREE"
    assert asked(made, servo()).reason == "ENGINES_DISAGREE"
    made.see(with_person(0.9), age_s=AGE, at_rad=HOME)
    assert isinstance(asked(made, servo()), Bounded)
