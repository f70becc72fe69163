"""A sensor of the cell, as a program has it: it signs what it sees, and pushes it.

Opening it waits a moment for the connection, and `see` for nothing, so threads and coroutines may call it alike:

    with Sensor("camera-1.key", "10.0.5.20:8801", calibration="camera-1.pdf") as sensor:
        sensor.see(people=[...])

    async with Sensor("camera-1.key", "10.0.5.20:8801", calibration="camera-1.pdf") as sensor:
        sensor.see(people=[...])
"""

from __future__ import annotations

import hashlib
import re
import threading
import time
from collections import deque
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final

from capabilities.statements.observation import FRAME_BYTES, PEOPLE
from capabilities.values.errors import CapabilityError
from pep.base.errors import ConfigError, PepFault
from pep.base.key_file import read_key
from pep.base.tcp_place import tcp_place
from pep.sensor.followed_people import KEEP_S, FollowedPeople
from pep.sensor.frame_sender import SenderTasks, SenderThread
from pep.sensor.frame_writer import FrameWriter
from pep.sensor.metres import number
from pep.sensor.sensor_error import SensorError, SensorFault

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence
    from typing import Self

    from capabilities.keys.keys import PrivateKey
    from capabilities.statements.observation import ObservedFact, ObservedObject
    from pep.sensor.metres import PersonSight

SKEW_S: Final = 1.0
"""Oldest capture that is still sent: a gateway takes an older one for a recording (`pep.perception`)."""
CONNECT_S: Final = 2.0
"""Longest wait of the opening for a first connection."""
RATED: Final = 30
"""Frames over which the rate is measured."""
HEX_DIGEST: Final = re.compile(r"[0-9a-f]{64}")


@dataclass(frozen=True, slots=True)
class SentFrame:
    """One frame that was signed.

    Attributes:
        sequence: its number.
        gateways: to how many perception points it went; 0 while none listens, and nothing is sent later.
        age_ms: time from its capture to its sending.
        rate_hz: of the last frames; 0 for the first.
        people: ids of everybody in it, as they last over time.
        unseen: parts of people that were assumed, by id.
    """

    sequence: int
    gateways: int
    age_ms: int
    rate_hz: float
    people: tuple[str, ...]
    unseen: dict[str, tuple[str, ...]]


