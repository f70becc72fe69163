"""Report of an enforcement point to the process that started it, on request.

It has at least the age of the revocation view.

The question `{"report": true}` comes as a line on standard input, and the answer goes to standard output. The pipe
belongs to that process alone, so joint angles are told here that the server keeps from strangers on its HTTP port.
"""

from __future__ import annotations

import asyncio
import json
import sys
from typing import TYPE_CHECKING

from capabilities.statements.revocation import NEVER_MS

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable

    from pep.provider.feed import ProviderFollower


async def serve_reports(report: Callable[[], Awaitable[dict[str, object]]]) -> None:
    """Answers every question on standard input, until the input ends.

    Args:
        report: makes an answer; plain JSON.
    """
    reader = asyncio.StreamReader()
    loop = asyncio.get_running_loop()
    try:
        await loop.connect_read_pipe(lambda: asyncio.StreamReaderProtocol(reader), sys.stdin)
    except ValueError:  # a file: there are no questions
        return
    while line := await reader.readline():
        if line.strip() == b'{"report": true}':
            answer = json.dumps({"answer": await report()}, allow_nan=False)
            sys.stdout.write(answer + "\n")
            sys.stdout.flush()


def view_of(follower: ProviderFollower) -> dict[str, object]:
    """Epoch and age of the revocation view; None while there is none."""
    view = follower.view()
    return {"epoch": None, "age_ms": None} if view.age_ms >= NEVER_MS else {"epoch": view.epoch, "age_ms": view.age_ms}
