"""Question to the physics room out of files, and its answer for people and machines."""

from __future__ import annotations

import hashlib
import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final, assert_never

from capabilities.values.scope import Tier
from pep.pit.assessment.assess import assess
from pep.pit.assessment.assessment import RowsCertificate
from pep.pit.assessment.path_legs import LegsCertificate
from pep.pit.base.errors import PitError
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
)
from pep.pit.checker import Unverified, Verified, verify
from pep.pit.files.motion_file import motion_of, seed_of, word_of
from pep.pit.files.plain_file import FILE_LIMIT_BYTES, value_of
from pep.pit.files.scene_file import situation_of
from pep.pit.files.trajectory_file import CSV, is_trajectory, trajectory_of, trajectory_of_csv
from pep.pit.proof.proof_document import document, question_digest
from pep.pit.robot.calibration import Calibration, calibrated, nominal_error_m
from pep.pit.robot.outfit import Outfit, ToolFile
from pep.pit.robot.robot import Robot
from pep.pit.robot.urdf_robot import robot_of
from pep.pit.scene.cell import CALIBRATED_UNCERTAINTY_M, TRACKING_M
from policies.evidence.tiers import RULES, TierRule

if TYPE_CHECKING:
    from collections.abc import Iterable

    from pep.pit.assessment.assessment import Assessment
    from pep.pit.base.motion import Motion
    from pep.pit.files.scene_file import Situation
    from policies.evidence.evidence import Contribution, ImpactFault

URDF: Final = ".urdf"
DEFAULT_ROBOT: Final = "ur3e"
"""Robot of a question that names none."""
UNCERTAINTY: Final = "robot_uncertainty_m"
PATIENCE_S: Final = 600.0
"""Longest time for an answer out of files without a limit of their own.

They do not grow old, and no arm waits.
"""
MICRO: Final = 1e6
MILLI: Final = 1e3


@dataclass(frozen=True, slots=True)
class Asked:
    """One question: this robot with its held object, this situation, this motion."""

    robot: Robot
    situation: Situation
    motion: Motion

    def answer(self) -> Assessment | ImpactFault:
        """Answer of the physics room."""
        return assess(
            self.robot,
            self.situation.scene,
            self.motion,
            self.situation.cell,
            perception_age_s=self.situation.age_s,
            touch=self.situation.touch,
            seed=seed_of(self.motion),
        )

    def proof(self, said: Assessment) -> bytes:
        """The proof document of the answer.

        Raises:
            PitError: there is no path to prove anything of, or it is of a form without a document.
        """
        return document(
            said,
            robot=self.robot,
            scene=self.situation.scene,
            motion=self.motion,
            cell=self.situation.cell,
            perception_age_s=self.situation.age_s,
            touch=self.situation.touch,
        )

    @property
    def digest(self) -> str:
        """Name of the question in a proof of its answer.

        Raises:
            PitError: a question that has no proof.
        """
        return question_digest(
            robot=self.robot,
            scene=self.situation.scene,
            motion=self.motion,
            cell=self.situation.cell,
            perception_age_s=self.situation.age_s,
            touch=self.situation.touch,
        )

    @property
    def moves(self) -> bool:
        """True for a motion of the arm, whose answer has a proof document."""
        return not isinstance(self.motion, GripperMove | OutputSet)

    @property
    def said(self) -> str:
        """The question in one line."""
        view = self.situation.scene
        if view is None or self.situation.age_s is None:
            seen = "nobody looked"
        else:
            seen = (
                f"{_number(len(view.people), 'person', 'people')} and {_number(len(view.objects), 'object', 'objects')}"
            )
            seen = f"{seen}, seen {self.situation.age_s:.2f} s before"
        return f"{word_of(self.motion)} of a {self.robot.model.name} with {self.robot.tool.name}; {seen}"


@dataclass(frozen=True, slots=True)
class Arm:
    """Robot of a question.

    Attributes:
        stated: a shipped model's name, a model file (`.toml`) or a URDF (`.urdf`); "" for the one that the scene names.
        outfit: with a URDF: the person's outfit of it.
        tools: with a URDF: files of tools beside the outfit's own.
        calibration: the arm's own kinematics, as its maker's tool wrote them.
    """

    stated: str
    outfit: Path | None = None
    calibration: Path | None = None
    tools: tuple[Path, ...] = ()

    def robot(self, tool: str) -> Robot:
        """The robot with this tool.

        Raises:
            PitError: no such model or tool, or a file that is refused.
            OSError: a file that cannot be read.
        """
        found = self._nominal(tool)
        if self.calibration is None:
            return found
        own = Calibration.from_yaml(text_of(self.calibration))
        return Robot.from_model(calibrated(found.model, own), tool=tool)

    def _nominal(self, tool: str) -> Robot:
        file = Path(self.stated)
        if (file.suffix == URDF) != (self.outfit is not None):
            raise PitError("PARAMETERS_WRONG", "a URDF and an outfit belong together")
        if self.outfit is not None:
            return robot_of(text_of(file), outfit_of(self.outfit, self.tools), tool=tool)
        if self.tools:
            raise PitError("PARAMETERS_WRONG", "a file of tools belongs to a URDF; a model file has its own")
        return Robot.from_toml(text_of(file), tool=tool) if file.suffix else Robot.load(self.stated, tool=tool)


