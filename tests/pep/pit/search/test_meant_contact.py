"""Contact that is meant: declared by the cell, granted by the token, gentle all the way.

Then it has tier 2, and never with a person.
"""

from dataclasses import replace

import numpy as np
import pytest
from pep.pit.base.motion import profile_of
from pep.pit.scene.obstacles import PairKind
from pep.pit.scene.pairs import pairs_of
from pep.pit.search.meant_contact import gentle_rows
from pep.pit.second.second_engine import SecondWorld
from tests.model.pit.path import NumpyPath
from tests.pep.pit.scenes import CELL, HOME, NOTHING, ROBOT, SEED, at_time, empty, random_scene, tcp

from pep.pit import (
    Capsule,
    CellParameters,
    Contact,
    GrippedObject,
    MoveJ,
    Person,
    Region,
    Sphere,
    Thing,
    assess,
    remaining,
)

ABOVE = (0.0, -1.6595, 1.8752, -1.7865, -1.57, 0.0)  # fingers 88 mm above the table, pointing down
DOWN = (0.0, -1.486, 2.164, -2.2488, -1.57, 0.0)  # fingers on the table, within what the arm errs by
GENTLE = (0.15, 0.5)  # rad/s, rad/s2: 31 mm/s at the fingers
CONTACTS = (Contact("table", "tool"), Contact("table", "payload"))
DECLARED = replace(CELL, contacts=CONTACTS)
GRANTED = frozenset({"table"})
FRESH = 0.1


def ask(move, touch=GRANTED, cell=DECLARED, scene=None, robot=ROBOT):
    return assess(
        robot, empty() if scene is None else scene, move, cell, perception_age_s=FRESH, touch=touch, seed=SEED
    )


def place(speed=GENTLE[0], acceleration=GENTLE[1], pan=0.0, start=ABOVE, target=DOWN):
    return MoveJ((pan, *start[1:]), (pan, *target[1:]), speed, acceleration)


@pytest.mark.parametrize("pan", [-0.6, 0.0, 0.6])
def test_placing_and_lifting_are_tier_two_with_the_grant_and_three_without(pan):
    for move in (place(pan=pan), place(pan=pan, start=DOWN, target=ABOVE)):
        meant = ask(move)
        assert (meant.tier, meant.index, meant.violations) == (2, 2.0, ())
        assert [(c.kind, c.object, c.index_milli) for c in meant.contributions] == [("meant_contact", "table", 2000)]
        assert meant.contributions[0].link == "gripper_high"
        for accident in (ask(move, touch=NOTHING), ask(move, cell=CELL), ask(move, touch=frozenset({"tables", "t"}))):
            assert (accident.tier, accident.contributions[0].kind) == (3, "rigid")
            assert accident.index == pytest.approx(3, abs=0.01)


def test_the_end_of_the_place_move_touches_within_what_the_arm_errs_by():
    path = NumpyPath(ROBOT, MoveJ(DOWN, DOWN, 1.0, 1.0))
    pairs = pairs_of(ROBOT, empty(), CELL, grown_m=0.0)
    nearest = float(path.clearance_at(pairs, 0, np.flatnonzero(pairs.kind == pairs.code_of(PairKind.RIGID))).min())
    assert 0 <= nearest <= CELL.robot_uncertainty_m


def test_only_what_the_cell_says_may_touch_by():
    assert ask(place(), cell=replace(CELL, contacts=(Contact("table", "payload"),))).tier == 3
    assert ask(place(), cell=replace(CELL, contacts=(Contact("table", "tool"),))).tier == 2
    other = replace(CELL, contacts=(Contact("shelf", "tool"),))
    assert ask(place(), cell=other, touch=frozenset({"table", "shelf"})).tier == 3


def test_too_fast_is_an_accident_and_the_speed_that_would_do_is_named():
    fast = ask(place(0.6, 1.4))
    assert (fast.tier, fast.contributions[0].kind) == (3, "rigid")
    assert 0.15 < fast.lower_tier_speed < 0.6
    assert ask(place(fast.lower_tier_speed, 1.4)).tier == 2
    assert ask(place(fast.lower_tier_speed * 1.05, 1.4)).tier == 3
    for limit, tier in ((0.02, 3), (0.04, 2)):
        assert ask(place(), cell=replace(DECLARED, contact_speed_m_s=limit)).tier == tier


