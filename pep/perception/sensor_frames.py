"""Frames that may describe the world: signed by a calibrated sensor of the cell, newer than all before, in time.

A sensor of the cell is one that the signed cell file names and the signed registry knows; any other is a stranger.

A frame that fails is an incident. As long as it is the newest of its sensor the world is distrusted: a forged frame
must not let the frame before it count a little longer.
"""

from __future__ import annotations

import base64
import json
import math
import threading
from collections import OrderedDict
from dataclasses import dataclass, replace
from enum import StrEnum
from typing import TYPE_CHECKING, Final, TypeAlias

from capabilities.statements import observation
from capabilities.statements.observation import FRAME_BYTES
from capabilities.values.errors import CapabilityError
from pep.perception.consistency import contradicted
from policies.evidence.evidence import PerceptionReading, SensorReading

if TYPE_CHECKING:
    from collections.abc import Mapping

    from capabilities.statements.observation import Observation
    from capabilities.values.caps import Caps
    from pep.base.ports import Clock, RegisteredSensor, Sensors

BOOTS_KEPT: Final = 64
"""Earlier boots of a sensor that are remembered; an older one is out of time anyway."""
SKEW_MS: Final = 1_000
"""Greatest difference between the clocks of one cell. Ours.

A frame captured longer ago, or ahead, is a recording and no view.
"""
NOBODY: Final = ""
"""The source of frames that name no sensor of the cell."""


class FrameFault(StrEnum):
    """Reason why a frame is not believed."""

    TOO_LARGE = "TOO_LARGE"
    MALFORMED = "MALFORMED"
    UNKNOWN_SENSOR = "UNKNOWN_SENSOR"
    UNTRUSTED = "UNTRUSTED"
    WRONG_SENSOR = "WRONG_SENSOR"
    WRONG_CALIBRATION = "WRONG_CALIBRATION"
    NOT_NEWER = "NOT_NEWER"
    OUT_OF_TIME = "OUT_OF_TIME"
    TOO_MANY_SENDERS = "TOO_MANY_SENDERS"
    """Nothing was read: more senders than a cell has sensors."""
    CONTRADICTED = "CONTRADICTED"
    """The frame is believed, since it adds to the others.

    That another sensor does not see the same is an incident.
    """


@dataclass(frozen=True, slots=True)
class SensorFrame:
    """A believed frame.

    Attributes:
        observation: the signed observation.
        arrived_ms: monotonic time of arrival.
        transit_ms: counted as age on arrival: the declared longest transit, or more by its sender's clock.
        judged_as: the registration it was judged by. Once the registry says something else, nobody vouches for it.
    """

    observation: Observation
    arrived_ms: int
    transit_ms: int
    judged_as: RegisteredSensor

    def age_ms(self, now_ms: int) -> int:
        """Milliseconds since exposure, transit included, at the monotonic time `now_ms`."""
        return now_ms - self.arrived_ms + self.transit_ms

    def sighting_age_ms(self, now_ms: int) -> int:
        """Milliseconds since the oldest sighting of the frame, transit included, at the monotonic time `now_ms`."""
        seen = self.observation
        late_ms = [person.age_ms for person in seen.people] + [thing.age_ms for thing in seen.objects]
        return self.age_ms(now_ms) + max(late_ms, default=0)


@dataclass(frozen=True, slots=True)
class RejectedFrame:
    """Frame that is not believed. `sensor` is its claimed sensor, or "" when none can be told."""

    fault: FrameFault
    sensor: str
    detail: str = ""


@dataclass(frozen=True, slots=True)
class Seen:
    """View that the sensors of the cell show.

    Attributes:
        frames: the newest believed one of each sensor that was heard.
        age_ms: of the oldest of them.
        silent: sensors of which there is none; while there are any, the view is not complete.
    """

    frames: tuple[SensorFrame, ...]
    age_ms: int
    silent: tuple[str, ...] = ()

    @property
    def complete(self) -> bool:
        """True where every sensor was heard, and each covers all of its field."""
        return not self.silent and all(frame.observation.complete for frame in self.frames)

    @property
    def content(self) -> object:
        """Content of the view for comparison: equal contents are the same scene, at any two times."""
        seen = (frame.observation for frame in self.frames)
        return self.complete, tuple((o.sensor, o.people, o.objects) for o in seen)


@dataclass(frozen=True, slots=True)
class Unseen:
    """No view: the cell has no sensor, or none of them was heard."""


@dataclass(frozen=True, slots=True)
class Distrusted:
    """No view: the newest frame of a sensor must not be believed."""

    rejected: RejectedFrame


View: TypeAlias = Seen | Unseen | Distrusted


