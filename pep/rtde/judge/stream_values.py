"""Values of a leased stream after its first, each inside the grant and certified before it is sent.

The arm stays under the watch (`pep.watch.watch`), which looks at authority, view and arm, and asks `left` about the
value that stands. Values come on the event loop, looks on the watch's thread.
"""

from __future__ import annotations

import hashlib
import struct
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, Protocol

from capabilities.values.algebra import bound_to_json
from capabilities.values.units import Unit
from pep.base.operation_row import Moves
from pep.base.ports import RemainingVerdict
from pep.base.stop_model import ESCALATE_MS
from pep.pit.assessment.led_motion import AGAIN_MS, LedArm, LedTool
from pep.rtde.command import command_values as v
from pep.rtde.judge.command_requests import CommandedOperation, asked_of, stands_s
from pep.rtde.motion.motion_follower import Over
from pep.rtde.robot.state_receiver import FRESH_MS
from pep.watch.watch import MotionOutcome
from pep.world.cell_stream import JointAngles, JointSpeeds, Judged, Shown
from policies.evidence.evidence import ImpactFault
from policies.words.reason_table import Reason

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from capabilities.values.chain import Chain
    from capabilities.values.scope import Grant
    from pep.base.ports import Clock
    from pep.request.permit import Permit
    from pep.rtde.command.command_values import Command, Six
    from pep.rtde.judge.command_requests import ToolSetup
    from pep.rtde.judge.lease_bounds import LeaseBounds
    from pep.rtde.judge.pose_targets import Posing
    from pep.rtde.robot.judge_port import Stopper
    from pep.rtde.robot.newest_state import NewestState
    from pep.rtde.robot.state_receiver import JointState
    from pep.world.cell_stream import Value
    from policies.evidence.model import Request
    from policies.words.parameters import Parameters

LASTS_MS: Final = 300_000
"""Ours: longest stream of one decision. The next decision asks again about all that no watch looks at."""
LATE_MS: Final = 100
"""Ours: longest delay of a program in ending or renewing its speeds; physics has patience for thrice that."""
SLOW_MS: Final = 50
"""Ours: longest time for the answer about a value, as the lifetime of a verdict.

The arm is elsewhere by the time of a later answer.
"""
FREE_MILLI: Final = 2_000
"""Above the tiers that need nobody, only an approval authorises: then what approvals bind holds for every value."""

JUDGED_MS: Final = 20
"""Ours: time after which a led arm is judged again, from where it is then."""
HOLD_S: Final = 0.02
"""Ours: time for which the control script hears of no newer joint speeds of a tool speed."""
RAMP_RAD_S2: Final = (0.1, 40.0)
"""Ours, U12: least and most acceleration at which joint speeds of a tool speed are taken up."""
_SIX: Final = 6
"""Angles, speeds, or the task frame, the first parameters of what is streamed."""
_NO_VALUE: Final = (0.0,) * _SIX


class Certifying(Protocol):
    """Certifier of the values of one stream: `pep.world.cell_stream.CellStream`."""

    def see(self, q_rad: Sequence[float]) -> Shown | ImpactFault:
        """Takes the newest view as the one from the next value on; `q_rad` are six measured angles."""
        ...

    def judge(self, value: Value, state: JointState, *, authorised_milli: int, seed: bytes) -> Judged | ImpactFault:
        """Judges all motion that a value allows until the arm stands."""
        ...

    def strays(self, state: JointState) -> str:
        """Quantity of a led motion that is above its bound, as a word; "" for none."""
        ...


