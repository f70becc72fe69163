"""A client that says "stop" and goes has said it: no end of the connection overtakes it, either way."""

import asyncio
import socket

import pytest
from pep.base.stop_model import STOP_DECELERATION_RAD_S2
from pep.rtde.lease.accepted_connection import AcceptedConnection
from pep.rtde.line.gateway import ScriptPort, stop_text
from pep.rtde.robot.connections import Upstream

pytestmark = pytest.mark.clause("RTDE-13")

STOP = b"stopj(2.0)\n"
STATE = b"\0\0\0\4"
WAIT_S = 10


class Heard:
    """A line that keeps what it was told."""

    def __init__(self):
        self.words = []

    def received(self, content):
        self.words.append(content)

    def left(self):
        self.words.append(None)


class Served(AcceptedConnection):
    """A connection that is served at once, or later."""

    def __init__(self, *, at_once):
        super().__init__()
        self.at_once, self.line, self.made = at_once, Heard(), asyncio.Event()

    def connection_made(self, transport):
        super().connection_made(transport)
        if self.at_once:
            self.begin(self.line)
        self.made.set()


@pytest.mark.parametrize("at_once", [True, False])
@pytest.mark.parametrize("said", [(STOP,), (b"x", STOP)])
def test_what_was_said_last_is_heard_where_writing_fails_first(at_once, said):
    async def scenario():
        served = Served(at_once=at_once)
        server = await asyncio.get_running_loop().create_server(lambda: served, "127.0.0.1", 0)
        client = socket.create_connection(server.sockets[0].getsockname()[:2])
        await served.made.wait()
        for piece in said[:-1]:
            client.sendall(piece)
            await asyncio.sleep(0.05)
        served.send(STATE)
        client.sendall(said[-1])
        assert client.recv(1)
        client.close()  # with bytes unread: a reset
        served.send(STATE)
        await asyncio.sleep(0.05)
        if not at_once:
            assert served.line.words == []
            served.begin(served.line)
        server.close()
        return served.line.words

    words = asyncio.run(asyncio.wait_for(scenario(), WAIT_S))
    assert words[-1] is None
    assert words.count(None) == 1
    assert b"".join(words[:-1]) == b"".join(said)


def test_a_connection_that_ends_as_it_should_is_heard_once():
    async def scenario():
        served = Served(at_once=True)
        server = await asyncio.get_running_loop().create_server(lambda: served, "127.0.0.1", 0)
        client = socket.create_connection(server.sockets[0].getsockname()[:2])
        client.sendall(STOP)
        client.close()
        while None not in served.line.words:
            await asyncio.sleep(0.005)
        server.close()
        return served.line.words

    assert asyncio.run(asyncio.wait_for(scenario(), WAIT_S)) == [STOP, None]


class Slow:
    """A controller that says its state, and looks at what it was told only after it has said it again."""

    def __init__(self):
        self.socket = socket.create_server(("127.0.0.1", 0))

    def port(self):
        return self.socket.getsockname()[1]

    async def told(self, wait_s):
        loop = asyncio.get_running_loop()
        self.socket.setblocking(False)
        link, _ = await loop.sock_accept(self.socket)
        link.setblocking(False)
        with link:
            await loop.sock_sendall(link, STATE)
            await asyncio.sleep(wait_s)  # whoever spoke has gone by now
            link.send(STATE)
            text = b""
            while part := await loop.sock_recv(link, 4096):
                text += part
            return text


@pytest.mark.parametrize("at_once", [False, True])
def test_a_stop_arrives_at_a_controller_that_says_something_first(monkeypatch, at_once):
    """The line is left with the controller's state unread; `at_once`, what it would be without our care."""

    async def scenario():
        slow, back = Slow(), Served(at_once=False)
        line = ScriptPort(back, stop_deceleration_rad_s2=STOP_DECELERATION_RAD_S2, stopping=lambda _: None)
        monkeypatch.setattr("pep.rtde.line.gateway.StreamPort._heard", lambda *_: None)
        told = asyncio.ensure_future(slow.told(0.2))
        assert await line.robot.reach("127.0.0.1", slow.port()) is None
        transport = line.robot._transport
        transport.pause_reading()  # its state comes between our last look and our going
        await asyncio.sleep(0.05)
        line.received(STOP)
        transport.resume_reading()
        transport.close() if at_once else line.left()
        return await told

    if at_once:
        with pytest.raises(OSError):
            asyncio.run(asyncio.wait_for(scenario(), WAIT_S))
    else:
        assert asyncio.run(asyncio.wait_for(scenario(), WAIT_S)) == stop_text(STOP_DECELERATION_RAD_S2)


def test_a_controller_that_keeps_the_connection_is_left_in_time(monkeypatch):
    async def scenario():
        monkeypatch.setattr("pep.rtde.robot.connections.LINGER_S", 0.1)
        heard, gone = [], []
        upstream = Upstream(heard.append, lambda: gone.append(1))
        with socket.create_server(("127.0.0.1", 0)) as server:
            assert await upstream.reach(*server.getsockname()) is None
            link, _ = server.accept()
            with link:
                upstream.close()
                upstream.close()
                assert not upstream.connected
                link.sendall(STATE)
                assert link.recv(1) == b""
                await asyncio.sleep(0.3)
                with pytest.raises(OSError):
                    for _ in range(3):
                        link.sendall(STATE)
                        await asyncio.sleep(0.01)
        assert (heard, gone) == ([], [])

    asyncio.run(asyncio.wait_for(scenario(), WAIT_S))
