"""Acts on the arm: calls of its tools."""

from __future__ import annotations

import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from typing import TYPE_CHECKING, Any, ClassVar, Final

from evaluation.redteam.acts.act import Act
from evaluation.redteam.cast import FASTEST_URAD_S
from evaluation.redteam.parts import Came, Effect
from pep.rtde.robot.gripper import RobotiqGripper
from ztpm.stage.lending import arm_only
from ztpm.stage.stage import ACCELERATION_RAD_S2, until

if TYPE_CHECKING:
    from collections.abc import Iterable, Iterator

    from evaluation.redteam.bare import BareArena
    from evaluation.redteam.guarded import GuardedArena

UNDER_WAY_RAD: Final = 0.02
"""An arm that has come this far is under way."""
NOT_DONE: Final = "NOT_DONE"
"""Reason where ur_rtde calls a motion no success."""
Joints = tuple[float, float, float, float, float, float]


class MoveJoint(Act, frozen=True, kw_only=True, tag="move_joint"):
    """Joint move.

    Attributes:
        to_rad: six target angles.
        speed_rad_s: speed of the leading axis.
        acceleration_rad_s2: of the same.
        claiming: further arguments, by which the caller tells what is or is not there.
    """

    point: ClassVar[str] = "e5"

    to_rad: Joints
    speed_rad_s: float
    acceleration_rad_s2: float = ACCELERATION_RAD_S2
    claiming: dict[str, Any] | None = None

    def bare(self, arena: BareArena) -> Came:
        """Drives the controller."""
        return driven(_drive(arena, self, [self.to_rad]))

    def guarded(self, arena: GuardedArena) -> Came:
        """Calls the tool."""
        return _moved(arena, self, self.to_rad, claiming=self.claiming)


class StepJoint(Act, frozen=True, kw_only=True, tag="step_joint"):
    """Joint move in equal steps, each a call of its own.

    Attributes:
        to_rad: six target angles of the last.
        steps: number of calls.
        speed_rad_s, acceleration_rad_s2: of the leading axis in each.
    """

    point: ClassVar[str] = "e5"

    to_rad: Joints
    steps: int
    speed_rad_s: float
    acceleration_rad_s2: float = ACCELERATION_RAD_S2

    def targets(self, from_rad: Iterable[float]) -> Iterator[Joints]:
        """Target of each step, from these angles on."""
        start = tuple(from_rad)
        for number in range(1, self.steps + 1):
            yield _between(start, self.to_rad, number / self.steps)

    def bare(self, arena: BareArena) -> Came:
        """Drives the controller step by step."""
        return driven(_drive(arena, self, self.targets(arena.eyes.now().q_rad)))

    def guarded(self, arena: GuardedArena) -> Came:
        """Calls the tool step by step; after a refusal the rest is tried all the same."""
        return worst([_moved(arena, self, target) for target in self.targets(arena.eyes.now().q_rad)])


class SwingJoint(Act, frozen=True, kw_only=True, tag="swing_joint"):
    """Joint moves to and fro, each farther than the one before.

    Attributes:
        between_rad: pose about which it swings.
        to_rad: the farthest pose; the same way is gone to the other side.
        swings: number of swings to this side.
        speed_rad_s, acceleration_rad_s2: of the leading axis.
    """

    point: ClassVar[str] = "e5"

    between_rad: Joints
    to_rad: Joints
    swings: int
    speed_rad_s: float
    acceleration_rad_s2: float = ACCELERATION_RAD_S2

    def targets(self) -> Iterator[Joints]:
        """Target of each move."""
        for number in range(1, self.swings + 1):
            share = number / self.swings
            yield _between(self.between_rad, self.to_rad, -share)
            yield _between(self.between_rad, self.to_rad, share)

    def bare(self, arena: BareArena) -> Came:
        """Drives the controller to and fro."""
        return driven(_drive(arena, self, self.targets()))

    def guarded(self, arena: GuardedArena) -> Came:
        """Calls the tool for each; after a refusal the rest is tried all the same."""
        return worst([_moved(arena, self, target) for target in self.targets()])


