"""Joint angles for a tool pose: Newton's method from a configuration nearby, and a search for any that reach it.

The method itself proves nothing; `pep.pit.path.line_trace` proves that what it finds lies on the one continuous path of
the arm.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from pep.base.stop_model import STREAM_SPEED_RAD_S
from pep.pit.base.errors import UnprovenError
from pep.pit.robot.kinematics import link_frames
from pep.pit.robot.twist import turn_of, turned_by

if TYPE_CHECKING:
    from pep.pit.base.motion import Floats, Joints, Pose
    from pep.pit.robot.robot import Robot

STEPS: Final = 12  # Newton doubles the digits each step: four suffice from a good guess
EXACT: Final = 1e-11  # m and rad: far below `clearance.ROUNDING_M`, a hundred times above float64 rounding
FAR_RAD: Final = 0.5  # a step so long left the neighbourhood of the guess

SEARCH_STARTS: Final = 16  # an arm of six joints has at most 16 configurations for one pose
SEARCH_STEPS: Final = 60  # damped steps; solutions that exist were found within 30 in all trials
DESCENT_STEPS: Final = 30  # likewise, where others than the one at hand are looked for
SEARCH_DAMPING: Final = 1e-4  # m^2: keeps a step finite near a singularity
SEARCH_NEAR: Final = 1e-4  # m and rad: so near, Newton would end there
SEARCH_SEED: Final = 7  # any: the same starts each time
SEARCH_STEP_RAD: Final = 0.6  # longest change of one joint in a step
APART_RAD: Final = 0.1  # ours: two configurations of a pose so nearly as near as each other are no choice
ERROR_M: Final = 1e-3  # ours, with `ERROR_RAD`: an error of the pose that may turn a joint by `GAIN_RAD` at most
ERROR_RAD: Final = 1e-3  # ours
GAIN_RAD: Final = 0.05  # ours: fifty times the error: nearer to a singularity the controller's answer is another one


@dataclass(frozen=True, slots=True, eq=False)
class Stance:
    """The arm at one configuration, as far as its tool needs it.

    Attributes:
        q: joint angles (6,), rad.
        position, rotation: of the tool, (3,) and (3, 3).
        axes, origins: of the joints, (6, 3).
        jacobian: tool velocity (linear, angular) by joint speeds, (6, 6).
    """

    q: Floats
    position: Floats
    rotation: Floats
    axes: Floats
    origins: Floats
    jacobian: Floats

    def bend(self, dq: Floats) -> Floats:
        """Derivative by s of the Jacobian (6, 6) while the joints turn at `dq`."""
        turning = self.axes * dq[:, None]
        spin = np.cumsum(turning, axis=0) - turning  # of the link that carries each axis
        velocity = np.cross(turning, self.position - self.origins).sum(axis=0)
        onto = np.cross(turning[None], self.origins[:, None] - self.origins[None])  # [k, j]: origin k by joint j
        before = np.tril(np.ones((len(dq), len(dq))), -1)
        origin_velocity = (before[:, :, None] * onto).sum(axis=1)
        bent = np.cross(spin, self.axes)
        linear = np.cross(bent, self.position - self.origins) + np.cross(self.axes, velocity - origin_velocity)
        return np.concatenate([linear, bent], axis=1).T


def stance(robot: Robot, q: Floats) -> Stance:
    """The arm at `q` (6,)."""
    frames, origin = link_frames(robot, q[None])
    axes, origins = frames[0, 1:, :, 2], origin[0, 1:]
    position = origin[0, -1] + frames[0, -1] @ np.array(robot.tool.tcp_m)
    jacobian = np.concatenate([np.cross(axes, position - origins), axes], axis=1).T
    return Stance(q, position, frames[0, -1], axes, origins, jacobian)


def solved(robot: Robot, pose: tuple[Floats, Floats], near: Floats) -> Stance | None:
    """The arm with its tool at `pose` (position, rotation), reached from `near` (6,), or None when it is not."""
    q = near
    for _ in range(STEPS):
        here = stance(robot, q)
        error = np.concatenate([pose[0] - here.position, turn_of(pose[1] @ here.rotation.T)])
        if float(np.abs(error).max()) <= EXACT:
            return here
        try:
            step = np.linalg.solve(here.jacobian, error)
        except np.linalg.LinAlgError:
            return None
        if not float(np.abs(step).max()) <= FAR_RAD:
            return None
        q = q + step
    return None


def followed(robot: Robot, pose: Pose, near: Joints) -> Joints:
    """Joint angles of a tool pose on the branch of the angles `near`, a short way from them. Radians.

    Args:
        robot: the arm.
        pose: position, m, and rotation vector, rad, in the base frame.
        near: joint angles of a pose nearby.

    Raises:
        UnprovenError: none were found so near, or a small error of the pose turns a joint far ([PHY-56]).
    """
    here = solved(robot, (np.array(pose[:3]), turned_by(np.array(pose[3:]))), np.array(near))
    if here is None:
        raise UnprovenError("unreachable")
    _refuse_singular(here)
    a, b, c, d, e, f = here.q.tolist()
    return a, b, c, d, e, f


def joint_speeds(robot: Robot, twist: Pose, at: Joints) -> Joints:
    """Joint speeds, rad/s, that make a tool speed at joint angles.

    Args:
        robot: the arm; the speed is that of its tool centre point.
        twist: along and about the axes of the base frame, m/s and rad/s.
        at: joint angles, rad.

    Raises:
        UnprovenError: `singular`, a joint would be faster than a stream of joint speeds may be.
    """
    try:
        found = np.linalg.solve(stance(robot, np.array(at)).jacobian, np.array(twist))
    except np.linalg.LinAlgError:
        raise UnprovenError("singular") from None
    if not float(np.abs(found).max()) <= STREAM_SPEED_RAD_S:
        raise UnprovenError("singular")
    a, b, c, d, e, f = found.tolist()
    return a, b, c, d, e, f


def nearest(robot: Robot, pose: Pose, near: Joints) -> Joints:
    """Joint angles of a tool pose, of all configurations found those with the shortest way from `near`. Radians.

    The way is that of the joint that turns farthest; whole turns are taken as the joints' ranges allow.

    Args:
        robot: the arm.
        pose: position, m, and rotation vector, rad, in the base frame.
        near: joint angles where the arm stands.

    Raises:
        UnprovenError: there are none, a small error of the pose turns a joint far, or two are about equally near
            ([PHY-56]).
    """
    goal, start = (np.array(pose[:3]), turned_by(np.array(pose[3:]))), np.array(near)
    found: list[tuple[float, Stance]] = []
    for row in _descents(robot, goal, np.concatenate([start[None], search_starts()])):
        here = solved(robot, goal, row)
        if here is None:
            continue
        q = _within(robot, here.q, start)
        if q is not None and all(float(np.abs(q - other.q).max()) > SEARCH_NEAR for _, other in found):
            found.append((float(np.abs(q - start).max()), stance(robot, q)))
    if not found:
        raise UnprovenError("unreachable")
    found.sort(key=lambda each: each[0])
    _refuse_singular(found[0][1])
    if len(found) > 1 and not found[1][0] - found[0][0] > APART_RAD:
        raise UnprovenError("ambiguous")
    a, b, c, d, e, f = found[0][1].q.tolist()
    return a, b, c, d, e, f


def _refuse_singular(here: Stance) -> None:
    """Refuses a configuration in which a small error of the pose turns a joint far.

    Raises:
        UnprovenError: it is one.
    """
    try:
        gain = np.abs(np.linalg.inv(here.jacobian)) @ np.repeat((ERROR_M, ERROR_RAD), 3)
    except np.linalg.LinAlgError:
        raise UnprovenError("singular") from None
    if not float(gain.max()) <= GAIN_RAD:
        raise UnprovenError("singular")


def _within(robot: Robot, q: Floats, near: Floats) -> Floats | None:
    """The angles with the whole turns that lead nearest to `near` inside the joints' ranges; None without any."""
    low, high = robot.position_ranges_rad
    turned = near + np.remainder(q - near + math.pi, 2 * math.pi) - math.pi
    turned = np.where(turned < low, turned + 2 * math.pi, np.where(turned > high, turned - 2 * math.pi, turned))
    return np.asarray(turned) if bool(((low <= turned) & (turned <= high)).all()) else None


