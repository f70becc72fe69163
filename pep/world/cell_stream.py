"""A stream of joint targets or speeds in the cell: shown each view, asked about each value."""

from __future__ import annotations

import threading
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final, TypeAlias, assert_never

from pep.base.stop_model import patience_s
from pep.perception.sensor_frames import Seen
from pep.pit import Bounded, SceneError, ServoJ, SpeedJ, Stream
from pep.pit.assessment.assessment import milli
from pep.pit.assessment.led_motion import JointRates, Led, LedArm, LedTool, floor_milli, led_age, led_cell, led_scene
from pep.pit.base.errors import UnprovenError
from pep.pit.search.speed_envelope import moves_with
from pep.world.world import sight_of
from policies.evidence.evidence import ImpactFault
from policies.words.reason_table import Reason

if TYPE_CHECKING:
    from collections.abc import Sequence

    from pep.base.ports import Clock
    from pep.perception.sensor_frames import Frames
    from pep.pit import CellParameters
    from pep.pit.base.motion import Floats, Joints
    from pep.rtde.robot.state_receiver import JointState
    from pep.world.held_object import CommittedGrip

STEP_S: Final = 0.04
"""Ours: longest time for the whole question about one value.

The caller's event loop waits for it meanwhile.
"""
AGAIN_S: Final = 0.15
"""Longest time before a standing value is judged again: each 100 ms, and the judgement's own time (`pep.watch.watch`).
"""
SPEED_LOOKAHEAD_S: Final = 0.03
"""PHY-20: lookahead within which a servo target makes for exactly the speeds that lead to it."""


@dataclass(frozen=True, slots=True)
class JointAngles:
    """Joint angles to follow, rad, within `lookahead_s`; the next are due after `period_s`."""

    q_rad: tuple[float, ...]
    period_s: float
    lookahead_s: float


@dataclass(frozen=True, slots=True)
class JointSpeeds:
    """Joint speeds to take up and keep until ended, rad/s; the leading axis at an acceleration, rad/s2."""

    qd_rad_s: tuple[float, ...]
    acceleration_rad_s2: float


Value: TypeAlias = JointAngles | JointSpeeds | Led


@dataclass(frozen=True, slots=True)
class Judged:
    """Judgement of one value, with all motion that it allows until the arm stands.

    Attributes:
        index_milli: proven upper bound of its index, thousandths.
        violations: kinds that no authority allows.
        tcp_speed_m_s: proven bound on the speed of the tool centre point.
        contact_ratio: proven bound on speed by limit speed of any body region that could be met.
    """

    index_milli: int
    violations: tuple[str, ...]
    tcp_speed_m_s: float
    contact_ratio: float


@dataclass(frozen=True, slots=True)
class Shown:
    """View that was shown to the stream: its age in ms, and its content; both None when there is none."""

    age_ms: int | None
    content: object


