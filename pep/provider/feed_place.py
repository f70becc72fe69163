"""Place in the chain of revocations, from which pages of the feed are followed ([STM-14], [STM-18]). Pure."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, Protocol

from capabilities.statements import revocation
from pep.base.errors import FeedError, PepFault

if TYPE_CHECKING:
    from capabilities.statements.revocation import RevocationBase, RevocationIndex

PUT_BACK: Final = "a database that was put back needs `ztpm idp restore`"


class Held(Protocol):
    """High-water mark that a chain must meet."""

    def differs(self, line: int, epoch: int, head: str) -> bool:
        """True for a chain of the mark's line that has another head at the mark's epoch."""
        ...


@dataclass(frozen=True, slots=True)
class Place:
    """Epoch of a line, and the head of its chain there."""

    line: int
    epoch: int
    head: str

    def after(self, index: RevocationIndex, mark: Held, *, base: RevocationBase) -> Place:
        """The place behind a page, whose chain meets the mark, the base and, at its end, the index.

        Raises:
            FeedError: `FEED_FORKED`.
        """
        if index.line != self.line:
            raise FeedError(PepFault.FEED_FORKED, f"line {index.line} after {self.line}")
        epoch, head = self.epoch, self.head
        for entry in index.entries:
            if entry.epoch <= epoch:
                continue  # of the base, whose head stands for it
            epoch, head = entry.epoch, revocation.next_head(head, entry.epoch, entry.kind, entry.id)
            if mark.differs(index.line, epoch, head) or (epoch == base.epoch and head != base.head):
                raise _forked(epoch)
        if index.last == index.epoch and index.head != head:
            raise _forked(index.epoch)
        return Place(self.line, epoch, head)


def first_place(index: RevocationIndex, mark: Held) -> Place:
    """The place from which the chain of a first page goes on: its base, or the beginning of its line.

    Raises:
        FeedError: `FEED_FORKED` for a base that differs from the mark.
    """
    if index.base == revocation.NO_BASE:
        return Place(index.line, 0, revocation.first_head(index.line))
    if mark.differs(index.line, index.base.epoch, index.base.head):
        raise _forked(index.base.epoch)
    return Place(index.line, index.base.epoch, index.base.head)


def _forked(epoch: int) -> FeedError:
    return FeedError(PepFault.FEED_FORKED, f"another history up to epoch {epoch}: {PUT_BACK}")