class Sensor:
    """Registered sensor with its key.

    Args:
        key: file of the encrypted key (passphrase in ZTPM_PASSPHRASE), or the key itself.
        gateway: HOST:PORT of the perception point, or several: each gets every frame.
        calibration: file of the registered calibration document, or its SHA-256 in hex.
        name: the sensor's registered id; left out, the key file's name without its ending.
        keep_s: time for which a person whom a frame lost is told on, with their age; 0 for not at all.

    Raises:
        ConfigError: `CONFIG_INVALID` naming the argument.
    """

    def __init__(
        self,
        key: Path | str | PrivateKey,
        gateway: str | Sequence[str],
        *,
        calibration: Path | str,
        name: str = "",
        keep_s: float = KEEP_S,
    ) -> None:
        if isinstance(key, Path | str):
            name = name or Path(key).stem
            key = read_key(Path(key), name="key")
        if not name:
            raise ConfigError(PepFault.CONFIG_INVALID, "name: a key that is no file does not say whose it is")
        self._writer = FrameWriter(key, name=name, calibration=_digest(calibration))
        self._places = [
            tcp_place(each, name="gateway") for each in ([gateway] if isinstance(gateway, str) else gateway)
        ]
        if not self._places:
            raise ConfigError(PepFault.CONFIG_INVALID, "gateway: none is named")
        self._people = FollowedPeople(keep_s)
        self._captured_s = 0.0
        self._sent_s: deque[float] = deque(maxlen=RATED + 1)
        self._lines: SenderThread | SenderTasks | None = None
        self._lock = threading.Lock()

    @property
    def name(self) -> str:
        """The sensor's registered id."""
        return self._writer.name

    def see(
        self,
        people: Iterable[PersonSight] = (),
        objects: Iterable[ObservedObject] = (),
        *,
        facts: Iterable[ObservedFact] = (),
        captured_s: float | None = None,
        complete: bool = True,
    ) -> SentFrame:
        """Sends one frame; a refused one is not sent, and leaves the sensor as it was.

        Args:
            people: everybody who is seen.
            objects: everything that is seen, but what the cell file has and what the arm holds.
            facts: numbers for rows of tools without a robot.
            captured_s: wall clock at exposure, seconds since the epoch; None for now.
            complete: everybody and everything in the watched space is told. An empty frame then says: nobody is there.

        Raises:
            SensorError: with the reason, the place and the next step.
        """
        with self._lock:
            lines = self._open()  # before the time is taken: a first connection may be waited for
            now_s = time.time()
            at_s = now_s if captured_s is None else number(captured_s, "captured_s")
            self._in_time(at_s, now_s)
            followed = self._people.after(list(people), at_s=at_s)
            told = followed.told(at_s=at_s)
            if len(told) > PEOPLE:
                raise SensorError(SensorFault.TOO_LARGE, f"{len(told)} people, over {PEOPLE}", "Tell the nearest.")
            try:
                text = self._writer.frame(
                    told, objects, captured_s=at_s, complete=complete, facts=facts, most_bytes=FRAME_BYTES - 1
                )
            except CapabilityError as error:
                raise SensorError(
                    SensorFault.SIGHT_MALFORMED,
                    error.detail,
                    "Mend the member that is named; docs/sensors.md has them.",
                ) from error
            self._people, self._captured_s = followed, at_s
            gateways = lines.send(text.encode() + b"\n")
            self._sent_s.append(time.monotonic())
        return SentFrame(
            sequence=self._writer.sequence,
            gateways=gateways,
            age_ms=max(0, round((time.time() - at_s) * 1000)),
            rate_hz=self._rate_hz(),
            people=tuple(each.id for each in told),
            unseen=followed.unseen,
        )

    def close(self) -> None:
        """Ends all connections, what was sent before them."""
        lines, self._lines = self._lines, None
        if isinstance(lines, SenderThread):
            lines.close()

    def __enter__(self) -> Self:
        """Sensor with its connections, on a thread of its own."""
        self._open()
        return self

    def __exit__(self, *_: object) -> None:
        """Ends all connections."""
        self.close()

    async def __aenter__(self) -> Self:
        """Sensor with its connections, on the running event loop."""
        self._lines = lines = SenderTasks(self._places)
        await lines.connected(CONNECT_S)
        return self

    async def __aexit__(self, *_: object) -> None:
        """Ends all connections."""
        lines, self._lines = self._lines, None
        if isinstance(lines, SenderTasks):
            await lines.end()

    def _open(self) -> SenderThread | SenderTasks:
        if self._lines is None:
            self._lines = SenderThread(self._places, wait_s=CONNECT_S)
        return self._lines

    def _in_time(self, at_s: float, now_s: float) -> None:
        if not -SKEW_S <= at_s - now_s <= SKEW_S:
            raise SensorError(
                SensorFault.OUT_OF_TIME,
                f"captured {now_s - at_s:.3f} s ago",
                "Send each frame at once, and give captured_s in seconds since the epoch.",
            )
        if at_s < self._captured_s:
            raise SensorError(
                SensorFault.NOT_NEWER, "captured before the frame before it", "Send frames in their order."
            )

    def _rate_hz(self) -> float:
        if len(self._sent_s) < 2:
            return 0.0
        return round((len(self._sent_s) - 1) / max(1e-6, self._sent_s[-1] - self._sent_s[0]), 1)


def _digest(calibration: Path | str) -> str:
    if isinstance(calibration, str) and HEX_DIGEST.fullmatch(calibration):
        return calibration
    try:
        return hashlib.sha256(Path(calibration).read_bytes()).hexdigest()
    except OSError as error:
        raise ConfigError(PepFault.CONFIG_INVALID, f"calibration: {type(error).__name__}") from error