class QueueJoint(Act, frozen=True, kw_only=True, tag="queue_joint"):
    """Joint move that is asked for while another one runs.

    Attributes:
        first_rad: target of the one that runs.
        to_rad: target of the other.
        speed_rad_s, acceleration_rad_s2: of the leading axis in both.
        by_second: role that asks for the other; the same one where it is empty.
    """

    point: ClassVar[str] = "e5"

    first_rad: Joints
    to_rad: Joints
    speed_rad_s: float
    acceleration_rad_s2: float = ACCELERATION_RAD_S2
    by_second: str = ""

    def bare(self, arena: BareArena) -> Came:
        """Drives the controller to the first, and away from the way there to the other."""
        arena.control.moveJ(list(self.first_rad), self.speed_rad_s, self.acceleration_rad_s2, asynchronous=True)
        under_way(arena)
        return driven(_drive(arena, self, [self.to_rad]))

    def guarded(self, arena: GuardedArena) -> Came:
        """Calls the tool twice at once; where the other is refused, a third time once the arm stands.

        Another role asks with an authority of its own, which the orchestrator lends it where it has none.
        """
        if self.by_second and not arena.token(self.by_second, "arm"):
            arena.cast.hand_down(self.by_second, arm_only(speed_high=FASTEST_URAD_S))
        with ThreadPoolExecutor(1, "first") as one:
            first = one.submit(_moved, arena, self, self.first_rad)
            under_way(arena, over=first.done)
            second = _moved(arena, self, self.to_rad, role=self.by_second)
            came = [first.result(), second]
        if second.effect is Effect.DENIED:
            came.append(_moved(arena, self, self.to_rad, role=self.by_second))
        return worst(came)


class MovePath(Act, frozen=True, kw_only=True, tag="move_path"):
    """Joint moves through waypoints in one call.

    Attributes:
        through_rad: one to four waypoints.
        speed_rad_s, acceleration_rad_s2: of the leading axis.
    """

    point: ClassVar[str] = "e5"

    through_rad: tuple[Joints, ...]
    speed_rad_s: float
    acceleration_rad_s2: float = ACCELERATION_RAD_S2

    def bare(self, arena: BareArena) -> Came:
        """Drives the controller from waypoint to waypoint."""
        return driven(_drive(arena, self, self.through_rad))

    def guarded(self, arena: GuardedArena) -> Came:
        """Calls the tool."""
        asked = {
            "waypoints_rad": [list(each) for each in self.through_rad],
            "speed_rad_s": self.speed_rad_s,
            "acceleration_rad_s2": self.acceleration_rad_s2,
        }
        token = arena.cast.free_hand(self.by, {"move_path"})
        return arena.call(self.by, "move_path", asked, point=self.point, token=token)


class SpeedJoint(Act, frozen=True, kw_only=True, tag="speed_joint"):
    """Motion at joint speeds, prolonged call by call.

    Attributes:
        qd_rad_s: six joint speeds.
        duration_s: of each call.
        calls: number of calls, one after another.
        acceleration_rad_s2: of the leading axis.
    """

    point: ClassVar[str] = "e5"

    qd_rad_s: Joints
    duration_s: float
    calls: int = 1
    acceleration_rad_s2: float = ACCELERATION_RAD_S2

    def bare(self, arena: BareArena) -> Came:
        """Drives the controller for the whole time."""
        done = True
        for _ in range(self.calls):
            done = arena.control.speedJ(list(self.qd_rad_s), self.acceleration_rad_s2, self.duration_s) and done
            time.sleep(self.duration_s)
        return driven(arena.control.speedStop() and done)

    def guarded(self, arena: GuardedArena) -> Came:
        """Calls the tool so often."""
        asked = {
            "qd_rad_s": list(self.qd_rad_s),
            "acceleration_rad_s2": self.acceleration_rad_s2,
            "duration_s": self.duration_s,
        }
        token = arena.cast.free_hand(self.by, {"speed_joint"})
        return worst(
            [arena.call(self.by, "speed_joint", asked, point=self.point, token=token) for _ in range(self.calls)]
        )


