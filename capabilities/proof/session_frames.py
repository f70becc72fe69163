"""An open session: messages in, frames out, and back. One MAC key for each direction, a counter in every MAC.

Clauses [SES-6] to [SES-9] in docs/spec.md. A frame says: the other end sent this message, as its n-th. It does not say
when: frames can be held back unseen, so a receiver that must not act late asks for a heartbeat. Nothing
is encrypted.
"""

from __future__ import annotations

import hmac
import struct
import threading
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from cryptography.hazmat.primitives.hashes import SHA256
from cryptography.hazmat.primitives.hmac import HMAC

from capabilities.proof.key_agreement import PROFILE
from capabilities.values.errors import Fault, FaultCode

if TYPE_CHECKING:
    from capabilities.values.caps import Caps

LAST_COUNTER: Final = 2**64 - 1
MOST_MISSING: Final = 1_024
"""Longest gap in frames that a carriage with losses may have: two seconds of a stream at 500 Hz.

A longer gap is an outage.
"""
_LABEL: Final = PROFILE.encode() + b" frame"
_HEAD: Final = struct.Struct(">BQ")
"""Kind and counter, as the frame has them."""
_IMAGE: Final = struct.Struct(">BQI")
"""Kind, counter and length of the message, as the MAC covers them."""
_TAG_BYTES: Final = 32
OVERHEAD_BYTES: Final = _HEAD.size + _TAG_BYTES
_MESSAGE: Final = 0
_END: Final = 1


@dataclass(frozen=True, slots=True)
class SessionMessage:
    """A message that the other end sent in this session, after all that were opened before.

    Attributes:
        body: as it was sealed.
        missing: how many frames between the one opened before and this one never came; 0 on a carriage that loses none.
    """

    body: bytes
    missing: int


@dataclass(frozen=True, slots=True)
class End:
    """End of a session by the other end: no message was cut off but those that `missing` counts."""

    missing: int


