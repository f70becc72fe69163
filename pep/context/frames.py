"""Which frames may say what the world is: signed by a registered sensor, calibrated, newer than all before, in time.

A frame that fails is not dropped and forgotten. It is an incident, and as long as it is the newest of its sensor the
world is distrusted: somebody who can forge one frame must not gain that the frame before it counts a little longer.
"""

from __future__ import annotations

import base64
import json
import math
import threading
from collections import OrderedDict
from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING, Final, TypeAlias

from capabilities.errors import CapabilityError
from capabilities.statements import observation

if TYPE_CHECKING:
    from capabilities.caps import Caps
    from capabilities.statements.observation import Observation
    from pep.ports import Clock, RegisteredSensor, Sensors

FRAME_BYTES: Final = 65_536
"""Largest frame; one with 16 people and 64 objects has about 40 kB."""
BOOTS_KEPT: Final = 64
"""Earlier boots of a sensor that are remembered; an older one is out of time anyway."""
SKEW_MS: Final = 1_000
"""Clocks of one cell differ less than this; a frame captured longer ago (or ahead) is a recording, not a view. Ours."""
NOBODY: Final = ""
"""The source of frames that name no registered sensor."""


class FrameFault(StrEnum):
    """Why a frame is not believed."""

    TOO_LARGE = "TOO_LARGE"
    MALFORMED = "MALFORMED"
    UNKNOWN_SENSOR = "UNKNOWN_SENSOR"
    UNTRUSTED = "UNTRUSTED"
    WRONG_SENSOR = "WRONG_SENSOR"
    WRONG_CALIBRATION = "WRONG_CALIBRATION"
    NOT_NEWER = "NOT_NEWER"
    OUT_OF_TIME = "OUT_OF_TIME"


@dataclass(frozen=True, slots=True)
class Frame:
    """A believed frame.

    Attributes:
        observation: what was seen.
        arrived_ms: monotonic time of arrival.
        transit_ms: counted as age on arrival: the declared longest transit, or more by its sender's clock.
    """

    observation: Observation
    arrived_ms: int
    transit_ms: int


@dataclass(frozen=True, slots=True)
class Rejected:
    """A frame that is not believed. `sensor` is the one that it claims, or "" when none can be told."""

    fault: FrameFault
    sensor: str
    detail: str = ""


@dataclass(frozen=True, slots=True)
class Seen:
    """The newest believed frame of every registered sensor, oldest age first counted.

    Attributes:
        frames: one for each registered sensor.
        age_ms: of the oldest of them.
    """

    frames: tuple[Frame, ...]
    age_ms: int


@dataclass(frozen=True, slots=True)
class Unseen:
    """No view: no sensor is registered, or one of them has sent nothing yet."""


@dataclass(frozen=True, slots=True)
class Distrusted:
    """The newest frame of a sensor is one that must not be believed."""

    rejected: Rejected


View: TypeAlias = Seen | Unseen | Distrusted


