"""`PermittedControl`: the interface of `rtde_control.RTDEControlInterface`, and nothing moves without a permit.

What commands the robot for tools that decide and act in one process (`pep.rtde.motion.drive`): it asks nobody, and
sends what it is shown a permit of. Stops are always let through, past the lock and past the gate. Who holds the raw
object holds the robot.
"""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING, Any, Final

from capabilities.values.units import Unit
from pep.base.errors import ActuationRefusedError
from pep.base.operations import MOVE_JOINT, MOVE_LINEAR, MOVE_PATH, SPEED_JOINT, digest_of, padded
from pep.base.stop_model import patience_s
from pep.rtde.command.stop_rules import joint_stop, tool_stop
from pep.rtde.motion.control_interface import STOPPING, UNWATCHED_HZ, ControlInterface
from policies.words.reason_table import Reason

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from pep.base.ports import Clock
    from pep.request.permit import Permit

MOTION: Final = (
    "directTorque", "forceMode", "forceModeSetDamping", "forceModeSetGainScaling", "freedriveMode",
    "jogStart", "moveJ_IK", "moveL_FK", "movePath", "moveUntilContact", "servoC", "servoJ", "servoL", "speedL",
    "startContactDetection", "teachMode", "toolContact",
)  # fmt: skip
"""They move the arm, or let it be moved, and no operation of the cell stands for them."""
CONFIGURATION: Final = (
    "enableExternalFtSensor", "ftRtdeInputEnable", "kickWatchdog", "reconnect", "reuploadScript", "sendCustomScript",
    "sendCustomScriptFile", "sendCustomScriptFunction", "setCustomScriptFile", "setExternalForceTorque", "setGravity",
    "setPayload", "setTargetPayload", "setTcp", "setWatchdog", "stopContactDetection", "waitPeriod", "initPeriod",
    "zeroFtSensor",
)  # fmt: skip
"""They change what later commands mean, run programs of the caller, or send registers beside the gate."""
PROGRAM_STOPS: Final = frozenset({"stopScript", "triggerProtectiveStop"})
"""Stops that end a stream of speeds too. Any other but `speedStop` would meet the thread that moves the arm, and the
controller ends a program in which two threads do."""