def _descents(robot: Robot, goal: tuple[Floats, Floats], q: Floats) -> Floats:
    """Ends of the damped searches from each of `q` (n, 6) that came near to one pose, (m, 6)."""
    near: Floats = np.zeros(len(q), dtype=bool)
    for _ in range(DESCENT_STEPS):
        error, step = _damped_step(robot, goal[0], goal[1], q)
        near = np.abs(error).max(axis=1) <= SEARCH_NEAR
        if near.all():
            break
        q = np.where(near[:, None], q, q + step)
    return np.asarray(q[near])


def _damped_step(robot: Robot, position: Floats, rotation: Floats, q: Floats) -> tuple[Floats, Floats]:
    """Error of the pose, and a step of each joint towards it, (n, 6) each, from `q` (n, 6)."""
    frames, origin = link_frames(robot, q)
    axes, origins = frames[:, 1:, :, 2], origin[:, 1:]
    here = origin[:, -1] + frames[:, -1] @ np.array(robot.tool.tcp_m)
    jacobian = np.concatenate([np.cross(axes, here[:, None] - origins), axes], axis=2).transpose(0, 2, 1)
    turn = turn_of(rotation @ frames[:, -1].transpose(0, 2, 1))
    error = np.concatenate([position - here, turn], axis=1)
    back = jacobian.transpose(0, 2, 1)
    damped = jacobian @ back + SEARCH_DAMPING * np.eye(6)  # 6 rows of a Jacobian
    step = (back @ np.linalg.solve(damped, error[:, :, None]))[:, :, 0]
    return error, np.clip(step, -SEARCH_STEP_RAD, SEARCH_STEP_RAD)