def outfit_of(file: Path, tools: Iterable[Path]) -> Outfit:
    """A person's outfit of an arm, with tools out of files of their own.

    Raises:
        PitError: a file that is refused.
        OSError: a file that cannot be read.
    """
    outfit = Outfit.from_toml(text_of(file))
    for each in tools:
        outfit = outfit.fitted_with(ToolFile.from_toml(text_of(each)).tools)
    return outfit


def text_of(file: Path) -> str:
    """Text of a file.

    Raises:
        PitError: it is too long, or not UTF-8.
        OSError: it cannot be read.
    """
    with file.open("rb") as opened:
        raw = opened.read(FILE_LIMIT_BYTES + 1)
    if len(raw) > FILE_LIMIT_BYTES:
        raise PitError("BODY_TOO_LARGE", f"{file.name}: at most {FILE_LIMIT_BYTES} bytes")
    try:
        return raw.decode("utf-8")
    except UnicodeDecodeError as error:
        raise PitError("BODY_MALFORMED", f"{file.name}: not UTF-8") from error


def asked(scene: Path, motion: Path, arm: Arm) -> Asked:
    """The question that two files ask of a robot.

    Args:
        scene: a scene file. What its cell does not state is as in a running one, but for the time an answer may take,
            and for the uncertainty of an arm with a calibration.
        motion: a motion file, or a trajectory as `motion_in` reads it.
        arm: the robot; its tool is the one that the scene's cell names.

    Raises:
        PitError: a file that is refused, with its reason and place.
        OSError: a file that cannot be read.
    """
    stated = value_of(text_of(scene).encode(), scene)
    known = False  # whether the scene says how well the arm is known
    if isinstance(stated, dict) and isinstance(stated.get("cell"), dict):
        stated["cell"].setdefault("time_limit_s", PATIENCE_S)
        known = UNCERTAINTY in stated["cell"]
        if arm.calibration is not None:
            stated["cell"].setdefault(UNCERTAINTY, CALIBRATED_UNCERTAINTY_M)
    situation = situation_of(stated)
    named = arm if arm.stated else replace(arm, stated=situation.robot or DEFAULT_ROBOT)
    robot = named.robot(situation.cell.tool)
    what = motion_in(motion, robot)
    if arm.calibration is None and not known:
        uncertainty = nominal_error_m(robot.model) + TRACKING_M
        situation = replace(situation, cell=replace(situation.cell, robot_uncertainty_m=uncertainty))
    return Asked(robot.holding(situation.held), situation, what)


def motion_in(file: Path, robot: Robot) -> Motion:
    """The motion that a file states: a motion file, or a trajectory as others write it.

    Args:
        file: JSON, TOML, YAML or CSV, by its ending.
        robot: whose joints a trajectory names.

    Raises:
        PitError: a file that is refused, with its reason and place.
        OSError: a file that cannot be read.
    """
    joints = [joint.name for joint in robot.model.joints]
    text = text_of(file)
    if file.suffix == CSV:
        return trajectory_of_csv(text, file, joints)
    value = value_of(text.encode(), file)
    return trajectory_of(value, joints) if is_trajectory(value) else motion_of(value)


def effect(said: Assessment) -> TierRule:
    """Rule of the table of tiers for the answer; a violation is refused at every tier."""
    return TierRule.REFUSE if said.violations else RULES[said.tier]


def advice(said: Assessment, motion: Motion) -> str:
    """Advice that would lower the tier, in one sentence."""
    if said.violations:
        return f"Denied at any speed and by anyone: {', '.join(said.violations)}."
    if said.lower_tier_speed is not None:
        unit = unit_of(motion)
        return f"At {said.lower_tier_speed:.3f} {unit.word} or less of {unit.of} the tier is below {int(said.tier)}."
    if said.tier <= Tier.REVERSIBLE:
        return "There is no lower tier for a motion."
    if said.perception != "fresh":
        return f"A fresh and whole view of the cell may lower the tier; this one is {said.perception}."
    first = said.contributions[0] if said.contributions else None
    more = f"; it is decided by {_what(first)}" if first is not None else ""
    return f"No lower speed was proven to lower the tier{more}."


