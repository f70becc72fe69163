"""Properties P1 to P14 of whole answers that are tested nowhere else; docs/physics.md lists the others."""

import itertools
import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from pep.pit.assessment.straight_assessment import MoveQuestion
from pep.pit.base.tier import ratio_index
from pep.pit.robot.model import Model
from pep.pit.robot.robot import _assemble
from pep.pit.search.certify import RESOLUTION
from pep.pit.search.engine import chosen
from pep.pit.search.question import as_run, view_around
from policies.evidence.evidence import ImpactFault
from tests.model.pit.engine import NUMPY
from tests.pep.pit.assessment.test_bad_numbers import CONFIGURED, MOTIONS
from tests.pep.pit.scenes import (
    CELL,
    FRONT,
    HOME,
    NOTHING,
    ROBOT,
    SEED,
    empty,
    random_move,
    random_scene,
    random_shape,
    sweep,
    tcp,
    with_glass,
    with_person,
)

from pep.pit import (
    Assessment,
    Box,
    GrippedObject,
    JointLeg,
    JointPath,
    ModelError,
    MoveJ,
    Person,
    Region,
    Robot,
    Scene,
    Sphere,
    Thing,
    Workspace,
    Zone,
    assess,
)

AGE = 0.1
CELL = replace(CELL, time_limit_s=60.0)  # a slow machine is no fault here


def ask(scene, motion, cell=CELL, robot=ROBOT, age=AGE, **more):
    answer = assess(robot, scene, motion, cell, perception_age_s=age, touch=NOTHING, seed=SEED, **more)
    assert isinstance(answer, Assessment), answer
    return answer


def not_lower(more, less):
    """The one answer counts no less than the other."""
    assert more.index >= less.index - RESOLUTION
    assert more.tier >= less.tier or more.index >= less.index - RESOLUTION
    assert set(more.violations) >= set(less.violations)


def drawn(seed, count, **more):
    rng = np.random.default_rng([1400, seed])
    for _ in range(count):
        yield rng, random_scene(rng, things=2, regions=2, **more), random_move(rng, float(rng.choice([0.3, 1.0])))


# ---- P2, P3: of whole answers, of every form of motion


FASTER = {
    "move_j": lambda m: replace(m, speed_rad_s=1.5 * m.speed_rad_s),
    "speed_j": lambda m: replace(m, qd_rad_s=tuple(1.5 * x for x in m.qd_rad_s)),
    "joint_path": lambda m: replace(m, legs=tuple(replace(x, speed_rad_s=1.5 * x.speed_rad_s) for x in m.legs)),
    "move_l": lambda m: replace(m, speed_m_s=1.5 * m.speed_m_s),
    "speed_l": lambda m: replace(m, twist=tuple(1.5 * x for x in m.twist)),
    "line_path": lambda m: replace(m, legs=tuple(replace(x, speed_m_s=1.5 * x.speed_m_s) for x in m.legs)),
    "gripper": lambda m: replace(m, force_n=1.5 * m.force_n),
}


@pytest.mark.parametrize("name", FASTER)
def test_p2_faster_never_lowers_whatever_the_form(name):
    for scene in (with_glass(), with_person(1.1)):
        not_lower(ask(scene, FASTER[name](MOTIONS[name])), ask(scene, MOTIONS[name]))


@pytest.mark.parametrize("name", [name for name in MOTIONS if name != "output"])
def test_p3_an_older_view_never_lowers_whatever_the_form(name):
    scene = with_person(1.4)
    answers = [ask(scene, MOTIONS[name], age=age) for age in (0.0, 0.2, 0.5, 0.6, 2.0)]
    for older, newer in itertools.pairwise(answers[::-1]):
        not_lower(older, newer)
    assert answers[-1].tier >= 3


VAGUE = (
    "person_uncertainty_m",
    "robot_uncertainty_m",
    "intrusion_tracked_m",
    "intrusion_untracked_m",
    "person_speed_m_s",
)


@pytest.mark.parametrize("name", VAGUE)
def test_p3_a_vaguer_cell_never_lowers(name):
    met = False
    for _, scene, move in drawn(3, 6):
        plain = ask(scene, move)
        for factor in (1.3, 3.0):
            vaguer = ask(scene, move, cell=replace(CELL, **{name: factor * getattr(CELL, name)}))
            not_lower(vaguer, plain)
            met |= vaguer.index > plain.index + RESOLUTION
    assert met


# ---- P5: whatever is added


def test_p5_a_keep_out_zone_and_a_smaller_room_never_lower():
    met = set()
    for rng, scene, move in drawn(5, 8):
        plain = ask(scene, move)
        for name, more in {
            "hard": replace(scene, zones=(*scene.zones, Zone("hard", random_shape(rng), None))),
            "declared": replace(scene, zones=(*scene.zones, Zone("more", random_shape(rng), 4))),
            "room": replace(scene, workspace=Workspace((-0.6, -0.6, -0.2), (0.6, 0.6, 0.7))),
            "on the way": replace(
                scene, zones=(*scene.zones, Zone("way", Sphere(tuple(tcp(move.start).tolist()), 0.05), None))
            ),
        }.items():
            answer = ask(more, move)
            not_lower(answer, plain)
            if answer.index > plain.index + RESOLUTION or set(answer.violations) > set(plain.violations):
                met.add(name)
    assert met >= {"declared", "room", "on the way"}