class LeasedStream:
    """One stream under its permit: `pep.rtde.robot.judge_port.Steps` for its line, `RemainingImpact` for its watch.

    Args:
        certifying: of this stream; has been shown a view.
        permit: of the request that opens it.
        bounds: of every value.
        parameters: of the policies: what an approval binds.
        posing: kinematics of the arm, for targets that are poses.
        fitted: as for the first value.
        arm: newest state of the robot, heard by the follower of the stream.
        stopper: knows of stops.
        clock: the monotonic one counts.
    """

    def __init__(
        self,
        certifying: Certifying,
        permit: Permit,
        *,
        bounds: LeaseBounds,
        parameters: Parameters,
        posing: Posing,
        fitted: ToolSetup,
        arm: NewestState,
        stopper: Stopper,
        clock: Clock,
    ) -> None:
        self._certifying = certifying
        self._permit = permit
        self._bounds = bounds
        self._parameters = parameters
        self._posing = posing
        self._fitted = fitted
        self._arm = arm
        self._stopper = stopper
        self._clock = clock
        self._seed = bytes.fromhex(permit.digest)
        self._began_ms = clock.monotonic_ms()
        self._until_ms = self._began_ms + LASTS_MS
        self._form: _Form | None = None  # of the command that was stepped last
        self._tool_speed: v.SpeedL | None = None  # that command, where it is one
        self._lever = 1.0  # of the last tool speed that was none of rest: rad/s of the leading joint per m/s or rad/s
        self._stands: tuple[Value, int | None] | None = None  # and until when, where it is not for ever
        self._numbers: tuple[float, ...] | None = None  # of the value that stands
        self._opened: tuple[float, ...] | None = None  # the first value
        self._judged_ms = self._began_ms
        self._lost: Reason | None = None
        self._ended_ms: int | None = None
        self._taken: list[tuple[int, tuple[float, ...]]] = []

    # -- the line's side, on the event loop

    def step(self, command: Command) -> Reason | None:
        """See `Steps.step`. A value that is not taken ends the stream for good."""
        asked = asked_of(command, path=(), fitted=self._fitted, granted=lambda _: self._bounds.grant)
        if isinstance(asked, CommandedOperation) and asked.operation == self._bounds.operation:
            self._form = self._form_of(command, asked.numbers)  # type: ignore[arg-type]  # a stream has no lists
            self._tool_speed = command if isinstance(command, v.SpeedL) else None
            return self.follow(asked.numbers[:_SIX])  # type: ignore[arg-type]  # these are six
        self._form = None
        return self.follow(_NO_VALUE)

    def follow(self, six: Six) -> Reason | None:
        """See `Steps.follow`."""
        reason = self._why_not(six)
        if reason is not None:
            self._lost = self._lost or reason
        return reason

    def written(self, command: Command) -> Command:
        """See `Steps.written`: as the joint angles or speeds that were judged ([LSD-15], [LSD-29])."""
        match command, None if self._stands is None else self._stands[0]:
            case v.ServoL(_, time_s, lookahead_s, gain), JointAngles(q_rad):
                return v.ServoJ(q_rad, time_s, lookahead_s, gain)  # type: ignore[arg-type]  # six, of a pose
            case v.SpeedL(), JointSpeeds(qd_rad_s, acceleration_rad_s2):
                return v.SpeedJ(qd_rad_s, acceleration_rad_s2, HOLD_S)  # type: ignore[arg-type]  # likewise, of a twist
            case _:
                return command

    def renewed(self) -> Command | None:
        """See `Steps.renewed`: the joint speeds of the tool speed that stands, where the arm is now ([LSD-29])."""
        command, stands, now_ms = self._tool_speed, self._stands, self._clock.monotonic_ms()
        if command is None or stands is None or now_ms - self._judged_ms < JUDGED_MS:
            return None
        if self._lost is not None or self._ended_ms is not None or self._over_at(now_ms):
            return None
        value = self._speeds_of(command.xd_m_s_rad_s, command.acceleration_m_s2)
        reason = value if isinstance(value, Reason) else self._certified(value, self._permit.index_milli)
        if isinstance(value, Reason) or reason is not None:
            self._lost = reason
            return None
        self._stands, self._judged_ms = (value, stands[1]), now_ms
        return self.written(command)

    def _form_of(self, command: Command, numbers: tuple[float, ...]) -> _Form:
        match command:
            case v.ServoL(_, time_s, lookahead_s, _):
                return _Form(numbers[_SIX:], lambda pose: self._joints_of(pose, time_s, lookahead_s), None)
            case v.SpeedL(_, acceleration_m_s2, time_s):
                stands_ms = _ms(stands_s(time_s))
                return _Form(numbers[_SIX:], lambda twist: self._speeds_of(twist, acceleration_m_s2), stands_ms)
            case _:
                return _Form.of(command, numbers)

    def _joints_of(self, pose: Six, time_s: float, lookahead_s: float) -> Value | Reason:
        """Joint angles of a pose, on the branch of the value before, or of where the arm is."""
        state = self._state()
        if state is None:
            return Reason.EVIDENCE_MISSING
        stands = None if self._stands is None else self._stands[0]
        near = stands.q_rad if isinstance(stands, JointAngles) else state.q_rad
        found = self._posing.followed(pose, near)  # type: ignore[arg-type]  # six, counted where they were read
        return Reason(found.reason) if isinstance(found, ImpactFault) else JointAngles(found, time_s, lookahead_s)

    def _speeds_of(self, twist: Six, acceleration: float) -> Value | Reason:
        """Joint speeds of a tool speed where the arm is, taken up in the time that the tool would take."""
        state = self._state()
        if state is None:
            return Reason.EVIDENCE_MISSING
        found = self._posing.speeds(twist, state.q_rad)  # type: ignore[arg-type]  # six, counted where they were read
        if isinstance(found, ImpactFault):
            return Reason(found.reason)
        fastest = max(map(abs, twist))
        if fastest > 0:
            self._lever = max(map(abs, found)) / fastest
        least, most = RAMP_RAD_S2
        return JointSpeeds(found, min(most, max(least, self._lever * acceleration)))

    def ended(self) -> None:
        """See `Steps.ended`."""
        self._ended_ms = self._clock.monotonic_ms()

    def _why_not(self, six: Six) -> Reason | None:
        began_ms = self._clock.monotonic_ms()
        if self._lost is not None:
            return self._lost
        stopped_ms = self._stopper.stopped_ms
        stopped = stopped_ms is not None and stopped_ms >= self._permit.since_ms
        if self._ended_ms is not None or stopped or self._over_at(began_ms):
            return Reason.VERDICT_EXPIRED
        form = self._form
        if form is None:
            return Reason.NOT_WHAT_WAS_DECIDED
        numbers = six + form.rest
        reason = self._bounds.outside(numbers) or (Reason.NOT_WHAT_WAS_DECIDED if self._grows(numbers) else None)
        if reason is not None:
            return reason
        value = form.value(six)
        if isinstance(value, Reason):
            return value
        reason = self._certified(value, self._permit.index_milli)
        now_ms = self._clock.monotonic_ms()
        if reason is None and now_ms - began_ms > SLOW_MS:
            reason = Reason.WATCH_LATE
        if reason is None:
            self._stands = value, None if form.stands_ms is None else now_ms + form.stands_ms
            self._numbers = numbers
            if self._opened is None:
                self._opened = numbers
                if form.lasts_ms is not None:
                    self._until_ms = min(self._until_ms, began_ms + form.lasts_ms)
            self._judged_ms = now_ms
            self._taken.append((now_ms, numbers))
        return reason

    def _grows(self, numbers: tuple[float, ...]) -> bool:
        """True where a later value of force mode has another frame, or a stronger or faster axis, than the first.

        People may have been asked about that one, and a push and a pull are alike to what is in between.
        """
        first = self._opened
        if first is None or self._bounds.operation.moves is not Moves.BY_FORCE:
            return False
        same = numbers[:_SIX] == first[:_SIX]
        return not (same and all(abs(now) <= abs(most) for now, most in zip(numbers[_SIX:], first[_SIX:], strict=True)))

    def saw(self, state: JointState) -> None:
        """Looks at a led arm: within its bounds, and judged anew from where it is. On the follower's thread."""
        stands = self._stands
        if self._lost is not None or stands is None or not isinstance(stands[0], LedTool | LedArm):
            return
        now_ms = self._clock.monotonic_ms()
        since_ms = now_ms - self._judged_ms
        if self._certifying.strays(state):
            self._lost = Reason.LED_OUT_OF_BOUNDS
        elif since_ms > AGAIN_MS:
            self._lost = Reason.WATCH_LATE
        elif since_ms >= JUDGED_MS:
            self._lost = self._certified(stands[0], self._permit.index_milli)
            self._judged_ms = now_ms

    def _certified(self, value: Value, authorised_milli: int) -> Reason | None:
        state = self._state()
        if state is None:
            return Reason.EVIDENCE_MISSING
        found = self._certifying.judge(value, state, authorised_milli=authorised_milli, seed=self._seed)
        if isinstance(found, ImpactFault):
            return _reason(found)
        if found.violations:
            return Reason.PHYSICS_VIOLATION
        if found.index_milli > authorised_milli:
            return Reason.IMPACT_ROSE
        if authorised_milli > FREE_MILLI and self._too_fast(found):
            return Reason.APPROVED_TOO_FAST
        return None

    def _too_fast(self, found: Judged) -> bool:
        most = self._parameters
        return not (
            found.tcp_speed_m_s * Unit.MICROMETRE_PER_SECOND.per_si <= most.approved_tcp_speed_um_s
            and found.contact_ratio * Unit.PERMILLE.per_si <= most.approved_contact_permille
        )

    def _state(self) -> JointState | None:
        """Newest state of the robot; None where it is silent, or nobody looks at it any more."""
        return self._arm.state if self._arm.silent_ms <= FRESH_MS else None

    # -- the watch's side, on its threads

    @property
    def ended_ms(self) -> int | None:
        """Monotonic time at which the program or the line ended the stream; None before."""
        return self._ended_ms

    @property
    def lost(self) -> Reason | None:
        """Reason for which a value was not taken, or the one that stands is outside of bounds since; None before."""
        if self._lost is None and self._ended_ms is None and self._numbers is not None:
            self._lost = self._bounds.outside(self._numbers)
        return self._lost

    @property
    def over(self) -> bool:
        """True once the time of the stream is over, or that of the value that stands."""
        return self._over_at(self._clock.monotonic_ms())

    def _over_at(self, now_ms: int) -> bool:
        stands = self._stands
        late = stands is not None and stands[1] is not None and now_ms > stands[1] + LATE_MS
        return late or now_ms >= self._until_ms

    def left(
        self,
        request: Request,  # noqa: ARG002 - the port's own form
        state_q_rad: Sequence[float],
        *,
        authorised_milli: int,
        touch: frozenset[str],  # noqa: ARG002 - it was given when the stream began
        running: float | None,  # noqa: ARG002 - nothing slows a stream down
        oldest_ms: int | None,  # noqa: ARG002 - every frame counts for the values to come, however old
    ) -> RemainingVerdict:
        """Verdict on the value that stands, by the newest view: `pep.base.ports.RemainingImpact`."""
        shown = self._certifying.see(state_q_rad)
        if isinstance(shown, ImpactFault):
            return RemainingVerdict(
                holds=False, index_milli=None, cause=shown.detail, fault=str(_reason(shown)), age_ms=None
            )
        stands = self._stands
        reason = None if stands is None else self._certified(stands[0], authorised_milli)
        fault = "" if reason in (None, Reason.IMPACT_ROSE) else str(reason)
        return RemainingVerdict(
            holds=reason is None,
            index_milli=None,
            cause="" if reason is None else str(reason),
            fault=fault,
            age_ms=shown.age_ms,
            shown=shown.content,
        )

    # -- for the record

    def batch(self) -> dict[str, object] | None:
        """The values since the last call, as plain JSON: how many, when, and their digest; None when there were none.

        The digest is SHA-256 of each value's monotonic time in ms (signed 64 bits) and numbers (doubles), big-endian.
        """
        taken, self._taken = self._taken, []
        if not taken:
            return None
        image = struct.Struct(f">q{len(taken[0][1])}d")
        content = b"".join(image.pack(at_ms, *numbers) for at_ms, numbers in taken)
        return {
            "request_id": self._permit.request_id,
            "values": len(taken),
            "first_ms": taken[0][0],
            "digest": hashlib.sha256(content).hexdigest(),
        }


