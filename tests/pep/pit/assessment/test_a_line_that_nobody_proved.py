"""No answer without a covering proof: what is not proven to its end is refused, and has no tier."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest
from pep.pit import (
    CellParameters,
    JointLeg,
    JointPath,
    LineLeg,
    LinePath,
    MoveJ,
    MoveL,
    Person,
    Region,
    Robot,
    ServoJ,
    SpeedJ,
    SpeedL,
    Sphere,
    assess,
    remaining,
)
from pep.pit.assessment.assessment import Assessment, Evident, RowsCertificate
from pep.pit.assessment.path_legs import LegsCertificate
from pep.pit.base.errors import UnprovenError
from pep.pit.base.motion import Profile
from pep.pit.checker import Code, Unverified, Verified, verify
from pep.pit.path.course import straight_cells
from pep.pit.path.course_angles import Track
from pep.pit.path.straight_path import GRID
from pep.pit.proof.proof_document import document
from pep.pit.scene.pairs import pairs_of
from pep.pit.scene.separation import stopping
from pep.pit.search.certify import proven
from pep.pit.search.kernel import compiled_path
from pep.pit.search.kernel.broad_phase import EVERYWHERE
from pep.pit.search.kernel.compiled_course import CompiledCourse
from pep.pit.search.kernel.row_cover import CELL
from pep.pit.search.kernel.straight_answer import StraightCertified
from policies.evidence.evidence import ImpactFault
from tests.model.pit import search
from tests.model.pit.course import NumpyCourse
from tests.model.pit.path import NumpyPath
from tests.pep.pit.corruption import seal
from tests.pep.pit.lines import placed, pose_of
from tests.pep.pit.scenes import CELL as PARAMETERS
from tests.pep.pit.scenes import HOME, NOTHING, ROBOT, SEED, empty, random_move, random_scene
from tests.pep.pit.search.test_lines import shifted

PATIENT = replace(PARAMETERS, time_limit_s=60.0, watch_time_limit_s=60.0)
ARM = Robot.load("ur3e", tool="robotiq_2f85")
# The line of the finding, whose first pieces lie next to a place where the wrist is singular.
LINE = MoveL((0.22, -1.74, 1.31, -1.0, -0.055, -0.27), (-0.1124, -0.4811, 0.2892, 0.9975, 1.4363, -1.1117), 0.1, 0.5)
HEAD = replace(
    CellParameters(tool="robotiq_2f85").surveyed,
    people=(Person("p", ((Region.HEAD, Sphere((-0.097, -0.501, 0.204), 0.1)),)),),
)
WRIST = (*HOME[:4], 0.15, HOME[5])
THROUGH = MoveL(WRIST, pose_of((*HOME[:4], -0.15, HOME[5])), 0.1, 1.0)
UNPROVEN = {
    "singular": THROUGH,
    "unreachable": shifted((-2.0, 0.0, 0.0)),
    "half_turn": shifted((0.05, 0.0, 0.0), (math.pi, 0, 0)),
    "uneven_twist": SpeedL(HOME, (0.05, 0.0, 0.0, 0.0, 0.0, 0.2), 0.5, 0.3),
}


def ask(motion, scene=None, robot=ROBOT, cell=PATIENT):
    scene = empty() if scene is None else scene
    return assess(robot, scene, motion, cell, perception_age_s=0.1, touch=NOTHING, seed=SEED)


def proof_of(answer, motion, scene=None, robot=ROBOT, cell=PATIENT):
    scene = empty() if scene is None else scene
    return document(answer, robot=robot, scene=scene, motion=motion, cell=cell, perception_age_s=0.1, touch=NOTHING)


def touching(q=HOME):
    """A person whose head is where the tool is."""
    position, _ = placed(q)
    return replace(empty(), people=(Person("p", ((Region.HEAD, Sphere(tuple(position.tolist()), 0.1)),)),))


@pytest.mark.long
def test_the_line_of_the_finding_names_the_person_whom_it_meets():
    cell = replace(CellParameters(tool="robotiq_2f85"), time_limit_s=60.0)
    answer = ask(LINE, HEAD, ARM, cell)
    assert answer.violations == ("person",)
    assert min(c.clearance_um for c in answer.contributions if c.kind == "person") < -60_000
    verdict = verify(proof_of(answer, LINE, HEAD, ARM, cell))
    assert isinstance(verdict, Verified)
    assert verdict.rows > 0


@pytest.mark.parametrize(("why", "motion"), UNPROVEN.items())
def test_what_is_not_proven_to_its_end_is_a_fault(why, motion):
    assert ask(motion) == ImpactFault("UNPROVEN", why)
    left = remaining(
        ROBOT, empty(), motion, PATIENT, at_rad=motion.start, authorised_milli=4000, perception_age_s=0.1, touch=NOTHING
    )
    assert left == ImpactFault("UNPROVEN", why)


def test_a_path_with_a_leg_that_is_not_proven_is_a_fault():
    good = LineLeg(pose_of(WRIST), 0.1, 1.0)
    path = LinePath(HOME, (good, LineLeg(THROUGH.target, 0.1, 1.0), good))
    assert ask(path) == ImpactFault("UNPROVEN", "singular")


STANDING = {
    "line": MoveL(HOME, pose_of(HOME), 0.1, 1.0),
    "joint move": MoveJ(HOME, HOME, 0.1, 1.0),
    "joint speeds": SpeedJ(HOME, (0.0,) * 6, 1.0, 0.1),
    "tool speed": SpeedL(HOME, (0.0,) * 6, 1.0, 0.1),
    "servo": ServoJ(HOME, (0.0,) * 6, HOME, 0.002, 0.1),
    "joint path": JointPath(HOME, (JointLeg(HOME, 0.1, 1.0),)),
    "line path": LinePath(HOME, (LineLeg(pose_of(HOME), 0.1, 1.0),)),
}


@pytest.mark.parametrize("motion", STANDING.values(), ids=STANDING)
def test_a_start_in_contact_is_looked_at_even_where_nothing_moves(motion):
    free, met = ask(motion), ask(motion, touching())
    assert (free.index, free.violations) == (0.0, ())
    assert (met.index, met.violations) == (4.0, ("person",))
    assert {c.kind for c in met.contributions} == {"person"}
    assert isinstance(verify(proof_of(free, motion)), Verified)
    assert isinstance(verify(proof_of(met, motion, touching())), Verified)


@pytest.mark.parametrize("motion", STANDING.values(), ids=STANDING)
def test_the_checker_looks_at_the_start_too(motion):
    """The free answer's proof about a scene in which a person is touched."""
    free, met = (json.loads(proof_of(ask(motion, s), motion, s)) for s in (empty(), touching()))
    met["answer"] |= {name: free["answer"][name] for name in ("index", "tier", "violations")}
    met["proof"] = free["proof"]
    assert verify(seal(met)) == Unverified(Code.ANSWER_WRONG, "answer")


