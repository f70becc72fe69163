"""Shipping the journal to the identity provider's ledger, behind the effects and never in their way."""

from __future__ import annotations

import asyncio
import secrets
from typing import TYPE_CHECKING, Final

import httpx2

from capabilities.proof.proof import prove
from pep.base.errors import JournalError, PepFault

if TYPE_CHECKING:
    from collections.abc import Callable

    from capabilities.keys.keys import PrivateKey
    from pep.base.ports import Clock
    from pep.journal.file_journal import FileJournal

BATCH_BYTES: Final = 131_072
"""Records of one request; half of what the ledger accepts in one body."""
PERIOD_S: Final = 0.5
GATHER_S: Final = 0.1
"""Ours: pause after a request that was less than half full, so that what comes meanwhile shares the next one."""
BACK_OFF_S: Final = 5.0
TIMEOUT_S: Final = 10.0


class JournalShipper:
    """Shipper of records that the ledger lacks, in order, with this PEP's proof.

    Args:
        journal: read only.
        http: client of the identity provider.
        issuer: base URL.
        key: of this PEP.
        clock: its wall time goes into the proof.
        incident: told when the ledger refuses.
    """

    def __init__(
        self,
        journal: FileJournal,
        http: httpx2.AsyncClient,
        *,
        issuer: str,
        key: PrivateKey,
        clock: Clock,
        incident: Callable[[JournalError], None],
    ) -> None:
        self._journal = journal
        self._http = http
        self._url = f"{issuer}/ledger/records"
        self._key = key
        self._clock = clock
        self._incident = incident
        self.accepted_through = 0
        self._sent_bytes = 0

    async def run(self) -> None:
        """Ships for ever."""
        while True:
            try:
                more = await self.ship()
            except JournalError as error:
                self._incident(error)
                await asyncio.sleep(BACK_OFF_S)
                continue
            except httpx2.HTTPError:
                # An identity provider that is down is no reason to stop: nothing waits for the shipper.
                await asyncio.sleep(PERIOD_S)
                continue
            if not more:
                await asyncio.sleep(PERIOD_S)
            elif self._sent_bytes < BATCH_BYTES // 2:
                await asyncio.sleep(GATHER_S)

    async def ship(self) -> bool:
        """Ships one batch to the ledger; True when there may be more. A record that is already there changes nothing.

        Raises:
            JournalError: `LEDGER_REFUSED` when the ledger has another history.
            httpx2.HTTPError: when it cannot be reached.
        """
        batch = self._journal.after(self.accepted_through, most_bytes=BATCH_BYTES)
        if not batch:
            return False
        body = b'{"records":[' + b",".join(batch) + b"]}"  # they are JSON
        proof = prove(
            self._key,
            method="POST",
            url=self._url,
            body=body,
            token=None,
            at=int(self._clock.wall_s()),
            jti=secrets.token_urlsafe(18),
        )
        response = await self._http.post(
            self._url, content=body, headers={"content-type": "application/json", "dpop": proof}, timeout=TIMEOUT_S
        )
        if response.status_code >= 500:
            raise httpx2.TransportError(f"status {response.status_code}")
        try:
            answer = response.json()
            through = answer["accepted_through"] if response.status_code == 200 else None
        except (ValueError, KeyError, TypeError):
            answer, through = {}, None
        if not isinstance(through, int) or isinstance(through, bool):
            code = answer.get("code") if isinstance(answer, dict) else None
            # A ledger restored from a backup wants earlier records again; asking from the start is idempotent.
            self.accepted_through = 0
            raise JournalError(PepFault.LEDGER_REFUSED, f"status {response.status_code} {code}")
        if not self.accepted_through < through <= self._journal.last_seq:
            raise JournalError(PepFault.LEDGER_REFUSED, f"accepted through {through}")
        self.accepted_through = through
        self._sent_bytes = len(body)
        return True
