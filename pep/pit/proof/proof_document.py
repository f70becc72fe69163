"""Whole proof of an assessment as one canonical text, which an independent checker recomputes.

The form is docs/physics.md, "The certificate" (PHY-30 to PHY-33, PHY-44 to PHY-48): the question with everything that
the answer depends on, the answer, and the rows, leg by leg where there are several. The rows are the coarsest that
prove the answer: a pair that stays far off needs one for the whole way, so the text is small and quickly checked.
"""

from __future__ import annotations

import hashlib
from typing import TYPE_CHECKING, Any, Final, assert_never

import numpy as np
import rfc8785

from pep.pit.assessment.assessment import RowsCertificate
from pep.pit.assessment.dispatch import drive_of, joint_moves, line_drives
from pep.pit.assessment.path_legs import LegsCertificate
from pep.pit.base.errors import ProofError
from pep.pit.base.motion import (
    BlendedPath,
    GripperMove,
    JointPath,
    JointTrajectory,
    LinePath,
    MoveJ,
    MoveL,
    OutputSet,
    ServoJ,
    SpeedJ,
    SpeedL,
    profile_of,
)
from pep.pit.path.straight_path import GRID
from pep.pit.proof.course_proof import NOT_TRACED, SLACK, Recorded, followed, past_limit
from pep.pit.proof.motion_proof import hex_of, hexed, motion_text
from pep.pit.proof.row_proofs import DIGITS, Claimed, ProofRows
from pep.pit.scene.pairs import pairs_of
from pep.pit.scene.separation import stopping
from pep.pit.search.engine import chosen
from pep.pit.search.question import as_run, view_around
from pep.pit.search.start_violations import joint_limits
from pep.pit.search.timed_course import Nowhere, PastLimit, TimedCourse
from pep.pit.search.trajectory_pieces import piece_drives, pieces_of

if TYPE_CHECKING:
    from collections.abc import Iterator

    from pep.pit.assessment.assessment import Assessment
    from pep.pit.base.motion import Driven, Joints, LineLeg, Motion
    from pep.pit.path.path import Keys
    from pep.pit.proof.motion_proof import Moving
    from pep.pit.proof.row_proofs import Proven
    from pep.pit.robot.robot import Robot
    from pep.pit.scene.cell import CellParameters
    from pep.pit.scene.pairs import Pairs
    from pep.pit.scene.scene import Scene
    from pep.pit.scene.view import View
    from pep.pit.search.timed_course import Drive

VERSION: Final = "ztpm-pit-proof/4"
NO_FORM: Final = "only motions of the arm without blends have a certificate that can be written down"
CELL_NUMBERS: Final = (
    "stop_deceleration_rad_s2",
    "stop_delay_s",
    "watch_age_limit_s",
    "reaction_s",
    "person_speed_m_s",
    "intrusion_tracked_m",
    "intrusion_untracked_m",
    "person_uncertainty_m",
    "warn_band_m",
    "penetration_band_m",
    "harm_ratio_body",
    "harm_ratio_head",
    "contact_area_m2",
    "robot_uncertainty_m",
    "fragile_band_m",
    "rigid_band_m",
    "overlap_limit_m",
    "contact_speed_m_s",
    "contact_near_m",
    "contact_depth_m",
    "tcp_speed_limit_m_s",
    "elbow_speed_limit_m_s",
    "momentum_limit_kg_m_s",
    "perception_age_limit_s",
    "unknown_floor",
    "retreat_joint_speed_rad_s",
    "retreat_speed_m_s",
    "retreat_tolerance_m",
)
"""Numbers of the cell on which a path's index depends; the cell's objects are in the scene."""
NO_ROWS: Final[dict[str, Any]] = {"cover": [], "retreating": [], "meant": [], "met": []}


