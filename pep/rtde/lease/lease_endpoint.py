"""Endpoint at which a lease is requested and renewed: a POST or a PUT with a token and a proof.

    request    POST, Authorization: DPoP <token>, DPoP: <proof>, body: the opening
               (`capabilities.proof.session_opening`, [SES-1])
    answer     201 {"lease", "session", "port"}; 401 and the reason for a fault of steps 1 to 10, 409 LEASE_HELD
    request    PUT, the same headers with another token, body: {"lease"}, as it was answered ([LSD-10])
    answer     200 {"not_after"}; 401 as above, 404 LEASE_UNKNOWN, 403 for another agent, key or mandate

A lease is on record before it is answered, and so is each renewal. Its carriage is then brought to `port` within
`SILENCE_MS`.
"""

from __future__ import annotations

import asyncio
import contextlib
import math
import secrets
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Final
from urllib.parse import urlsplit

from starlette.applications import Starlette
from starlette.responses import JSONResponse
from starlette.routing import Route

from capabilities.keys import keys
from capabilities.proof import session_opening
from capabilities.proof.key_agreement import KEY_BYTES, NONCE_BYTES
from capabilities.values import strict_json
from capabilities.values.chain import Chain
from capabilities.values.errors import Fault
from pep.base import caller_place
from pep.base.errors import JournalError
from pep.gate import records
from pep.request.authority import PresentedRequest
from pep.rtde.lease.lease import ID_BYTES, Lease
from policies.words.reason_table import Reason

if TYPE_CHECKING:
    from collections.abc import Callable

    from starlette.requests import Request

    from capabilities.keys.keys import PrivateKey
    from capabilities.values.caps import Caps
    from pep.base.ports import Clock, Journal
    from pep.request.authority import Authority, Credentials
    from pep.rtde.lease.lease import Leases

OPENING_BYTES: Final = 2_048
RENEWING: Final = "PUT"
"""Method of a renewal."""
LOSSLESS: Final = 0
"""Frames that the carriage may lose: none, since it is TCP."""


