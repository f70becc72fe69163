"""Slot for one motion at a time: the request that has the arm now."""

from __future__ import annotations

from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from policies.evidence.model import Request


class Slot:
    """`MotionSlot` port for a cell without streams: nothing prolongs a running motion. On one event loop."""

    def __init__(self) -> None:
        self._holder: str | None = None

    def reserve(self, request_id: str) -> bool:
        """True when nothing moves and the arm is now this request's."""
        if self._holder is None:
            self._holder = request_id
        return self._holder == request_id

    def joins(self, request: Request, *, agent: str) -> bool:  # noqa: ARG002 - the port's own form
        """Never."""
        return False

    def release(self, request_id: str) -> None:
        """Frees the arm, if it was this request's."""
        if self._holder == request_id:
            self._holder = None
