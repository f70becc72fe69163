"""Forged frames: each is right in all but one thing."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum
from typing import TYPE_CHECKING, Final

from msgspec import structs

from capabilities.keys import keys
from capabilities.statements import observation
from capabilities.values.caps import DEFAULT as CAPS
from ztpm.cell.setup import SENSOR_CALIBRATION, SENSOR_ID

if TYPE_CHECKING:
    from capabilities.keys.keys import PrivateKey
    from ursim.sensor.sensor_scene import Seen

OTHER_SENSOR: Final = "camera-9"
OTHER_CALIBRATION: Final = "0" * 64
MINUTES_MS: Final = 120_000
"""Distance in time of a frame that is too old, or too new."""
BEFORE: Final = 5
"""So many frames earlier is the number of one that is out of sequence."""


class Wrong(StrEnum):
    """Fault of a frame; all else in it is right."""

    KEY = "key"
    """Signed by a key that nobody knows."""
    AGENT = "agent"
    """Signed by the key of the agent that sends it."""
    ENFORCEMENT = "enforcement"
    """Signed by the tool server's key: a known one, of another role."""
    UNSIGNED = "unsigned"
    """The signature is left out."""
    ALGORITHM = "algorithm"
    """The header says that there is no signature."""
    BODY = "body"
    """A true frame with another body under its signature."""
    SENSOR = "sensor"
    """In the name of a sensor that the cell does not have."""
    CALIBRATION = "calibration"
    """Signed by the sensor, of another calibration."""
    REPLAYED = "replayed"
    """True frames of an earlier time, once more."""
    STALE = "stale"
    """Signed by the sensor, captured two minutes ago."""
    AHEAD = "ahead"
    """Signed by the sensor, captured two minutes ahead."""
    SEQUENCE = "sequence"
    """Signed by the sensor, with an earlier number of its running boot."""
    NOTHING = "nothing"
    """Signed by the sensor, and right in every member: its key was stolen."""


@dataclass
class Forgery:
    """Frames that a forger makes one by one.

    Attributes:
        wrong: with each.
        signer: the forger's key.
        seen: the scene that they claim.
        boot_id: of the sensor's alleged start.
    """

    wrong: Wrong
    signer: PrivateKey
    seen: Seen
    boot_id: str
    _sequence: int = field(default=0, init=False)

    def frame(self, *, captured_s: float, complete: bool, true: str | None) -> str | None:
        """The next one; None where it needs a true one and there is none.

        Args:
            captured_s: wall clock of its alleged capture.
            complete: it claims to cover all that the sensor watches.
            true: the newest true frame, if one was overheard.
        """
        self._sequence += 1
        self.seen, people, objects = self.seen.at(captured_s)
        claimed = observation.Observation(
            sensor=SENSOR_ID,
            boot_id=self.boot_id,
            sequence=self._sequence,
            captured_ms=int(captured_s * 1000),
            calibration=SENSOR_CALIBRATION,
            complete=complete,
            people=people,
            objects=objects,
        )
        match self.wrong:
            case Wrong.SENSOR:
                claimed = structs.replace(claimed, sensor=OTHER_SENSOR)
            case Wrong.CALIBRATION:
                claimed = structs.replace(claimed, calibration=OTHER_CALIBRATION)
            case Wrong.STALE:
                claimed = structs.replace(claimed, captured_ms=claimed.captured_ms - MINUTES_MS)
            case Wrong.AHEAD:
                claimed = structs.replace(claimed, captured_ms=claimed.captured_ms + MINUTES_MS)
            case Wrong.SEQUENCE | Wrong.BODY if true is None:
                return None
            case Wrong.SEQUENCE:
                assert true is not None
                running = observation.open(true, {keys.public_raw(self.signer)}, CAPS)
                claimed = structs.replace(claimed, boot_id=running.boot_id, sequence=max(0, running.sequence - BEFORE))
        return _spoiled(observation.sign(claimed, self.signer), self.wrong, true or "")


def _spoiled(text: str, wrong: Wrong, true: str) -> str:
    """A signed frame, spoiled afterwards where that is what is wrong with it."""
    header, body, _ = text.split(".")
    match wrong:
        case Wrong.UNSIGNED:
            return f"{header}.{body}."
        case Wrong.ALGORITHM:
            stated = keys.unb64u(header)
            for name in (b'"EdDSA"', b'"Ed25519"'):
                stated = stated.replace(name, b'"none"')
            return f"{keys.b64u(stated)}.{body}."
        case Wrong.BODY:
            true_header, _, true_signature = true.split(".")
            return f"{true_header}.{body}.{true_signature}"
        case _:
            return text