@pytest.mark.parametrize("why", ["half_turn", "uneven_twist"])
def test_the_checker_knows_no_answer_to_what_cannot_be_proven(why):
    """A proof without rows, of a motion next to the one that was asked about."""
    motion = UNPROVEN[why]
    still = MoveL(HOME, pose_of(HOME), 0.1, 1.0) if why == "half_turn" else SpeedL(HOME, (0.0,) * 6, 0.5, 0.3)
    top = json.loads(proof_of(ask(still), still))
    hexed = [float(x).hex() for x in (motion.target if why == "half_turn" else motion.twist)]
    top["question"]["motion"]["target" if why == "half_turn" else "twist"] = hexed
    top["answer"] |= {"index": (3.0).hex(), "tier": 3}
    verdict = verify(seal(top))
    assert isinstance(verdict, Unverified)
    assert verdict.code is Code.UNPROVEN


def test_the_checker_refuses_a_line_without_rows():
    """As the finding's proof was: nothing traced, nothing covered."""
    near = shifted((0.0, 0.0, 0.05))
    top = json.loads(proof_of(ask(near), near))
    top["answer"] |= {"index": (3.0).hex(), "tier": 3, "violations": []}
    course = {"limit": False, "edges": [], "second": [], "third": [], "nodes": [], "until": 0, "ahead": None}
    top["proof"] = {"cover": [], "retreating": [], "meant": [], "met": [], "course": course | {"seconds": None}}
    assert isinstance(verify(seal(top)), Unverified)


