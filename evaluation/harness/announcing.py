"""Server of a measured or attacked process: it says when it listens."""

from __future__ import annotations

import json
import sys
from typing import TYPE_CHECKING

import uvicorn

if TYPE_CHECKING:
    import socket


class Announcing(uvicorn.Server):
    """Server that says on standard output, in one JSON line, that it listens."""

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Listens, and says so."""
        await super().startup(sockets)
        if self.started:
            sys.stdout.write(json.dumps({"ready": True}) + "\n")
            sys.stdout.flush()
