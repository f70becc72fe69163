"""Renewal of a program's lease by tokens that are drawn meanwhile; the arm goes on."""

from __future__ import annotations

import asyncio
import secrets
import time
from typing import TYPE_CHECKING, Final, Protocol

import httpx2

from capabilities.proof.proof import prove
from capabilities.values.errors import Fault
from pep.rtde.lease.lease_endpoint import RENEWING, renewal_body
from pep.rtde.wire.client_texts import fitted
from ztpm.program.program_lease import JTI_BYTES, TIMEOUT_S, LeaseError, OpenedLease, members_of, refusal_of
from ztpm_idp.client import direct_http

if TYPE_CHECKING:
    from collections.abc import Callable

    from capabilities.keys.keys import PrivateKey

LOOK_S: Final = 1.0
"""Time between two looks whether there is another token."""
AGAIN_S: Final = 5.0
"""Time after a renewal that failed."""


class Tokens(Protocol):
    """Tokens of one mandate, as `ztpm_idp.client.Renewal` draws them."""

    def token(self) -> str:
        """The token to be used now; may wait for a new one."""
        ...


class LeaseRenewal:
    """Renewal of one lease for as long as it lasts.

    Args:
        leased: the lease, just opened.
        door: canonical URL of the gateway's door.
        key: of the tokens' holder.
        tokens: of the mandate.
        held: text of the token that the lease was opened with.
        told: is given the reason for each renewal that failed, a line of text. The lease goes on with its token.
        now: wall clock, seconds since the epoch.
    """

    def __init__(
        self,
        leased: OpenedLease,
        door: str,
        key: PrivateKey,
        tokens: Tokens,
        held: str,
        *,
        told: Callable[[str], None],
        now: Callable[[], float] = time.time,
    ) -> None:
        self._leased = leased
        self._door = door
        self._key = key
        self._tokens = tokens
        self._held = held
        self._told = told
        self._now = now

    async def keep(self) -> None:
        """Renews the lease each time that there is another token, for ever: to be cancelled."""
        while True:
            await asyncio.sleep(LOOK_S)
            try:
                await asyncio.to_thread(self.look)
            except Exception as error:  # noqa: BLE001 - who renews goes on, as long as the token lasts
                self._told(fitted(str(error) or type(error).__name__))
                await asyncio.sleep(AGAIN_S)

    def look(self) -> None:
        """Renews the lease where there is another token.

        Raises:
            ClientError, Denied: there is none any more, and the one at hand has ended.
            LeaseError: the gateway refuses it, or cannot be reached or believed.
        """
        token = self._tokens.token()
        if token == self._held:
            return
        at, body = self._now(), renewal_body(self._leased.id)
        jti = secrets.token_urlsafe(JTI_BYTES)
        proof = prove(self._key, method=RENEWING, url=self._door, body=body, token=token, at=int(at), jti=jti)
        headers = {"Authorization": f"DPoP {token}", "DPoP": proof, "Content-Type": "application/json"}
        try:
            with direct_http.client(TIMEOUT_S) as http:
                answer = http.put(self._door, content=body, headers=headers, follow_redirects=False)
        except httpx2.HTTPError as error:
            raise LeaseError("GATEWAY_UNREACHABLE", f"{self._door}: {type(error).__name__}", refused=False) from error
        said = members_of(answer.content)
        if answer.status_code != 200:
            raise LeaseError(
                *refusal_of(said.get("reason"), f"{self._door} answers {answer.status_code}"), refused=True
            )
        not_after = said.get("not_after")
        if type(not_after) is not int or isinstance(self._leased.session.renew(not_after, at=self._now()), Fault):
            raise LeaseError("GATEWAY_NOT_BELIEVED", "its answer has another form", refused=False)
        self._held = token
