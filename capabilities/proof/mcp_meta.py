"""Token and proof of an MCP request that has no headers: two members of its `_meta` ([PRF-10] in docs/spec.md).

The proof is an ordinary one. `mcp:` and the JSON-RPC method stand for the HTTP method, which can hold no colon, so that
no proof counts on both carriages; the server's audience stands for the URL; and the body is the RFC 8785 form of the
params without the two members, and without those that a client's SDK adds on the way (`UNCOVERED`). Everything else is
covered, so a retry needs a new proof.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from capabilities.proof.proof import prove
from capabilities.values import strict_json
from capabilities.values.errors import Fault, FaultCode, StatementError

if TYPE_CHECKING:
    from collections.abc import Mapping

    from capabilities.keys.keys import PrivateKey

META: Final = "_meta"
TOKEN: Final = "dev.ztpm/token"  # noqa: S105 - the name of a member
PROOF: Final = "dev.ztpm/proof"
CREDENTIALS: Final = frozenset({TOKEN, PROOF})
UNCOVERED: Final = frozenset(
    {
        "progressToken",
        "io.modelcontextprotocol/protocolVersion",
        "io.modelcontextprotocol/clientInfo",
        "io.modelcontextprotocol/clientCapabilities",
        "io.modelcontextprotocol/logLevel",
        "traceparent",
        "tracestate",
        "baggage",
    }
)
"""Members of `_meta` that an SDK writes after its caller has signed.

They say how to answer, and name a trace; none is decided on.
"""
_CLAUSE: Final = "PRF-10"


@dataclass(frozen=True, slots=True)
class UnverifiedRequest:
    """Parts of a request, unverified; input of `check_proof`.

    Attributes:
        token: text of the token, or None.
        proof: text of the proof, or None.
        method: the name that stands for the HTTP method.
        body: the bytes that stand for the body; empty where there are no credentials.
        params: as they came, without the credentials: no other server may ever see them.
    """

    token: str | None
    proof: str | None
    method: str
    body: bytes
    params: object


def method(rpc_method: str) -> str:
    """Name that stands for the HTTP method in a proof of a request of this JSON-RPC method."""
    return f"mcp:{rpc_method}"


def attach(
    params: Mapping[str, object],
    *,
    rpc_method: str,
    audience: str,
    key: PrivateKey,
    token: str,
    at: int,
    jti: str,
) -> dict[str, object]:
    """Params with token and a new proof by `key`; any later change of what is covered voids the proof.

    Args:
        params: of the request, complete but for members that are not covered. Credentials in them are replaced.
        rpc_method: JSON-RPC method of the request.
        audience: canonical URL of the server.
        key: the holder's.
        token: its text.
        at: seconds since the epoch.
        jti: 16 to 64 base64url characters, never used before.

    Raises:
        StatementError: `STATEMENT_MALFORMED` for params without a canonical form, or with a `_meta` that is no object.
    """
    meta = params.get(META, {})
    if not isinstance(meta, dict):
        raise StatementError(FaultCode.STATEMENT_MALFORMED, "_meta is no object")
    rest = _without(meta, CREDENTIALS)
    body = _covered(params, rest)
    proof = prove(key, method=method(rpc_method), url=audience, body=body, token=token, at=at, jti=jti)
    return {**params, META: {**rest, TOKEN: token, PROOF: proof}}


def detach(params: object, *, rpc_method: str) -> UnverifiedRequest | Fault:
    """The credentials of a request, and the request without them.

    Args:
        params: of the request, as a strict reader saw them (`strict_json.read`).
        rpc_method: JSON-RPC method of the request.

    Returns:
        The parts of the request, with or without credentials; or `TOKEN_MALFORMED` or `PROOF_MALFORMED` for a
        credential that is no text, and `PROOF_MALFORMED` for credentials beside params without a canonical form.
    """
    meta = params.get(META) if isinstance(params, dict) else None
    if not isinstance(params, dict) or not isinstance(meta, dict) or meta.keys().isdisjoint(CREDENTIALS):
        return UnverifiedRequest(None, None, method(rpc_method), b"", params)
    token, proof = meta.get(TOKEN), meta.get(PROOF)
    # A null is no absent member: a reader that takes it for one would see another request.
    if TOKEN in meta and not isinstance(token, str):
        return Fault(FaultCode.TOKEN_MALFORMED, _CLAUSE, "the token is no text")
    if PROOF in meta and not isinstance(proof, str):
        return Fault(FaultCode.PROOF_MALFORMED, _CLAUSE, "the proof is no text")
    rest = _without(meta, CREDENTIALS)
    try:
        body = _covered(params, rest)
    except StatementError as error:
        return Fault(FaultCode.PROOF_MALFORMED, _CLAUSE, error.detail)
    return UnverifiedRequest(token, proof, method(rpc_method), body, {**params, META: rest})


def stray(params: object) -> Fault | None:
    """None for a request over HTTP, whose header alone carries credentials; `TOKEN_MALFORMED` when `_meta` does too."""
    meta = params.get(META) if isinstance(params, dict) else None
    if isinstance(meta, dict) and not meta.keys().isdisjoint(CREDENTIALS):
        return Fault(FaultCode.TOKEN_MALFORMED, _CLAUSE, "credentials in the header's stead")
    return None


def stripped(params: Mapping[str, object]) -> dict[str, object]:
    """The params without credentials, fit or not."""
    meta = params.get(META)
    return {**params, META: _without(meta, CREDENTIALS)} if isinstance(meta, dict) else dict(params)


def _covered(params: Mapping[str, object], rest: Mapping[str, object]) -> bytes:
    """The bytes that a proof covers: params with this `_meta`, less what is not covered.

    Raises:
        StatementError: they have no canonical form.
    """
    return strict_json.canonical({**params, META: _without(rest, UNCOVERED)})


def _without(meta: Mapping[str, object], names: frozenset[str]) -> dict[str, object]:
    return {name: value for name, value in meta.items() if name not in names}