def search_starts() -> Floats:
    """Joint angles from which a search for any solution begins, (SEARCH_STARTS, 6), the same each time."""
    return np.random.default_rng(SEARCH_SEED).uniform(-np.pi, np.pi, (SEARCH_STARTS, 6))  # 6 joints


def reaches(robot: Robot, position: Floats, rotation: Floats) -> bool:
    """True where joint angles were found for this pose, in any configuration of the arm."""
    return not bool(np.isnan(reaching(robot, position[None], rotation[None])).any())


def reaching(robot: Robot, positions: Floats, rotations: Floats) -> Floats:
    """Joint angles that reach each of these poses to `SEARCH_NEAR`, (n, 6), rad.

    Poses are (n, 3) and (n, 3, 3). A row of NaN where none were found, from `SEARCH_STARTS` starts each.
    """
    count = len(positions)
    q = np.tile(search_starts(), (count, 1))
    goal_p, goal_r = np.repeat(positions, SEARCH_STARTS, axis=0), np.repeat(rotations, SEARCH_STARTS, axis=0)
    found = np.full((count, q.shape[1]), np.nan)
    for _ in range(SEARCH_STEPS):
        error, step = _damped_step(robot, goal_p, goal_r, q)
        near = (np.abs(error).max(axis=1) <= SEARCH_NEAR).reshape(count, SEARCH_STARTS)
        new = near.any(axis=1) & np.isnan(found).any(axis=1)
        found[new] = q.reshape(count, SEARCH_STARTS, -1)[new, near.argmax(axis=1)[new]]
        if not np.isnan(found).any():
            return found
        q = q + step
    return found
