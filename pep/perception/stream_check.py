"""A look at one sensor's live frames: rate, gaps, age, ids, jumps and units, each fault with its numbers.

The frames are judged as a gateway judges them, by the same receiver; nothing is decided on them here.
"""

from __future__ import annotations

import asyncio
import math
import statistics
from collections import Counter
from dataclasses import dataclass, field
from enum import StrEnum
from itertools import pairwise
from typing import TYPE_CHECKING, Any, Final

from capabilities.statements import observation, statement_form
from capabilities.statements.observation import REACH_UM, Sphere
from capabilities.values.errors import CapabilityError
from capabilities.values.units import Unit, si
from pep.perception.sensor_frames import Frames, SensorFrame

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping, Sequence

    from capabilities.statements.observation import Capsule, ObservedPerson
    from capabilities.values.caps import Caps
    from pep.base.ports import Clock, RegisteredSensor
    from pep.perception.sensor_frames import RejectedFrame

VIEW_MS: Final = 150
"""Oldest view, transit included, that a moving arm goes on by (docs/physics.md PHY-2)."""
SLOW: Final = 0.9
"""Least share of the stated rate. Ours."""
UNEVEN: Final = 1.5
"""Largest ratio of a gap that one in twenty is beyond to the middle one. Ours."""
JUMP_M: Final = 0.5
JUMP_M_S: Final = 5.0
"""Nobody goes farther between two frames: half a metre, and a sprint of 5 m/s. Ours."""
TALL_M: Final = (0.3, 5.0)
"""Least and greatest extent of a person in metres, assumed parts included. Ours."""
CELL_M: Final = 30.0
"""Farthest place in a cell. Ours."""
CHURN: Final = 3
"""Most ids for each person who is seen at once. Ours."""
AHEAD_MS: Final = 20
"""Most that a sensor's clock may be ahead, unnoticed. Ours."""


class StreamFault(StrEnum):
    """Faults of a sensor's stream of frames, beside those of a single frame."""

    FRAMES_NONE = "FRAMES_NONE"
    FRAMES_SLOW = "FRAMES_SLOW"
    FRAMES_GAPS = "FRAMES_GAPS"
    FRAMES_JITTER = "FRAMES_JITTER"
    FRAMES_LOST = "FRAMES_LOST"
    FRAMES_LATE = "FRAMES_LATE"
    PEOPLE_JUMP = "PEOPLE_JUMP"
    IDS_CHANGE = "IDS_CHANGE"
    NOT_METRES = "NOT_METRES"


@dataclass(frozen=True, slots=True)
class StreamFinding:
    """One fault: its code, of `StreamFault` or of `FrameFault`, and the numbers."""

    code: str
    detail: str


@dataclass(frozen=True, slots=True)
class StreamReport:
    """A stream in numbers.

    Attributes:
        frames: believed ones; rejected: the others.
        rate_hz: of the believed ones, from the first to the last.
        gap_ms: middle gap between arrivals; longest_ms: the longest one.
        age_ms: middle age at arrival, by both clocks: below 0 the sensor's is ahead.
        people, objects: most at once.
        ids: different people.
        findings: what is wrong, the worst for the arm first.
    """

    frames: int
    rejected: int
    rate_hz: float
    gap_ms: int
    longest_ms: int
    age_ms: int
    people: int
    objects: int
    ids: int
    findings: tuple[StreamFinding, ...]


@dataclass
class _Kept:
    """Of one believed frame: arrival, capture, number, boot, people's places and extents."""

    arrived_ms: int
    captured_ms: int
    age_ms: float
    sequence: int
    boot_id: str
    objects: int
    people: dict[str, tuple[float, float]] = field(default_factory=dict)
    odd: str = ""


