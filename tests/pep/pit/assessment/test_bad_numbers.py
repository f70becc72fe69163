"""Bad numbers in every place of scene, motion, cell, age and model: nothing is permitted for one.

Per cell of the matrix the answer has to be a named fault, or tier 3 and more, or the number does no harm: the index is no
lower than with the ordinary number that it stands for (0 for -0.0), and where there is none, than without it.
"""

import math
import warnings
from dataclasses import fields, is_dataclass, replace
from enum import Enum
from functools import cache

import pytest
from pep.pit.search.certify import RESOLUTION
from policies.evidence.evidence import ImpactFault
from policies.words.reason_table import Reason
from tests.pep.pit.lines import pose_of
from tests.pep.pit.scenes import CELL, HOME, NOTHING, ROBOT, SEED, with_glass, with_person

from pep.pit import (
    Assessment,
    Box,
    Capsule,
    Contact,
    GrippedObject,
    GripperMove,
    JointLeg,
    JointPath,
    LineLeg,
    LinePath,
    MoveJ,
    MoveL,
    Output,
    OutputSet,
    Part,
    Person,
    PitError,
    Region,
    Robot,
    Scene,
    ServoJ,
    SpeedJ,
    SpeedL,
    Sphere,
    StaticObject,
    StaticZone,
    Thing,
    Workspace,
    Zone,
    assess,
)

pytestmark = pytest.mark.long

HUGE = 10**400
BAD = {
    "nan": math.nan,
    "inf": math.inf,
    "-inf": -math.inf,
    "-0.0": -0.0,
    "1e308": 1e308,
    "-1e308": -1e308,
    "5e-324": 5e-324,
    "2**63": 2**63,
    "10**400": HUGE,
    "-10**400": -HUGE,
    "True": True,
    "False": False,
    "text": "1.0",
    "None": None,
}
ORDINARY = {"-0.0": (0.0,), "5e-324": (0.0, 1e-6), "True": (1.0,), "False": (0.0,)}
"""Ordinary numbers in place of a bad one; the first that is not refused counts."""


def places(value, at=()):
    """Places of the numbers in a frozen thing."""
    if isinstance(value, bool | str | Enum) or value is None:
        return
    if isinstance(value, int | float):
        yield at
    elif isinstance(value, tuple):
        for k, each in enumerate(value):
            yield from places(each, (*at, k))
    elif is_dataclass(value):
        for each in fields(value):
            yield from places(getattr(value, each.name), (*at, each.name))


def put(value, at, new):
    """The thing with another number at this place."""
    if not at:
        return new
    first, rest = at[0], at[1:]
    if isinstance(value, tuple):
        return (*value[:first], put(value[first], rest, new), *value[first + 1 :])
    return replace(value, **{first: put(getattr(value, first), rest, new)})


def test_every_place_is_found_and_one_is_changed():
    scene = with_person()
    found = list(places(scene))
    assert len(found) == len(set(found)) > 50
    for at in found:
        assert put(scene, at, math.nan) != scene
    assert put(scene, ("people", 0, "regions", 0, 1, "radius_m"), 7.0).people[0].regions[0][1].radius_m == 7.0


SCENE = replace(
    with_glass(),
    people=(
        Person("p", ((Region.TORSO, Capsule((2.1, 0.5, 0.2), (2.1, 0.5, 0.7), 0.18)),)),
        Person("q", ((Region.HAND, Sphere((1.5, -0.6, 0.4), 0.06)),)),
    ),
    objects=(
        *with_glass().objects,
        Thing("box", "rigid", Box((0.6, 0.6, 0.1), (0.1, 0.1, 0.1), (1.0, 0.0, 0.0, 0.0)), 0.01),
    ),
    zones=(
        Zone("store", Sphere((0.7, -0.7, 0.3), 0.1), 2),
        Zone("press", Box((-0.6, 0.6, 0.3), (0.1, 0.1, 0.1)), None),
    ),
    workspace=Workspace((-1.0, -1.0, -0.5), (1.0, 1.0, 1.5)),
)
CONFIGURED = replace(
    CELL,
    payload_kg=0.1,
    time_limit_s=60.0,  # a slow machine is no fault here
    objects=(*CELL.objects, StaticObject("post", "rigid", capsule=Capsule((0.7, 0.7, 0.0), (0.7, 0.7, 0.3), 0.02))),
    zones=(StaticZone("store", 2, sphere=Sphere((0.7, -0.7, 0.3), 0.1)),),
    workspace=SCENE.workspace,
    contacts=(Contact("box", "tool"),),
    parts=(Part("peg", 0.1),),
    outputs=(Output(3, 1, "lamp"),),
)
SWEEP = MoveJ((-0.3, *HOME[1:]), (0.3, *HOME[1:]), 0.25, 0.8)
POSE = pose_of(HOME)
UP = (*POSE[:2], POSE[2] + 0.05, *POSE[3:])
MOTIONS = {
    "move_j": SWEEP,
    "speed_j": SpeedJ(HOME, (0.1, 0.0, 0.0, 0.05, 0.0, 0.0), 1.0, 0.3),
    "servo_j": ServoJ(HOME, (0.01,) * 6, tuple(q + 0.001 for q in HOME), 0.002, 0.1),
    "joint_path": JointPath(HOME, (JointLeg(SWEEP.start, 0.25, 0.8), JointLeg(SWEEP.target, 0.25, 0.8))),
    "move_l": MoveL(HOME, UP, 0.05, 0.3),
    "speed_l": SpeedL(HOME, (0.0, 0.02, 0.0, 0.0, 0.0, 0.0), 0.5, 0.2),
    "line_path": LinePath(HOME, (LineLeg(UP, 0.05, 0.3),)),
    "gripper": GripperMove(HOME, 0.04, 0.05, 40.0),
    "output": OutputSet(3, True),
}


