"""Frames of one sensor, numbered and signed: the one place where a sensor's word becomes a statement."""

from __future__ import annotations

import secrets
from typing import TYPE_CHECKING

from capabilities.statements import observation as wire
from capabilities.values.caps import DEFAULT
from pep.sensor.sensor_error import SensorError, SensorFault

if TYPE_CHECKING:
    from collections.abc import Iterable

    from capabilities.keys.keys import PrivateKey


class FrameWriter:
    """Signs what a sensor saw, frame by frame, in a boot of its own.

    Args:
        key: signs every frame.
        name: the sensor's registered id.
        calibration: digest (hex) of its calibration.
    """

    def __init__(self, key: PrivateKey, *, name: str, calibration: str) -> None:
        self._key = key
        self.name = name
        self._calibration = calibration
        self._boot_id = secrets.token_hex(16)
        self.sequence = 0

    def frame(
        self,
        people: Iterable[wire.ObservedPerson],
        objects: Iterable[wire.ObservedObject],
        *,
        captured_s: float,
        complete: bool,
        facts: Iterable[wire.ObservedFact] = (),
        most_bytes: int = DEFAULT.statement_bytes,
    ) -> str:
        """The next frame, signed; a refused one takes no number.

        Args:
            people: as seen.
            objects: as seen.
            captured_s: wall clock at capture, seconds since the epoch.
            complete: the frame covers all that the sensor watches.
            facts: as measured.
            most_bytes: longest text.

        Raises:
            StatementError: `STATEMENT_MALFORMED` for a frame that no receiver would take.
            SensorError: `TOO_LARGE`.
        """
        text = wire.sign(
            wire.Observation(
                sensor=self.name,
                boot_id=self._boot_id,
                sequence=self.sequence + 1,
                captured_ms=int(captured_s * 1000),
                calibration=self._calibration,
                complete=complete,
                people=tuple(people),
                objects=tuple(objects),
                facts=tuple(facts),
            ),
            self._key,
        )
        if len(text) > most_bytes:
            raise SensorError(
                SensorFault.TOO_LARGE, f"a frame of {len(text)} bytes, over {most_bytes}", "Tell of fewer things."
            )
        self.sequence += 1
        return text
