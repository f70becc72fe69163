"""Acts on the wire: bytes at a controller's ports by a sender without a lease."""

from __future__ import annotations

import socket
import time
from contextlib import suppress
from typing import TYPE_CHECKING, ClassVar, Final, Literal

from evaluation.redteam.acts.act import Act
from evaluation.redteam.parts import Came, Effect
from pep.rtde.robot.connections import DASHBOARD, GRIPPER, PRIMARY, REALTIME, RTDE, SECONDARY

if TYPE_CHECKING:
    from evaluation.redteam.bare import BareArena
    from evaluation.redteam.guarded import GuardedArena
    from ztpm.stage.samples import StateRecorder

PORTS: Final = {
    "dashboard": DASHBOARD,
    "primary": PRIMARY,
    "secondary": SECONDARY,
    "realtime": REALTIME,
    "rtde": RTDE,
    "gripper": GRIPPER,
}
TIMEOUT_S: Final = 5.0
STARTS_S: Final = 1.5
"""Time within which a controller that takes a script has begun to move."""
ENDS_S: Final = 20.0
"""Longest motion of a script."""
STILL_S: Final = 0.3
"""Rest after which a motion has ended."""
MOVED_RAD: Final = 1e-3
"""Less than this on every joint is standing still."""
PAUSE_S: Final = 0.2
"""Pause between two pieces, so that each arrives by itself."""


class Send(Act, frozen=True, kw_only=True, tag="send"):
    """Bytes at a port of the controller, or of the gateway where one stands before it.

    Attributes:
        port: by its use.
        pieces: texts that are sent one after another; each ends a line unless `hexadecimal`.
        hexadecimal: the pieces are bytes, two digits each.
    """

    point: ClassVar[str] = "e5"

    port: Literal["dashboard", "primary", "secondary", "realtime", "rtde", "gripper"]
    pieces: tuple[str, ...]
    hexadecimal: bool = False

    def bare(self, arena: BareArena) -> Came:
        """Sends them to the controller."""
        self._send(arena.host)
        _moved(arena.eyes)
        return Came(Effect.DONE)

    def guarded(self, arena: GuardedArena) -> Came:
        """Sends them to the gateway; it is done where the arm moves."""
        try:
            self._send(arena.stage.cell.addresses.gateway_host)
        except ConnectionRefusedError:
            return Came(Effect.DENIED, self.point, "NOTHING_LISTENS")
        if _moved(arena.eyes):
            return Came(Effect.DONE)
        return Came(Effect.DENIED, self.point, "NOT_HEARD")

    def _send(self, host: str) -> None:
        with socket.create_connection((host, PORTS[self.port]), timeout=TIMEOUT_S) as link, suppress(ConnectionError):
            link.settimeout(PAUSE_S)
            for piece in self.pieces:
                link.sendall(bytes.fromhex(piece) if self.hexadecimal else piece.encode() + b"\n")
                with suppress(TimeoutError):  # what comes back is not looked at
                    link.recv(65_536)


def _moved(eyes: StateRecorder) -> bool:
    """True where the arm moves within some time; it stands again afterwards."""
    start, begun_s = eyes.now().q_rad, time.monotonic()
    still_s = begun_s
    moved = False
    while (now_s := time.monotonic()) - begun_s < (ENDS_S if moved else STARTS_S):
        sample = eyes.now()
        moved = moved or max(abs(a - b) for a, b in zip(sample.q_rad, start, strict=True)) > MOVED_RAD
        if not sample.still:
            still_s = now_s
        elif moved and now_s - still_s > STILL_S:
            break
        time.sleep(0.02)
    return moved
