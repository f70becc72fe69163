"""Recorder of the evaluation: every package of the controller, over an RTDE receive connection of its own.

Nothing that is judged shares this connection. Each sample keeps when it arrived here and what the controller's own
clock said; an arrival is never earlier than the sample, so times that are measured to it are never too short.
"""

from __future__ import annotations

import bisect
import socket
import threading
import time
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, Self, cast

from pep.base.thread_priority import goes_first
from pep.rtde.wire.codec import MAX_FRAME, Framer, Recipe, decode_answer, encode_request
from pep.rtde.wire.messages import (
    OutputsAnswer,
    ProtocolAnswer,
    RequestProtocol,
    SetupOutputs,
    Start,
    StartAnswer,
    Values,
)

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from types import TracebackType

    from pep.rtde.wire.messages import Answer

PORT: Final = 30004
FREQUENCY_HZ: Final = 500.0
PROTOCOL: Final = 2
NAMES: Final = ("timestamp", "actual_q", "actual_qd", "target_qd")
TIMEOUT_S: Final = 5.0
STILL_RAD_S: Final = 1e-3
"""All joints slower than this is standstill (1 mrad/s)."""
NEAR_RAD: Final = 1e-3
"""Difference of each joint within which the arm stands at a place."""


def near(q_rad: Sequence[float], there_rad: Sequence[float]) -> bool:
    """True where every joint is within a milliradian of that place."""
    return all(abs(a - b) <= NEAR_RAD for a, b in zip(q_rad, there_rad, strict=True))


class StateRecorderError(RuntimeError):
    """Controller that sends no state."""


@dataclass(frozen=True, slots=True)
class Sample:
    """One package.

    Attributes:
        arrived_s: CLOCK_MONOTONIC when it was read here.
        stamp_s: the controller's clock.
        q_rad, qd_rad_s: measured joint angles and speeds.
        target_qd_rad_s: commanded joint speeds.
    """

    arrived_s: float
    stamp_s: float
    q_rad: tuple[float, ...]
    qd_rad_s: tuple[float, ...]
    target_qd_rad_s: tuple[float, ...]

    @property
    def still(self) -> bool:
        """True where every joint is slower than 1 mrad/s."""
        return all(abs(speed) < STILL_RAD_S for speed in self.qd_rad_s)

    @property
    def commanded_rad_s(self) -> float:
        """Commanded speed of the leading axis."""
        return max(abs(speed) for speed in self.target_qd_rad_s)


class StateRecorder:
    """Samples of one controller, kept from the moment this is made.

    Args:
        host: of the controller.

    Raises:
        StateRecorderError: it does not speak RTDE here.
    """

    def __init__(self, host: str) -> None:
        try:
            self._link = socket.create_connection((host, PORT), timeout=TIMEOUT_S)
        except OSError as error:
            raise StateRecorderError(f"{host}: {type(error).__name__}") from error
        self._framer = Framer(MAX_FRAME)
        self._lock = threading.Lock()
        self._samples: list[Sample] = []
        self._answers = self._read()
        self._recipe = self._begin()
        self._thread = threading.Thread(target=self._keep, name="eyes", daemon=True)
        self._thread.start()

    def _begin(self) -> Recipe:
        self._link.sendall(encode_request(RequestProtocol(PROTOCOL), PROTOCOL))
        agreed = next(self._answers, None)
        if agreed != ProtocolAnswer(accepted=True):
            raise StateRecorderError("no RTDE of version 2")
        self._link.sendall(encode_request(SetupOutputs(NAMES, FREQUENCY_HZ), PROTOCOL))
        outputs = next(self._answers, None)
        if not isinstance(outputs, OutputsAnswer):
            raise StateRecorderError("no outputs")
        self._link.sendall(encode_request(Start(), PROTOCOL))
        if next(self._answers, None) != StartAnswer(accepted=True):
            raise StateRecorderError("the stream did not start")
        return Recipe(NAMES, outputs.types)

    def _read(self) -> Iterator[Answer]:
        while True:
            try:
                received = self._link.recv(65_536)
            except OSError:
                return
            if not received:
                return
            for frame in self._framer.feed(received):
                yield decode_answer(frame, PROTOCOL)

    def _keep(self) -> None:
        goes_first()  # when a sample came is not when this thread had its turn
        for answer in self._answers:
            if not isinstance(answer, Values):
                continue
            said = self._recipe.unpack(answer.packed)
            q, qd, target = (cast("tuple[float, ...]", said[name]) for name in NAMES[1:])
            sample = Sample(time.monotonic(), cast("float", said["timestamp"]), q, qd, target)
            with self._lock:
                self._samples.append(sample)

    def now(self) -> Sample:
        """The newest sample.

        Raises:
            StateRecorderError: when none has come for five seconds.
        """
        deadline = time.monotonic() + TIMEOUT_S
        while time.monotonic() < deadline:
            with self._lock:
                if self._samples and time.monotonic() - self._samples[-1].arrived_s < TIMEOUT_S:
                    return self._samples[-1]
            time.sleep(1 / FREQUENCY_HZ)
        raise StateRecorderError("the controller shows nothing")

    def since(self, arrived_s: float) -> list[Sample]:
        """The samples that arrived from then on; older ones are forgotten."""
        with self._lock:
            first = bisect.bisect_left(self._samples, arrived_s, key=lambda sample: sample.arrived_s)
            del self._samples[:first]
            return list(self._samples)

    def close(self) -> None:
        """Closes the connection."""
        self._link.close()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()