class CellStream:
    """One stream. Any thread: one value or view at a time.

    Args:
        holding: the arm with what it holds now; with another part it is another stream.
        cell: its parameters and surveyed objects.
        frames: the believed perception.
        touch: objects that the token grants to touch.
        clock: the monotonic one counts.
        led: how a force or a hand leads the arm, at most; None for any other stream.
    """

    def __init__(
        self,
        *,
        holding: CommittedGrip,
        cell: CellParameters,
        frames: Frames,
        touch: frozenset[str],
        clock: Clock,
        led: Led | None = None,
    ) -> None:
        self._holding = holding
        self._led_by = led
        self._rates: JointRates | None = None
        self._begun: Floats | None = None  # tool point at which a led motion began
        self._robot = holding.robot
        cell = led_cell(cell, led)
        self._cell = cell = replace(cell, time_limit_s=min(cell.time_limit_s, STEP_S))
        self._frames = frames
        self._lock = threading.Lock()
        by_hand = isinstance(led, LedArm)

        def now_s() -> float:
            # A view that nobody in it makes older does not age; a late answer is the caller's affair (`AGAIN_MS`).
            return 0.0 if by_hand else clock.monotonic_ms() / 1000

        self._stream = Stream(self._robot, cell, touch=touch, clock=now_s)

    def see(self, q_rad: Sequence[float]) -> Shown | ImpactFault:
        """Takes the newest view as the one from the next value on. Milliseconds.

        Args:
            q_rad: measured joint angles, six.
        """
        look = self._frames.look()
        try:
            sight = sight_of(look, self._cell)
        except SceneError as error:
            sight = ImpactFault(Reason.PERCEPTION_INVALID, error.detail)
        if isinstance(sight, ImpactFault):
            return sight
        at: Joints = tuple(q_rad)  # type: ignore[assignment]  # six, counted where they were read
        scene = led_scene(sight.scene) if isinstance(self._led_by, LedArm) else sight.scene
        self._stream.see(scene, age_s=led_age(sight.age_s, self._cell, self._led_by), at_rad=at)
        view = look.view()
        return Shown(look.age_ms(look.taken_ms), view.content if isinstance(view, Seen) else None)

    def judge(self, value: Value, state: JointState, *, authorised_milli: int, seed: bytes) -> Judged | ImpactFault:
        """Judges the motion that a value allows from the arm's present state. Microseconds where the bound settles it.

        A question that is not answered within `STEP_S` is a fault.

        Joint speeds that the arm takes up, or goes on with, are a stream of speeds (PHY-51). Other ones are judged as
        the servo target that makes for them: each joint goes at a speed between the measured one and that which is
        asked, however the others do. Nobody need end either at once: they go on until they are judged again, and for
        the patience that the controller has with a host that says nothing more.

        Args:
            value: that would be sent.
            state: measured now.
            authorised_milli: index that was authorised, thousandths.
            seed: digest of the request, for the whole question.
        """
        if self._holding.robot is not self._robot:
            return ImpactFault(Reason.PHYSICS_FAULT, "the arm holds another part than when the stream began")
        rates: JointRates | None = None
        if isinstance(value, LedTool | LedArm):
            try:
                rates = self._led(value, state)
            except UnprovenError as error:
                return ImpactFault(error.reason, error.detail)
            motion: ServoJ | SpeedJ = rates.envelope(self._cell)
        else:
            motion = _motion(value, state, self._cell)
        with self._lock:  # one question at a time; a new view needs no lock
            found = self._stream.step(motion, authorised_milli=authorised_milli, seed=seed)
        if isinstance(found, ImpactFault):
            return found
        violations = () if isinstance(found, Bounded) else found.violations
        if rates is not None:
            index_milli = max(milli(found.index), floor_milli(value))  # type: ignore[arg-type]  # it has rates
            return Judged(index_milli, violations, rates.tool_speed(found.tcp_speed_m_s), found.contact_ratio)
        return Judged(milli(found.index), violations, found.tcp_speed_m_s, found.contact_ratio)

    def strays(self, state: JointState) -> str:
        """Quantity of a led motion that is above its bound in this state, as a word; "" for none."""
        rates, begun = self._rates, self._begun
        if rates is None or begun is None:
            return ""
        return rates.exceeded(state, begun, stop_s=self._cell.stop_delay_s)

    def _led(self, value: Led, state: JointState) -> JointRates:
        rates = JointRates.of(value, self._robot, state.q_rad)
        if self._begun is None:
            self._begun = rates.position
        self._rates = rates
        return rates


def _motion(value: JointAngles | JointSpeeds, state: JointState, cell: CellParameters) -> ServoJ | SpeedJ:
    start, now = state.q_rad, state.qd_rad_s
    match value:
        case JointAngles(q_rad, period_s, lookahead_s):
            return ServoJ(start, now, q_rad, period_s, lookahead_s)  # type: ignore[arg-type]  # six, counted where they were read
        case JointSpeeds(qd_rad_s, acceleration_rad_s2):
            held = SpeedJ(start, qd_rad_s, acceleration_rad_s2, AGAIN_S)  # type: ignore[arg-type]
            if moves_with(held, now):
                return held
            target = tuple(q + qd * SPEED_LOOKAHEAD_S for q, qd in zip(start, qd_rad_s, strict=True))
            lasts_s = AGAIN_S + patience_s(cell.stop_deceleration_rad_s2)
            return ServoJ(start, now, target, lasts_s, SPEED_LOOKAHEAD_S)  # type: ignore[arg-type]
        case _:
            assert_never(value)