def with_model(**changes):
    model = ROBOT.model
    parts = {name: getattr(model, name) for name in Model.__dataclass_fields__ if name != "__pydantic_config__"}
    return _assemble(Model(**parts | changes), ROBOT.tool.name)


def test_p5_a_pair_of_the_arm_with_itself_never_lowers():
    """Without its self pairs the arm may fold into itself; each that is added can only count more."""
    bare = with_model(self_pairs={"base": ("wrist_3",)})
    folded = MoveJ(HOME, (0.0, -1.62, 2.9, 0.5, -1.57, 0.0), 0.5, 1.0)
    assert ask(empty(), folded, robot=bare).violations == ()
    assert ask(empty(), folded).violations == ("self",)
    for _, scene, move in drawn(6, 8):
        not_lower(ask(scene, move), ask(scene, move, robot=bare))


# ---- P6: what is not known


def test_p6_an_unknown_view_counts_no_less_than_any_completion_below_its_floor():
    for _, scene, move in drawn(7, 10):
        for seen in (scene, replace(scene, people=())):
            known, partial = ask(seen, move), ask(replace(seen, complete=False), move)
            not_lower(partial, known)
            nothing = ask(None, move, age=None)
            if known.tier < 3:
                assert nothing.tier >= known.tier
                assert nothing.index >= known.index


def test_p6_an_unknown_mass_counts_no_less_than_any_mass():
    for _, scene, move in drawn(8, 4):
        unknown = ask(scene, move, cell=replace(CELL, payload_kg=None))
        for mass in (0.0, 0.5, 1.5, 3.0):
            not_lower(unknown, ask(scene, move, cell=replace(CELL, payload_kg=mass)))


def test_p6_an_unknown_part_counts_no_less_than_what_it_may_be():
    part = Sphere((0.0, 0.0, 0.2), 0.03)
    unknown = ROBOT.holding(GrippedObject("part", part, None, blunt=False))
    for _, scene, move in drawn(9, 4):
        answer = ask(scene, move, robot=unknown)
        for mass, blunt in itertools.product((0.05, 1.0, 2.0), (True, False)):
            not_lower(answer, ask(scene, move, robot=ROBOT.holding(GrippedObject("part", part, mass, blunt=blunt))))


def test_p6_a_person_of_whom_less_is_known_counts_no_less():
    whole = with_person(1.25)
    trunk = tuple((r, s) for r, s in whole.people[0].regions if r in (Region.TORSO, Region.PELVIS, Region.ABDOMEN))
    arms = tuple((r, s) for r, s in whole.people[0].regions if r not in (Region.HEAD, Region.NECK))
    for move in (sweep(), sweep(0.5, 1.0)):
        seen = replace(whole, people=(Person("p", arms),))
        assert ask(replace(whole, people=(Person("p", trunk),)), move).index > ask(seen, move).index


# ---- P7: geometry


@pytest.mark.parametrize("link", range(7))
def test_p7_a_link_without_geometry_is_no_robot(link):
    from importlib import resources

    text = (resources.files("pep.pit") / "robots" / "ur3e.toml").read_text()
    blocks = text.split("[[")
    kept = [b for b in blocks if not (b.startswith("capsules]]") and f"\nlink = {link}\n" in b)]
    assert len(kept) < len(blocks)
    with pytest.raises(ModelError):
        Robot.from_toml("[[".join(kept), tool=ROBOT.tool.name)


# ---- P8: sequences


def test_p8_drift_is_seen_when_the_state_is_carried():
    """Six steps of 0.3 rad towards a person, each from the last one's end; the path is its worst."""
    scene = with_person(1.0, bearing=FRONT + 1.4)
    legs = tuple(JointLeg((0.3 * (k + 1), *HOME[1:]), 0.4, 2.0) for k in range(6))
    from_the_start = ask(scene, MoveJ(HOME, legs[0].target, 0.4, 2.0))
    starts = (HOME, *(leg.target for leg in legs))
    carried = [ask(scene, MoveJ(a, b, 0.4, 2.0)) for a, b in itertools.pairwise(starts)]
    assert max(each.index for each in carried) > from_the_start.index + 0.3
    path = ask(scene, JointPath(HOME, legs))
    assert path.index == pytest.approx(max(each.index for each in carried), abs=RESOLUTION)
    before = 0.0
    for count in range(1, 7):
        part = ask(scene, JointPath(HOME, legs[:count]))
        assert part.index >= before - RESOLUTION
        before = part.index


# ---- P10: no jump but one