# ---- the type


def rows(*intervals, asked=(0,), index=1.0):
    pair, low, high = np.array(intervals).T if intervals else np.zeros((3, 0), int)
    return RowsCertificate(np.array(asked), pair, low, high, np.full(len(pair), index))


@pytest.mark.parametrize(
    "proof",
    [
        rows(),
        rows((0, 0, GRID // 2)),
        rows((0, 0, GRID // 2), (0, 0, GRID // 2)),
        rows((0, 0, GRID), (1, 0, GRID)),
        rows((0, 0, 2 * GRID), asked=(0, 1)),
        rows((0, 0, GRID), (0, 0, GRID // 2), (0, GRID // 2, 0)),
        rows((0, 0, GRID), index=math.nan),
        rows((0, 0, GRID), asked=(0, 1)),
        rows((0, 0, GRID), index=1.5),
        Evident("joint_limit"),
        LegsCertificate(0, ()),
        LegsCertificate(2, (ask(MoveJ(HOME, (*HOME[:5], 0.1), 0.1, 1.0)),)),
    ],
)
def test_no_answer_is_made_without_a_proof_that_covers_it(proof):
    answer = ask(shifted((0.0, 0.0, 0.05)))
    assert isinstance(replace(answer, index=1.0, certificate=rows((0, 0, GRID))), Assessment)
    with pytest.raises(UnprovenError):
        replace(answer, index=1.0, certificate=proof)


# ---- the straight search, whose answers all go through one check of their rows


def beside_a_head():
    """A joint move past a person: the rows of some pairs are halved, many pairs are far apart."""
    move = MoveJ((HOME[0] - 0.9, *HOME[1:]), (HOME[0] + 0.9, *HOME[1:]), 0.3, 1.0)
    x, y, z = placed(HOME)[0].tolist()
    return move, replace(empty(), people=(Person("p", ((Region.HEAD, Sphere((1.5 * x, 1.5 * y, z), 0.1)),)),))


def leaf(found, low, *, halved):
    """Place of a row of `found`, from `low` on, that is a halved one or one of the first cut."""
    width = found[low:, 1] - found[low:, 0]
    return low + int(np.flatnonzero((width < CELL) == halved)[0])


def lose(found, at, far):
    return np.delete(found, at, axis=0), far


def put(found, at, column, value):
    found = found.copy()
    found[at, column] = value
    return found


def as_its_neighbour(found, at, far):
    """Both halves are the same one: as much is covered as before, and a half is not."""
    low, high = found[at, :2]
    other = low - (high - low) if low % (2 * (high - low)) else high
    return put(put(found, at, 0, other), at, 1, other + high - low), far


def forgotten(found, at, far):
    """A pair that was found far apart on the whole way, and is not said to be."""
    far = far.copy()
    far[np.flatnonzero(far == EVERYWHERE)[0]] = 0
    return found, far


LOSSES = {
    "a leaf of the first cut": (False, lose),
    "a halved leaf": (True, lose),
    "a half for the other": (True, as_its_neighbour),
    "a leaf for one of another pair": (False, lambda found, at, far: (put(found, at, 2, found[at, 2] + 1), far)),
    "a leaf of no pair": (False, lambda found, at, far: (put(found, at, 2, -1), far)),
    "a leaf twice": (False, lambda found, at, far: (np.concatenate([found, found[at : at + 1]]), far)),
    "a leaf backwards": (False, lambda found, at, far: (put(found, at, 1, found[at, 0]), far)),
    "what is far apart": (False, forgotten),
    "a higher index": (False, lambda found, at, far: (put(found, at, -1, 4.0), far)),
    "an index that is none": (False, lambda found, at, far: (put(found, at, -1, math.nan), far)),
}


@pytest.mark.parametrize("loss", LOSSES)
def test_a_search_that_loses_one_leaf_has_no_answer(monkeypatch, loss):
    motion, scene = beside_a_head()
    assert isinstance(ask(motion, scene), Assessment)
    true, (halved, change) = compiled_path.certify, LOSSES[loss]

    def losing(*asked):
        *head, told, broken, found, far = true(*asked)
        return *head, told, broken, *change(found, leaf(found, told + broken, halved=halved), far)

    monkeypatch.setattr(compiled_path, "certify", losing)
    assert ask(motion, scene) == ImpactFault("UNPROVEN", "the proof does not cover the motion")
    there_and_back = JointPath(motion.start, (JointLeg(motion.target, 0.3, 1.0), JointLeg(motion.start, 0.3, 1.0)))
    assert ask(there_and_back, scene) == ImpactFault("UNPROVEN", "the proof does not cover the motion")


@pytest.mark.parametrize("seed", range(6))
def test_the_quick_check_of_the_rows_is_the_exact_one(seed):
    rng = np.random.default_rng([77, seed])
    answer = ask(random_move(rng), random_scene(rng, things=4, regions=3))
    certificate = answer.certificate
    found, asked = certificate._certified._found, certificate.asked
    assert proven(asked, certificate._certified.proof, answer.index)
    begin, count = found.told + found.broken, len(found.leaves)
    assert count > 3
    for at in rng.choice(count, min(count, 40), replace=False).tolist():
        for change in (lose, as_its_neighbour):
            rows, far = change(found.found, begin + at, found.far)
            certified = StraightCertified(found._replace(found=rows, far=far), upper=4.0, attained=1.0, slower=None)
            assert not certified.proves(asked, 4.0)
            assert not proven(asked, certified.proof, 4.0)


@pytest.mark.parametrize("piece", [(0, GRID // 2), (GRID // 2, GRID)])
def test_no_course_is_made_of_a_part_of_a_motion(piece):
    still, low, high = np.zeros(6), *piece
    cells = straight_cells(np.array(HOME), still, low=low, high=high, stray=still, hurry=still)
    for kind in (NumpyCourse, CompiledCourse):
        with pytest.raises(UnprovenError):
            kind(ROBOT, cells, Track(None, 0.0, np.array(HOME), still))


def test_a_search_that_stops_before_a_violation_is_excluded_has_no_answer(monkeypatch):
    """A ball that the arm only just passes: the whole search says so, and its first cut alone cannot."""
    motion = MoveJ((HOME[0] - 0.9, *HOME[1:]), (HOME[0] + 0.9, *HOME[1:]), 0.1, 1.0)
    path, profile = NumpyPath(ROBOT, motion), Profile(1.8, 0.1, 1.0)
    stop = stopping(PARAMETERS, perception_age_s=0.1, joint_speed_rad_s=0.1)
    x, y, z = placed(HOME)[0].tolist()

    def asked(height):
        person = Person("p", ((Region.HAND, Sphere((x, y, z - height), 0.05)),))
        pairs = pairs_of(ROBOT, replace(empty(), people=(person,)), PARAMETERS, grown_m=0.0, touch=NOTHING)
        rows = np.arange(len(pairs))
        return search.certify(path, pairs, profile, stop, rows=rows, floor=4.0, check_time=lambda: None)

    passed = next(height for height in np.arange(0.0, 0.3, 0.001) if not asked(height).violated)
    monkeypatch.setattr(search, "DEPTH", 0)
    with pytest.raises(UnprovenError):
        asked(passed)
