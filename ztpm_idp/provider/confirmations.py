"""Marks by which enforcement points confirm how far they follow the feed ([STM-17])."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, Final

from capabilities.statements import mark, statement_form
from capabilities.values.caps import DEFAULT
from capabilities.values.errors import FaultCode, StatementError
from ztpm_idp.provider.problems import Problem
from ztpm_idp.store.errors import ConflictError
from ztpm_idp.store.points import Points

if TYPE_CHECKING:
    from ztpm_idp.provider.feed import Deployment
    from ztpm_idp.store.engine import Store

MARK_AGE_S: Final = 30
"""Oldest mark that is taken, seconds: that of a proof."""
MARK_SKEW_S: Final = 5
"""Seconds by which its clock may be ahead: those of a proof."""
CONNECTED_MS: Final = 30_000
"""Milliseconds since a point was heard after which it counts as gone: three of its periods."""
_TRIES: Final = 3


class Confirmations:
    """Writes marks, those of all who came at the same time in one transaction."""

    def __init__(self, store: Store) -> None:
        self._store = store
        self._turn = asyncio.Lock()
        self._waiting: dict[str, tuple[int, int, int]] = {}

    async def take(self, pep: str, *, line: int, epoch: int, at_ms: int) -> None:
        """The mark of an enforcement point is kept, durably.

        Raises:
            StoreUnavailableError: it may not be.
        """
        newest = self._waiting.get(pep, (-1, -1, 0))
        self._waiting[pep] = (*max((line, epoch), newest[:2]), at_ms)
        async with self._turn:
            if pep not in self._waiting:
                return  # with those of another's turn
            marks, self._waiting = self._waiting, {}
            for tries in range(1, _TRIES + 1):
                try:
                    async with self._store.beside() as connection:
                        await Points(connection).confirm(marks)
                except ConflictError:  # another process was the first to hear of a point
                    if tries == _TRIES:
                        raise
                else:
                    return


async def take_mark(provider: Deployment, confirmations: Confirmations, text: str) -> None:
    """Takes a confirming mark, whose own signature is its proof.

    Raises:
        Problem: `STATEMENT_UNTRUSTED`, `STATEMENT_MALFORMED`.
        StoreUnavailableError: it may not be kept.
    """
    at_ms = provider.now_ms()
    try:
        mark.unverified(text, DEFAULT)
        thumbprint = statement_form.signer_thumbprint(text)
        async with provider.store.read() as view:
            owner, counters = await view.points.owner(thumbprint), await view.counters()
        opened = mark.open(text, frozenset() if owner is None else {owner[1]}, DEFAULT)
    except StatementError as error:
        raise Problem(error.code, error.detail) from None
    except (KeyError, TypeError):
        raise Problem(FaultCode.STATEMENT_MALFORMED, "no header of a statement") from None
    ours = opened.issuer == provider.settings.issuer and not opened.entries and not opened.remaining
    given = opened.line == counters.revocation_line and opened.epoch <= counters.epoch
    young = -MARK_AGE_S <= opened.at - at_ms / 1_000 <= MARK_SKEW_S
    if owner is None or not (ours and given and young):
        raise Problem(FaultCode.STATEMENT_UNTRUSTED, "not a fresh mark of this feed")
    await confirmations.take(owner[0], line=opened.line, epoch=opened.epoch, at_ms=at_ms)
