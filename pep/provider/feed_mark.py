"""State of a follower that survives its restarts: its mark, and the revocations that it heard of.

A provider whose database was restored knows less than its enforcement points do. The mark shows that; the revocations
stay in force here.
"""

from __future__ import annotations

import json
import math
import os
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Final

from capabilities.statements import mark as statement
from capabilities.statements import revocation
from capabilities.values.errors import CapabilityError
from pep.base.errors import FeedError, PepFault
from pep.base.files import replace_file
from pep.provider.feed_place import Place

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

    from capabilities.keys.keys import PrivateKey
    from capabilities.statements.revocation import RevocationIndex
    from capabilities.values.caps import Caps

_PASSING: Final = frozenset({str(revocation.Revoked.TOKEN), str(revocation.Revoked.HOP)})
"""Kinds of things that end by themselves."""
PART_BYTES: Final = 150_000
"""Most bytes of the entries of one part of a mark, as JSON.

In base64 and with the rest they stay below the size of a statement (256 KiB).
"""
_ENTRY_BYTES: Final = 40
"""An entry without its id, as JSON, at most."""


@dataclass(frozen=True, slots=True)
class FeedMark:
    """The high-water mark that survives restarts.

    Attributes:
        issuer: issuer of the feed; another issuer's mark is no mark.
        epoch: highest accepted of its line.
        registry_version: highest accepted of its line.
        line: highest accepted.
        head: of the line's chain at `epoch`; empty in a mark of an earlier release, which knew no heads.
    """

    issuer: str
    epoch: int
    registry_version: int
    line: int
    head: str

    @classmethod
    def none(cls, issuer: str) -> FeedMark:
        """The mark of a follower that accepted nothing yet."""
        return cls(issuer, 0, 0, 0, revocation.first_head(0))

    def admits(self, index: RevocationIndex) -> bool:
        """True for an index of a newer line, or of this line and no older."""
        if index.line != self.line:
            return index.line > self.line
        return index.epoch >= self.epoch and index.registry_version >= self.registry_version

    def behind(self, index: RevocationIndex) -> Place | None:
        """Place of this mark, where it lies before the base of an index of its line; else None."""
        between = self.line == index.line and 0 < self.epoch < index.base.epoch
        return Place(self.line, self.epoch, self.head) if between and self.head else None

    def differs(self, line: int, epoch: int, head: str) -> bool:
        """True for a chain of this line that has another head at this epoch."""
        return (line, epoch) == (self.line, self.epoch) and self.head not in ("", head)


def signed_marks(mark: FeedMark, revoked: Iterable[tuple[str, str]], *, key: PrivateKey, at: int) -> tuple[str, ...]:
    """Mark with everything that this point knows to be revoked, signed in as many parts as it takes ([STM-15]).

    Args:
        mark: the high-water mark.
        revoked: (kind, id) pairs.
        key: of this point.
        at: seconds since the epoch.
    """
    parts, size = list[list[statement.MarkEntry]]([[]]), 0
    for kind, id_ in sorted(revoked):
        size += _ENTRY_BYTES + len(id_)
        if size > PART_BYTES or len(parts[-1]) == revocation.ENTRIES:
            parts.append([])
            size = _ENTRY_BYTES + len(id_)
        parts[-1].append(statement.MarkEntry(kind, id_))
    return tuple(
        statement.sign(
            statement.Mark(mark.issuer, mark.line, mark.epoch, mark.head, tuple(part), len(parts) - number, at), key
        )
        for number, part in enumerate(parts, start=1)
    )


def kept_names(path: Path, issuer: str) -> frozenset[tuple[str, str]]:
    """Everything in the file of kept revocations, (kind, id), also where another process writes it.

    Raises:
        FeedError: `STATE_UNREADABLE`.
    """
    try:
        lines = path.read_bytes().split(b"\n")[:-1] if path.exists() else []
        indexes = [revocation.read_again(str(json.loads(line)["text"])) for line in lines]
    except (OSError, ValueError, KeyError, TypeError, CapabilityError) as error:
        raise FeedError(PepFault.STATE_UNREADABLE, str(path)) from error
    return frozenset((e.kind, e.id) for index in indexes if index.issuer == issuer for e in index.entries)


