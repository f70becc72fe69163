"""A client's word is acknowledged before any answer, so that its next command is not held back."""

import asyncio
import fcntl
import socket
import struct
import termios

import pytest
from capabilities.proof.session_frames import Session
from capabilities.values.caps import DEFAULT
from pep.base.clock import SystemClock
from pep.rtde.lease.accepted_connection import AcceptedConnection
from pep.rtde.lease.lease_connection import LeaseConnection
from pep.rtde.lease.lease_messages import Open, delimited, encode

ROUNDS = 20
WAIT_S = 10


def unacknowledged(client):
    """Bytes that the other end's system has not acknowledged."""
    return struct.unpack("i", fcntl.ioctl(client.fileno(), termios.TIOCOUTQ, b"\0" * 4))[0]


class Heard(AcceptedConnection):
    """A connection that is answered: from then on the system would wait with acknowledgements for the next answer."""

    def __init__(self, seen):
        super().__init__()
        self.seen = seen

    def connection_made(self, transport):
        super().connection_made(transport)
        self.begin(self)

    def received(self, content):
        self.seen()
        self.send(content)

    def left(self):
        pass


def carrier(seen):
    clock = SystemClock()
    keys = {"sending": b"b" * 32, "receiving": b"a" * 32}
    session = Session(**keys, at=clock.wall_s(), not_after=int(clock.wall_s()) + 60, most_missing=0, caps=DEFAULT)

    def heard(_):
        seen()
        carried.say_again()

    class Answering(LeaseConnection):
        def say_again(self):
            self._transport.write(b"answer")

    carried = Answering(session, asking=False, clock=clock, heard=heard, ended=lambda _: None, flowing=lambda _: None)
    return carried


def said():
    """As the program's end of a carriage says it: any word will do."""
    clock = SystemClock()
    keys = {"sending": b"a" * 32, "receiving": b"b" * 32}
    session = Session(**keys, at=clock.wall_s(), not_after=int(clock.wall_s()) + 60, most_missing=0, caps=DEFAULT)
    return [delimited(session.seal(encode(Open(line, 30004)), at=clock.wall_s())) for line in range(10)]


async def left_unacknowledged(made, words):
    """Number of unacknowledged bytes each time that a word was acted on."""
    left, again = [], asyncio.Event()

    def seen():
        left.append(unacknowledged(client))
        again.set()

    loop = asyncio.get_running_loop()
    server = await loop.create_server(lambda: made(seen), "127.0.0.1", 0)
    with socket.create_connection(server.sockets[0].getsockname()) as client:
        for word in words:
            again.clear()
            client.sendall(word)
            await asyncio.wait_for(again.wait(), WAIT_S)
    server.close()
    return left


@pytest.mark.parametrize(("made", "words"), [(Heard, [b"command"] * ROUNDS), (carrier, said())])
def test_what_came_is_acknowledged_when_it_is_acted_on(made, words):
    assert asyncio.run(left_unacknowledged(made, words)) == [0] * len(words)