@dataclass(frozen=True, slots=True)
class SpeedUnit:
    """Unit of a motion's speed, and the thing that moves at it."""

    word: str
    of: str


def unit_of(motion: Motion) -> SpeedUnit:
    """Unit in which the speed of a motion is told."""
    match motion:
        case MoveJ() | SpeedJ() | ServoJ() | JointPath() | JointTrajectory():
            return SpeedUnit("rad/s", "the leading joint")
        case BlendedPath():
            return SpeedUnit("rad/s or m/s", "the leading joint or the tool point")
        case MoveL() | SpeedL() | LinePath():
            return SpeedUnit("m/s", "the tool point")
        case GripperMove():
            return SpeedUnit("m/s", "the fingers")
        case OutputSet():
            return SpeedUnit("", "nothing")
        case _:
            assert_never(motion)


def carriage(motion: Motion) -> dict[str, Any] | None:
    """Arguments with which a gateway carries a trajectory out, or the obstacle; None for any other motion."""
    if not isinstance(motion, JointTrajectory):
        return None
    # Of trajectories alone, and it loads slowly.
    from pep.base.operations import FOLLOW_TRAJECTORY
    from pep.mcp.mapping import Misfit, to_request
    from pep.world.timed_request import arguments_of

    arguments = arguments_of(motion)
    request = to_request(FOLLOW_TRAJECTORY, arguments, request_id="", audience="", at=0.0)
    if isinstance(request, Misfit):
        return {"carries": False, "why": f"{request.argument}: {request.detail}"}
    refusal = FOLLOW_TRAJECTORY.refuse(request)
    if refusal is not None:
        return {"carries": False, "why": f"{refusal.parameter} is beyond the operation's own limit"}
    return {"carries": True, "operation": FOLLOW_TRAJECTORY.name, "arguments": arguments}


def _what(told: Contribution) -> str:
    return " and ".join(name for name in (told.link, told.object) if name) or told.kind


def _number(count: int, one: str, more: str) -> str:
    return f"{count} {one if count == 1 else more}"


def to_plain(question: Asked, said: Assessment, proof: bytes | PitError) -> dict[str, Any]:
    """The answer as JSON.

    Args:
        question: the question.
        said: the answer.
        proof: its document, or why there is none.
    """
    lower = said.lower_tier_speed
    return {
        "tier": int(said.tier),
        "index": said.index,
        "clearance_mm": round(said.clearance_m * MILLI, 3) if math.isfinite(said.clearance_m) else None,
        "contributions": [contribution_to_plain(each) for each in said.contributions],
        "certificate": certificate_to_plain(said, proof),
        "model": said.model_digest,
        "violations": [str(word) for word in said.violations],
        "lower_tier_speed": None
        if lower is None
        else {"value": lower, "unit": unit_of(question.motion).word, "below_tier": int(said.tier)},
        "advice": advice(said, question.motion),
        "rule": str(effect(said)),
        "speed_m_s": said.speed_m_s,
        "tcp_speed_m_s": said.tcp_speed_m_s,
        "contact_ratio": said.contact_ratio,
        "perception": said.perception,
        "perception_age_s": said.perception_age_s,
        "engine": said.engine,
        "scene": said.scene_digest,
        "question": question.said,
    } | ({} if (carried := carriage(question.motion)) is None else {"gateway": carried})


def contribution_to_plain(told: Contribution) -> dict[str, Any]:
    """One contribution in the units of people."""
    return {
        "kind": told.kind,
        "link": told.link,
        "object": told.object,
        "t_s": told.at_ms / MILLI,
        "index": told.index_milli / MILLI,
        "clearance_mm": told.clearance_um / MILLI,
        "speed_m_s": told.speed_um_s / MICRO,
        "source": told.source,
    }


def certificate_to_plain(said: Assessment, proof: bytes | PitError) -> dict[str, Any]:
    """Proof of the answer, with the independent checker's verdict."""
    parts = said.certificate.legs if isinstance(said.certificate, LegsCertificate) else (said.certificate,)
    rows = sum(len(part.pair) for part in parts if isinstance(part, RowsCertificate))
    if isinstance(proof, PitError):
        return {"rows": rows, "sha256": None, "bytes": 0, "verified": False, "why": proof.detail}
    about = {"sha256": hashlib.sha256(proof).hexdigest(), "bytes": len(proof)}
    match verify(proof):
        case Verified() as verdict:
            return {"rows": verdict.rows, **about, "verified": True}
        case Unverified(code, place):
            return {"rows": rows, **about, "verified": False, "why": f"{code}: {place}"}
        case other:
            assert_never(other)
