"""Steps of a program that knows nothing of enforcement: each is one call, or a stream of equal ones."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING, Final

import msgspec

if TYPE_CHECKING:
    from rtde_control import RTDEControlInterface

Six = tuple[float, float, float, float, float, float]
CYCLE_S: Final = 0.008
"""Period of a stream: four of the controller's cycles."""
LOOKAHEAD_S: Final = 0.1
GAIN: Final = 300.0
"""ur_rtde's own examples of servoJ."""
SETTLES_S: Final = 0.5
"""Time for which the last target of a servo stream is repeated: the arm follows behind it."""
LONGEST_S: Final = 20.0
"""Longest wait for an asynchronous motion to end."""


class Step(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True, tag_field="call"):
    """One step."""

    @property
    def operation(self) -> str:
        """Operation that a token must grant for it; empty where none stands for it."""
        return ""

    def run(self, control: RTDEControlInterface) -> bool:
        """Does the step; False where ur_rtde calls it no success."""
        raise NotImplementedError


class MoveJ(Step, frozen=True, kw_only=True, tag="moveJ"):
    """Joint move; an asynchronous one is not waited for."""

    to_rad: Six
    speed_rad_s: float
    acceleration_rad_s2: float = 1.4
    asynchronous: bool = False

    @property
    def operation(self) -> str:
        """See `Step`."""
        return "move_joint"

    def run(self, control: RTDEControlInterface) -> bool:
        """See `Step`."""
        return bool(control.moveJ(list(self.to_rad), self.speed_rad_s, self.acceleration_rad_s2, self.asynchronous))


class MoveJPath(Step, frozen=True, kw_only=True, tag="moveJ_path"):
    """Joint moves through waypoints in one call, with the same speed and blend at each."""

    through_rad: tuple[Six, ...]
    speed_rad_s: float
    acceleration_rad_s2: float = 1.4
    blend_m: float = 0.0

    @property
    def operation(self) -> str:
        """See `Step`."""
        return "move_path"

    def run(self, control: RTDEControlInterface) -> bool:
        """See `Step`."""
        tail = [self.speed_rad_s, self.acceleration_rad_s2]
        blends = [*[self.blend_m] * (len(self.through_rad) - 1), 0.0]
        return bool(
            control.moveJ([[*each, *tail, blend] for each, blend in zip(self.through_rad, blends, strict=True)])
        )


class MoveL(Step, frozen=True, kw_only=True, tag="moveL"):
    """Straight move of the tool by a way in the base frame, from where it is."""

    by_m: tuple[float, float, float]
    speed_m_s: float
    acceleration_m_s2: float = 1.2
    asynchronous: bool = False

    @property
    def operation(self) -> str:
        """See `Step`."""
        return "move_linear"

    def run(self, control: RTDEControlInterface) -> bool:
        """See `Step`."""
        return bool(
            control.moveL(_shifted(control, self.by_m), self.speed_m_s, self.acceleration_m_s2, self.asynchronous)
        )


class MoveJIK(Step, frozen=True, kw_only=True, tag="moveJ_IK"):
    """Joint move of the tool by a way in the base frame, from where it is."""

    by_m: tuple[float, float, float]
    speed_rad_s: float
    acceleration_rad_s2: float = 1.4

    def run(self, control: RTDEControlInterface) -> bool:
        """See `Step`."""
        return bool(control.moveJ_IK(_shifted(control, self.by_m), self.speed_rad_s, self.acceleration_rad_s2))


class ServoJ(Step, frozen=True, kw_only=True, tag="servoJ"):
    """Stream of joint targets on a straight way to the last one."""

    from_rad: Six
    to_rad: Six
    over_s: float

    @property
    def operation(self) -> str:
        """See `Step`."""
        return "servo_joint"

    def run(self, control: RTDEControlInterface) -> bool:
        """See `Step`."""
        cycles = round(self.over_s / CYCLE_S)
        for number in range(1, cycles + round(SETTLES_S / CYCLE_S) + 1):
            begun = control.initPeriod()
            share = min(1.0, number / cycles)
            target = [a + share * (b - a) for a, b in zip(self.from_rad, self.to_rad, strict=True)]
            if not control.servoJ(target, 0.0, 0.0, CYCLE_S, LOOKAHEAD_S, GAIN):
                return False
            _wait(control, begun)
        return bool(control.servoStop())


