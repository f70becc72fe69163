"""The second engine's opinion of a course: as `pep.pit.oracle` gives it of a straight path, and of the inverse too.

On a line pinocchio has to find the tool where the line says, going as the line says, at joint angles that the kernel
found: so the inverse is confirmed without being computed twice.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import numpy as np
import pinocchio

from pep.pit.oracle import (
    DISTANCE_TOLERANCE_M,
    SPEED_TOLERANCE_M_S,
    Agreement,
    Disagreement,
    World,
    fractions,
    judged,
)

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from pep.pit.certify import Certified
    from pep.pit.drive import Drive
    from pep.pit.motion import Floats
    from pep.pit.pairs import Pairs
    from pep.pit.robot import Robot
    from pep.pit.scene import Scene
    from pep.pit.separation import Stopping
    from pep.pit.twist import Twist

POSE_TOLERANCE: Final = 1e-8  # m and rad; Newton ends at 1e-11
RATE_TOLERANCE: Final = 1e-6  # m and rad per unit of s, relative: two ways to the same velocity


def drive_check(
    drive: Drive,
    pairs: Pairs,
    scene: Scene,
    stop: Stopping,
    *,
    certified: Certified,
    rows: NDArray[np.intp],
    seed: bytes,
) -> Agreement | Disagreement:
    """Ask pinocchio and coal about every pair at the witnesses and at the seeded places, as `cross_check` does."""
    course, profile = drive.course, drive.profile
    world = World(course.robot, scene, pairs)
    every = np.arange(len(pairs))
    watched = [*certified.witnesses[:1], *certified.violated.values()]
    times = [profile.time_of(w.s) for w in watched] + [f * profile.duration_s for f in fractions(seed)]
    highest = 0.0

    def ask(s: float, rate: float) -> tuple[Floats, Floats] | Disagreement:
        q, dq = course.at(s)
        if drive.twist is not None and s <= drive.line_until and not _on_line(course.robot, drive.twist, s, q, dq):
            return Disagreement("joint angles on the line")
        return world.ask(q, dq * rate)

    for witness in watched:
        rate = float(profile.rate(np.array(witness.s)))
        told = ask(witness.s, rate)
        if isinstance(told, Disagreement):
            return told
        clearance, speed = told
        if not (np.abs(clearance - course.clearance_at(pairs, witness.key, every)) <= DISTANCE_TOLERANCE_M).all():
            return Disagreement("clearance at the witness")
        if not (np.abs(speed - rate * course.rush_at(pairs, witness.key, every)) <= SPEED_TOLERANCE_M_S).all():
            return Disagreement("speed at the witness")
    for time_s in times:
        told = ask(*profile.at(time_s))
        if isinstance(told, Disagreement):
            return told
        clearance, speed = told
        found = judged(pairs, stop, certified, rows, clearance=clearance[None, rows], speed=speed[None, rows])
        if isinstance(found, Disagreement):
            return found
        highest = max(highest, found.highest)
    return Agreement(len(times), highest)


def _on_line(robot: Robot, twist: Twist, s: float, q: Floats, dq: Floats) -> bool:
    """Whether pinocchio finds the tool where the line is at `s`, and going along it."""
    model, scratch = robot.pinocchio, robot.pinocchio.createData()
    pinocchio.forwardKinematics(model, scratch, q)
    wrist: Any = scratch.oMi[len(robot.model.joints)]
    lever = np.array(robot.tool.tcp_m)
    tool = pinocchio.SE3(wrist.rotation, wrist.act(lever))
    wanted = pinocchio.SE3(pinocchio.exp3(s * twist.turn) @ twist.rotation, twist.position + s * twist.line)
    off = max(
        float(np.abs(tool.translation - wanted.translation).max()),
        float(np.abs(pinocchio.log3(wanted.rotation @ tool.rotation.T)).max()),
    )
    jacobian = pinocchio.computeJointJacobian(model, scratch, q, len(robot.model.joints))  # of the wrist, in its frame
    velocity, spin = wrist.rotation @ (jacobian @ dq)[:3], wrist.rotation @ (jacobian @ dq)[3:]
    moving = np.concatenate([velocity + np.cross(spin, wrist.rotation @ lever), spin])
    wide = RATE_TOLERANCE * (1 + float(np.abs(twist.rate).max()))
    return off <= POSE_TOLERANCE and bool((np.abs(moving - twist.rate) <= wide).all())