def ask(scene=SCENE, motion=SWEEP, cell=CONFIGURED, age=0.1, robot=ROBOT, touch=NOTHING):
    return assess(robot, scene, motion, cell, perception_age_s=age, touch=touch, seed=SEED)


def passes(answer):
    """True where an answer would let the motion through without asking a person."""
    if isinstance(answer, ImpactFault):
        assert answer.reason in Reason.__members__
        assert answer.detail
        return False
    assert isinstance(answer, Assessment)
    assert 0 <= answer.index <= 4
    return answer.tier < 3 and not answer.violations


def wrong(asked, name, plain, ordinary=None):
    """Fault of the answer to a question with this bad number, or None.

    Args:
        asked: answers the question with a number.
        name: of the bad number.
        plain: the index without it.
        ordinary: answers it with an ordinary number; `asked` by default.
    """
    answer = asked(BAD[name])
    if not passes(answer):
        return None
    for number in ORDINARY.get(name, ()):
        known = (ordinary or asked)(number)
        if isinstance(known, Assessment):
            plain = known.index
            break
    return None if answer.index >= plain - RESOLUTION else f"index {answer.index}, and {plain} without it"


def cells_of(asked, whole):
    """For each place of a thing and each bad number: both, and what is wrong with the answer, or None."""
    plain = asked(whole)
    assert isinstance(plain, Assessment), plain
    for at in places(whole):

        def with_number(number, at=at):
            return asked(put(whole, at, number))

        ordinary = cache(with_number)
        for name in BAD:
            yield at, name, wrong(with_number, name, plain.index, ordinary)


def matrix(asked, whole):
    """All that is wrong over all places of a thing, and how many cells were asked."""
    cells = list(cells_of(asked, whole))
    return [cell for cell in cells if cell[2] is not None], len(cells)


def is_believed(asked, whole):
    """True where the answer is wrong at any place."""
    return any(what is not None for _, _, what in cells_of(asked, whole))


def test_the_plain_questions_pass():
    """Otherwise nothing could be permitted here, and the matrix would show nothing."""
    for name, motion in MOTIONS.items():
        answer = ask(motion=motion)
        assert passes(answer), (name, answer)
        assert answer.index >= 1


def test_p13_every_number_of_a_scene():
    found, count = matrix(lambda scene: ask(scene=scene), SCENE)
    assert found == []
    assert count > 50 * len(BAD)


@pytest.mark.timeout(600)
@pytest.mark.parametrize(
    "name", [pytest.param(each, marks=pytest.mark.campaign if each == "joint_path" else ()) for each in MOTIONS]
)
def test_p13_every_number_of_a_motion(name):
    found, count = matrix(lambda motion: ask(motion=motion), MOTIONS[name])
    assert found == []
    assert count >= len(BAD)


def test_p13_every_number_of_a_cell():
    found, count = matrix(lambda cell: ask(cell=cell), CONFIGURED)
    assert found == []
    assert count > 60 * len(BAD)


@pytest.mark.parametrize("name", BAD)
def test_p13_every_age(name):
    plain = ask().index
    if BAD[name] is None:
        assert ask(age=None).tier >= 3
        return
    assert wrong(lambda age: ask(age=age), name, plain) is None


STICK = GrippedObject("stick", Capsule((0.0, 0.0, 0.16), (0.0, 0.0, 0.24), 0.015), 0.3, blunt=True)


