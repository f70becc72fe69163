"""Load: requests that are made and signed beforehand, sent by so many clients, each of which waits for its answer.

Making a request costs more than most answers do, so nothing of it is done while time is taken.
"""

from __future__ import annotations

import asyncio
import json
import time
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final
from urllib.parse import urlsplit

from evaluation.harness.timing import WrongAnswerError

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

PATIENCE_S: Final = 60.0
"""Longest wait for one answer."""
NO_SUCCESS: Final = 300
"""First status that is no success."""


@dataclass(frozen=True, slots=True)
class Ready:
    """One request as it goes over the wire."""

    raw: bytes


@dataclass(frozen=True, slots=True)
class Answered:
    """Answers to a batch.

    Attributes:
        bodies: JSON of each answer, in the order of the requests.
        took_s: of each, from its first byte out to its last byte in.
        ended: monotonic time of each, seconds.
        seconds: of the whole batch.
    """

    bodies: list[Any]
    took_s: list[float]
    ended: list[float]
    seconds: float


def ready(method: str, url: str, body: bytes, headers: dict[str, str]) -> Ready:
    """A request with these headers; the connection stays open."""
    split = urlsplit(url)
    target = f"{split.path}?{split.query}" if split.query else split.path
    lines = [f"{method} {target} HTTP/1.1", f"host: {split.netloc}", f"content-length: {len(body)}"]
    lines += [f"{name}: {value}" for name, value in headers.items()]
    return Ready("\r\n".join((*lines, "", "")).encode() + body)


class Connection:
    """One connection, with one request at a time."""

    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self._reader, self._writer = reader, writer

    @classmethod
    async def to(cls, place: tuple[str, int]) -> Connection:
        """A connection to a worker."""
        return cls(*await asyncio.open_connection(*place))

    async def answer(self, raw: bytes) -> Any:
        """The answer to a request: JSON, or text.

        Raises:
            WrongAnswerError: it is no success.
        """
        self._writer.write(raw)
        return await asyncio.wait_for(self._read(), PATIENCE_S)

    async def _read(self) -> Any:
        head = (await self._reader.readuntil(b"\r\n\r\n")).decode("latin-1").split("\r\n")
        status = int(head[0].split()[1])
        length = next(int(line.partition(":")[2]) for line in head if line.lower().startswith("content-length:"))
        body = await self._reader.readexactly(length)
        if status >= NO_SUCCESS:
            raise WrongAnswerError(f"{status}: {body.decode(errors='replace')[:300]}")
        return json.loads(body) if body[:1] in b"{[" else body.decode()

    def close(self) -> None:
        """Closes it."""
        self._writer.close()


async def sent(places: Sequence[tuple[str, int]], requests: Sequence[Ready], *, clients: int) -> Answered:
    """Answers to all requests.

    Args:
        places: host and port of each worker; clients are spread over them.
        requests: in any order of sending.
        clients: connections, each with one request at a time.

    Raises:
        WrongAnswerError: an answer was no success.
    """
    found = Answered([None] * len(requests), [0.0] * len(requests), [0.0] * len(requests), 0.0)
    waiting = iter(enumerate(requests))
    opened = [await Connection.to(places[n % len(places)]) for n in range(clients)]
    began = time.monotonic()
    try:
        async with asyncio.TaskGroup() as group:
            for connection in opened:
                group.create_task(_client(connection, waiting, found))
    except* WrongAnswerError as errors:
        raise errors.exceptions[0] from None
    finally:
        for connection in opened:
            connection.close()
    return Answered(found.bodies, found.took_s, found.ended, time.monotonic() - began)


async def _client(connection: Connection, waiting: Iterator[tuple[int, Ready]], found: Answered) -> None:
    for place, request in waiting:
        began = time.monotonic()
        found.bodies[place] = await connection.answer(request.raw)
        found.ended[place] = time.monotonic()
        found.took_s[place] = found.ended[place] - began