def document(
    answer: Assessment,
    *,
    robot: Robot,
    scene: Scene | None,
    motion: Motion,
    cell: CellParameters,
    perception_age_s: float | None,
    touch: frozenset[str],
) -> bytes:
    """The proof document of an answer: canonical JSON (RFC 8785) that `pep.pit.checker.verify` verifies.

    Nothing of it is kept or computed before it is asked for: this costs about as much as the assessment did.

    Args:
        answer: the answer of `assess`.
        robot: the others are what `assess` was asked, unchanged.
        scene: likewise.
        motion: likewise.
        cell: likewise.
        perception_age_s: likewise.
        touch: likewise.

    Raises:
        ProofError: a motion that moves no joint; an answer to another question; a row that cannot be proven to the
            answer's index.
        PitError: a question that no answer could have been given to.
    """
    if isinstance(motion, GripperMove | OutputSet | BlendedPath):
        raise ProofError("PARAMETERS_WRONG", NO_FORM)
    view = view_around(robot, scene, perception_age_s, motion.start, cell)
    same = (answer.model_digest, answer.scene_digest, answer.start, answer.perception_age_s, answer.perception)
    if same != (robot.model_digest, view.scene.digest, motion.start, view.age_s, view.perception):
        raise ProofError("PARAMETERS_WRONG", "the answer to another question")
    question = _question(robot, view, motion, cell, touch)
    prover = _Prover(robot, view, cell, touch)
    match motion:
        case JointPath() | LinePath():
            if not isinstance(answer.certificate, LegsCertificate):
                raise ProofError("PARAMETERS_WRONG", "the answer to another question")
            proofs = prover.legs(motion, answer.certificate)
            legs = zip(answer.certificate.answers, proofs, strict=True)
            proof: dict[str, Any] = {"legs": [{"answer": _claim(said), "proof": each} for said, each in legs]}
        case JointTrajectory():
            if not isinstance(answer.certificate, LegsCertificate):
                raise ProofError("PARAMETERS_WRONG", "the answer to another question")
            answers = answer.certificate.answers
            timed = zip(answers, prover.timed(motion, answers), strict=True)
            proof = {
                "legs": [{"answer": _claim(said), "proof": each} for said, each in timed],
                "until_s": hexed(pieces_of(motion).ends_s[: len(answers)]),
            }
        case MoveJ() | SpeedJ():
            proof = prover.straight(motion, answer)
        case MoveL() | SpeedL() | ServoJ():
            drive = drive_of(robot, motion, cell, perception_age_s=view.stopping_age_s, check_time=lambda: None)
            proof = prover.driven(motion.start, drive, motion, answer)
        case _:
            assert_never(motion)
    claim = _claim(answer) | {
        "tier": int(answer.tier),
        "model": answer.model_digest,
        "scene": answer.scene_digest,
    }
    content: dict[str, Any] = {"v": VERSION, "question": question, "answer": claim, "proof": proof}
    return rfc8785.dumps(content | {"digest": hashlib.sha256(rfc8785.dumps(content)).hexdigest()})


def question_digest(
    *,
    robot: Robot,
    scene: Scene | None,
    motion: Motion,
    cell: CellParameters,
    perception_age_s: float | None,
    touch: frozenset[str],
) -> str:
    """SHA-256 (hex) of the question in its canonical form: `Verified.question` of a proof about it.

    Raises:
        ProofError: a motion that moves no joint.
        PitError: a scene that must not be reasoned about.
    """
    if isinstance(motion, GripperMove | OutputSet | BlendedPath):
        raise ProofError("PARAMETERS_WRONG", NO_FORM)
    view = view_around(robot, scene, perception_age_s, motion.start, cell)
    return hashlib.sha256(rfc8785.dumps(_question(robot, view, motion, cell, touch))).hexdigest()


_NOTHING: Final[dict[str, Any]] = NO_ROWS | {"cut": DIGITS[0]}


def _claim(answer: Assessment) -> dict[str, Any]:
    return {"index": hex_of(answer.index), "violations": sorted(str(each) for each in answer.violations)}