@dataclass(frozen=True, slots=True)
class SensorStatus:
    """One sensor at one instant: its newest believed frame, and a newer rejected one, if any."""

    sensor: str
    frame: SensorFrame | None
    rejected: RejectedFrame | None

    def no_older(self, oldest_ms: int, now_ms: int) -> SensorStatus:
        """The same, silent where its frame is older than that at the monotonic time `now_ms`."""
        if self.frame is None or self.frame.age_ms(now_ms) <= oldest_ms:
            return self
        return replace(self, frame=None)


@dataclass(frozen=True, slots=True)
class Look:
    """One look at all sensors of the cell, for physics and for the record alike.

    Attributes:
        heard: in the order of their ids; first, under "", what strangers last sent, if no good frame came since.
        taken_ms: monotonic time.
    """

    heard: tuple[SensorStatus, ...]
    taken_ms: int

    def age_ms(self, now_ms: int) -> int | None:
        """The oldest frame's age at `now_ms`, or None when there is no frame."""
        return max((one.frame.age_ms(now_ms) for one in self.heard if one.frame is not None), default=None)

    def sighting_age_ms(self, now_ms: int) -> int | None:
        """Age at `now_ms` of the oldest sighting in all frames, or None when there is no frame."""
        return max((one.frame.sighting_age_ms(now_ms) for one in self.heard if one.frame is not None), default=None)

    def view(self) -> View:
        """View of the world, as it may be believed."""
        for one in self.heard:
            if one.rejected is not None:
                return Distrusted(one.rejected)
        frames = tuple(one.frame for one in self.heard if one.frame is not None)
        age_ms = self.age_ms(self.taken_ms)
        if age_ms is None:
            return Unseen()
        return Seen(frames, age_ms, tuple(one.sensor for one in self.heard if one.frame is None))

    def reading(self, *, now_ms: int, limit_ms: int, witnesses: tuple[SensorReading, ...] = ()) -> PerceptionReading:
        """The same view as evidence.

        Args:
            now_ms: monotonic time at which the decision uses it.
            limit_ms: a frame of a greater age is stale.
            witnesses: comparisons with independent sources (`pep.perception.consistency.witnessed`).
        """
        readings = []
        for one in self.heard:
            age_ms = None if one.frame is None else one.frame.age_ms(now_ms)
            state = "missing" if age_ms is None else "fresh" if age_ms <= limit_ms else "stale"
            fault = "" if one.rejected is None else str(one.rejected.fault)
            readings.append(SensorReading(one.sensor, "invalid" if fault else state, fault, age_ms))
        return PerceptionReading((*readings, *witnesses))


