"""Lines over descriptors of all kinds, read and written by the event loop, which nobody holds up."""

import asyncio
import os
import socket

import pytest
from pep.mcp.body_screen import LINE_BYTES
from pep.mcp.stdio_wire import StdoutText, lines_of

pytestmark = pytest.mark.timeout(20)
LARGE = "x" * 3_000_000 + "\n"


def piped():
    return os.pipe()


def joined():
    """Both ends of a socket, as Node gives its children."""
    ends = socket.socketpair()
    return tuple(end.detach() for end in ends)


async def all_lines(descriptor):
    return [line async for line in lines_of(descriptor)]


def drained(descriptor):
    read = bytearray()
    while chunk := os.read(descriptor, 1 << 20):
        read += chunk
    return bytes(read)


@pytest.mark.parametrize("made", [piped, joined])
def test_lines_come_whole_and_the_last_without_its_end(made):
    reads, writes = made()
    os.write(writes, b'{"a":1}\n{"b"')
    os.write(writes, b":2}\n\nrest")
    os.close(writes)
    assert asyncio.run(all_lines(reads)) == [b'{"a":1}', b'{"b":2}', b"", b"rest"]


def test_a_file_is_read_too(tmp_path):
    (tmp_path / "lines").write_bytes(b"one\ntwo\n")
    descriptor = os.open(tmp_path / "lines", os.O_RDONLY)
    assert asyncio.run(all_lines(descriptor)) == [b"one", b"two", b""]


def test_of_a_line_that_is_too_long_only_its_beginning_is_kept():
    reads, writes = piped()

    async def run():
        long = b"y" * (5 * LINE_BYTES) + b"\nshort\n"
        writing = asyncio.create_task(asyncio.to_thread(os.write, writes, long))
        reading = asyncio.create_task(all_lines(reads))
        await writing
        os.close(writes)
        return await reading

    first, *others = asyncio.run(run())
    assert LINE_BYTES < len(first) <= 2 * LINE_BYTES
    assert others == [b"short", b""]


@pytest.mark.parametrize("made", [piped, joined])
def test_a_reader_that_does_not_read_holds_up_nobody_else(made):
    reads, writes = made()
    text, turns = StdoutText(writes), []

    async def run():
        await text.write(LARGE)
        flushing = asyncio.create_task(text.flush())
        for _ in range(5):
            await asyncio.sleep(0.01)
            turns.append(flushing.done())
        reading = asyncio.create_task(asyncio.to_thread(drained, reads))
        await flushing
        await text.write("after\n")
        await text.flush()
        os.close(writes)
        return await reading

    assert asyncio.run(run()) == (LARGE + "after\n").encode()
    assert turns == [False] * 5


def test_what_there_is_room_for_needs_no_thread(monkeypatch):
    reads, writes = piped()
    text = StdoutText(writes)
    monkeypatch.setattr("anyio.to_thread.run_sync", None)

    async def run():
        await text.write("one\n")
        await text.write("two\n")
        await text.flush()
        await text.flush()

    asyncio.run(run())
    assert os.read(reads, 100) == b"one\ntwo\n"


def test_a_reader_that_has_gone_is_an_error():
    reads, writes = piped()
    os.close(reads)
    text = StdoutText(writes)

    async def run():
        await text.write("one\n")
        await text.flush()

    with pytest.raises(BrokenPipeError):
        asyncio.run(run())