def test_p13_every_number_of_what_is_held():
    """A bad held object is refused where it is taken up, or gets no answer that passes for less."""
    holding = ROBOT.holding(STICK)
    plain = ask(robot=holding).index
    found = []
    for at in places(STICK):
        for name in BAD:

            def asked(number, at=at):
                try:
                    return ask(robot=ROBOT.holding(put(STICK, at, number).checked()))
                except (PitError, TypeError, OverflowError):
                    return ImpactFault("PHYSICS_FAULT", "never taken up")

            if BAD[name] is None and at[-1] == "mass_kg":
                assert asked(None).tier == 4
                continue
            what = wrong(asked, name, plain)
            if what is not None:
                found.append((at, name, what))
    assert found == []


# ---- the model: read from text, so that each number is one of the text


def numbers_of_the_model():
    """Places of the numbers in the lines of the shipped model: (line, index of the number in it)."""
    from importlib import resources

    text = (resources.files("pep.pit") / "robots" / "ur3e.toml").read_text()
    lines = text.splitlines()
    for k, line in enumerate(lines):
        head, _, tail = line.partition("=")
        value = tail.split("#")[0].strip()
        if value and not value.startswith('"') and '"' not in value:
            for number in range(value.count(",") + 1):
                yield lines, k, head, value, number


def text_with(lines, k, head, value, number, new):
    parts = value.strip("[]").split(",")
    parts[number] = new
    joined = ", ".join(parts)
    value = f"[{joined}]" if value.startswith("[") else joined
    return "\n".join([*lines[:k], f"{head}= {value}", *lines[k + 1 :]])


SPELT = {
    "nan": "nan", "inf": "inf", "-inf": "-inf", "-0.0": "-0.0", "1e308": "1e308", "-1e308": "-1e308", "5e-324": "5e-324",
    "2**63": str(2**63), "10**400": str(HUGE), "True": "true", "False": "false", "text": '"1.0"',
}  # fmt: skip


def robot_of(text):
    try:
        return Robot.from_toml(text, tool="robotiq_2f85")
    except PitError as refusal:
        assert refusal.reason in Reason.__members__
        return None


SHARES = 3
"""Number of turns in which the bad numbers of the suite meet all places of the model."""


@pytest.mark.parametrize("name", SPELT)
def test_p13_numbers_of_a_model(name):
    """A third of the bad numbers in each place of the model."""
    check_numbers_of_the_model(name, list(numbers_of_the_model())[list(SPELT).index(name) % SHARES :: SHARES])


@pytest.mark.campaign
@pytest.mark.parametrize("name", SPELT)
def test_p13_every_number_of_a_model(name):
    check_numbers_of_the_model(name, list(numbers_of_the_model()))


def test_the_model_has_all_its_numbers():
    assert len(list(numbers_of_the_model())) > 200


def check_numbers_of_the_model(name, asked):
    assert list(wrong_of_the_model(name, asked)) == []


def wrong_of_the_model(name, asked):
    """Places in which the number is believed.

    An arm with a 0 is another arm and may count less; one with a bad number may not.
    """
    plain = ask().index
    for place in asked:
        robot = robot_of(text_with(*place, SPELT[name]))
        if robot is None:
            continue
        answer = ask(robot=robot)
        if passes(answer) and answer.index < plain - RESOLUTION:
            zero = robot_of(text_with(*place, "0.0"))
            if name not in ORDINARY or zero is None or ask(robot=zero).index > answer.index + RESOLUTION:
                yield place[1] + 1, place[2], place[4], answer.index


# ---- without the walls the matrix is not empty


def test_without_its_check_a_scene_is_believed(monkeypatch):
    monkeypatch.setattr(Scene, "defect", lambda self: None)
    radius = ("objects", 1, "shape", "radius_m")
    assert is_believed(lambda number: ask(scene=put(SCENE, radius, number)), SCENE.objects[1].shape.radius_m)


def test_without_its_check_a_cell_is_believed(monkeypatch):
    monkeypatch.setattr("pep.pit.scene.cell._defect", lambda cell: None)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", RuntimeWarning)
        assert is_believed(lambda cell: ask(cell=cell), CONFIGURED)


@pytest.mark.campaign
def test_without_its_check_a_model_is_believed(monkeypatch):
    monkeypatch.setattr("pep.pit.robot.model.TURN_LIMIT_RAD", math.inf)
    monkeypatch.setattr("pep.pit.robot.model.THINNEST_M", 5e-324)
    for name in ("1e308", "5e-324"):
        assert any(wrong_of_the_model(name, numbers_of_the_model())), name