class StreamProgress:
    """A stream: as long as its values come and are taken.

    Args:
        stream: whose values they are.
        clock: the monotonic one counts.
    """

    stands: Final = True

    def __init__(self, stream: LeasedStream, clock: Clock) -> None:
        self._stream = stream
        self._clock = clock

    def look(self, state: JointState) -> Over | None:
        """Stopped, where a value was not taken; ended, by its time or by its program, which has stopped it then."""
        stream = self._stream
        if stream.ended_ms is None:
            stream.saw(state)
        if stream.lost is not None:
            return Over(MotionOutcome.STOPPED, stream.lost, str(stream.lost))
        if stream.over:
            return Over(MotionOutcome.ENDED, Reason.VERDICT_EXPIRED)
        if stream.ended_ms is None:
            return None
        if state.still:
            return Over(MotionOutcome.ENDED)
        late = self._clock.monotonic_ms() - stream.ended_ms > ESCALATE_MS
        return Over(MotionOutcome.ENDED, Reason.VERDICT_EXPIRED) if late else None


def envelope(request: Request, chain: Chain, grant: Grant) -> dict[str, object]:
    """Envelope of a stream as plain JSON: the limits of every value. The decision about its opening has the index."""
    return {
        "request_id": request.request_id,
        "object": request.object,
        "operation": request.operation,
        "agent": chain.leaf.agent,
        "limits": [
            [limit.parameter.name, str(limit.parameter.unit), bound_to_json(limit.bound)] for limit in grant.limits
        ],
        "lasts_ms": LASTS_MS,
    }


