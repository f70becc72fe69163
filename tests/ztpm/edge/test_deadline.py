"""Connections that say nothing, or too slowly, end by themselves; an honest one is served meanwhile and afterwards."""

import asyncio
import contextlib
import socket

import pytest

from ztpm.edge import connection
from ztpm.edge.server import EdgeServer

pytestmark = pytest.mark.real_time

LATE_S = 0.4
PATIENCE_S = 10.0
REQUEST = b"POST / HTTP/1.1\r\nhost: x\r\ncontent-length: 4\r\n\r\nbody"


async def app(scope, receive, send):
    assert scope["type"] == "http"
    body = b""
    while True:
        part = await receive()
        body += part.get("body", b"")
        if part["type"] == "http.disconnect":
            return
        if not part.get("more_body"):
            break
    await send({"type": "http.response.start", "status": 200, "headers": [(b"content-length", b"4")]})
    await send({"type": "http.response.body", "body": body})


@pytest.fixture
def late(monkeypatch):
    monkeypatch.setattr(connection, "REQUEST_S", LATE_S)


async def served(play):
    probe = socket.create_server(("127.0.0.1", 0))
    server = EdgeServer(app, log_level="error", lifespan="off")
    running = asyncio.create_task(server.serve(sockets=[probe]))
    try:
        async with asyncio.timeout(PATIENCE_S):
            while not server.started:
                await asyncio.sleep(0.01)
            await play(probe.getsockname()[1])
    finally:
        server.should_exit = True
        await running


async def ended(reader):
    """The server closes; how long that took, by the loop's clock.

    Closing with bytes still unread is a reset on the wire, not an orderly end: who keeps talking may see either.
    """
    started = asyncio.get_running_loop().time()
    with contextlib.suppress(ConnectionResetError):
        while await reader.read(4096):
            pass
    return asyncio.get_running_loop().time() - started


@pytest.mark.parametrize(
    "said",
    [b"", b"P", REQUEST[:30], REQUEST[:-4], REQUEST[:-1]],
    ids=["nothing", "one byte", "half a header", "no body", "half a body"],
)
def test_an_unfinished_request_ends(late, said):
    async def play(port):
        reader, writer = await asyncio.open_connection("127.0.0.1", port)
        writer.write(said)
        assert await ended(reader) < PATIENCE_S / 2
        writer.close()

    asyncio.run(served(play))


def test_bytes_one_by_one_do_not_set_the_clock_back(late):
    async def play(port):
        reader, writer = await asyncio.open_connection("127.0.0.1", port)

        async def drip():
            for byte in REQUEST[:-1] * 100:
                if writer.is_closing():
                    return
                writer.write(bytes([byte]))
                await asyncio.sleep(LATE_S / 20)

        dripping = asyncio.create_task(drip())
        assert await ended(reader) < PATIENCE_S / 2
        dripping.cancel()
        writer.close()

    asyncio.run(served(play))


def test_a_whole_request_is_served_and_a_second_may_come_later(late):
    async def play(port):
        reader, writer = await asyncio.open_connection("127.0.0.1", port)
        for _ in range(2):
            writer.write(REQUEST)
            head = await reader.readuntil(b"\r\n\r\n")
            assert head.startswith(b"HTTP/1.1 200")
            assert await reader.readexactly(4) == b"body"
            # Between whole requests the connection is kept by the server's own rule, which is longer here.
            with pytest.raises(TimeoutError):
                await asyncio.wait_for(reader.read(1), 2 * LATE_S)
        writer.close()

    asyncio.run(served(play))
