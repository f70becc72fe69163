"""Second engine's check of a course, like `pep.pit.second.straight_check` of a path, and of the inverse.

On a line pinocchio has to find the tool where the line says, going as the line says, at joint angles that the kernel
found: so the inverse is confirmed without being computed twice.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import numpy as np
import pinocchio

from pep.pit.second.second_engine import SPEED_TOLERANCE_M_S, SecondWorld
from pep.pit.second.straight_check import Agreement, Disagreement, fractions, judged_where_near, look

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from pep.pit.base.motion import Floats
    from pep.pit.base.travel import Stopping
    from pep.pit.robot.robot import Robot
    from pep.pit.robot.twist import Twist
    from pep.pit.scene.pairs import Pairs
    from pep.pit.scene.scene import Scene
    from pep.pit.search.certify import Certified
    from pep.pit.search.timed_course import TimedCourse

POSE_TOLERANCE: Final = 1e-8  # m and rad; Newton ends at 1e-11
RATE_TOLERANCE: Final = 1e-6  # m and rad per unit of s, relative: two ways to the same velocity


def drive_check(
    drive: TimedCourse,
    pairs: Pairs,
    scene: Scene,
    stop: Stopping,
    *,
    certified: Certified,
    rows: NDArray[np.intp],
    seed: bytes,
) -> Agreement | Disagreement:
    """Asks pinocchio and coal about every pair at the witnesses and at the seeded places, as `cross_check` does."""
    course, profile = drive.course, drive.profile
    world = SecondWorld(course.robot, scene, pairs)
    every = np.arange(len(pairs))
    watched = [*certified.witnesses[:1], *certified.violated.values()]
    # By the path parameter at the witnesses, by time everywhere: two ways to the same places.
    met = [(w.s, float(profile.rate(np.array(w.s)))) for w in watched]
    timed = [profile.at(profile.time_of(w.s)) for w in watched]
    timed += [profile.at(share * profile.duration_s) for share in fractions(seed)]
    places = [*met, *timed]
    angles = [course.at(s) for s, _ in places]
    if drive.twist is not None:
        line = _Line(course.robot, drive.twist)
        for (s, _), (q, dq) in zip(places, angles, strict=True):
            if s <= drive.line_until and not line.holds(s, q, dq):
                return Disagreement("joint angles on the line")
    at = np.array([q for q, _ in angles])
    moving_at = np.array([dq * rate for (_, rate), (_, dq) in zip(places, angles, strict=True)])
    kernel = np.array([course.clearance_at(pairs, witness.key, every) for witness in watched]).reshape(-1, len(pairs))
    sight = look(world, at, moving_at, kernel, stop=stop, since=len(met), upper=certified.upper)
    if not sight.agrees:
        return Disagreement("clearance at the witness")
    for k, witness in enumerate(watched):
        moving = met[k][1] * course.rush_at(pairs, witness.key, every)
        if not (np.abs(sight.speed[k, pairs.body] - moving) <= SPEED_TOLERANCE_M_S).all():
            return Disagreement("speed at the witness")
    return judged_where_near(world, sight, stop=stop, certified=certified, rows=rows)


class _Line:
    """Line of the tool as pinocchio sees it."""

    def __init__(self, robot: Robot, twist: Twist) -> None:
        self._robot, self._twist, self._scratch = robot, twist, robot.pinocchio.createData()
        self._wide = RATE_TOLERANCE * (1 + float(np.abs(twist.rate).max()))

    def holds(self, s: float, q: Floats, dq: Floats) -> bool:
        """True where pinocchio finds the tool on the line at `s`, and going along it."""
        model, scratch, twist = self._robot.pinocchio, self._scratch, self._twist
        last = len(self._robot.model.joints)
        pinocchio.forwardKinematics(model, scratch, q)
        wrist: Any = scratch.oMi[last]
        jacobian = pinocchio.computeJointJacobian(model, scratch, q, last)  # of the wrist, in its frame
        rotation, lever = wrist.rotation, np.array(self._robot.tool.tcp_m)
        wanted = pinocchio.exp3(s * twist.turn) @ twist.rotation
        off = max(
            float(np.abs(wrist.act(lever) - (twist.position + s * twist.line)).max()),
            float(np.abs(pinocchio.log3(wanted @ rotation.T)).max()),
        )
        moved = jacobian @ dq
        velocity, spin = rotation @ moved[:3], rotation @ moved[3:]
        x, y, z = rotation @ lever
        carried = np.array([spin[1] * z - spin[2] * y, spin[2] * x - spin[0] * z, spin[0] * y - spin[1] * x])
        stray = max(float(np.abs(velocity + carried - twist.line).max()), float(np.abs(spin - twist.turn).max()))
        return off <= POSE_TOLERANCE and stray <= self._wide
