"""Listener: connections as they come out of it."""

import asyncio
import socket

from ztpm.edge.listener import Listener, bound
from ztpm.edge.places import Bounds, Places


def test_no_part_of_an_answer_waits_for_the_one_before():
    seen = []

    class Seen(asyncio.Protocol):
        def connection_made(self, transport):
            seen.append(transport.get_extra_info("socket").getsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY))
            transport.close()

    async def go():
        (listening,) = bound("127.0.0.1", 0)
        listener = Listener(listening, places=Places(Bounds()), protocol=lambda _: Seen(), tls=None)
        reader, writer = await asyncio.open_connection(*listening.getsockname())
        assert await asyncio.wait_for(reader.read(), 10) == b""
        writer.close()
        listener.close()

    asyncio.run(go())
    assert seen == [1]
