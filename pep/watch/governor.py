"""Governor of one motion: slows it while slower suffices, checks that it slowed, and restores its speed later.

It sets the controller's speed slider and believes only the robot's later word on its speed. Until that word comes the
arm counts as fast as before. Where the word does not come in time, or changes for the worse later, the motion has to be
stopped. Time and the slider are arguments; nothing here waits.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final, Protocol

if TYPE_CHECKING:
    from pep.pit import CellParameters

FULL: Final = 1.0
MARGIN: Final = 1e-3
"""Ours: distance of the slider below the proven speed, so that rounding in the controller never exceeds it."""
MS: Final = 1000


class Slider(Protocol):
    """The controller's speed slider."""

    def set(self, fraction: float) -> None:
        """Begins to set the slider to this fraction; never waits. A later call supersedes an earlier one."""
        ...

    @property
    def failed(self) -> bool:
        """True where the controller did not take the newest setting."""
        ...


@dataclass(frozen=True, slots=True)
class ReportedSpeeds:
    """The robot's word on its speed, as fractions of the commanded one.

    Attributes:
        slider: position of its speed slider (`target_speed_fraction`).
        scaling: actual fraction of the commanded speed (`speed_scaling`).
        heard_ms: monotonic time at which the package was heard.
    """

    slider: float
    scaling: float
    heard_ms: int

    @property
    def fastest(self) -> float:
        """Fastest speed of the arm, now or by itself later; anything but a number counts as full speed."""
        both = (self.slider, self.scaling)
        return max(both) if all(0.0 <= each <= FULL for each in both) else FULL


@dataclass(frozen=True, slots=True)
class Offer:
    """Speeds that a judgement of the rest of a motion allows.

    Attributes:
        holds: the rest of the motion is inside the authorised index, at the speed in question.
        fraction: the highest speed at which it would be, or None.
        index_milli: of what is left, or None.
        cause: cause against it, "" when it holds.
    """

    holds: bool
    fraction: float | None
    index_milli: int | None
    cause: str


@dataclass(frozen=True, slots=True)
class Change:
    """One change of speed, for the record and for the caller.

    Attributes:
        at_ms: monotonic time at which it was asked for.
        after_ms: the same, since the motion began.
        fraction: of the commanded speed, from then on.
        cause: cause of the change; "clear" when there is none any more, "ended" after the motion.
        index_milli: of what was left at the speed before, or None.
        confirmed_ms: monotonic time at which the robot said so, or None when it never did.
    """

    at_ms: int
    after_ms: int
    fraction: float
    cause: str
    index_milli: int | None
    confirmed_ms: int | None = None

    def told(self) -> dict[str, object]:
        """The change as plain JSON."""
        return {
            "t_ms": self.at_ms,
            "after_ms": self.after_ms,
            "percent": round(100 * self.fraction),
            "cause": self.cause,
            "index_milli": self.index_milli,
            "t_confirmed_ms": self.confirmed_ms,
        }


@dataclass(frozen=True, slots=True)
class Pacing:
    """Slowing down and going on, as a cell is set up for it (docs/physics.md, PHY-50).

    Attributes:
        delay_ms, change_ms: slowing down from a fraction r is seen after `delay_ms` + r * `change_ms` at the latest.
        slowest: fraction of the commanded speed below which a motion is stopped.
        dwell_ms: time for which a higher speed has to hold before it is taken up.
        gain: by how much it has to be higher; full speed always is.
    """

    delay_ms: float
    change_ms: float
    slowest: float
    dwell_ms: float
    gain: float

    @staticmethod
    def of(cell: CellParameters) -> Pacing:
        """The numbers of the cell."""
        return Pacing(
            delay_ms=cell.slider_delay_s * MS,
            change_ms=MS / cell.slider_change_per_s,
            slowest=cell.slowest_fraction,
            dwell_ms=cell.restore_dwell_s * MS,
            gain=cell.restore_gain,
        )

    def due_ms(self, heard_ms: int, running: float) -> int:
        """Time by which the robot must be seen slower, when it was heard at that speed at that time."""
        return int(heard_ms + self.delay_ms + running * self.change_ms)