class PermittedControl(ControlInterface):
    """A control connection behind permits.

    Args:
        control: the raw `RTDEControlInterface`; keep no other reference to it.
        audience: canonical URL of the server whose permits count here.
        clock: both clocks.
        raise_refusals: whether a refused motion raises `ActuationRefusedError` (True) or returns False, as callers of
            ur_rtde expect.
        stop_deceleration_rad_s2: the cell's stop model, of the leading axis: every stop is at least this hard.

    Raises:
        ValueError: for a deceleration that no stop can have; every stop would fail.
    """

    def __init__(
        self, control: Any, *, audience: str, clock: Clock, raise_refusals: bool, stop_deceleration_rad_s2: float
    ) -> None:
        super().__init__(control, stop_deceleration_rad_s2=stop_deceleration_rad_s2)
        self._audience = audience
        self._clock = clock
        self._raise = raise_refusals
        self._noting = threading.Lock()
        self._stopped_ms: int | None = None
        self._stops = 0
        # What is being sent again and again, since which stop, and until when; and whether the arm may be moving by it.
        self._stream: tuple[tuple[float, ...], float, int, int] | None = None
        self._speeding = False
        # What of a path was not sent yet, its speed and acceleration, and since which stop.
        self._legs: tuple[tuple[tuple[float, ...], ...], float, float, int] | None = None

    def moveJ(  # noqa: N802 - the interface's own name
        self,
        q: Sequence[float],
        speed: float = 1.05,
        acceleration: float = 1.4,
        asynchronous: bool = False,  # noqa: FBT001, FBT002 - the interface's own order
        *,
        permit: Permit | None = None,
    ) -> bool:
        """Starts a straight move in joint space; False (or an exception) when it was not sent.

        A stop that comes while the command is being handed over may reach the controller before it; it is given once
        more behind it. So is a stop after a command that the controller did not acknowledge.

        The controller is always asked for an asynchronous move: only that can be stopped by a command. Wait for the end
        by watching the joints; `asynchronous=False` is refused, since it would promise a wait that a stop could not
        end.

        Args:
            q: 6 joint angles, rad.
            speed: of the leading axis, rad/s.
            acceleration: of the leading axis, rad/s2.
            asynchronous: must be True.
            permit: of exactly these numbers.

        Raises:
            ActuationRefusedError: if `raise_refusals`, with `NOT_WHAT_WAS_DECIDED` without permit or for other numbers,
                `VERDICT_EXPIRED` when the permit is too old, `EFFECT_FAILED` when the controller did not take the
                command.
        """
        if permit is None:
            return self._refuse(Reason.NOT_WHAT_WAS_DECIDED, "moveJ: no permit")
        if not asynchronous:
            return self._refuse(Reason.PARAMETERS_WRONG, "moveJ: only asynchronous")
        digest = digest_of(MOVE_JOINT, (*q, speed, acceleration), audience=self._audience)
        return self._begin_move(digest, (tuple(q),), speed, acceleration, permit)

    def move_path(
        self, waypoints: Sequence[Sequence[float]], speed: float, acceleration: float, *, permit: Permit
    ) -> bool:
        """Starts the first of some straight moves in joint space; the others follow one by one by `next_leg`.

        One permit is spent for all of them. ur_rtde's own path would upload another program; rest to rest is the same.

        Args:
            waypoints: 1 to 4 times 6 joint angles, rad.
            speed: of the leading axis of each, rad/s.
            acceleration: likewise, rad/s2.
            permit: of exactly these numbers.

        Raises:
            ActuationRefusedError: as `moveJ`.
        """
        points = tuple(tuple(point) for point in waypoints)
        numbers = (*(q for point in padded(points) for q in point), speed, acceleration)
        digest = digest_of(MOVE_PATH, numbers, audience=self._audience)
        return self._begin_move(digest, points, speed, acceleration, permit)

    def moveL(  # noqa: N802 - the interface's own name
        self,
        pose: Sequence[float],
        speed: float = 0.25,
        acceleration: float = 1.2,
        asynchronous: bool = False,  # noqa: FBT001, FBT002 - the interface's own order
        *,
        permit: Permit | None = None,
    ) -> bool:
        """Starts a straight move of the tool; in everything else as `moveJ`.

        Args:
            pose: of the tool in the base frame: position, m, and rotation vector, rad.
            speed: of the tool point, m/s.
            acceleration: of the tool point, m/s2.
            asynchronous: must be True.
            permit: of exactly these numbers.

        Raises:
            ActuationRefusedError: as `moveJ`.
        """
        if permit is None:
            return self._refuse(Reason.NOT_WHAT_WAS_DECIDED, "moveL: no permit")
        if not asynchronous:
            return self._refuse(Reason.PARAMETERS_WRONG, "moveL: only asynchronous")
        digest = digest_of(MOVE_LINEAR, (*pose, speed, acceleration), audience=self._audience)

        def send() -> Any:
            return self._control.moveL(list(pose), speed, acceleration, True)  # noqa: FBT003 - its own order

        return self._begin("moveL", digest, permit, lambda stops: self._send_move(send, stops))

    def next_leg(self) -> bool:
        """Whether the next move of the path under way was sent: there is one, and no stop has come since it began."""
        with self._lock:
            if self._legs is None or self._legs[3] != self._stops or not self._legs[0]:
                self._legs = None
                return False
            (point, *later), speed, acceleration, stops = self._legs
            self._legs = (tuple(later), speed, acceleration, stops)
            return self._send_leg(point, speed, acceleration, stops)

    def _begin_move(
        self, digest: str, points: tuple[tuple[float, ...], ...], speed: float, acceleration: float, permit: Permit
    ) -> bool:
        def send(stops: int) -> bool:
            self._legs = (points[1:], speed, acceleration, stops)
            return self._send_leg(points[0], speed, acceleration, stops)

        return self._begin("moveJ", digest, permit, send)

    def _begin(self, name: str, digest: str, permit: Permit, send: Callable[[int], bool]) -> bool:
        """Whether the move was taken that the permit is of; `send` is given how many stops there were before."""
        with self._lock:
            stops = self._stops
            if self._speeding:
                return self._refuse(Reason.BUSY, f"{name}: a stream of speeds is under way")
            try:
                # Inside the lock: nothing may come between the last check and the command.
                permit.spend(digest=digest, stopped_ms=self._stopped_ms)
            except ActuationRefusedError as refused:
                return self._refuse(refused.reason, f"{name}: {refused.detail}")
            self._legs = None
            if send(stops):
                return True
        return self._refuse(Reason.EFFECT_FAILED, f"{name}: the controller did not take the command")

    def _send_leg(self, q: tuple[float, ...], speed: float, acceleration: float, stops: int) -> bool:
        def send() -> Any:
            return self._control.moveJ(list(q), speed, acceleration, True)  # noqa: FBT003 - its own order

        return self._send_move(send, stops)

    def _send_move(self, send: Callable[[], Any], stops: int) -> bool:
        """Whether the controller took the move. Under the lock; a stop that came meanwhile is given again."""
        taken = False
        try:
            taken = bool(send())
        finally:
            # A stop counts before it sends: one that is not counted yet is sent after this command anyway.
            if self._stops != stops or not taken:
                self._legs = None
                self._control.stopJ(self._deceleration, False)  # noqa: FBT003 - likewise
        return taken

    def speedJ(  # noqa: N802 - the interface's own name
        self, qd: Sequence[float], acceleration: float = 0.5, time: float = 0.0, *, permit: Permit | None = None
    ) -> bool:
        """The arm takes up these joint speeds; False (or an exception) when nothing was sent, or not acknowledged.

        It keeps them while `hold_speed` is called, for `time` at most, and stands after `end_speed` or any stop. The
        controller itself stops it when nothing is sent for `patience_s`: ur_rtde's own `time` does not, its script
        repeats the motion until it is told to stop. A stream under way is prolonged by another permit for the same
        speeds.

        Args:
            qd: 6 joint speeds, rad/s.
            acceleration: of the leading axis, rad/s2.
            time: how long, s, counted from the arrival of the permitted request when it prolongs a stream.
            permit: of exactly these numbers.

        Raises:
            ActuationRefusedError: as `moveJ`.
        """
        if permit is None:
            return self._refuse(Reason.NOT_WHAT_WAS_DECIDED, "speedJ: no permit")
        numbers = (*qd, acceleration, time)
        digest = digest_of(SPEED_JOINT, numbers, audience=self._audience)
        with self._lock:
            stops, running = self._stops, self._stream
            prolongs = running is not None and running[:3] == (tuple(qd), acceleration, stops)
            if running is not None and not prolongs:
                return self._refuse(Reason.BUSY, "speedJ: another stream is under way")
            if not prolongs and not self._control.setWatchdog(1 / patience_s(self._deceleration)):
                return self._refuse(Reason.EFFECT_FAILED, "speedJ: the controller does not watch")
            try:
                permit.spend(digest=digest, stopped_ms=self._stopped_ms)
            except ActuationRefusedError as refused:
                if not prolongs:
                    self._control.setWatchdog(UNWATCHED_HZ)
                return self._refuse(refused.reason, f"speedJ: {refused.detail}")
            since_ms = permit.since_ms if prolongs else self._clock.monotonic_ms()
            until_ms = since_ms + round(time * Unit.MILLISECOND.per_si)
            if running is not None:
                until_ms = max(until_ms, running[3])
            self._stream = (tuple(qd), acceleration, stops, until_ms)
            if self._send_speed():
                return True
        return self._refuse(Reason.EFFECT_FAILED, "speedJ: the controller did not take the command")

    def hold_speed(self) -> bool:
        """Whether the stream goes on: its speeds were sent once more, before its end and with no stop in between.

        Raises:
            ActuationRefusedError: `EFFECT_FAILED` when the controller did not take them; the stream is over.
        """
        with self._lock:
            if self._stream is None or self._stream[2] != self._stops or self.speed_left_ms <= 0:
                return False
            if not self._send_speed():
                raise ActuationRefusedError(Reason.EFFECT_FAILED, "speedJ: the controller did not take the speeds")
            return True

    @property
    def speed_left_ms(self) -> int:
        """How long the stream may still be held, ms; 0 when there is none."""
        stream = self._stream
        return 0 if stream is None else max(0, stream[3] - self._clock.monotonic_ms())

    def end_speed(self) -> None:
        """The arm stands, unless the controller did not listen: watch it. The controller is as patient as before."""
        with self._lock:
            self._stream = None
            if self._speeding:
                self._brake_speed()
            self._control.setWatchdog(UNWATCHED_HZ)

    def _send_speed(self) -> bool:
        """Whether the controller took the speeds. Under the lock; a stop that came meanwhile is given again."""
        assert self._stream is not None
        qd, acceleration, stops, _ = self._stream
        self._speeding = True
        taken = False
        try:
            taken = bool(self._control.speedJ(list(qd), acceleration, 0.0))
        finally:
            if self._stops != stops or not taken:
                self._stream = None
                self._brake_speed()
        return taken

    def _brake_speed(self, deceleration: float | None = None) -> Any:
        """The stop of a stream: at the cell's deceleration, or harder when that is asked for."""
        asked = self._deceleration if deceleration is None else deceleration
        told = self._control.speedStop(joint_stop(asked, self._deceleration))
        self._speeding = False
        return told

    def carries(self, payload_kg: float, centre_m: Sequence[float]) -> bool:
        """Whether the controller reckons with this payload from now on. For the PEP alone: `setPayload` stays refused.

        Args:
            payload_kg: tool and all that is held.
            centre_m: of that mass, in the flange frame.
        """
        with self._lock:
            return bool(self._control.setPayload(payload_kg, list(centre_m)))

    @property
    def stopped_ms(self) -> int | None:
        """Monotonic time of the newest stop, or None."""
        return self._stopped_ms

    @property
    def stops(self) -> int:
        """How many stops have been asked for; whoever sends something later compares it with what it was."""
        return self._stops

    def note_stop(self) -> None:
        """A stop has been asked for: every permit of an earlier request is void from now on, spent or not."""
        with self._noting:
            self._stopped_ms = self._clock.monotonic_ms()
            self._stops += 1

    def stopJ(self, a: float = 0.0, asynchronous: bool = False) -> None:  # noqa: N802, FBT001, FBT002
        """The arm decelerates, at least as hard as the cell's stop model assumes.

        Args:
            a: rad/s2 of the leading axis; a weaker one than the model's is raised to it.
            asynchronous: whether to return before standstill.
        """
        self._stop("stopJ", (joint_stop(a, self._deceleration), asynchronous), {})

    def stopL(self, a: float = 0.0, asynchronous: bool = False) -> None:  # noqa: N802, FBT001, FBT002
        """The tool decelerates along a line.

        Args:
            a: m/s2 of the tool; raised to what the cell's deceleration is at a lever of 1 m, and to 10 m/s2, which
                ur_rtde asks for by itself. Only `stopJ` is the stop of the cell's model.
            asynchronous: whether to return before standstill.
        """
        self._stop("stopL", (tool_stop(a, self._deceleration), asynchronous), {})

    def speedStop(self, a: float = 0.0) -> Any:  # noqa: N802
        """Ends a speed motion.

        Args:
            a: m/s2 of the tool or rad/s2 of the leading axis, as the speed was given: raised as in `stopL`, which at a
                lever of 1 m is the same number in both.
        """
        return self._stop("speedStop", (tool_stop(a, self._deceleration),), {})

    def servoStop(self, a: float = 0.0) -> Any:  # noqa: N802
        """Ends a servo motion.

        Args:
            a: m/s2 of the tool, raised as in `stopL`.
        """
        return self._stop("servoStop", (tool_stop(a, self._deceleration),), {})

    def disconnect(self) -> None:
        """The arm is told to stop, and the connection ends."""
        self.note_stop()
        self._control.disconnect()

    def _refuse(self, reason: Reason, detail: str) -> bool:
        if self._raise:
            raise ActuationRefusedError(reason, detail)
        return False

    def _stop(self, name: str, arguments: tuple[Any, ...], options: dict[str, Any]) -> Any:
        self.note_stop()

        def give() -> Any:
            if self._speeding and name not in PROGRAM_STOPS:
                asked = arguments[0] if name in {"stopJ", "speedStop"} else None
                return self._brake_speed(asked)
            return getattr(self._control, name)(*arguments, **options)

        return self._at_once(give)


def _refusing(name: str) -> Callable[..., bool]:
    def refuse(self: PermittedControl, *_: Any, **__: Any) -> bool:
        return self._refuse(Reason.NOT_GRANTED, f"{name}: no operation of this cell stands for it")

    refuse.__doc__ = f"Refused: no operation of this cell stands for `{name}`."
    return refuse


def _stopping(name: str) -> Callable[..., Any]:
    def stop(self: PermittedControl, *arguments: Any, **options: Any) -> Any:
        return self._stop(name, arguments, options)

    stop.__doc__ = f"`{name}` of the control interface: past lock and gate."
    return stop


for _names, _make in (((*MOTION, *CONFIGURATION), _refusing), (STOPPING, _stopping)):
    for _name in _names:
        if _name not in PermittedControl.__dict__:
            setattr(PermittedControl, _name, _make(_name))
