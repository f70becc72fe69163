"""Times of words out of a carriage: commands at once, the controller's words together."""

import asyncio

import pytest
from capabilities.proof.session_frames import End, Session
from capabilities.values.caps import DEFAULT
from pep.base.clock import SystemClock
from pep.rtde.lease.lease import SILENCE_MS, LeaseEnding
from pep.rtde.lease.lease_connection import LeaseConnection
from pep.rtde.lease.lease_messages import Bytes, LeaseOver, Open, Opened, SessionFrameSplitter, decode

KEYS = {True: (b"a" * 32, b"b" * 32), False: (b"b" * 32, b"a" * 32)}


def session(*, asking):
    clock, (sending, receiving) = SystemClock(), KEYS[asking]
    until = int(clock.wall_s()) + 60
    return Session(
        sending=sending, receiving=receiving, at=clock.wall_s(), not_after=until, most_missing=0, caps=DEFAULT
    )


class Wire(asyncio.Transport):
    """Keeps each write."""

    def __init__(self):
        super().__init__()
        self.writes, self.ended = [], False

    def write(self, data):
        self.writes.append(bytes(data))

    def is_closing(self):
        return self.ended

    def can_write_eof(self):
        return True

    def write_eof(self):
        self.ended = True

    def close(self):
        self.ended = True


def begun(*, asking, over=lambda _: None):
    """One end with an open line, and its wire."""
    carrier = LeaseConnection(
        session(asking=asking),
        asking=asking,
        clock=SystemClock(),
        heard=lambda _: None,
        ended=over,
        flowing=lambda _: None,
    )
    wire = Wire()
    carrier.connection_made(wire)
    if asking:
        carrier.say(Open(0, 30004))
        carrier._lines.heard(Opened(0))
    else:
        carrier._lines.heard(Open(0, 30004))
        carrier.say(Opened(0))
    return carrier, wire


def words(wire, *, asking):
    """Words that the other end reads in all that was written."""
    other, clock = session(asking=not asking), SystemClock()
    opened = [other.open(frame, at=clock.wall_s()) for frame in SessionFrameSplitter().feed(b"".join(wire.writes))]
    return [each if isinstance(each, End) else decode(each.body) for each in opened]


SAID = [Bytes(0, bytes([n]) * 40) for n in range(5)]


def test_a_command_is_written_when_it_is_said():
    async def scenario():
        carrier, wire = begun(asking=True)
        for word in SAID:
            before = len(wire.writes)
            carrier.say(word)
            assert len(wire.writes) == before + 1
        assert [w for w in words(wire, asking=True) if isinstance(w, Bytes)] == SAID

    asyncio.run(scenario())


def test_what_the_controller_says_on_several_lines_is_written_once():
    async def scenario():
        carrier, wire = begun(asking=False)
        await asyncio.sleep(0.01)
        for _ in range(2):
            wire.writes.clear()
            for word in SAID:
                carrier.say(word)
            assert wire.writes == []
            await asyncio.sleep(0.01)
            assert len(wire.writes) == 1

    asyncio.run(scenario())


@pytest.mark.parametrize("later", [False, True])
def test_what_was_said_before_the_end_is_written_before_it(later):
    async def scenario():
        told = []
        carrier, wire = begun(asking=False, over=told.append)
        for word in SAID:
            carrier.say(word)
        if later:
            await asyncio.sleep(0.01)
        carrier.close(LeaseEnding.AUTHORITY)
        assert wire.ended
        found = words(wire, asking=False)
        assert [w for w in found if isinstance(w, Bytes)] == SAID
        assert [type(w) for w in found[-2:]] == [LeaseOver, End]
        await asyncio.sleep(0.01)
        assert len(words(wire, asking=False)) == len(found)
        assert told == [LeaseEnding.AUTHORITY]

    asyncio.run(scenario())


def test_silence_is_noticed_when_it_has_lasted_and_not_a_beat_later():
    async def scenario():
        loop, told = asyncio.get_running_loop(), []
        carrier, _ = begun(asking=False, over=told.append)
        for _ in range(3):
            assert carrier._silence.when() - loop.time() <= (SILENCE_MS + 1) / 1000
            carrier._listen()
        carrier._heard_ms -= SILENCE_MS + 1
        carrier._listen()
        assert told == [LeaseEnding.SILENT]
        carrier._listen()
        assert told == [LeaseEnding.SILENT]

    asyncio.run(scenario())
