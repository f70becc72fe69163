"""Feed of a running cell to the browsers that look at it, made once for all of them.

    gateway's live report, 10 times a second ─┐
    picture of the cell, once a second ───────┴▶ what changed ─▶ one mailbox per viewer ─▶ server-sent events

Nothing is made while nobody looks. A slow viewer misses intermediate values, never the newest, and holds up nobody.
"""

from __future__ import annotations

import asyncio
import json
import threading
from typing import TYPE_CHECKING, Any, Final

from ztpm.base.processes import REPORT

if TYPE_CHECKING:
    from collections.abc import AsyncIterator, Callable, Mapping

    from ztpm.base.processes import Child

FRAME_S: Final = 0.1
"""Period of the arm's picture."""
PARTS_S: Final = 1.0
"""Period of everything else."""
ALIVE_S: Final = 1.0
"""Longest time without a frame: the page knows by it that the feed lives."""
ANSWER_S: Final = 0.5
"""Longest wait for the gateway."""
JOIN_S: Final = 3.0
GATEWAY, ROBOT = "gateway", "robot"
"""Faults of a frame: who says nothing."""


class Mailbox:
    """Newest value of each kind for one viewer. On the server's event loop."""

    def __init__(self, newest: Mapping[str, bytes]) -> None:
        self._waiting = dict(newest)
        self._news = asyncio.Event()
        if newest:
            self._news.set()

    def put(self, news: Mapping[str, bytes]) -> None:
        """Puts the newest values in place of those that were not taken yet."""
        self._waiting |= news
        self._news.set()

    async def take(self) -> bytes:
        """Events that were not taken yet; waits for one."""
        await self._news.wait()
        self._news.clear()
        waiting, self._waiting = self._waiting, {}
        return b"".join(waiting.values())


class LiveFeed:
    """Feed of one cell.

    Args:
        gateway: its process now; None while there is none.
        parts: HTML of each part of the page, by its name, as it is now.
        clock: monotonic, seconds.
        wall_ms: wall clock, milliseconds since the epoch.
    """

    def __init__(
        self,
        gateway: Callable[[], Child | None],
        parts: Callable[[], Mapping[str, str]],
        *,
        clock: Callable[[], float],
        wall_ms: Callable[[], int],
    ) -> None:
        self._gateway = gateway
        self._parts = parts
        self._clock = clock
        self._wall_ms = wall_ms
        self._newest: dict[str, bytes] = {}
        self._values: dict[str, Any] = {}  # of which the newest were made: cheaper to compare than to write
        self._boxes: set[Mailbox] = set()
        self._loop: asyncio.AbstractEventLoop | None = None
        self._looked_at = threading.Event()
        self._over = threading.Event()
        self._lock = threading.Lock()
        self._threads = [
            threading.Thread(target=self._produce, args=(make, period_s), name=f"live {make.__name__}", daemon=True)
            for make, period_s in ((self._frame, FRAME_S), (self._page, PARTS_S))
        ]
        self._told_s = 0.0
        self._told_by: Child | None = None
        self._held = self._motion = self._frame_text = ""

    # ---- viewers, on the server's event loop

    async def events(self) -> AsyncIterator[bytes]:
        """Events for one viewer, from all that is known now on, until it leaves."""
        self._loop = asyncio.get_running_loop()
        with self._lock:
            box = Mailbox(self._newest)
            self._boxes.add(box)
        self._begin()
        try:
            while True:
                yield await box.take()
        finally:
            with self._lock:
                self._boxes.discard(box)
                if not self._boxes:
                    self._looked_at.clear()
                    self._newest.clear()  # what nobody saw age is no news to the next one

    def _begin(self) -> None:
        self._looked_at.set()
        for thread in self._threads:
            if thread.ident is None:
                thread.start()

    def close(self) -> None:
        """Ends the feed."""
        self._over.set()
        self._looked_at.set()
        for thread in self._threads:
            if thread.ident is not None:
                thread.join(JOIN_S)

    # ---- producers, a thread each

    def _produce(self, make: Callable[[], None], period_s: float) -> None:
        while not self._over.is_set():
            self._looked_at.wait()
            begun_s = self._clock()
            make()
            self._over.wait(max(0.0, period_s - (self._clock() - begun_s)))

    def _frame(self) -> None:
        gateway = self._gateway()
        now = None if gateway is None else gateway.ask({REPORT: "live"}, timeout_s=ANSWER_S)
        if now is None or "arm" not in now or gateway is None:
            self._tell("frame", {"fault": GATEWAY})
            return
        if gateway is not self._told_by:  # another process, perhaps with another cell file
            self._told_by, self._held, self._motion = gateway, "", ""
        arm = now["arm"]
        if now["held"] != self._held or "standing" not in self._newest:
            standing = gateway.ask({REPORT: "standing"}, timeout_s=ANSWER_S)
            if standing is not None and "parts" in standing:
                self._held, self._motion = standing["held"], ""
                self._tell("standing", standing)
        if now["motion"] != self._motion or "way" not in self._newest:
            way = gateway.ask({REPORT: "way"}, timeout_s=ANSWER_S)
            if way is not None and "postures" in way:
                self._motion = way["motion"]
                self._tell("way", way["postures"])
        self._tell("seen", now["bodies"])
        self._tell("frame", {"fault": ROBOT} if arm is None else {"fault": "", **arm})

    def _page(self) -> None:
        for name, html in self._parts().items():
            self._tell(f"part-{name}", {"name": name, "html": html}, event="part")

    def _tell(self, kind: str, value: Any, *, event: str = "") -> None:
        """Gives the viewers a value, where it is news of its kind."""
        if kind == "frame":
            value = {**value, "at_ms": self._wall_ms()} if self._due(value) else None
            if value is None:
                return
        with self._lock:
            if not self._boxes or (kind in self._newest and self._values.get(kind) == value):
                return
        said = json.dumps(value, allow_nan=False, separators=(",", ":"))
        text = f"event: {event or kind}\ndata: {said}\n\n".encode()
        with self._lock:
            if not self._boxes:  # the last viewer has left meanwhile
                return
            self._newest[kind], self._values[kind] = text, value
            boxes, loop = tuple(self._boxes), self._loop
        if loop is not None and not loop.is_closed():
            loop.call_soon_threadsafe(_deliver, boxes, {kind: text})

    def _due(self, value: dict[str, Any]) -> bool:
        """True where the frame is news, or the last one is `ALIVE_S` old."""
        now_s, text = self._clock(), json.dumps(value)
        due = text != self._frame_text or now_s - self._told_s >= ALIVE_S
        if due:
            self._frame_text, self._told_s = text, now_s
        return due


def _deliver(boxes: tuple[Mailbox, ...], news: Mapping[str, bytes]) -> None:
    for box in boxes:
        box.put(news)
