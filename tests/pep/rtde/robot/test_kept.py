"""Connection of our own to a controller's port: it comes back from any end."""

import asyncio
from contextlib import asynccontextmanager

import pytest
from pep.rtde.robot.reconnecting import ReconnectingConnection
from pep.rtde.wire.messages import WireError, WireFault

from pep.rtde.robot import reconnecting

HOST = "127.0.0.1"

pytestmark = pytest.mark.clause("RTDE-18")


@pytest.fixture(autouse=True)
def impatient(monkeypatch):
    monkeypatch.setattr(reconnecting, "SILENCE_S", 0.2)
    monkeypatch.setattr(reconnecting, "RETRY_S", 0.02)


class Robot:
    """A port that does `then` with each client, after it has heard what that says first."""

    def __init__(self, then):
        self.then, self.heard, self.gone = then, [], 0

    async def _serve(self, reader, writer):
        self.heard.append(await reader.readexactly(5))
        await self.then(writer)
        await reader.read()
        self.gone += 1
        writer.close()

    @asynccontextmanager
    async def listening(self, port=0):
        server = await asyncio.start_server(self._serve, HOST, port)
        try:
            yield server.sockets[0].getsockname()[1]
        finally:
            server.close()


class Client:
    def __init__(self, port):
        self.heard, self.lost, self.begun = [], 0, 0
        self.kept = ReconnectingConnection(HOST, port, begin=self._begin, heard=self._heard, lost=self._lost)

    def _begin(self):
        self.begun += 1
        return b"first"

    def _heard(self, content):
        self.heard.append(content)
        if content == b"bad":
            raise WireError(WireFault.KIND, "bad")

    def _lost(self):
        self.lost += 1


async def until(what):
    async with asyncio.timeout(5):
        while not what():
            await asyncio.sleep(0.005)


async def ended(writer):
    writer.close()


async def silent(writer):
    pass


async def malformed(writer):
    writer.write(b"bad")


@pytest.mark.parametrize("then", [ended, silent, malformed])
def test_it_is_had_again_and_begins_as_the_first(then):
    async def scenario():
        broken = []
        asyncio.get_running_loop().set_exception_handler(lambda _, told: broken.append(told))
        robot = Robot(then)
        async with robot.listening() as port:
            client = Client(port)
            await client.kept.begin()
            await until(lambda: len(robot.heard) >= 3)
            assert set(robot.heard) == {b"first"}
            assert client.begun - client.lost in (0, 1)
            assert client.lost >= 2
            client.kept.close()
            await until(lambda: robot.gone >= len(robot.heard) - 1)
            assert not client.kept.connected
            assert broken == [], "none of it is a fault of ours"

    asyncio.run(scenario())


def test_who_says_something_now_and_then_is_kept():
    async def speaking(writer):
        for _ in range(12):
            await asyncio.sleep(0.05)
            writer.write(b"here")

    async def scenario():
        robot = Robot(speaking)
        async with robot.listening() as port:
            client = Client(port)
            await client.kept.begin()
            await until(lambda: len(client.heard) >= 12)
            assert (client.begun, client.lost, client.kept.connected) == (1, 0, True)
            client.kept.close()

    asyncio.run(scenario())


def test_a_robot_that_comes_late_is_waited_for():
    async def scenario():
        robot = Robot(malformed)
        async with robot.listening() as port:
            pass
        client = Client(port)
        begins = asyncio.create_task(client.kept.begin())
        await until(lambda: client.lost >= 3)
        assert not begins.done()
        assert not client.kept.connected
        client.kept.send(b"for nobody")
        async with robot.listening(port):
            await asyncio.wait_for(begins, 5)
            await until(lambda: client.heard)
            client.kept.close()
            begun = client.begun
            await asyncio.sleep(0.1)
            assert client.begun == begun, "closed is for good"

    asyncio.run(scenario())