def test_far_from_the_object_the_tool_may_go_faster():
    """The bound on speed holds only within 30 mm: from high above the peak is higher, the end is not."""
    from_home = place(0.5, 0.15, start=HOME)
    answer = ask(from_home)
    assert answer.tcp_speed_m_s > DECLARED.contact_speed_m_s
    assert answer.tier == 2
    assert ask(from_home, cell=replace(DECLARED, contact_near_m=0.2)).tier == 3


def test_pressing_is_no_touching():
    deep = tuple(a + 0.3 * (b - a) for a, b in zip(DOWN, ABOVE, strict=True))
    deep = tuple(2 * d - u for d, u in zip(DOWN, deep, strict=True))
    assert ask(place(target=deep)).tier == 3
    assert ask(place(target=deep), cell=replace(DECLARED, contact_depth_m=0.2)).tier == 2


def test_the_rest_of_the_arm_keeps_the_ordinary_law():
    """A post beside the arm: the tool may touch it, the forearm that meets it must not."""
    path = NumpyPath(ROBOT, MoveJ(HOME, HOME, 1.0, 1.0))
    _, poses = path.nodes(np.array([0]))
    elbow = poses.ends[0, ROBOT.body_index("forearm_tube"), 0]
    x, y, z = (float(v) for v in elbow)
    post = Thing("post", "rigid", Capsule((x, y - 0.09, z - 0.05), (x, y - 0.09, z + 0.05), 0.02), 0.0)
    scene = replace(empty(), objects=(*empty().objects, post))
    cell = replace(DECLARED, contacts=(Contact("post", "tool"), Contact("post", "payload")))
    move = MoveJ(HOME, (0.15, *HOME[1:]), 0.1, 0.5)
    back = replace(move, target=(-0.15, *HOME[1:]))
    answers = [ask(m, touch=frozenset({"post"}), cell=cell, scene=scene) for m in (move, back)]
    hit = max(answers, key=lambda a: a.index)
    assert hit.tier == 3
    assert not hit.contributions[0].link.startswith("gripper")
    assert hit.contributions[0].kind == "rigid"


def test_never_a_person():
    x, y, z = tcp(DOWN)
    hand = Person("table", ((Region.HAND, Sphere((x, y, z - 0.03), 0.03)),))
    scene = replace(empty(), people=(hand,))
    cell = replace(DECLARED, contacts=(*CONTACTS, Contact("table/hand", "tool")))
    answer = ask(place(), cell=cell, scene=scene, touch=frozenset({"table", "table/hand"}))
    assert answer.violations == ("person",)
    assert answer.tier == 4


def test_a_fragile_object_may_be_touched_too_and_a_zone_may_not():
    x, y, _ = tcp(DOWN)
    vase = Thing("vase", "fragile", Sphere((x, y, -0.01), 0.03), 0.005)
    scene = replace(empty(), objects=(*empty().objects, vase))
    cell = replace(DECLARED, contacts=(*CONTACTS, Contact("vase", "tool")))
    target = tuple(d + 0.31 * (u - d) for d, u in zip(DOWN, ABOVE, strict=True))
    both = frozenset({"table", "vase"})
    assert ask(place(target=target), scene=scene, cell=cell, touch=both).tier == 2
    assert ask(place(target=target), scene=scene, cell=cell, touch=GRANTED).tier == 3


def test_payload_touches_by_its_own_contact():
    held = ROBOT.holding(GrippedObject("cube", Sphere((0.0, 0.0, 0.19), 0.03), 0.2, blunt=True))
    target = tuple(d + 0.36 * (u - d) for d, u in zip(DOWN, ABOVE, strict=True))
    move = place(target=target)
    touching = ask(move, robot=held)
    assert (touching.tier, touching.contributions[0].kind, touching.contributions[0].link) == (
        2,
        "meant_contact",
        "payload",
    )
    assert ask(move, robot=held, cell=replace(CELL, contacts=(Contact("table", "tool"),))).tier == 3


