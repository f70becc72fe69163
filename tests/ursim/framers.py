"""Clients of the primary and real-time ports: their bytes cut into frames, however they were torn, and read whole."""

import struct

from pep.rtde.wire.frame_splitter import LENGTH, FrameSplitter, LengthError
from pep.rtde.wire.messages import WireError, WireFault
from pep.rtde.wire.primary_state import PARTS, OtherPart
from pep.rtde.wire.realtime_frames import REALTIME_SIZE, RealtimeState

from pep.rtde.wire import primary_frames as f


class PrimaryFramer:
    """Of 30001 or 30002. Raises `WireError` as `PrimaryCutter`, and for a frame that contradicts itself."""

    def __init__(self):
        self._cutter = f.PrimaryFrameSplitter()

    def feed(self, received):
        return [decoded(kind, body) for kind, body in self._cutter.feed(received)]


def decoded(kind, body):
    if kind == f.ROBOT_STATE:
        return f.PrimaryState(tuple(parts(body)))
    return f.decode_message(body) if kind == f.MESSAGE else f.OtherFrame(kind, body)


def parts(body):
    at = 0
    while at < len(body):
        if len(body) - at < f.HEADER:
            raise WireError(WireFault.PAYLOAD, "a part without its header")
        size, kind = struct.unpack_from(">iB", body, at)
        f.check_size(size, len(body) - at)
        held = body[at + f.HEADER : at + size]
        yield PARTS[kind].unpack(held) if kind < len(PARTS) else OtherPart(kind, held)
        at += size


class RealtimeFramer:
    """Of 30003. Raises `WireError` for a length that is not `REALTIME_SIZE`."""

    def __init__(self):
        self._cutter = FrameSplitter(REALTIME_SIZE, REALTIME_SIZE, itself=True)

    def feed(self, received):
        try:
            return [RealtimeState.unpack(piece[LENGTH:]) for piece in self._cutter.feed(received)]
        except LengthError as error:
            raise WireError(WireFault.SIZE, f"a real-time state of {error.length} bytes") from error