class Governor:
    """Governor of the speed of one motion.

    Args:
        slider: of the controller; this motion's alone while it lasts.
        pacing: of the cell.
        least: fraction of this motion's speed below which it could not be told from standstill.
        speeds: reported speeds before the motion begins. Its slider is put back to that position.
        now_ms: monotonic time.

    Attributes:
        changes: of the speed, in order.
    """

    def __init__(self, slider: Slider, *, pacing: Pacing, least: float, speeds: ReportedSpeeds, now_ms: int) -> None:
        self.changes: list[Change] = []
        self._slider = slider
        self._pacing = pacing
        self._least = max(least, pacing.slowest)
        self._base = speeds.slider if 0.0 <= speeds.slider <= FULL else FULL
        self._speeds = speeds
        self._began_ms = now_ms
        self._ordered = FULL
        self._set = self._base
        self._before = FULL
        self._lowest = FULL
        self._due_ms: int | None = None
        self._better: tuple[float, int] | None = None

    @property
    def running(self) -> float:
        """The highest fraction of the commanded speed that the arm can have.

        Full speed, unless the slider was set here: a person may push it up on the pendant at any time before.
        """
        if self._ordered >= FULL:
            return FULL
        if self._due_ms is None:
            return self._ordered
        return min(self._before, max(self._ordered, self._speeds.fastest))

    @property
    def heard_ms(self) -> int:
        """Monotonic time at which the robot was heard last."""
        return self._speeds.heard_ms

    @property
    def ordered(self) -> float:
        """The fraction that was ordered last."""
        return self._ordered

    def hear(self, speeds: ReportedSpeeds, *, now_ms: int) -> str:
        """Takes in the robot's word; the reason to stop the motion, or "" when it goes as it should.

        Args:
            speeds: the newest.
            now_ms: monotonic time.
        """
        self._speeds = speeds
        if self._ordered >= FULL:
            self._confirm_rise(now_ms)
            return ""
        if self._slider.failed:
            return f"the slider was not set to {self._ordered:.0%}"
        fastest = speeds.fastest
        if self._due_ms is None:
            self._confirm_rise(now_ms)
            return "" if fastest <= self._ordered else f"faster than {self._ordered:.0%}"
        if fastest <= self._ordered:
            self._due_ms = None
            self.changes[-1] = replace(self.changes[-1], confirmed_ms=now_ms)
            return ""
        if now_ms > self._due_ms:
            return f"not slowed to {self._ordered:.0%} in time"
        # On its way down it only gets slower; otherwise another program sets the slider.
        if fastest > self._lowest + MARGIN:
            return f"faster on the way to {self._ordered:.0%}"
        self._lowest = min(self._lowest, fastest)
        return ""

    def take(self, offer: Offer, *, running: float, heard_ms: int, now_ms: int) -> bool:
        """True where the motion goes on, at the offered speed; sets the slider where that is another one.

        Args:
            offer: of a judgement.
            running: the speed that it was asked about.
            heard_ms: time at which the robot was heard in the judged place.
            now_ms: monotonic time.
        """
        if offer.holds:
            self._consider(offer, running=running, now_ms=now_ms)
            return True
        self._better = None
        if offer.fraction is None or not offer.fraction >= self._least:
            return False
        due_ms = self._pacing.due_ms(heard_ms, running)
        if offer.fraction < self._ordered:
            self._before = self._lowest = self.running
            self._order(offer.fraction, offer.cause, offer.index_milli, now_ms)
            self._due_ms = due_ms if self._due_ms is None else min(self._due_ms, due_ms)
        elif self._due_ms is not None:
            # What was asked for before is slow enough, when it comes as early as this judgement counts on.
            self._due_ms = min(self._due_ms, due_ms)
        return True

    def end(self, *, now_ms: int) -> bool:
        """Begins to put the slider back, after the motion and at rest; true where it had been moved."""
        if not self.changes:
            return False
        self._ordered, self._due_ms, self._set = FULL, None, self._base
        self._slider.set(self._set)
        self.changes.append(self._change(FULL, "ended", None, now_ms))
        return True

    def _confirm_rise(self, now_ms: int) -> None:
        """Marks a higher speed as taken up once the slider is seen where it was set."""
        if self.changes and self.changes[-1].confirmed_ms is None and self._at(self._set):
            self.changes[-1] = replace(self.changes[-1], confirmed_ms=now_ms)

    def _at(self, fraction: float) -> bool:
        return abs(self._speeds.slider - fraction) <= MARGIN

    def put_back(self, speeds: ReportedSpeeds, *, now_ms: int) -> bool:
        """True where, after `end`, the robot reports its slider back where it was."""
        self._speeds = speeds
        self._confirm_rise(now_ms)
        return self._at(self._base)

    def _consider(self, offer: Offer, *, running: float, now_ms: int) -> None:
        """Takes up a higher speed that was offered for long enough: the lowest of those offers."""
        if self._ordered >= FULL or self._due_ms is not None or running < self._ordered:
            return
        offered = offer.fraction
        if offered is None or not (offered >= FULL or offered >= self._ordered + self._pacing.gain):
            self._better = None
            return
        lowest, since_ms = self._better or (FULL, now_ms)
        lowest = min(lowest, offered)
        self._better = lowest, since_ms
        if now_ms - since_ms >= self._pacing.dwell_ms:
            self._better = None
            self._order(lowest, "clear", offer.index_milli, now_ms)

    def _order(self, fraction: float, cause: str, index_milli: int | None, now_ms: int) -> None:
        """Orders this fraction at most, and never more than the slider's first position."""
        self._ordered = fraction
        self._set = self._base if fraction >= FULL else max(0.0, min(fraction - MARGIN, self._base))
        self._slider.set(self._set)
        self.changes.append(self._change(fraction, cause, index_milli, now_ms))

    def _change(self, fraction: float, cause: str, index_milli: int | None, now_ms: int) -> Change:
        return Change(now_ms, now_ms - self._began_ms, fraction, cause, index_milli)