class Session:
    """One end of an open session. `seal` and `open` may be called at once from several threads.

    A refused frame changes nothing. A session ends for good with an end frame, sealed or opened, or at a time outside
    its window.


    Args:
        sending: key of the direction away from this end, 32 bytes.
        receiving: key of the other direction.
        at: when it opened, seconds since the epoch.
        not_after: when it ends, seconds since the epoch, excluded.
        most_missing: how many frames in a row may be missing: 0 on a carriage that neither loses nor reorders (a pipe,
            TCP, HTTP), where a gap means that frames were taken out; else at most `MOST_MISSING`.
        caps: largest message, and skew.

    Raises:
        ValueError: for another `most_missing`.
    """

    __slots__ = (
        "_from",
        "_lock",
        "_longest_s",
        "_most_bytes",
        "_most_missing",
        "_opened",
        "_over",
        "_receiving",
        "_sealed",
        "_sending",
        "_until",
    )

    def __init__(
        self, *, sending: bytes, receiving: bytes, at: float, not_after: int, most_missing: int, caps: Caps
    ) -> None:
        if not 0 <= most_missing <= MOST_MISSING:
            raise ValueError(f"{most_missing} frames may not be missing")
        self._sending = _keyed(sending)
        self._receiving = _keyed(receiving)
        self._from = at - caps.skew_s
        self._until = not_after
        self._longest_s = caps.skew_s + caps.session_lifetime_s
        self._most_missing = most_missing
        self._most_bytes = caps.frame_bytes
        self._sealed = 0
        self._opened = 0
        self._over = False
        self._lock = threading.Lock()

    @property
    def over(self) -> bool:
        """True once either end has ended the session, or a call found it outside its time.

        A session whose time has passed since the last call still answers False.
        """
        return self._over

    def renew(self, not_after: int, *, at: float) -> Fault | None:
        """Moves the end of the open session, and nothing else of it: keys and counters go on.

        Args:
            not_after: when it ends from now on, seconds since the epoch, excluded.
            at: seconds since the epoch.

        Returns:
            None; or `PROOF_STALE` when the session is over, or for an end that is past, or later than that of a session
            that is opened now. Then nothing has changed.
        """
        with self._lock:
            if (over := self._ended(at)) is not None:
                return over
            # [SES-10] as for an opening
            if not at < not_after <= at + self._longest_s:
                return _NO_END
            self._until = not_after
            return None

    def seal(self, message: bytes, *, at: float) -> bytes | Fault:
        """The frame of a message to the other end; or the fault.

        Args:
            message: at most `Caps.frame_bytes`.
            at: seconds since the epoch.

        Returns:
            The frame; or `PROOF_STALE` when the session is over, `PROOF_MALFORMED` for a message that is too large.
        """
        return self._seal(_MESSAGE, message, at)

    def close(self, *, at: float) -> bytes | Fault:
        """The frame that ends the session, in both directions and at once for this end; or `PROOF_STALE`."""
        return self._seal(_END, b"", at)

    def open(self, frame: bytes, *, at: float) -> SessionMessage | End | Fault:
        """Message or end that the other end sent, or the first fault of the frame.

        Args:
            frame: as it came, delimited by its carriage.
            at: seconds since the epoch.

        Returns:
            The message or the end; or `PROOF_STALE` when the session is over, `PROOF_MALFORMED` for a frame of no
            possible length or kind, `PROOF_WRONG_KEY` when it was not made with the other end's key as it stands,
            `REPLAYED` when its counter is not above the last one, `PROOF_NOT_FOR_THIS_REQUEST` when more frames are
            missing before it than may be.
        """
        with self._lock:
            # [SES-6] the session is not over
            if (over := self._ended(at)) is not None:
                return over
            # [SES-7] a frame of this direction of this session: bounded, then authentic, and only then read
            if not OVERHEAD_BYTES <= len(frame) <= OVERHEAD_BYTES + self._most_bytes:
                return _MALFORMED
            message = frame[_HEAD.size : -_TAG_BYTES]
            kind, counter = _HEAD.unpack_from(frame)
            if not hmac.compare_digest(_tag(self._receiving, kind, counter, message), frame[-_TAG_BYTES:]):
                return _NOT_THEIRS
            if kind != _MESSAGE and (kind != _END or message):
                return _MALFORMED
            # [SES-8] after the last one, and not too far after it
            missing = counter - self._opened - 1
            if missing < 0:
                return _REPLAYED
            if missing > self._most_missing:
                return _GAP
            self._opened = counter
            # [SES-9] an end is an end
            if kind == _END:
                self._over = True
                return End(missing)
            return SessionMessage(message, missing)

    def _seal(self, kind: int, message: bytes, at: float) -> bytes | Fault:
        with self._lock:
            if (over := self._ended(at)) is not None:
                return over
            if len(message) > self._most_bytes:
                return _MALFORMED
            if self._sealed >= LAST_COUNTER:
                return _EXHAUSTED
            self._sealed += 1
            self._over = kind == _END
            return _HEAD.pack(kind, self._sealed) + message + _tag(self._sending, kind, self._sealed, message)

    def _ended(self, at: float) -> Fault | None:
        if self._over:
            return _OVER
        if not self._from <= at < self._until:
            self._over = True
            return _OVER
        return None


def _keyed(key: bytes) -> HMAC:
    """MAC state that every frame of one direction starts from.

    A frame is MACed by a copy of it, in a third of the time.
    """
    begun = HMAC(key, SHA256())
    begun.update(_LABEL)
    return begun


def _tag(begun: HMAC, kind: int, counter: int, message: bytes) -> bytes:
    mac = begun.copy()
    mac.update(_IMAGE.pack(kind, counter, len(message)) + message)
    return mac.finalize()


_OVER: Final = Fault(FaultCode.PROOF_STALE, "SES-6", "the session is over")
_NO_END: Final = Fault(FaultCode.PROOF_STALE, "SES-10", "no end that a session may have")
_MALFORMED: Final = Fault(FaultCode.PROOF_MALFORMED, "SES-7", "not a frame")
_NOT_THEIRS: Final = Fault(FaultCode.PROOF_WRONG_KEY, "SES-7", "not a frame of this session and direction")
_REPLAYED: Final = Fault(FaultCode.REPLAYED, "SES-8", "not after the last frame")
_GAP: Final = Fault(FaultCode.PROOF_NOT_FOR_THIS_REQUEST, "SES-8", "frames are missing before it")
_EXHAUSTED: Final = Fault(FaultCode.PROOF_STALE, "SES-8", "no counter is left")