class _Prover:
    """Prover for one question: all of it but the motion, and the proof of each leg's answer."""

    def __init__(self, robot: Robot, view: View, cell: CellParameters, touch: frozenset[str]) -> None:
        """Makes a prover that has computed nothing yet."""
        self.robot, self.view, self.cell, self.touch = robot, view, cell, touch

    def _pairs(self) -> Pairs:
        return pairs_of(self.robot, self.view.scene, self.cell, grown_m=self.view.grown_m, touch=self.touch)

    def legs(self, path: JointPath | LinePath, certificate: LegsCertificate) -> Iterator[dict[str, Any]]:
        """Each leg's proof."""
        match path:
            case JointPath():
                for move, said in zip(joint_moves(path), certificate.answers, strict=True):
                    yield self.straight(move, said)
            case LinePath():
                drives = line_drives(self.robot, path, check_time=lambda: None)
                for leg, (start, drive), said in zip(path.legs, drives, certificate.answers, strict=False):
                    yield self.driven(start, drive, leg, said)
            case _:
                assert_never(path)

    def timed(self, motion: JointTrajectory, answers: tuple[Assessment, ...]) -> Iterator[dict[str, Any]]:
        """The proof of each piece of a trajectory."""
        for (start, drive), said in zip(piece_drives(self.robot, motion, self.cell), answers, strict=False):
            yield self.driven(start, drive, motion, said)

    def straight(self, motion: MoveJ | SpeedJ, answer: Assessment) -> dict[str, Any]:
        """The proof of a straight joint motion's answer."""
        run = as_run(motion, self.cell)
        profile = profile_of(run)
        if profile is None or joint_limits(self.robot, run.start, run.target).broken:
            return _NOTHING
        engine = chosen()
        path = engine.path(self.robot, run)
        demands = engine.demands(path, self.cell)
        stop = stopping(self.cell, perception_age_s=self.view.stopping_age_s, joint_speed_rad_s=profile.peak_rad_s)
        rows = ProofRows(path, profile, stop, self._pairs(), cell=self.cell, slack=0.0)
        members = _rows_of(answer, rows).members
        met = [[pair, (low + high) // 2] for pair, low, high in members["met"]]
        return members | {"met": met, "cut": _cut(*demands.intervals(profile))}

    def driven(
        self, start: Joints, drive: Drive, motion: Driven | LineLeg | JointTrajectory, answer: Assessment
    ) -> dict[str, Any]:
        """The proof of a curved motion's answer.

        Raises:
            ProofError: no piece of its line shows the joint limit that it goes beyond.
        """
        match drive:
            case Nowhere():
                return NO_ROWS | {"course": NOT_TRACED}
            case PastLimit(shown):
                return NO_ROWS | {"course": past_limit(self.robot, start, shown, motion)}
            case TimedCourse():
                return self._followed(start, drive, motion, answer)
            case _:
                assert_never(drive)

    def _followed(
        self, start: Joints, drive: TimedCourse, motion: Driven | LineLeg | JointTrajectory, answer: Assessment
    ) -> dict[str, Any]:
        way = Recorded(self.robot, start, drive)
        profile = drive.profile
        joint = drive.leading_rad_s(profile)
        stop = stopping(self.cell, perception_age_s=self.view.stopping_age_s, joint_speed_rad_s=joint)
        rows = ProofRows(way, profile, stop, self._pairs(), cell=self.cell, slack=SLACK)
        proven = _rows_of(answer, rows)
        return proven.members | {"course": followed(way, proven.places, motion)}


def _rows_of(answer: Assessment, rows: ProofRows) -> Proven:
    """The rows that prove an answer of the pairs that its search asked about: all but those of a retreat."""
    found = answer.certificate
    if not isinstance(found, RowsCertificate):
        raise ProofError("PARAMETERS_WRONG", "the answer to another question")
    asked = np.zeros(len(rows.pairs), dtype=bool)
    asked[found.asked] = True
    return rows.proof(Claimed(answer.index, answer.violations, found), asked)


def _question(robot: Robot, view: View, motion: Moving, cell: CellParameters, touch: frozenset[str]) -> dict[str, Any]:
    numbers: dict[str, Any] = {name: hex_of(getattr(cell, name)) for name in CELL_NUMBERS}
    numbers["payload_kg"] = None if cell.payload_kg is None else hex_of(cell.payload_kg)
    numbers["contacts"] = sorted([contact.object, contact.by] for contact in cell.contacts)
    return {
        "model": robot.content,
        "scene": view.scene.content,
        "cell": numbers,
        "age_s": None if view.age_s is None else hex_of(view.age_s),
        "touch": sorted(touch),
        "motion": motion_text(motion),
    }


def _cut(low: Keys, high: Keys) -> str:
    """Depths of the intervals on which speeds of the whole path are bounded, one digit each."""
    return "".join(DIGITS[(GRID // width).bit_length() - 1] for width in (high - low).tolist())