def test_granting_a_touch_only_lowers():
    """With the grant the index is never more than without, and no violation changes."""
    rng = np.random.default_rng(900)
    lowered = 0
    for _ in range(12):
        scene = random_scene(rng, things=1, regions=1, zones=0)
        scene = replace(scene, objects=(*scene.objects, *empty().objects))
        target = tuple(d + rng.uniform(-0.05, 0.2) * (u - d) for d, u in zip(DOWN, ABOVE, strict=True))
        move = place(float(rng.uniform(0.05, 0.3)), float(rng.uniform(0.05, 0.3)), start=HOME, target=target)
        cell = replace(DECLARED, contacts=(*CONTACTS, Contact("thing0", "tool")))
        without = ask(move, cell=cell, scene=scene, touch=NOTHING)
        granted = ask(move, cell=cell, scene=scene, touch=frozenset({"table", "thing0"}))
        assert granted.index <= without.index + 0.011
        assert granted.violations == without.violations
        lowered += granted.index < without.index - 0.05
    assert lowered > 3


def test_gentle_is_what_samples_say():
    """A pair proven gentle is so at each sample of the other engine; another has a sample that is not."""
    rng = np.random.default_rng(901)
    proven = refused = met = 0
    for _ in range(20):
        share = rng.uniform(-0.2, 0.4)
        target = tuple(d + share * (u - d) for d, u in zip(DOWN, ABOVE, strict=True))
        move = place(float(rng.uniform(0.05, 0.6)), float(rng.uniform(0.2, 2)), start=HOME, target=target)
        path, profile = NumpyPath(ROBOT, move), profile_of(move)
        pairs = pairs_of(ROBOT, empty(), DECLARED, grown_m=0.0, touch=GRANTED)
        gentle = gentle_rows(path, pairs, profile, DECLARED, check_time=lambda: None)
        world = SecondWorld(ROBOT, empty(), pairs)
        rough = np.zeros(len(pairs), dtype=bool)
        for t in np.linspace(0, profile.duration_s, 300):
            clearance, speed = world.ask(*at_time(path, profile, t))
            rough |= ((clearance < 0.03) & (speed > 0.05)) | (clearance < -0.02)
        assert not rough[gentle].any()
        asked = np.flatnonzero(pairs.touchable)
        assert {pairs.name_of(row) for row in asked} == {"table"}
        others = np.setdiff1d(asked, gentle)
        proven, refused, met = proven + len(gentle), refused + len(others), met + int(rough[others].sum())
    assert proven > 5
    assert met > 0.8 * refused > 2


def test_the_watch_knows_meant_contact():
    move = place()

    def left(share, touch, authorised=2000):
        at = tuple(a + share * (b - a) for a, b in zip(ABOVE, DOWN, strict=True))
        return remaining(
            ROBOT,
            empty(),
            move,
            replace(DECLARED, watch_time_limit_s=30.0),
            at_rad=at,
            authorised_milli=authorised,
            perception_age_s=FRESH,
            touch=touch,
        )

    for share in (0.0, 0.5, 0.9, 1.0):
        assert left(share, GRANTED).holds
    assert left(0.5, NOTHING).cause == "rigid"
    assert left(0.5, GRANTED, 1999).cause == "meant_contact"


@pytest.mark.parametrize(
    "contacts", [(Contact("", "tool"),), (Contact("table", "elbow"),), (Contact("a", "tool"), Contact("a", "tool"))]
)
def test_contacts_that_cannot_be(contacts):
    assert replace(CELL, contacts=contacts).defect()


def test_contacts_are_read_from_the_cell_file():
    from pep.pit import CellError

    text = '[[contacts]]\nobject = "table"\nby = "tool"\n[[contacts]]\nobject = "table"\nby = "payload"\n'
    assert CellParameters.from_toml(text).contacts == CONTACTS
    for bad in ('[[contacts]]\nobject = "table"\nby = "person"\n', '[[contacts]]\nobject = "table"\n'):
        with pytest.raises(CellError):
            CellParameters.from_toml(bad)
