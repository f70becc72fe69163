"""Right answers, by an engine that shares nothing with ours: pinocchio and coal at instants 8 ms apart."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from evaluation.pit import sampled
from evaluation.pit.workload import AGE_S
from pep.pit import JointPath, MoveJ
from pep.pit.assessment.dispatch import joint_moves
from pep.pit.base.motion import profile_of
from pep.pit.base.travel import Stopping
from pep.pit.robot.kinematics import layout, poses
from pep.pit.scene.pairs import pairs_of
from pep.pit.scene.separation import stopping

if TYPE_CHECKING:
    from evaluation.pit.question import Question
    from pep.pit.base.motion import Floats
    from pep.pit.base.travel import Stopping


@dataclass(frozen=True, slots=True, eq=False)
class Asked:
    """Question made ready, with the answers of pinocchio and coal at instants 8 ms apart.

    Attributes:
        question: the asked one.
        angles: joint angles of the instants.
        pin: its pairs in pinocchio and coal.
        nearest: least clearance of any pair, metre.
        index: the highest index: coal's clearances and the kinematics' speeds under the room's laws.
        extra: further values that a cell needs.
    """

    question: Question
    angles: list[Floats]
    pin: sampled.SampledByCoal
    nearest: float
    index: float
    extra: dict[str, Any] = field(default_factory=dict)


def ready(question: Question) -> Asked:
    """The question with its truth."""
    instants, pin = sampled.instants(question), sampled.SampledByCoal(question)
    angles = [q for q, _ in instants]
    robot, cell = question.robot, question.cell
    pairs = pairs_of(robot, question.scene, cell, grown_m=0.0)
    clear, plan = pin.each(angles), layout(robot)
    asked = np.arange(pin.pairs)
    radius, index = plan.radius[pairs.body], 1.0
    leading = _leading(question)
    for row, (q, qd) in zip(clear, instants, strict=True):
        moving = poses(robot, plan, q[None], qd)
        speed = moving.speed[0, pairs.body] + radius * moving.spin[0, pairs.body]
        index = max(index, float(pairs.index(asked, row, speed, stop_of(question, leading)).max()))
    return Asked(question, angles, pin, float(clear.min()), index)


def _leading(question: Question) -> float:
    """Speed of the fastest joint of a joint move, rad/s; 0 for any other motion."""
    motion = question.motion
    if not isinstance(motion, MoveJ):
        return 0.0
    profile = profile_of(motion)
    return 0.0 if profile is None else profile.peak_rad_s


def stop_of(question: Question, leading_rad_s: float) -> Stopping:
    """Stopping of the arm when a joint moves at this speed, with the view's age."""
    return stopping(question.cell, perception_age_s=AGE_S, joint_speed_rad_s=leading_rad_s)


def legs_truth(question: Question) -> Asked:
    """A path's truth: the highest of its legs'."""
    assert isinstance(question.motion, JointPath)
    legs = [ready(replace(question, motion=leg)) for leg in joint_moves(question.motion)]
    return Asked(question, [], legs[0].pin, min(each.nearest for each in legs), max(each.index for each in legs))