class StreamCheck(Frames):
    """Judge of one sensor's frames that keeps what tells how good the stream is.

    Args:
        sensor: as it is registered, or will be.
        clock: as of `Frames`.
        caps: as of `Frames`.
    """

    def __init__(self, sensor: RegisteredSensor, *, clock: Clock, caps: Caps) -> None:
        super().__init__(sensors=_Only(sensor), named=frozenset({sensor.sensor}), clock=clock, caps=caps)
        self._sensor = sensor
        self._wall = clock
        self._checked_caps = caps
        self._kept: list[_Kept] = []
        self._refused: Counter[tuple[str, str]] = Counter()
        self._odd = ""
        self.begun = asyncio.Event()
        """Set at the first frame, believed or not."""

    def admit(self, text: bytes) -> SensorFrame | RejectedFrame:
        """The verdict of `Frames.admit`, kept."""
        verdict = super().admit(text)
        self.begun.set()
        if isinstance(verdict, SensorFrame):
            self._kept.append(_kept(verdict, self._wall.wall_s()))
        else:
            self._refused[str(verdict.fault), verdict.detail] += 1
            self._odd = self._odd or self._beyond(text)
        return verdict

    def report(self, *, stated_hz: float) -> StreamReport:
        """Everything so far.

        Args:
            stated_hz: frames a second that the sensor is to send.
        """
        kept = self._kept
        gaps = [b.arrived_ms - a.arrived_ms for a, b in pairwise(kept)]
        lasted_ms = kept[-1].arrived_ms - kept[0].arrived_ms if kept else 0
        rate_hz = 1000 * len(gaps) / lasted_ms if lasted_ms else 0.0
        most = max((len(one.people) for one in kept), default=0)
        ids = {name for one in kept for name in one.people}
        findings = [*self._refusals(), *self._findings(gaps, rate_hz, stated_hz)]
        if len(ids) > CHURN * max(1, most):
            findings.append(StreamFinding(StreamFault.IDS_CHANGE, f"{len(ids)} ids for at most {most} at once"))
        return StreamReport(
            frames=len(kept),
            rejected=sum(self._refused.values()),
            rate_hz=round(rate_hz, 1),
            gap_ms=round(statistics.median(gaps)) if gaps else 0,
            longest_ms=max(gaps, default=0),
            age_ms=round(statistics.median(one.age_ms for one in kept)) if kept else 0,
            people=most,
            objects=max((one.objects for one in kept), default=0),
            ids=len(ids),
            findings=tuple(findings),
        )

    def _refusals(self) -> Iterator[StreamFinding]:
        if self._odd:
            yield StreamFinding(StreamFault.NOT_METRES, self._odd)
        for (fault, detail), count in self._refused.most_common():
            yield StreamFinding(fault, f"{count} frames{f': {detail}' if detail else ''}")

    def _findings(self, gaps: Sequence[int], rate_hz: float, stated_hz: float) -> Iterator[StreamFinding]:
        kept = self._kept
        if not gaps:
            yield StreamFinding(StreamFault.FRAMES_NONE, f"{len(kept)} believed")
            return
        odd = next((one.odd for one in kept if one.odd), "")
        if odd and not self._odd:
            yield StreamFinding(StreamFault.NOT_METRES, odd)
        allowed_ms = VIEW_MS - self._sensor.transit_ms
        long = [gap for gap in gaps if gap > allowed_ms]
        if long:
            yield StreamFinding(
                StreamFault.FRAMES_GAPS, f"{len(long)} over {allowed_ms} ms, the longest {max(long)} ms"
            )
        if rate_hz < SLOW * stated_hz:
            yield StreamFinding(StreamFault.FRAMES_SLOW, f"{rate_hz:.1f} a second, {stated_hz:g} stated")
        middle, uneven = statistics.median(gaps), sorted(gaps)[math.ceil(0.95 * len(gaps)) - 1]
        if uneven > UNEVEN * max(1, middle) + 2:  # both clocks are read to the millisecond
            yield StreamFinding(
                StreamFault.FRAMES_JITTER, f"one gap in twenty is {uneven} ms or more, the middle one {middle:.0f} ms"
            )
        lost = sum(b.sequence - a.sequence - 1 for a, b in pairwise(kept) if a.boot_id == b.boot_id)
        if lost > sum(self._refused.values()):
            yield StreamFinding(StreamFault.FRAMES_LOST, f"{lost} numbers are missing")
        age_ms = statistics.median(one.age_ms for one in kept)
        if not -AHEAD_MS <= age_ms <= self._sensor.transit_ms:
            yield StreamFinding(
                StreamFault.FRAMES_LATE, f"{age_ms:.0f} ms old at arrival, {self._sensor.transit_ms} ms declared"
            )
        jumps = [each for a, b in pairwise(kept) for each in _jumps(a, b)]
        if jumps:
            yield StreamFinding(StreamFault.PEOPLE_JUMP, f"{len(jumps)} times, the farthest {max(jumps):.2f} m")

    def _beyond(self, text: bytes) -> str:
        """Place of the largest coordinate of a frame that is signed well and tells of places that no frame has."""
        try:
            claims = statement_form.open(
                observation.KIND, text.decode("ascii"), frozenset({self._sensor.key}), self._checked_caps
            )
        except (CapabilityError, UnicodeDecodeError):
            return ""
        seen = {name: claims[name] for name in ("people", "objects") if name in claims}
        far = max(map(abs, _micrometres(seen)), default=0)
        if far <= REACH_UM:
            return ""
        return f"a coordinate of {si(far, Unit.MICROMETRE):g} m: {si(far, Unit.MICROMETRE) / 1000:g} m in millimetres?"


