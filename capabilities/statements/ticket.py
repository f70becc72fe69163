"""Ticket: a tool server's word that this very request came to it just now, for one gateway of a robot.

It lends nothing: the gateway verifies the caller's token and proof itself. It says which enrolled enforcement point
passed the request on, and binds every byte of it that counts. Clauses [TKT-1] to [TKT-7] in docs/spec.md.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from capabilities.keys import keys
from capabilities.statements import statement_form
from capabilities.statements.claims import HexDigest, Id, Name, Url, Whole, read
from capabilities.statements.revocation import Revoked
from capabilities.values.errors import CapabilityError, Fault, FaultCode, StatementError
from capabilities.values.form import Form, plain

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping

    from capabilities.keys.keys import PrivateKey
    from capabilities.statements.revocation import RevocationView
    from capabilities.values.caps import Caps

KIND: Final = "ticket"
BYTES: Final = 2_048
"""Longest text: one with the longest id and URLs (256 bytes each) has 1,662."""
AGE_MS: Final = 500
"""Oldest accepted ticket.

It is issued when everything else about the request is done. After that comes one connection on the cell's own network,
and the reading of at most 32 KiB.
"""
AHEAD_MS: Final = 100
"""Longest time by which a ticket may come from the future.

The skew that other statements have (5 s) would let a ticket live ten times as long as it may. Machines of one cell keep
time to milliseconds; where they do not, calls are refused.
"""


@dataclass(frozen=True, slots=True)
class RequestDigests:
    """Digests of the three parts of a request, each a SHA-256 (hex).

    Attributes:
        token: the token's text as it was presented; of no byte when there was none.
        proof: the text of the proof of possession, likewise.
        body: its exact bytes.
    """

    token: str
    proof: str
    body: str

    @classmethod
    def of(cls, *, token: str | None, proof: str | None, body: bytes) -> RequestDigests:
        """Digests of this request; None stands for a part that it does not have."""
        # Only ASCII is a token or a proof; any other text that came as one gets a digest of its own, and no exception.
        texts = ((text or "").encode("utf-8", "surrogatepass") for text in (token, proof))
        return cls(*(hashlib.sha256(raw).hexdigest() for raw in (*texts, body)))


@dataclass(frozen=True, slots=True)
class Ticket:
    """Word of a tool server about one request.

    Attributes:
        id: 32 random hex digits; the ticket is good once.
        pep: registered id of the tool server that signed.
        audience: canonical URL of the cell, as tokens name it.
        url: canonical URL of the gateway's endpoint that it is for.
        carried: the request.
        at_ms: when it was issued, milliseconds since the epoch.
    """

    id: str
    pep: str
    audience: str
    url: str
    carried: RequestDigests
    at_ms: int


class _Claims(Form, frozen=True):
    id: Id
    pep: Name
    audience: Url
    url: Url
    token: HexDigest
    proof: HexDigest
    body: HexDigest
    at_ms: Whole


def issue(carried: RequestDigests, *, id: str, pep: str, audience: str, url: str, key: PrivateKey, at: float) -> str:  # noqa: A002 - the member's name
    """The signed ticket for this request.

    Args:
        carried: the request.
        id: 32 hex digits, never used before.
        pep: registered id of who signs.
        audience: canonical URL of the cell.
        url: canonical URL of the gateway's endpoint.
        key: of that enforcement point.
        at: now, seconds since the epoch.
    """
    return sign(Ticket(id, pep, audience, url, carried, int(at * 1_000)), key)


def sign(ticket: Ticket, key: PrivateKey) -> str:
    """The ticket, signed."""
    said, carried = ticket, ticket.carried
    claims = _Claims(said.id, said.pep, said.audience, said.url, carried.token, carried.proof, carried.body, said.at_ms)
    return statement_form.seal(KIND, plain(claims), key, _read, most_bytes=BYTES)


def open(text: str, keys: Collection[bytes], caps: Caps) -> Ticket:  # noqa: A001 - read as ticket.open
    """The ticket, signed by one of these keys.

    Raises:
        StatementError: as `sealed.open`; also for a text of more than `BYTES`.
    """
    if len(text) > BYTES:
        raise StatementError(FaultCode.STATEMENT_MALFORMED, f"over {BYTES} bytes")
    return _read(statement_form.open(KIND, text, keys, caps))


def _read(claims: dict[str, object]) -> Ticket:
    said = read(_Claims, claims)
    return Ticket(
        said.id, said.pep, said.audience, said.url, RequestDigests(said.token, said.proof, said.body), said.at_ms
    )


def verify(
    text: str,
    carried: RequestDigests,
    *,
    peps: Mapping[str, bytes],
    view: RevocationView,
    audience: str,
    url: str,
    at: float,
    caps: Caps,
) -> Ticket | Fault:
    """The ticket, when it is for exactly this request, here and now; or the first fault. Never raises.

    Whether it was used before is the verifier's memory ([TKT-7]), not this module's.

    Args:
        text: as it came.
        carried: the request beside it, as it came.
        peps: raw public key of each enrolled tool server, by its id.
        view: the revocation view. Its age is asked when the token is verified, on which every effect depends.
        audience: canonical URL of the cell.
        url: canonical URL of the verifier's own endpoint.
        at: now, seconds since the epoch.
        caps: the bounds.
    """
    # [TKT-1] one short spelling, of this kind, by an enrolled key, with exactly its members
    try:
        ticket = open(text, frozenset(peps.values()), caps)
    except CapabilityError as error:
        return Fault(error.code, "TKT-1", error.detail)
    # [TKT-2] by the key of the very enforcement point that it names
    named = peps.get(ticket.pep)
    if named is None or keys.thumbprint(named) != statement_form.signer_thumbprint(text):
        return Fault(FaultCode.STATEMENT_UNTRUSTED, "TKT-2", "signed by another than it names")
    # [TKT-3] a key that is not revoked
    if (str(Revoked.KEY), keys.b64u(keys.thumbprint_bytes(named))) in view.revoked:
        return Fault(FaultCode.STATEMENT_UNTRUSTED, "TKT-3", "the key is revoked")
    # [TKT-4] for this cell, and this very gateway
    if (ticket.audience, ticket.url) != (audience, url):
        return Fault(FaultCode.WRONG_AUDIENCE, "TKT-4")
    # [TKT-5] for this request
    if ticket.carried != carried:
        return Fault(FaultCode.PROOF_NOT_FOR_THIS_REQUEST, "TKT-5")
    # [TKT-6] just now
    age_ms = at * 1_000 - ticket.at_ms
    if not age_ms >= -AHEAD_MS:
        return Fault(FaultCode.NOT_YET_VALID, "TKT-6")
    if not age_ms <= AGE_MS:
        return Fault(FaultCode.EXPIRED, "TKT-6")
    return ticket


def retention_ms(caps: Caps) -> int:
    """Milliseconds for which the id of an accepted ticket is kept, from its acceptance on ([TKT-7]).

    They run on a monotonic clock.

    The ticket may come from the future and lives for the greatest age after that, and the time may then be set back by
    the skew ([PRF-9]). One second more covers whole milliseconds and a clock that runs slow.
    """
    return AHEAD_MS + AGE_MS + caps.skew_s * 1_000 + 1_000