@dataclass(frozen=True, slots=True)
class _Form:
    """Common part of a stream's first command and all that follow it.

    Attributes:
        rest: parameters after the six angles or speeds.
        value: makes the value for physics from those six; a reason where there is none.
        stands_ms: time for which a value stands; None for ever: a servo target ends by itself.
        lasts_ms: longest time for all values together; None where the command says none.
    """

    rest: tuple[float, ...]
    value: Callable[[Six], Value | Reason]
    stands_ms: int | None
    lasts_ms: int | None = None

    @classmethod
    def of(cls, command: Command, numbers: tuple[float, ...]) -> _Form:
        """The form of a stream's command, whose parameters are these."""
        rest = numbers[_SIX:]
        match command:
            case v.ServoJ(_, time_s, lookahead_s, _):
                return cls(rest, lambda q_rad: JointAngles(q_rad, time_s, lookahead_s), None)
            case v.SpeedJ(_, acceleration_rad_s2, time_s):
                stands_ms = round(stands_s(time_s) * Unit.MILLISECOND.per_si)
                return cls(rest, lambda qd_rad_s: JointSpeeds(qd_rad_s, acceleration_rad_s2), stands_ms)
            case v.ForceMode():
                speeds, (lasts_s, far_m) = rest[6:12], rest[12:]
                return cls(rest, lambda frame: LedTool(frame, speeds, far_m), None, _ms(lasts_s))
            case v.FreedriveMode() | v.TeachMode():
                tool_m_s, joint_rad_s, lasts_s, far_m = rest
                return cls(rest, lambda _: LedArm(tool_m_s, joint_rad_s, far_m), None, _ms(lasts_s))
            case _:
                raise AssertionError(f"{type(command).__name__} is no stream")


def _ms(seconds: float) -> int:
    return round(seconds * Unit.MILLISECOND.per_si)


def _reason(fault: ImpactFault) -> Reason:
    try:
        return Reason(fault.reason)
    except ValueError:
        return Reason.PHYSICS_FAULT
