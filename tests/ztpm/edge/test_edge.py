"""A listener behind the edge, over real sockets: strangers crowd it, and others are served meanwhile."""

import asyncio
import contextlib
import errno
import logging
import socket
import ssl

import pytest
from tests.e2e.tls import Authority
from ztpm.edge.places import Bounds
from ztpm.edge.server import EdgeServer
from ztpm_idp.routes import caller

from pep.base import caller_place
from ztpm.edge import connection, listener, places

FEW = Bounds(strangers=8, by_address=4, stops=4, stops_by_address=2, parties=4, by_party=2)
STRANGER, OTHER = "127.0.0.2", "127.0.0.3"
PATIENCE_S = 10.0


@pytest.fixture(autouse=True)
def _no_grace(monkeypatch):
    """A crowd of a few comes within milliseconds; `test_places` has the time that each newcomer has."""
    monkeypatch.setattr(places, "GRACE_S", 0.0)


class App:
    """Answers 200; a path names the claim that is made, `/wait` answers when it is let go, `/much` answers much."""

    def __init__(self):
        self.go = asyncio.Event()

    async def __call__(self, scope, receive, send):
        if scope["path"].startswith("/party/"):
            caller_place.proven(scope, scope["path"].removeprefix("/party/"))
        elif scope["path"] == "/stop":
            caller_place.stopping(scope)
        elif scope["path"] == "/wait":
            await self.go.wait()
        body = b"x" * (8_000_000 if scope["path"] == "/much" else 2)
        await send({"type": "http.response.start", "status": 200, "headers": [(b"content-length", b"%d" % len(body))]})
        await send({"type": "http.response.body", "body": body})


async def served(play, *, bounds=FEW, **options):
    listening = socket.create_server(("127.0.0.1", 0))
    app = App()
    server = EdgeServer(app, bounds=bounds, log_level="warning", lifespan="off", timeout_graceful_shutdown=1, **options)
    app.server = server
    running = asyncio.create_task(server.serve(sockets=[listening]))
    try:
        async with asyncio.timeout(PATIENCE_S):
            while not server.started:
                await asyncio.sleep(0.01)
            await play(listening.getsockname()[1], app)
    finally:
        app.go.set()
        server.should_exit = True
        await running


async def connected(port, address=STRANGER, **options):
    return await asyncio.open_connection("127.0.0.1", port, local_addr=(address, 0), **options)


async def asked(reader, writer, path="/"):
    writer.write(f"GET {path} HTTP/1.1\r\nhost: x\r\n\r\n".encode())
    head = await reader.readuntil(b"\r\n\r\n")
    await reader.readexactly(int(head.lower().split(b"content-length: ")[1].split(b"\r\n")[0]))
    return head.split()[1]


async def over(reader):
    with contextlib.suppress(ConnectionResetError):
        while await reader.read(4_096):
            pass
    return True


def test_the_silent_connections_of_an_address_go_in_their_order_and_another_address_is_served():
    async def play(port, _):
        other = await connected(port, OTHER)
        crowd = [await connected(port) for _ in range(40)]
        for reader, _ in crowd[:36]:
            assert await over(reader)
        assert not any(reader.at_eof() for reader, _ in crowd[36:])
        assert await asked(*other) == b"200"
        assert await asked(*crowd[-1]) == b"200"
        for _, writer in (other, *crowd):
            writer.close()

    asyncio.run(served(play))


@pytest.mark.parametrize("path", ["/party/alice", "/stop"])
def test_a_proven_caller_or_a_stop_of_the_strangers_own_address_keeps_its_connection(path):
    async def play(port, _):
        known, stranger = await connected(port), await connected(port)
        assert await asked(*known, path) == b"200"
        assert await asked(*stranger) == b"200"
        crowd = [await connected(port) for _ in range(20)]
        assert await over(stranger[0])
        assert await asked(*known) == b"200"
        for _, writer in (known, stranger, *crowd):
            writer.close()

    asyncio.run(served(play))


def test_requests_that_strangers_keep_waiting_do_not_keep_a_newcomer_of_their_address_out():
    async def play(port, _):
        crowd = [await connected(port) for _ in range(4)]
        for _, writer in crowd:
            writer.write(b"GET /wait HTTP/1.1\r\nhost: x\r\n\r\n")
        await asyncio.sleep(0.05)
        newcomer = await connected(port)
        assert await asked(*newcomer) == b"200"
        assert await over(crowd[0][0])
        for _, writer in (newcomer, *crowd):
            writer.close()

    asyncio.run(served(play))


def test_a_tls_handshake_that_does_not_come_has_a_place_and_makes_room(tmp_path):
    authority = Authority(tmp_path, ["127.0.0.1"])

    async def play(port, _):
        crowd = [await connected(port) for _ in range(40)]
        for reader, _ in crowd[:36]:
            assert await over(reader)
        trusting = ssl.create_default_context(cafile=authority.ca)
        trusting.check_hostname = False
        honest = await connected(port, ssl=trusting)
        assert await asked(*honest) == b"200"
        for _, writer in (honest, *crowd):
            writer.close()

    asyncio.run(served(play, ssl_certfile=str(authority.certificate), ssl_keyfile=str(authority.key)))


def test_an_answer_that_nobody_takes_ends(monkeypatch):
    monkeypatch.setattr(connection, "ANSWER_S", 0.2)

    async def play(port, _):
        reader, writer = await connected(port, limit=1_024)
        writer.write(b"GET /much HTTP/1.1\r\nhost: x\r\n\r\n")
        writer.transport.pause_reading()
        await asyncio.sleep(0.6)
        writer.transport.resume_reading()
        took = 0
        with contextlib.suppress(ConnectionResetError):
            while part := await reader.read(65_536):
                took += len(part)
        assert took < 8_000_000
        writer.close()

    asyncio.run(served(play))


def test_a_system_without_descriptors_ends_a_strangers_connection_and_says_so_in_one_line(monkeypatch, caplog):
    refusals = iter([errno.EMFILE, errno.ENFILE])

    class Scarce(socket.socket):
        def accept(self):
            if (number := next(refusals, None)) is not None and crowd:
                raise OSError(number, "Too many open files")
            return super().accept()

    crowd = []

    async def play(port, _):
        crowd.append(await connected(port))
        newcomer = await connected(port, OTHER)
        assert await asked(*newcomer) == b"200"
        assert await over(crowd[0][0])
        newcomer[1].close()
        crowd[0][1].close()

    monkeypatch.setattr(listener, "AT_ONCE", 1)
    monkeypatch.setattr(socket, "create_server", lambda address, **_: bound(Scarce, address))
    with caplog.at_level(logging.WARNING):
        asyncio.run(served(play))
    assert [record.name for record in caplog.records if record.name.startswith("asyncio")] == []
    assert [record.name for record in caplog.records].count("ztpm.edge.listener") >= 1


def bound(kind, address):
    listening = kind()
    listening.bind(address)
    listening.listen()
    return listening


def test_both_sides_name_the_extension_alike():
    assert caller.PLACE == caller_place.EXTENSION