class SpeedJ(Step, frozen=True, kw_only=True, tag="speedJ"):
    """Stream of joint speeds."""

    qd_rad_s: Six
    for_s: float
    acceleration_rad_s2: float = 1.4

    @property
    def operation(self) -> str:
        """See `Step`."""
        return "speed_joint"

    def run(self, control: RTDEControlInterface) -> bool:
        """See `Step`."""
        for _ in range(round(self.for_s / CYCLE_S)):
            begun = control.initPeriod()
            if not control.speedJ(list(self.qd_rad_s), self.acceleration_rad_s2, CYCLE_S):
                return False
            _wait(control, begun)
        return bool(control.speedStop())


class SpeedL(Step, frozen=True, kw_only=True, tag="speedL"):
    """Stream of tool speeds."""

    xd: Six
    for_s: float
    acceleration_m_s2: float = 0.5

    @property
    def operation(self) -> str:
        """See `Step`."""
        return "speed_linear"

    def run(self, control: RTDEControlInterface) -> bool:
        """See `Step`."""
        for _ in range(round(self.for_s / CYCLE_S)):
            begun = control.initPeriod()
            if not control.speedL(list(self.xd), self.acceleration_m_s2, CYCLE_S):
                return False
            _wait(control, begun)
        return bool(control.speedStop())


class Jog(Step, frozen=True, kw_only=True, tag="jog"):
    """Jogging, millimetres and degrees a second, as ur_rtde takes it."""

    speeds: Six
    for_s: float

    def run(self, control: RTDEControlInterface) -> bool:
        """See `Step`."""
        if not control.jogStart(list(self.speeds)):
            return False
        time.sleep(self.for_s)
        return bool(control.jogStop())


class Custom(Step, frozen=True, kw_only=True, tag="custom_script"):
    """Lines of URScript in place of the control script."""

    script: str

    def run(self, control: RTDEControlInterface) -> bool:
        """See `Step`."""
        return bool(control.sendCustomScriptFunction("own", self.script))


class SetTcp(Step, frozen=True, kw_only=True, tag="setTcp"):
    """Another tool centre point, in the flange's frame."""

    pose: Six

    @property
    def operation(self) -> str:
        """See `Step`."""
        return "set_tcp"

    def run(self, control: RTDEControlInterface) -> bool:
        """See `Step`."""
        return bool(control.setTcp(list(self.pose)))


class Rest(Step, frozen=True, kw_only=True, tag="wait"):
    """Nothing, for a time."""

    s: float

    def run(self, control: RTDEControlInterface) -> bool:  # noqa: ARG002 - as every step
        """See `Step`."""
        time.sleep(self.s)
        return True


class UntilSteady(Step, frozen=True, kw_only=True, tag="until_steady"):
    """Waits until an asynchronous motion has ended."""

    def run(self, control: RTDEControlInterface) -> bool:
        """See `Step`."""
        end_s = time.monotonic() + LONGEST_S
        while not control.isSteady() and time.monotonic() < end_s:
            time.sleep(0.05)
        return True


Moving = MoveJ | MoveJPath | MoveL | MoveJIK | ServoJ | SpeedJ | SpeedL | Jog
AnyStep = Moving | Custom | SetTcp | Rest | UntilSteady


def _wait(control: RTDEControlInterface, begun: object) -> None:
    """Waits for the end of a stream's cycle."""
    end_s = time.monotonic() + CYCLE_S
    control.waitPeriod(begun)
    time.sleep(max(0.0, end_s - time.monotonic()))


def _shifted(control: RTDEControlInterface, by_m: tuple[float, float, float]) -> list[float]:
    """Pose of the tool, shifted in the base frame."""
    x, y, z, *turn = control.getForwardKinematics()
    return [x + by_m[0], y + by_m[1], z + by_m[2], *turn]