class FeedMarkFile:
    """The mark on disk, replaced atomically and synced."""

    def __init__(self, path: Path) -> None:
        self.path = path

    def read(self, issuer: str) -> FeedMark:
        """The stored mark, or that of nothing when there is none yet.

        Raises:
            FeedError: `STATE_UNREADABLE` when there is one that cannot be read: starting from zero would accept a
                rolled-back feed.
        """
        try:
            stored = json.loads(self.path.read_bytes())
            mark = FeedMark(
                str(stored["issuer"]),
                int(stored["epoch"]),
                int(stored["registry_version"]),
                int(stored.get("line", 0)),
                str(stored.get("head", "")),
            )
        except FileNotFoundError:
            return FeedMark.none(issuer)
        except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
            raise FeedError(PepFault.STATE_UNREADABLE, str(self.path)) from error
        return mark if mark.issuer == issuer else FeedMark.none(issuer)

    def write(self, mark: FeedMark) -> None:
        """The mark is on disk.

        Raises:
            OSError: when it could not be made durable.
        """
        replace_file(self.path, json.dumps(asdict(mark)).encode())


@dataclass(frozen=True, slots=True)
class _Kept:
    """One signed index that brought something, and the wall time at which it came, in seconds."""

    at_s: int
    text: str
    index: RevocationIndex

    @property
    def line(self) -> bytes:
        return json.dumps({"at": self.at_s, "text": self.text}).encode() + b"\n"

    @property
    def names(self) -> frozenset[tuple[str, str]]:
        return frozenset((entry.kind, entry.id) for entry in self.index.entries)


class KeptRevocations:
    """Everything that this point heard is revoked, on disk until it would have ended.

    A line for each signed index that brought something, as it was signed. A token and a hop end with the longest
    lifetime of a token; nothing else ends by itself.

    Args:
        path: of the file, made when there is none.
        issuer: of the feed; what another issuer revoked is not kept.
        caps: hold the longest lifetime of a token.
        at: wall time in seconds.

    Attributes:
        revoked: (kind, id) pairs.

    Raises:
        FeedError: `STATE_UNREADABLE` when the file cannot be read or put in order: starting without it would forget.
    """

    def __init__(self, path: Path, *, issuer: str, caps: Caps, at: float) -> None:
        self._path = path
        try:
            content = path.read_bytes() if path.exists() else b""
            # A line without its end was never synced, and what it says was never acted on as accepted.
            whole = [self._read(line) for line in content.split(b"\n")[:-1]]
            young_s = at - caps.lifetime_s - caps.skew_s
            needed, covered = list[_Kept](), set[tuple[str, str]]()
            for kept in reversed(whole):
                living = {name for name in kept.names if name[0] not in _PASSING or kept.at_s >= young_s}
                if kept.index.issuer == issuer and not living <= covered:
                    needed.append(kept)
                    covered |= kept.names
            self._lines = needed[::-1]
            self._unsynced, self._torn = list[_Kept](), False
            if (fresh := b"".join(kept.line for kept in self._lines)) != content:
                replace_file(path, fresh)
        except (OSError, ValueError, KeyError, TypeError, CapabilityError) as error:
            raise FeedError(PepFault.STATE_UNREADABLE, str(path)) from error
        self.revoked = frozenset(covered)

    @property
    def texts(self) -> tuple[str, ...]:
        """The signed indexes, oldest first."""
        return tuple(kept.text for kept in self._lines)

    def hear(self, index: RevocationIndex, text: str, *, at: float) -> None:
        """Puts what a verified index says in force at once."""
        kept = _Kept(math.ceil(at), text, index)
        if not kept.names <= self.revoked:
            self.revoked |= kept.names
            self._unsynced.append(kept)

    @property
    def synced(self) -> bool:
        """True where all that was heard is on disk."""
        return not self._unsynced

    def sync(self) -> None:
        """All that was heard is on disk.

        Raises:
            OSError: when it could not be made durable; the next call tries again.
        """
        torn, self._torn = self._torn, True
        coming = list(self._unsynced)  # more may be heard meanwhile
        if torn:  # half a line may be there
            replace_file(self._path, b"".join(kept.line for kept in (*self._lines, *coming)))
        else:
            with self._path.open("ab") as file:
                file.write(b"".join(kept.line for kept in coming))
                file.flush()
                os.fsync(file.fileno())
        self._torn = False
        self._lines += coming
        del self._unsynced[: len(coming)]

    def _read(self, line: bytes) -> _Kept:
        stored = json.loads(line)
        text = str(stored["text"])
        return _Kept(int(stored["at"]), text, revocation.read_again(text))
