"""`GuardedControl`: the interface of `rtde_control.RTDEControlInterface`, before the judge that the gateway has.

A convenience inside one process, no isolation: who holds the raw object holds the robot, and code in this process finds
it. A program that is not trusted belongs behind the gateway (`pep.rtde.line.gateway`).
"""
# ruff: noqa: N802, FBT001, FBT002, PLR0917 - the interface's own names, and its own order

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final, overload

from pep.rtde.command import command_values as v
from pep.rtde.command.command_table import ROWS
from pep.rtde.held_calls import HeldCalls
from pep.rtde.method_calls import command_of, path_of, waypoints_of
from pep.rtde.script.move_path import PathMove
from pep.rtde.wire.refusal import Refused
from policies.words.reason_table import Reason

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence
    from datetime import timedelta


ZEROS: Final = (0.0,) * 6
NOWHERE: Final = (0.0,) * 3
EVERY_AXIS: Final = (1,) * 6
_OWN: Final = "a program of its own"


class GuardedControl(HeldCalls):
    """A program's control connection, whose commands are decided and recorded as the gateway decides and records them.

    A command that is refused gives False, as one that failed does with ur_rtde; `reason` and `told` say why. A stream
    (`servoJ`, `speedJ`) is decided by its first value, which waits for that; each later value is judged in a
    millisecond, and one that is not taken stops the arm. So does a program that stops calling: after the time that its
    value stands and 100 ms more, by us, and after 200 ms by the controller's own watchdog, should this process be gone.
    A move that is under way when this process dies goes on to its end: only the gateway stops that, too.

    Stops pass at once, from any thread. During a move that is waited for the control script reads nothing, so a stop
    ends it: call `reuploadScript` then, as ur_rtde wants it. No method may be called on the judge's own loop.

    Args, attributes and errors are those of `HeldCalls`.
    """

    # ---- moves

    @overload
    def moveJ(
        self, q: Sequence[float], speed: float = 1.05, acceleration: float = 1.4, asynchronous: bool = False
    ) -> bool: ...

    @overload
    def moveJ(self, path: Sequence[Sequence[float]], asynchronous: bool = False) -> bool: ...

    def moveJ(self, *arguments: Any, **options: Any) -> bool:
        """To joint angles [rad; rad/s and rad/s2 of the leading axis], or along a list of waypoints."""
        if _along(arguments, options):
            return self._along(PathMove.MOVEJ, *arguments, **options)
        return self._move_joint(*arguments, **options)

    def _move_joint(
        self, q: Sequence[float], speed: float = 1.05, acceleration: float = 1.4, asynchronous: bool = False
    ) -> bool:
        return self._ask(command_of(1, q, speed, acceleration, asynchronous))

    @overload
    def moveL(
        self, pose: Sequence[float], speed: float = 0.25, acceleration: float = 1.2, asynchronous: bool = False
    ) -> bool: ...

    @overload
    def moveL(self, path: Sequence[Sequence[float]], asynchronous: bool = False) -> bool: ...

    def moveL(self, *arguments: Any, **options: Any) -> bool:
        """To a pose, straight [m, rad; m/s and m/s2 of the tool point], or along a list of waypoints."""
        if _along(arguments, options):
            return self._along(PathMove.MOVEL, *arguments, **options)
        return self._move_line(*arguments, **options)

    def _move_line(
        self, pose: Sequence[float], speed: float = 0.25, acceleration: float = 1.2, asynchronous: bool = False
    ) -> bool:
        return self._ask(command_of(3, pose, speed, acceleration, asynchronous))

    def moveJ_IK(
        self, pose: Sequence[float], speed: float = 1.05, acceleration: float = 1.4, asynchronous: bool = False
    ) -> bool:
        """To a pose, straight in joint space."""
        return self._ask(command_of(2, pose, speed, acceleration, asynchronous))

    def moveL_FK(
        self, q: Sequence[float], speed: float = 0.25, acceleration: float = 1.2, asynchronous: bool = False
    ) -> bool:
        """To joint angles, straight in tool space."""
        return self._ask(command_of(4, q, speed, acceleration, asynchronous))

    def movePath(self, path: Any, asynchronous: bool = False) -> bool:
        """Along a `rtde_control.Path`, as it is now."""
        waypoints = waypoints_of(path)
        if isinstance(waypoints, Refused):
            return self._ask(waypoints)
        return self._ask(v.MovePath(bool(asynchronous)), waypoints)

    def _along(self, move: PathMove, path: Sequence[Sequence[float]], asynchronous: bool = False) -> bool:
        made = path_of(move, path)
        if made is None:
            return self._ask(Refused(Reason.PARAMETERS_WRONG, "a waypoint has nine numbers"))
        return self.movePath(made, asynchronous)

    def moveUntilContact(
        self, xd: Sequence[float], direction: Sequence[float] = ZEROS, acceleration: float = 1.2
    ) -> bool:
        """With a tool speed until something is touched."""
        return self._ask(command_of(51, xd, direction, acceleration))

    # ---- what is held

    def speedJ(self, qd: Sequence[float], acceleration: float = 0.5, time: float = 0.0) -> bool:
        """With joint speeds [rad/s; rad/s2], for `time` seconds or until the next call."""
        return self._ask(command_of(9, qd, acceleration, time))

    def speedL(self, xd: Sequence[float], acceleration: float = 0.25, time: float = 0.0) -> bool:
        """With a tool speed [m/s, rad/s; m/s2], for `time` seconds."""
        return self._ask(command_of(10, xd, acceleration, time))

    def servoJ(
        self,
        q: Sequence[float],
        speed: float,
        acceleration: float,
        time: float,
        lookahead_time: float,
        gain: float,
        /,
    ) -> bool:
        """Towards joint angles [rad] for the next `time` [s]. Speed and acceleration are not used by ur_rtde either."""
        del speed, acceleration
        return self._ask(command_of(11, q, time, lookahead_time, gain))

    def servoL(
        self,
        pose: Sequence[float],
        speed: float,
        acceleration: float,
        time: float,
        lookahead_time: float,
        gain: float,
        /,
    ) -> bool:
        """Towards a pose for the next `time` [s]."""
        del speed, acceleration
        return self._ask(command_of(24, pose, time, lookahead_time, gain))

    def servoC(self, pose: Sequence[float], speed: float = 0.25, acceleration: float = 1.2, blend: float = 0.0) -> bool:
        """Towards a pose on circles."""
        return self._ask(command_of(12, pose, speed, acceleration, blend))

    def directTorque(
        self,
        torque: Sequence[float],
        viscous_scale: Sequence[float] = (0.9, 0.9, 0.8, 0.9, 0.9, 0.9),
        coulomb_scale: Sequence[float] = (0.8, 0.8, 0.7, 0.8, 0.8, 0.8),
    ) -> bool:
        """With joint torques [Nm]. The scales are not used by ur_rtde's script either."""
        del viscous_scale, coulomb_scale
        return self._ask(command_of(66, torque))

    def forceMode(
        self,
        task_frame: Sequence[float],
        selection_vector: Sequence[int],
        wrench: Sequence[float],
        type: int,  # noqa: A002 - URScript's own name
        limits: Sequence[float],
        /,
    ) -> bool:
        """With forces along the selected axes of a frame."""
        return self._ask(command_of(6, task_frame, selection_vector, wrench, type, limits))

    def jogStart(
        self,
        speeds: Sequence[float],
        feature: int = v.JogFrame.BASE.value,
        acc: float = 0.5,
        custom_frame: Sequence[float] = ZEROS,
    ) -> bool:
        """With a tool speed in a frame, until `jogStop`."""
        return self._ask(command_of(41, speeds, feature, acc, custom_frame))

    def teachMode(self) -> bool:
        """A person may push the arm."""
        return self._ask(command_of(18))

    def freedriveMode(self, free_axes: Sequence[int] = EVERY_AXIS, feature: Sequence[float] = ZEROS) -> bool:
        """A person may push the arm along the free axes of a frame."""
        return self._ask(command_of(52, free_axes, feature))

    # ---- what later commands rely on

    def setPayload(self, mass: float, cog: Sequence[float], /) -> bool:
        """Mass [kg] and its centre [m]; zeros keep the one there is."""
        return self._ask(command_of(17, mass, cog))

    def setTargetPayload(self, mass: float, cog: Sequence[float] = (), inertia: Sequence[float] = ZEROS) -> bool:
        """Mass, its centre and its inertia."""
        return self._ask(command_of(65, mass, cog if len(cog) else NOWHERE, inertia))

    def setTcp(self, tcp_offset: Sequence[float], /) -> bool:
        """Where the tool centre is on the flange [m, rad]."""
        return self._ask(command_of(29, tcp_offset))

    def setGravity(self, direction: Sequence[float], /) -> bool:
        """Which way is down [m/s2]."""
        return self._ask(command_of(59, direction))

    def zeroFtSensor(self) -> bool:
        """What the sensor reads now is nothing."""
        return self._ask(command_of(8))

    def forceModeSetDamping(self, damping: float, /) -> bool:
        """Of force mode."""
        return self._ask(command_of(20, damping))

    def forceModeSetGainScaling(self, scaling: float, /) -> bool:
        """Of force mode."""
        return self._ask(command_of(21, scaling))

    def ftRtdeInputEnable(
        self,
        enable: bool,
        sensor_mass: float = 0.0,
        sensor_measuring_offset: Sequence[float] = NOWHERE,
        sensor_cog: Sequence[float] = NOWHERE,
    ) -> bool:
        """Whether force mode believes what a client writes."""
        return self._ask(command_of(56, enable, sensor_mass, sensor_measuring_offset, sensor_cog))

    def enableExternalFtSensor(
        self,
        enable: bool,
        sensor_mass: float = 0.0,
        sensor_measuring_offset: Sequence[float] = NOWHERE,
        sensor_cog: Sequence[float] = NOWHERE,
    ) -> bool:
        """Whether there is a sensor that is not the robot's own."""
        return self._ask(command_of(57, enable, sensor_mass, sensor_measuring_offset, sensor_cog))

    def setExternalForceTorque(self, external_force_torque: Sequence[float], /) -> bool:
        """What such a sensor would say."""
        return self._ask(command_of(55, external_force_torque))

    def startContactDetection(self, direction: Sequence[float] = ZEROS) -> bool:
        """From now on the arm goes back to where it touches something."""
        return self._ask(command_of(62, direction))

    def stopContactDetection(self) -> Any:
        """No more; answers whether it was touched."""
        return self._read("stopContactDetection", (), {})

    def toolContact(self, direction: Sequence[float], /) -> Any:
        """For how many cycles there has been a contact from this direction."""
        return self._read("toolContact", (list(direction),), {})

    # ---- stops

    def stopJ(self, a: float = 2.0, asynchronous: bool = False) -> None:
        """Ends a move, at least as hard as the cell's stop model assumes [rad/s2]."""
        self._stop(v.StopJ(float(a), bool(asynchronous)))

    def stopL(self, a: float = 10.0, asynchronous: bool = False) -> None:
        """Ends a move; likewise [m/s2]."""
        self._stop(v.StopL(float(a), bool(asynchronous)))

    def speedStop(self, a: float = 10.0) -> Any:
        """Ends `speedJ` or `speedL`; likewise."""
        return self._stop(v.SpeedStop(float(a)))

    def servoStop(self, a: float = 10.0) -> Any:
        """Ends `servoJ`, `servoL` or `servoC`; likewise."""
        return self._stop(v.ServoStop(float(a)))

    # ---- the control script

    def reuploadScript(self) -> Any:
        """The control script runs again; what was under way has ended."""
        return self._replace("reuploadScript")

    def reconnect(self) -> Any:
        """The connection is there again, and the control script runs; what was under way has ended."""
        return self._replace("reconnect")

    def disconnect(self) -> None:
        """The program has ended, and the connection."""
        self._stop_program()
        with self._lock:
            self._control.disconnect()

    def setWatchdog(self, min_frequency: float = 10.0) -> bool:
        """The controller ends the program when nothing is said as often as this [Hz]."""
        return self._set_watchdog(command_of(35, min_frequency))

    def kickWatchdog(self) -> Any:
        """Something is said. It prolongs no stream: only its values do."""
        return self._read("kickWatchdog", (), {})

    def initPeriod(self) -> Any:
        """The start of a cycle, for `waitPeriod`."""
        return self._control.initPeriod()

    def waitPeriod(self, start: timedelta, /) -> None:
        """The rest of the cycle has passed."""
        self._control.waitPeriod(start)

    def sendCustomScript(self, script: str, /) -> bool:
        """Refused: a program of its own is judged behind the gateway at best."""
        return self._unsaid(script)

    def sendCustomScriptFunction(self, function_name: str, script: str, /) -> bool:
        """Refused, likewise."""
        return self._unsaid(function_name, script)

    def sendCustomScriptFile(self, file_path: str, /) -> bool:
        """Refused, likewise."""
        return self._unsaid(file_path)

    def setCustomScriptFile(self, file_path: str, /) -> bool:
        """Refused, likewise: another script would be sent in place of ur_rtde's own."""
        return self._unsaid(file_path)

    def _unsaid(self, *_: str) -> bool:
        return self._refused(Reason.NOT_GRANTED, _OWN)


def _along(arguments: tuple[Any, ...], options: dict[str, Any]) -> bool:
    """Whether a move was given a list of waypoints."""
    if not arguments:
        return "path" in options
    first = arguments[0]
    return len(first) > 0 and hasattr(first[0], "__len__")


def _ending(what: v.Ending, name: str) -> Callable[[GuardedControl], Any]:
    def end(self: GuardedControl) -> Any:
        return self._stop(v.End(what))

    end.__doc__ = f"`{name}` of the control interface: past lock and judge."
    end.__name__ = name
    return end


for _what in v.Ending:
    _name = ROWS[_what.value].name
    setattr(GuardedControl, _name, _ending(_what, _name))