@given(ratio=st.floats(1e-3, 1), step=st.floats(0, 1e-6))
def test_p10_the_index_of_a_ratio_jumps_at_its_limit_alone(ratio, step):
    more = min(1.0, ratio + step)
    assert 0 <= ratio_index(more) - ratio_index(ratio) <= 10 * (more - ratio) + 1e-12
    assert ratio_index(1.0) <= 3 + 1e-12
    assert ratio_index(math.nextafter(1.0, 2.0)) == 4


def test_p10_a_little_nearer_is_a_little_more():
    """The index moves with a thing by at most the steepest band and the search's open part."""
    found = []
    x, y, z = tcp()
    for away in np.arange(0.40, 0.10, -0.005).tolist():
        share = 1 + away / math.hypot(x, y)
        glass = Thing("glass", "fragile", Sphere((share * x, share * y, z), 0.03), 0.0)
        found.append(ask(Scene(objects=(glass,)), sweep(0.5, 1.0)).index)
    assert found[-1] > 2.5
    found = [index for index in found if index < 2]  # nearer, the band is what the arm itself still travels
    steps = np.diff(found)
    assert found[-1] > 1.9
    assert (steps >= -RESOLUTION).all()
    assert steps.max() <= 0.005 / CELL.fragile_band_m + 2 * RESOLUTION


# ---- P12: engines


@pytest.mark.parametrize("seed", range(3))
def test_p12_whole_answers_of_both_engines_are_one(seed):
    for _, scene, move in drawn(20 + seed, 8):
        view = view_around(ROBOT, scene, AGE, move.start, CELL)
        ours, plain = (
            MoveQuestion(
                ROBOT, view, as_run(move, CELL), CELL, touch=NOTHING, seed=SEED, check_time=lambda: None, engine=engine
            ).answer()
            for engine in (chosen(), NUMPY)
        )
        assert (ours.tier, ours.violations) == (plain.tier, plain.violations)
        assert ours.index == pytest.approx(plain.index, abs=RESOLUTION)
        assert ours.speed_m_s == pytest.approx(plain.speed_m_s, abs=1e-9)
        assert ours.contact_ratio == pytest.approx(plain.contact_ratio, abs=RESOLUTION)


# ---- P14: too late


@pytest.mark.parametrize("name", [name for name in MOTIONS if name not in ("gripper", "output")])
def test_p14_a_clock_that_runs_out_is_a_fault_whatever_the_form(name):
    """At whichever of its looks at the clock the time is over: no answer passes."""
    box = Thing("box", "rigid", Box((*tcp()[:2], 0.0), (0.05, 0.05, 0.05)), 0.0)
    scene = replace(with_person(), objects=(*empty().objects, box))
    looks = itertools.count()
    cell = replace(CONFIGURED, time_limit_s=1.0)

    def running_out(after):
        ticks = itertools.count()
        return lambda: 0.0 if next(ticks) <= after else 2.0

    asked = {"perception_age_s": AGE, "touch": NOTHING, "seed": SEED}
    whole = assess(ROBOT, scene, MOTIONS[name], cell, **asked, clock=lambda: next(looks) * 0.0)
    assert isinstance(whole, Assessment)
    late = [
        assess(ROBOT, scene, MOTIONS[name], cell, **asked, clock=running_out(after))
        for after in np.unique(np.linspace(0, min(next(looks) - 2, 400), 8).astype(int)).tolist()
    ]
    assert late[0] == ImpactFault("PHYSICS_FAULT", "no answer in time")
    for answer in late:
        # What is only advice may be left out when time runs out; the index itself may not change.
        assert isinstance(answer, ImpactFault) or (answer.index, answer.tier) == (whole.index, whole.tier)


def test_p14_a_clock_that_is_none_is_a_fault():
    for tick in (math.nan, math.inf):
        answer = assess(
            ROBOT, empty(), sweep(), CELL, perception_age_s=AGE, touch=NOTHING, seed=SEED,
            clock=iter([0.0, *[tick] * 1000]).__next__,
        )  # fmt: skip
        assert isinstance(answer, ImpactFault)


# ---- the list in the documents


def named_tests():
    """By property, the modules with a test named for it."""
    found = {}
    for module in sorted(Path(__file__).parent.rglob("test_*.py")):
        for name in re.findall(r"^def test_((?:p\d+_)+)", module.read_text(), re.MULTILINE):
            for number in re.findall(r"p(\d+)_", name):
                found.setdefault(int(number), set()).add(module.stem)
    return found


def test_the_documents_name_every_module_that_shows_a_property():
    text = (Path(__file__).parents[3] / "docs" / "physics.md").read_text()
    rows = re.findall(r"^\| P(\d+) \|[^|]*\|([^|]*)\|$", text, re.MULTILINE)
    listed = {int(number): set(re.findall(r"`(test_\w+)`", modules)) for number, modules in rows}
    assert listed == named_tests()
    assert sorted(listed) == list(range(1, 15))