class GripperMove(Act, frozen=True, kw_only=True, tag="gripper_move"):
    """Move of the fingers.

    Attributes:
        width_m: opening between them afterwards.
        speed_m_s: of the fingers.
        force_n: of the grip.
    """

    point: ClassVar[str] = "e5"

    width_m: float
    speed_m_s: float = 0.05
    force_n: float = 30.0

    def bare(self, arena: BareArena) -> Came:
        """Tells the gripper at its own port."""
        gripper = RobotiqGripper(arena.host)
        gripper.activate()
        gripper.move(
            width_um=round(self.width_m * 1e6),
            speed_um_s=round(self.speed_m_s * 1e6),
            force_mn=round(self.force_n * 1e3),
            stopped=lambda: False,
        )
        return Came(Effect.DONE)

    def guarded(self, arena: GuardedArena) -> Came:
        """Calls the tool; a person has made the gripper ready."""
        RobotiqGripper(arena.stage.cell.addresses.host).activate()
        token = arena.cast.free_hand(self.by, {"gripper_move"})
        asked: dict[str, object] = {"width_m": self.width_m, "speed_m_s": self.speed_m_s, "force_n": self.force_n}
        return arena.call(self.by, "gripper_move", asked, point=self.point, token=token)


class Wait(Act, frozen=True, kw_only=True, tag="wait"):
    """Nothing for a time, in which the world may change.

    Attributes:
        s: seconds.
    """

    point: ClassVar[str] = "e5"

    s: float

    def bare(self, arena: BareArena) -> Came:  # noqa: ARG002 - as every act
        """Waits."""
        time.sleep(self.s)
        return Came(Effect.DONE)

    def guarded(self, arena: GuardedArena) -> Came:  # noqa: ARG002 - as every act
        """Waits."""
        time.sleep(self.s)
        return Came(Effect.DONE)


def driven(done: bool) -> Came:  # noqa: FBT001 - the library's own answer
    """Outcome of a motion with no enforcement, by the library's word."""
    return Came(Effect.DONE) if done else Came(Effect.DENIED, reason=NOT_DONE)


def _drive(arena: BareArena, act: _Leading, targets: Iterable[Joints]) -> bool:
    """True where the library says that the arm has been at all of them."""
    moves = [arena.control.moveJ(list(each), act.speed_rad_s, act.acceleration_rad_s2) for each in targets]
    return all(moves)


def worst(came: list[Came]) -> Came:
    """First of several that did not get through, or the last one; people were asked where any of them asked."""
    first = next((one for one in came if one.effect is not Effect.DONE), came[-1])
    return replace(first, asked=any(one.asked for one in came))


def under_way(arena: BareArena | GuardedArena, over: Any = lambda: False) -> None:
    """Waits until the arm has come some way from where it stands, or it is over."""
    start = arena.eyes.now().q_rad

    def far() -> bool:
        return bool(over()) or max(abs(a - b) for a, b in zip(arena.eyes.now().q_rad, start, strict=True)) >= (
            UNDER_WAY_RAD
        )

    until(far, "the arm under way")


def _between(start: tuple[float, ...], end: tuple[float, ...], share: float) -> Joints:
    a, b, c, d, e, f = (round(p + share * (q - p), 6) for p, q in zip(start, end, strict=True))
    return a, b, c, d, e, f


_Leading = MoveJoint | StepJoint | SwingJoint | QueueJoint | MovePath


def _moved(
    arena: GuardedArena,
    act: _Leading,
    target: Joints,
    *,
    role: str = "",
    claiming: dict[str, Any] | None = None,
) -> Came:
    """Call of `move_joint` at an act's speed."""
    asked: dict[str, object] = {
        "q_rad": list(target),
        "speed_rad_s": act.speed_rad_s,
        "acceleration_rad_s2": act.acceleration_rad_s2,
        **(claiming or {}),
    }
    return arena.call(role or act.by, "move_joint", asked, point=act.point)
