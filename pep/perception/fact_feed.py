"""Facts of registered sensors, out of the frames that they push: what rows of tools without a robot depend on."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from pep.perception.receiver import FrameReceiver
from pep.perception.sensor_frames import NOBODY, FrameFault, Frames
from policies.evidence.fact_reading import FactReading
from policies.evidence.tiers import FRESH

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Sequence

    from capabilities.values.caps import Caps
    from pep.base.ports import Clock, Sensors
    from pep.base.tier_row import FactRow
    from pep.perception.sensor_frames import SensorStatus

WRONG_UNIT: Final = "WRONG_UNIT"
"""Fault of a fact that its sensor states in another unit than the row."""
NOT_STATED: Final = "NOT_STATED"
"""Fault of a fact that the sensor's newest frame does not have."""


class FactFeed:
    """Receives the frames of the sensors that rows name, and reads their facts. Nothing is believed before `listen`.

    Args:
        sensors: registered ones, with their keys.
        clock: ages on its monotonic, skew on its wall time.
        caps: bounds and skew.
        incident: called with (sensor, fault, detail, how many since the last call).
    """

    def __init__(
        self, sensors: Sensors, *, clock: Clock, caps: Caps, incident: Callable[[str, str, str, int], None]
    ) -> None:
        self._sensors = sensors
        self._clock = clock
        self._caps = caps
        self._incident = incident
        self._frames: Frames | None = None
        self._receiver: FrameReceiver | None = None

    async def listen(self, rows: Iterable[FactRow], *, host: str, port: int) -> int:
        """Receives frames from now on; the port that was bound.

        Args:
            rows: each sensor that one of them names is heard, and no other.
            host: address to listen at.
            port: TCP port; 0 for any.
        """
        named = frozenset(row.sensor for row in rows)
        self._frames = Frames(sensors=self._sensors, named=named, clock=self._clock, caps=self._caps)
        self._receiver = FrameReceiver(self._frames, clock=self._clock, incident=self._incident)
        return await self._receiver.listen(host, port)

    async def close(self) -> None:
        """Ends the reception."""
        if self._receiver is not None:
            await self._receiver.close()

    def readings(self, rows: Sequence[FactRow]) -> tuple[FactReading, ...]:
        """Reading of each row's fact, in one look at all sensors, now ([FCT-2])."""
        if self._frames is None:
            return tuple(row.unheard() for row in rows)
        look = self._frames.look()
        heard = {one.sensor: one for one in look.heard}
        noise = heard.pop(NOBODY, None)
        known = self._sensors.sensors()
        return tuple(
            _reading(row, heard.get(row.sensor), noise, now_ms=look.taken_ms)
            if row.sensor in known
            else row.unheard(str(FrameFault.UNKNOWN_SENSOR))
            for row in rows
        )


def _reading(row: FactRow, heard: SensorStatus | None, noise: SensorStatus | None, *, now_ms: int) -> FactReading:
    """Reading of one fact, of a registered sensor."""
    if heard is None or heard.frame is None:
        rejected = None if heard is None else heard.rejected
        return row.unheard("" if rejected is None else str(rejected.fault))
    age_ms = heard.frame.age_ms(now_ms)
    found = next((fact for fact in heard.frame.observation.facts if fact.name == row.name), None)
    value = None if found is None or found.unit != row.unit else found.value
    # A frame that must not be believed is the newest word of its sensor, or, where it names none, of any.
    rejected = heard.rejected or (None if noise is None else noise.rejected)
    if rejected is not None:
        return FactReading(row.fact, "invalid", str(rejected.fault), value, str(row.unit), age_ms)
    if found is None:
        return FactReading(row.fact, "missing", NOT_STATED, None, str(row.unit), age_ms)
    if value is None:
        return FactReading(row.fact, "invalid", WRONG_UNIT, None, str(row.unit), age_ms)
    state = FRESH if age_ms <= row.fresh_ms else "stale"
    return FactReading(row.fact, state, "", value, str(row.unit), age_ms)