class Frames:
    """The newest frames, and whether they may be believed. Any thread.

    Args:
        sensors: registered ones, with their keys.
        named: ids of the sensors that the signed cell file names. Each of them must be heard.
        clock: ages on its monotonic, skew on its wall time.
        caps: bounds and skew.
    """

    def __init__(self, *, sensors: Sensors, named: frozenset[str], clock: Clock, caps: Caps) -> None:
        self._sensors = sensors
        self._named = named
        self._clock = clock
        self._caps = caps
        self._lock = threading.Lock()
        self._newest: dict[str, SensorFrame] = {}
        self._rejected: dict[str, RejectedFrame] = {}
        self._boots: dict[str, OrderedDict[str, None]] = {}

    def admit(self, text: bytes) -> SensorFrame | RejectedFrame:
        """Takes in the frame as the newest of its sensor, or the reason why it is not believed.

        Args:
            text: one compact JWS, without the newline.
        """
        arrived_ms = self._clock.monotonic_ms()
        with self._lock:
            verdict = self._judge(text, arrived_ms)
            if isinstance(verdict, SensorFrame):
                self._newest[verdict.observation.sensor] = verdict
                self._rejected.pop(verdict.observation.sensor, None)
                # Unsigned noise counts no longer once the next signed frame has come.
                self._rejected.pop(NOBODY, None)
            else:
                self._rejected[verdict.sensor if self.knows(verdict.sensor) else NOBODY] = verdict
            return verdict

    def reject(self, fault: FrameFault, *, sensor: str = NOBODY) -> RejectedFrame:
        """Counts a frame that could not even be read as the newest, too."""
        rejected = RejectedFrame(fault, sensor)
        with self._lock:
            self._rejected[sensor if self.knows(sensor) else NOBODY] = rejected
        return rejected

    def knows(self, sensor: str) -> bool:
        """True where the cell has a sensor of that name."""
        return sensor in self._watching()

    def look(self, *, oldest_ms: int | None = None) -> Look:
        """Look at every sensor that the cell names, now.

        Args:
            oldest_ms: a sensor whose frame is older counts as silent; None for no such limit.
        """
        registered = self._watching()
        with self._lock:
            heard = [self._heard(name, registered.get(name)) for name in sorted(self._named)]
            noise = self._rejected.get(NOBODY)
            taken_ms = self._clock.monotonic_ms()
        if oldest_ms is not None:
            heard = [one.no_older(oldest_ms, taken_ms) for one in heard]
        if noise is not None:
            heard.insert(0, SensorStatus(NOBODY, None, noise))
        return Look(tuple(heard), taken_ms)

    def view(self, *, oldest_ms: int | None = None) -> View:
        """View of the world now, as it may be believed; `oldest_ms` as of `look`."""
        return self.look(oldest_ms=oldest_ms).view()

    def contradiction(self, frame: SensorFrame) -> RejectedFrame | None:
        """Contradiction about people between `frame` and another complete and fresh frame; None for none."""
        with self._lock:
            others = [other for name, other in self._newest.items() if name != frame.observation.sensor]
        for other in others:
            apart_ms = abs(frame.arrived_ms - other.arrived_ms)
            detail = contradicted(frame.observation, other.observation, apart_ms=apart_ms)
            if detail:
                return RejectedFrame(FrameFault.CONTRADICTED, frame.observation.sensor, detail)
        return None

    def _watching(self) -> Mapping[str, RegisteredSensor]:
        """The sensors that the cell names, as far as the registry knows them."""
        return {name: sensor for name, sensor in self._sensors.sensors().items() if name in self._named}

    def _heard(self, name: str, registered: RegisteredSensor | None) -> SensorStatus:
        frame = self._newest.get(name)
        vouched = frame is not None and frame.judged_as == registered
        return SensorStatus(name, frame if vouched else None, None if registered is None else self._rejected.get(name))

    def _judge(self, text: bytes, arrived_ms: int) -> SensorFrame | RejectedFrame:
        """The numbered recipe of a frame."""
        claimed = _claimed_sensor(text)
        # 1 size, before anything is parsed
        if not len(text) <= FRAME_BYTES:
            return RejectedFrame(FrameFault.TOO_LARGE, claimed)
        try:
            compact = text.decode("ascii")
        except UnicodeDecodeError:
            return RejectedFrame(FrameFault.MALFORMED, claimed)
        # 2 the sensor is one of the cell's
        sensor = self._watching().get(claimed)
        if sensor is None:
            return RejectedFrame(FrameFault.UNKNOWN_SENSOR if claimed else FrameFault.MALFORMED, claimed)
        # 3 its own key signed it: another sensor's is as good as a stranger's
        try:
            seen = observation.open(compact, frozenset({sensor.key}), self._caps)
        except CapabilityError as error:
            return RejectedFrame(FrameFault.UNTRUSTED, claimed, str(error.code))
        return self._in_order(seen, sensor, arrived_ms)

    def _in_order(self, seen: Observation, sensor: RegisteredSensor, arrived_ms: int) -> SensorFrame | RejectedFrame:
        # 4 the verified frame names the sensor of the verifying key
        if seen.sensor != sensor.sensor:
            return RejectedFrame(FrameFault.WRONG_SENSOR, sensor.sensor)
        # 5 the calibration is the registered one
        if seen.calibration != sensor.calibration:
            return RejectedFrame(FrameFault.WRONG_CALIBRATION, sensor.sensor)
        # 6 newer than every frame before it
        if not self._newer(seen):
            return RejectedFrame(FrameFault.NOT_NEWER, sensor.sensor)
        # 7 captured about now, by its sender's clock: a recording from before our start has no predecessor here
        drift_ms = self._clock.wall_s() * 1000 - seen.captured_ms
        if not -SKEW_MS <= drift_ms <= SKEW_MS + sensor.transit_ms:
            return RejectedFrame(FrameFault.OUT_OF_TIME, sensor.sensor)
        # A frame that was held up on the way is as old as its sender's clock says, if that is more than the transit.
        return SensorFrame(seen, arrived_ms, max(sensor.transit_ms, math.ceil(drift_ms)), sensor)

    def _newer(self, seen: Observation) -> bool:
        """True where the frame follows its sensor's last one.

        Within one boot it has a higher sequence number, in a new boot a later capture.
        """
        last = self._newest.get(seen.sensor)
        if last is None:
            return True
        before = last.observation
        if seen.boot_id == before.boot_id:
            return seen.sequence > before.sequence and seen.captured_ms >= before.captured_ms
        boots = self._boots.setdefault(seen.sensor, OrderedDict())
        boots[before.boot_id] = None
        while len(boots) > BOOTS_KEPT:
            boots.popitem(last=False)
        return seen.boot_id not in boots and seen.captured_ms > before.captured_ms


def _claimed_sensor(text: bytes) -> str:
    """Sensor that a frame claims to come from, unverified: it decides only whose newest frame this is."""
    parts = text[: 2 * FRAME_BYTES].split(b".")
    if len(parts) != 3:
        return NOBODY
    try:
        claims = json.loads(base64.urlsafe_b64decode(parts[1] + b"=" * (-len(parts[1]) % 4)))
    except (ValueError, RecursionError):
        return NOBODY
    sensor = claims.get("sensor") if isinstance(claims, dict) else None
    return sensor if isinstance(sensor, str) and len(sensor) <= 256 else NOBODY
