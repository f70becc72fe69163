"""Response of a tool: the enforcement point's word that a result came of this very call to this very tool.

It vouches for the origin of a result, never for its content. Clause [STM-11] in docs/spec.md.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from capabilities.statements import statement_form
from capabilities.statements.claims import HexDigest, Id, Name, Url, Whole, lasting, read
from capabilities.values.errors import Fault, FaultCode
from capabilities.values.form import Form, plain

if TYPE_CHECKING:
    from collections.abc import Collection

    from capabilities.keys.keys import PrivateKey
    from capabilities.values.caps import Caps

KIND: Final = "response"
LIFETIME_S: Final = 3_600
"""Longest life of a response: that of the hop of evidence kind `key` that the call was made under."""


class Response(Form, frozen=True):
    """One answer of one tool.

    Attributes:
        audience: canonical URL of the enforcement point that the call came to.
        agent, hop_id: the holder that called.
        proof: name (hex) of the call's proof ([PRF-7]): one for each call, known to who made it, and in
            the record of the decision.
        request: SHA-256 (hex) of the request that was decided; the same for every retry.
        tool: its name.
        definition: SHA-256 (hex) of the definition; it was the approved one before and after.
        result: SHA-256 (hex) of the result's canonical JSON.
        tainted: the call had an argument in which, or in whose origin, instructions or hidden characters were found.
        at, not_after: when it answered, and until when the response counts; seconds since the epoch, at most
            `LIFETIME_S` apart.
    """

    audience: Url
    agent: Name
    hop_id: Id
    proof: HexDigest
    request: HexDigest
    tool: Name
    definition: HexDigest
    result: HexDigest
    tainted: bool
    at: Whole
    not_after: Whole


@dataclass(frozen=True, slots=True)
class Call:
    """The call that an answer is expected to. Members as in `Response`."""

    audience: str
    agent: str
    hop_id: str
    proof: str
    request: str
    tool: str


def sign(response: Response, key: PrivateKey) -> str:
    """The response, signed by the enforcement point."""
    return statement_form.seal(KIND, plain(response), key, _read)


def open(text: str, keys: Collection[bytes], caps: Caps) -> Response:  # noqa: A001 - read as response.open
    """The response, signed by one of these keys: that of the enforcement point whose audience was called.

    Raises:
        StatementError: as `sealed.open`; also for one that lives longer than `LIFETIME_S` or not at all.
    """
    return _read(statement_form.open(KIND, text, keys, caps))


def _read(claims: dict[str, object]) -> Response:
    response = read(Response, claims)
    lasting(response.at, response.not_after, LIFETIME_S)
    return response


def refusal(response: Response, call: Call, *, at: float, caps: Caps) -> Fault | None:
    """None when it is the answer to this very call, now; else the first fault ([STM-11]).

    Args:
        response: opened with the key of the enforcement point of `call.audience`.
        call: as the caller recorded it when it was made.
        at: seconds since the epoch.
        caps: the bounds.
    """
    if response.audience != call.audience:
        return Fault(FaultCode.STATEMENT_UNTRUSTED, "STM-11", "said for another enforcement point")
    if (response.agent, response.hop_id) != (call.agent, call.hop_id):
        return Fault(FaultCode.WRONG_AUDIENCE, "STM-11", "an answer to another holder")
    if (response.proof, response.request, response.tool) != (call.proof, call.request, call.tool):
        return Fault(FaultCode.PROOF_NOT_FOR_THIS_REQUEST, "STM-11", "an answer to another call")
    if not response.at <= at + caps.skew_s:
        return Fault(FaultCode.NOT_YET_VALID, "STM-11")
    if not at < response.not_after:
        return Fault(FaultCode.EXPIRED, "STM-11")
    return None