class _Only:
    """Registry of one sensor."""

    def __init__(self, sensor: RegisteredSensor) -> None:
        self._sensor = sensor

    def sensors(self) -> Mapping[str, RegisteredSensor]:
        """The one."""
        return {self._sensor.sensor: self._sensor}


def _kept(frame: SensorFrame, wall_s: float) -> _Kept:
    seen = frame.observation
    people = {person.id: _place(person) for person in seen.people}
    odd = next((fault for person in seen.people if (fault := _odd_person(person))), "")
    far_m = max((math.hypot(*at) for at in people.values()), default=0.0)
    if not odd and far_m > CELL_M:
        odd = f"somebody is {far_m:g} m away"
    return _Kept(
        frame.arrived_ms, seen.captured_ms, wall_s * 1000 - seen.captured_ms, seen.sequence, seen.boot_id,
        len(seen.objects), people, odd,
    )  # fmt: skip


def _place(person: ObservedPerson) -> tuple[float, float]:
    lows, highs = zip(*(_ends(shape) for _, shape in person.regions), strict=True)
    x, y = (si(min(p[d] for p in lows) + max(p[d] for p in highs), Unit.MICROMETRE) / 2 for d in (0, 1))
    return x, y


def _odd_person(person: ObservedPerson) -> str:
    """Extent of a person that nobody has, or ""."""
    lows, highs = zip(*(_ends(shape) for _, shape in person.regions), strict=True)
    extent_m = max(si(max(p[d] for p in highs) - min(p[d] for p in lows), Unit.MICROMETRE) for d in range(3))
    if TALL_M[0] <= extent_m <= TALL_M[1]:
        return ""
    return f"{person.id[:64]} has an extent of {extent_m:g} m"


def _ends(shape: Capsule | Sphere) -> tuple[tuple[int, ...], tuple[int, ...]]:
    """Least and greatest coordinates of a body region, in micrometres."""
    points = (shape.center_um,) if isinstance(shape, Sphere) else (shape.a_um, shape.b_um)
    lows, highs = ([pick(axis) for axis in zip(*points, strict=True)] for pick in (min, max))
    return tuple(low - shape.radius_um for low in lows), tuple(high + shape.radius_um for high in highs)


def _jumps(before: _Kept, after: _Kept) -> Iterator[float]:
    """Distances, in metres, of those who are further on than a person goes in that time."""
    passed_s = max(0, after.captured_ms - before.captured_ms) / 1000
    for name in before.people.keys() & after.people.keys():
        gone_m = math.dist(before.people[name], after.people[name])
        if gone_m > JUMP_M + JUMP_M_S * passed_s:
            yield gone_m


def _micrometres(value: Any, name: str = "") -> Iterator[int]:
    """Whole numbers of members in micrometres, at any depth."""
    if isinstance(value, dict):
        for key, each in value.items():
            yield from _micrometres(each, key)
    elif isinstance(value, list):
        for each in value:
            yield from _micrometres(each, name)
    elif isinstance(value, int) and not isinstance(value, bool) and name.endswith("_um"):
        yield value
