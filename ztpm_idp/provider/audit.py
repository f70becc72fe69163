"""The ledger for auditors: it is followed into its tree and index, proven by checkpoints and paths, and searched."""

from __future__ import annotations

import asyncio
import logging
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Final

from capabilities.log import merkle, tree_head
from ztpm_idp.domain.codes import IdpCode
from ztpm_idp.provider import cef
from ztpm_idp.provider.problems import Problem
from ztpm_idp.store.audit import Audit
from ztpm_idp.store.errors import ConflictError, StoreUnavailableError

if TYPE_CHECKING:
    from collections.abc import Callable

    from capabilities.log.merkle import Node
    from capabilities.log.tree_head import EntryProof, TreeHead
    from ztpm_idp.domain.audit import AuditRow
    from ztpm_idp.provider.feed import Deployment
    from ztpm_idp.store.audit import Search
    from ztpm_idp.store.engine import Store

logger = logging.getLogger(__name__)
FOLLOW_PERIOD_S: Final = 30.0
"""Time between two looks at the ledger while nobody asks; a question takes in what came since."""
MOST_ENTRIES: Final = 1_000
"""Entries of one answer to a search."""
ANSWER_BYTES: Final = 4_194_304
"""Bytes of the lines of one answer, the first line apart: that of an entry may be a megabyte."""


class LedgerGapError(StoreUnavailableError):
    """An entry is missing where numbers have no gap: the database was changed by hand."""


class LedgerFollower:
    """Takes the ledger's entries into tree and index, one follower at a time in this process."""

    def __init__(self, store: Store) -> None:
        self._store = store
        self._turn = asyncio.Lock()

    async def through(self) -> int:
        """Number of entries, all of those that were committed before the call, that tree and index hold.

        Raises:
            StoreUnavailableError: the store failed, or lacks an entry.
        """
        async with self._store.read() as view:
            size = await view.audit.size()
            followed = await view.audit.followed()
        if followed >= size:
            return size
        async with self._turn:
            while followed < size:
                before = followed
                try:
                    async with self._store.beside() as connection:
                        followed = await Audit(connection).follow()
                    if followed == before:
                        raise LedgerGapError
                except ConflictError:  # another process was faster
                    async with self._store.read() as view:
                        followed = await view.audit.followed()
        return size

    async def run(self, *, period_s: float = FOLLOW_PERIOD_S) -> None:
        """Follows for ever, so that a question finds little left to do."""
        while True:
            await asyncio.sleep(period_s)
            try:
                await self.through()
            except StoreUnavailableError as error:
                logger.error("the ledger was not followed: %s", type(error.__cause__).__name__)  # noqa: TRY400 - no text of the error


async def _nodes(audit: Audit, asks: Callable[[Node], object]) -> Node:
    """The nodes that a computation reads, fetched at once: it runs once with nothing but their names."""
    wanted = set[tuple[int, int]]()

    def named(level: int, index: int) -> bytes:
        wanted.add((level, index))
        return merkle.EMPTY_ROOT

    asks(named)
    return await audit.node(wanted)


async def checkpoint(provider: Deployment, follower: LedgerFollower) -> str:
    """The signed checkpoint of the ledger as it is."""
    size = await follower.through()
    async with provider.store.read() as view:
        return _signed(provider, await _head(provider, view.audit, size))


async def _head(provider: Deployment, audit: Audit, size: int) -> TreeHead:
    node = await _nodes(audit, lambda named: merkle.root(size, named))
    return tree_head.TreeHead(tree_head.origin_of(provider.settings.issuer), size, merkle.root(size, node))


def _signed(provider: Deployment, head: TreeHead) -> str:
    return tree_head.sign(head, provider.keys.ledger)


async def entry_proof(provider: Deployment, follower: LedgerFollower, entry: int | str) -> EntryProof:
    """Proof that an entry stands in the ledger as it is.

    Args:
        provider: of this deployment.
        follower: of its ledger.
        entry: its number, from 1, or its hash.

    Raises:
        Problem: `ENTRY_UNKNOWN`.
    """
    size = await follower.through()
    async with provider.store.read() as view:
        number = entry if isinstance(entry, int) else await view.audit.number_of(entry)
        if number is None or not 1 <= number <= size:
            raise Problem(IdpCode.ENTRY_UNKNOWN)
        index = number - 1
        node = await _nodes(view.audit, lambda named: merkle.inclusion(index, size, named))
        head = await _head(provider, view.audit, size)
    return tree_head.EntryProof(index, tuple(merkle.inclusion(index, size, node)), _signed(provider, head))


async def consistency(provider: Deployment, follower: LedgerFollower, *, old: int) -> tuple[list[bytes], str]:
    """Proof that the ledger goes on from its first `old` entries, and the checkpoint that it leads to.

    Raises:
        Problem: `ENTRY_UNKNOWN` where the ledger is shorter.
    """
    size = await follower.through()
    if old > size:
        raise Problem(IdpCode.ENTRY_UNKNOWN, f"the ledger has {size} entries")
    async with provider.store.read() as view:
        node = await _nodes(view.audit, lambda named: merkle.consistency(old, size, named))
        head = await _head(provider, view.audit, size)
    return merkle.consistency(old, size, node), _signed(provider, head)


async def entry_line(provider: Deployment, number: int) -> bytes:
    """One entry, as the ledger has it.

    Raises:
        Problem: `ENTRY_UNKNOWN`.
    """
    async with provider.store.read() as view:
        found = await view.audit.entry(number)
    if found is None:
        raise Problem(IdpCode.ENTRY_UNKNOWN)
    return found[0]


@dataclass(frozen=True, slots=True)
class Found:
    """Answer to a search.

    Attributes:
        rows: in order, each with its entry's hash.
        lines: the entries of the rows as lines, where they were asked for.
        more_after: number to go on after, or before; None where there is no more.
        size: entries of the ledger that were looked at.
    """

    rows: tuple[tuple[AuditRow, str], ...]
    lines: tuple[bytes, ...]
    more_after: int | None
    size: int


async def search(provider: Deployment, follower: LedgerFollower, asked: Search, *, whole: bool) -> Found:
    """The entries that meet a question, at most `most` of them and `ANSWER_BYTES` of lines.

    Args:
        provider: of this deployment.
        follower: of its ledger.
        asked: the question; its `through` is set here, so that all pages of one moment agree.
        whole: the entries' lines too.
    """
    size = await follower.through()
    async with provider.store.read() as view:
        found = await view.audit.search(replace(asked, through=size, most=asked.most + 1))
        more, found = len(found) > asked.most, found[: asked.most]
        lines = dict[int, bytes]()
        if whole:
            room, kept = ANSWER_BYTES, 0
            for _, _, length in found:
                room -= length
                if room < 0 and kept:
                    break
                kept += 1
            more, found = more or kept < len(found), found[:kept]
            lines = await view.audit.lines(row.seq for row, _, _ in found)
    return Found(
        tuple((row, digest) for row, digest, _ in found),
        tuple(lines[row.seq] for row, _, _ in found) if whole else (),
        found[-1][0].seq if more and found else None,
        size,
    )


def as_cef(found: Found) -> str:
    """The entries as CEF events, a line each."""
    return "".join(
        cef.event(row, digest, line) + "\n" for (row, digest), line in zip(found.rows, found.lines, strict=True)
    )