@dataclass(frozen=True, slots=True)
class LeaseEndpoint:
    """Inputs of the endpoint.

    Attributes:
        leases: of the robot.
        authority: steps 1 to 10.
        clock: both clocks.
        journal: durable.
        caps: bounds.
        url: canonical, of this door; what the proofs of openings name.
        audience: canonical URL of the cell, as tokens name it.
        signer: this enforcement point's key, by which a holder knows that it talks to it.
        port: TCP port for carriages.
        lease_ms: oldest acceptable view of revocations: that of motion.
        vacated: true once the robot's owner without a lease has let go of it; asked where there is none.
        random: source of so many random bytes.
    """

    leases: Leases
    authority: Authority
    clock: Clock
    journal: Journal
    caps: Caps
    url: str
    audience: str
    signer: PrivateKey
    port: int
    lease_ms: int
    vacated: Callable[[], bool] = lambda: True
    random: Callable[[int], bytes] = secrets.token_bytes
    turn: asyncio.Lock = field(default_factory=asyncio.Lock, repr=False)
    """Of renewals: they count in the order in which they are on record."""

    def app(self) -> Starlette:
        """ASGI app of the endpoint."""
        path = urlsplit(self.url).path
        asked = Route(path, self._asked, methods=[session_opening.METHOD])
        return Starlette(routes=[asked, Route(path, self._renewed, methods=[RENEWING])])

    async def _asked(self, request: Request) -> JSONResponse:
        proven = await self._proven(request, session_opening.METHOD)
        if isinstance(proven, JSONResponse):
            return proven
        presented, credentials, chain = proven
        opened = self._opened(presented, credentials, chain)
        if isinstance(opened, Fault):
            return await self._refuse(401, Reason(opened.code), credentials)
        lease, answer = opened
        vacant = self.leases.current is None and self.vacated()
        if not (vacant and self.leases.open(lease, at_ms=self.clock.monotonic_ms())):
            return await self._refuse(409, Reason.LEASE_HELD, credentials)
        try:
            # No durable record, no lease: each motion under it is on record besides.
            body = self._recorded(credentials, chain, lease.not_after)
            await asyncio.to_thread(self.journal.append, "lease", body)
        except JournalError:
            self.leases.end(lease)
            return _denied(503, Reason.RECORD_FAILED)
        return JSONResponse({"lease": lease.id.hex(), "session": answer, "port": self.port}, status_code=201)

    async def _renewed(self, request: Request) -> JSONResponse:
        """[LSD-10] Another token in the place of the lease's own."""
        proven = await self._proven(request, RENEWING)
        if isinstance(proven, JSONResponse):
            return proven
        presented, credentials, chain = proven
        lease = self.leases.current
        if lease is None or not secrets.compare_digest(_lease_named(presented.body), lease.id):
            return await self._refuse(404, Reason.LEASE_UNKNOWN, credentials)
        unfit = lease.unfit(chain)
        if unfit is not None:
            return await self._refuse(403, unfit, credentials)
        async with self.turn:
            at = self.clock.wall_s()
            not_after = session_opening.session_end(chain.scope.not_after, at=at, caps=self.caps)
            try:
                body = self._recorded(credentials, chain, not_after)
                await asyncio.to_thread(self.journal.append, "lease-renewed", body)
            except JournalError:
                return _denied(503, Reason.RECORD_FAILED)
            # The lease may be over since, and the token too; that one who looks after the lease sees.
            over = self.leases.current is not lease
            if over or lease.renew(credentials, not_after, at=self.clock.wall_s()) is not None:
                return await self._refuse(404, Reason.LEASE_UNKNOWN, credentials)
        return JSONResponse({"not_after": not_after})

    async def _proven(
        self, request: Request, method: str
    ) -> tuple[PresentedRequest, Credentials, Chain] | JSONResponse:
        """The request with its verified token and proof; or the refusal, which is on record."""
        body = await _body(request)
        if body is None:
            return await self._refuse(413, Reason.BODY_TOO_LARGE, None)
        token, proof = _one(request, "authorization"), _one(request, "dpop")
        scheme, _, text = (token or "").partition(" ")
        presented = PresentedRequest(
            token=text if scheme.lower() == "dpop" and text else None,
            proof=proof,
            method=method,
            url=self.url,
            body=body,
        )
        try:
            credentials = self.authority.check(presented, lease_ms=self.lease_ms)
        except Exception:  # noqa: BLE001 - a verification that breaks has not verified
            return await self._refuse(401, Reason.TOKEN_MALFORMED, None)
        if (fault := credentials.fault) is not None:
            return await self._refuse(401, Reason(fault.code), credentials)
        assert isinstance(credentials.chain, Chain)
        caller_place.proven(request.scope, credentials.chain.leaf.agent)
        return presented, credentials, credentials.chain

    def _recorded(self, credentials: Credentials, chain: Chain, not_after: int) -> dict[str, Any]:
        """Record of a lease for the journal, without its id, which is the way to its carriage."""
        return {
            "at": self.clock.wall_s(),
            "agent": chain.leaf.agent,
            "hop": chain.leaf.hop_id,
            "key": keys.thumbprint(chain.leaf.key),
            "proof": credentials.proof_name,
            "not_after": not_after,
        }

    async def _refuse(self, status: int, reason: Reason, credentials: Credentials | None) -> JSONResponse:
        body = records.refusal(
            at=self.clock.wall_s(),
            at_ms=self.clock.monotonic_ms(),
            reason=reason,
            status=status,
            credentials=credentials,
            where={"path": urlsplit(self.url).path},
        )
        with contextlib.suppress(JournalError):  # refused either way
            await asyncio.to_thread(self.journal.append, "refusal", body)
        return _denied(status, reason)

    def _opened(self, presented: PresentedRequest, credentials: Credentials, chain: Chain) -> tuple[Lease, str] | Fault:
        assert presented.token is not None
        assert presented.proof is not None
        answered = session_opening.answer(
            presented.body,
            presented.proof,
            holder_key=chain.leaf.key,
            url=self.url,
            audience=self.audience,
            token=presented.token,
            signer=self.signer,
            private=self.random(KEY_BYTES),
            nonce=self.random(NONCE_BYTES),
            not_after=math.floor(chain.scope.not_after),
            at=self.clock.wall_s(),
            most_missing=LOSSLESS,
            caps=self.caps,
        )
        if isinstance(answered, Fault):
            return answered
        lease = Lease(self.random(ID_BYTES), chain.leaf.agent, credentials, answered.session, answered.not_after)
        return lease, answered.text.decode()


def renewal_body(lease_id: bytes) -> bytes:
    """Body of a renewal of the lease with this id."""
    return strict_json.canonical({"lease": lease_id.hex()})


def _lease_named(body: bytes) -> bytes:
    """Id of the lease in a renewal's body; nothing where that is any other text than its one spelling."""
    try:
        named = strict_json.read(body, limit_bytes=OPENING_BYTES, limit_depth=1)
        lease_id = bytes.fromhex(str(named.get("lease"))) if isinstance(named, dict) else b""
    except ValueError:
        return b""
    return lease_id if body == renewal_body(lease_id) else b""


def _one(request: Request, name: str) -> str | None:
    """Header, where there is exactly one of that name."""
    values = request.headers.getlist(name)
    return values[0] if len(values) == 1 else None


async def _body(request: Request) -> bytes | None:
    """Body, or None for one that is longer than an opening can be."""
    body = b""
    async for chunk in request.stream():
        body += chunk
        if len(body) > OPENING_BYTES:
            return None
    return body


def _denied(status: int, reason: Reason) -> JSONResponse:
    return JSONResponse({"decision": "DENY", "reason": str(reason)}, status_code=status)