class Frames:
    """The newest frames, and whether they may be believed. Any thread.

    Args:
        sensors: registered ones, with their keys.
        clock: ages on its monotonic, skew on its wall time.
        caps: bounds and skew.
    """

    def __init__(self, *, sensors: Sensors, clock: Clock, caps: Caps) -> None:
        self._sensors = sensors
        self._clock = clock
        self._caps = caps
        self._lock = threading.Lock()
        self._newest: dict[str, Frame] = {}
        self._rejected: dict[str, Rejected] = {}
        self._boots: dict[str, OrderedDict[str, None]] = {}

    def admit(self, text: bytes) -> Frame | Rejected:
        """The frame, now the newest of its sensor; or why it is not believed, and then that is the newest.

        Args:
            text: one compact JWS, without the newline.
        """
        arrived_ms = self._clock.monotonic_ms()
        with self._lock:
            verdict = self._judge(text, arrived_ms)
            if isinstance(verdict, Frame):
                self._newest[verdict.observation.sensor] = verdict
                self._rejected.pop(verdict.observation.sensor, None)
                # Noise that nobody signed is outlived by the next frame that somebody did.
                self._rejected.pop(NOBODY, None)
            else:
                known = verdict.sensor in self._sensors.sensors()
                self._rejected[verdict.sensor if known else NOBODY] = verdict
            return verdict

    def reject(self, fault: FrameFault, *, sensor: str = NOBODY) -> Rejected:
        """A frame that could not even be read counts as the newest, too."""
        rejected = Rejected(fault, sensor)
        with self._lock:
            self._rejected[sensor if sensor in self._sensors.sensors() else NOBODY] = rejected
        return rejected

    def knows(self, sensor: str) -> bool:
        """Whether a sensor of that name is registered."""
        return sensor in self._sensors.sensors()

    def view(self) -> View:
        """The world as it may be believed now."""
        registered = self._sensors.sensors()
        with self._lock:
            for name, rejected in self._rejected.items():
                if name == NOBODY or name in registered:
                    return Distrusted(rejected)
            if not registered or not all(name in self._newest for name in registered):
                return Unseen()
            frames = tuple(self._newest[name] for name in sorted(registered))
        now = self._clock.monotonic_ms()
        return Seen(frames, max(now - frame.arrived_ms + frame.transit_ms for frame in frames))

    def _judge(self, text: bytes, arrived_ms: int) -> Frame | Rejected:
        """The numbered recipe of a frame."""
        claimed = _claimed_sensor(text)
        # 1 size, before anything is parsed
        if not len(text) <= FRAME_BYTES:
            return Rejected(FrameFault.TOO_LARGE, claimed)
        try:
            compact = text.decode("ascii")
        except UnicodeDecodeError:
            return Rejected(FrameFault.MALFORMED, claimed)
        # 2 the sensor is registered
        sensor = self._sensors.sensors().get(claimed)
        if sensor is None:
            return Rejected(FrameFault.UNKNOWN_SENSOR if claimed else FrameFault.MALFORMED, claimed)
        # 3 its own key signed it: another sensor's is as good as a stranger's
        try:
            seen = observation.open(compact, frozenset({sensor.key}), self._caps)
        except CapabilityError as error:
            return Rejected(FrameFault.UNTRUSTED, claimed, str(error.code))
        return self._in_order(seen, sensor, arrived_ms)

    def _in_order(self, seen: Observation, sensor: RegisteredSensor, arrived_ms: int) -> Frame | Rejected:
        # 4 what was verified names the sensor whose key verified it
        if seen.sensor != sensor.sensor:
            return Rejected(FrameFault.WRONG_SENSOR, sensor.sensor)
        # 5 the calibration is the registered one
        if seen.calibration != sensor.calibration:
            return Rejected(FrameFault.WRONG_CALIBRATION, sensor.sensor)
        # 6 newer than every frame before it
        if not self._newer(seen):
            return Rejected(FrameFault.NOT_NEWER, sensor.sensor)
        # 7 captured about now, by its sender's clock: a recording from before our start has no predecessor here
        drift_ms = self._clock.wall_s() * 1000 - seen.captured_ms
        if not -SKEW_MS <= drift_ms <= SKEW_MS + sensor.transit_ms:
            return Rejected(FrameFault.OUT_OF_TIME, sensor.sensor)
        # A frame that was held up on the way is as old as its sender's clock says, if that is more than the transit.
        return Frame(seen, arrived_ms, max(sensor.transit_ms, math.ceil(drift_ms)))

    def _newer(self, seen: Observation) -> bool:
        """Whether the frame follows its sensor's last one: higher sequence in one boot, later capture in a new boot."""
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
    """The sensor that a frame says it comes from, unverified: it only tells whose newest frame this is."""
    parts = text[: 2 * FRAME_BYTES].split(b".")
    if len(parts) != 3:
        return NOBODY
    try:
        claims = json.loads(base64.urlsafe_b64decode(parts[1] + b"=" * (-len(parts[1]) % 4)))
    except (ValueError, RecursionError):
        return NOBODY
    sensor = claims.get("sensor") if isinstance(claims, dict) else None
    return sensor if isinstance(sensor, str) and len(sensor) <= 256 else NOBODY
