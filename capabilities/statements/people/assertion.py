"""WebAuthn assertion of a passkey: a signature over a challenge, made by a person who was present and verified.

Pure: what an enforcement point believes of a passkey is decided here, without any library of WebAuthn. A challenge is
the SHA-256 of a domain word and of what the person agrees to, so that a login never counts as a vote. The counter of an
authenticator decides nothing: synchronised passkeys keep it at 0, and each challenge is good for one act alone.
Clauses [PSK-1] to [PSK-7] in docs/spec.md.
"""

from __future__ import annotations

import hashlib
import re
from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING, Final
from urllib.parse import urlsplit

from cryptography.hazmat.primitives.asymmetric import utils

from capabilities.keys import keys, signatures
from capabilities.keys.keys import Algorithm
from capabilities.values import strict_json
from capabilities.values.errors import BadKeyError, FaultCode, StatementError

if TYPE_CHECKING:
    from collections.abc import Mapping

AUTHENTICATOR_BYTES: Final = 37
"""Bytes of authenticator data without credential and extensions: hash, flags, counter (WebAuthn section 6.1)."""
CLIENT_BYTES: Final = 512
"""Most bytes of the client's JSON.

It holds a challenge, an origin of at most 256 bytes, and what a browser adds of its own.
"""
CREDENTIAL_BYTES: Final = 512
"""Longest id of a credential; the standard allows 1023, known authenticators need at most 300."""
_CLIENT_DEPTH: Final = 4
_HASH_BYTES: Final = 32
_PRESENT: Final = 0x01
_VERIFIED: Final = 0x04
_BACKED_UP_EVER: Final = 0x08
_BACKED_UP: Final = 0x10
_FLAGS: Final = _PRESENT | _VERIFIED | _BACKED_UP_EVER | _BACKED_UP
"""Flags of authenticator data that an assertion may have (WebAuthn section 6.1)."""
_GET: Final = "webauthn.get"
_DOMAIN: Final = re.compile(r"([a-z0-9]([a-z0-9-]*[a-z0-9])?\.)*[a-z]([a-z0-9-]*[a-z0-9])?", re.ASCII)
"""A host name whose last label is no number: an address is no name of a relying party."""


class Word(StrEnum):
    """Domain word of a challenge: for which kind of act the assertion is, and for no other."""

    VOTE = "ztpm-passkey-vote/1"
    CLEARING = "ztpm-passkey-clearing/1"
    LOGIN = "ztpm-passkey-login/1"
    REVOCATION = "ztpm-passkey-revocation/1"
    AUTHORIZATION = "ztpm-passkey-consent/1"
    ENROLMENT = "ztpm-passkey-enrolment/1"
    ADMINISTRATION = "ztpm-passkey-administration/1"


@dataclass(frozen=True, slots=True)
class RelyingParty:
    """Relying party to which passkeys belong: its id, a host name, and the one origin of its pages."""

    rp_id: str
    origin: str


@dataclass(frozen=True, slots=True)
class Assertion:
    """An assertion: authenticator data and client JSON as they were signed, and the signature of 64 bytes."""

    authenticator: bytes
    client: bytes
    signature: bytes


def relying_party(issuer: str) -> RelyingParty | None:
    """The relying party of an identity provider; None where its host is an address, which no passkey belongs to.

    Args:
        issuer: canonical URL of the provider.
    """
    parts = urlsplit(issuer)
    host = parts.hostname or ""
    if _DOMAIN.fullmatch(host) is None or (parts.scheme != "https" and host != "localhost"):
        return None
    return RelyingParty(host, f"{parts.scheme}://{parts.netloc}")


def challenge(word: Word, bound: Mapping[str, object]) -> bytes:
    """The challenge, 32 bytes: SHA-256 of word, line feed, and the RFC 8785 form of what is bound.

    Raises:
        StatementError: `STATEMENT_MALFORMED` when `bound` has no such form.
    """
    return hashlib.sha256(f"{word}\n".encode() + strict_json.canonical(dict(bound))).digest()


def login_challenge(issuer: str, nonce: str) -> bytes:
    """The challenge of a login, 32 bytes.

    Args:
        issuer: canonical URL of the provider.
        nonce: the provider's, fresh for this login.
    """
    return challenge(Word.LOGIN, {"issuer": issuer, "nonce": nonce})


def of_browser(authenticator: bytes, client: bytes, signature: bytes, *, key: bytes) -> Assertion:
    """The assertion with the signature in its one spelling: of P-256 r and the lower s, 32 bytes each.

    Args:
        authenticator: its data, as the browser gives it.
        client: the client's JSON.
        signature: of P-256 as DER.
        key: raw public key of the credential.

    Raises:
        StatementError: `STATEMENT_UNTRUSTED` for what is no signature of the key's algorithm.
    """
    if keys.algorithm_of(key) is Algorithm.P256:
        try:
            r, s = utils.decode_dss_signature(signature)
            low = min(s, signatures.P256_N - s)
            signature = r.to_bytes(_HASH_BYTES, "big") + low.to_bytes(_HASH_BYTES, "big")
        except (ValueError, OverflowError):
            raise StatementError(FaultCode.STATEMENT_UNTRUSTED, "not a signature of P-256") from None
    return Assertion(authenticator, client, signature)


def check(assertion: Assertion, *, expected: bytes, party: RelyingParty, key: bytes) -> None:
    """Checks that the credential with this key asserted exactly this challenge, to this relying party.

    Args:
        assertion: as `of_browser` gives it.
        expected: the challenge, 32 bytes.
        party: the pinned relying party.
        key: raw public key of the credential, Ed25519 or P-256, which fixes the algorithm.

    Raises:
        StatementError: `STATEMENT_MALFORMED`, `STATEMENT_WRONG_KIND` or `STATEMENT_UNTRUSTED`.
    """
    # [PSK-1] bounded, and exactly the parts of an assertion
    if len(assertion.authenticator) != AUTHENTICATOR_BYTES or not 0 < len(assertion.client) <= CLIENT_BYTES:
        raise StatementError(FaultCode.STATEMENT_MALFORMED, "not the parts of an assertion")
    _client(assertion.client, expected, party)
    # [PSK-4] the pinned relying party; a person present and verified
    flags = assertion.authenticator[_HASH_BYTES]
    if assertion.authenticator[:_HASH_BYTES] != hashlib.sha256(party.rp_id.encode()).digest():
        raise StatementError(FaultCode.STATEMENT_UNTRUSTED, "a passkey of another relying party")
    if flags & ~_FLAGS or flags & (_BACKED_UP_EVER | _BACKED_UP) == _BACKED_UP:
        raise StatementError(FaultCode.STATEMENT_MALFORMED, "flags that no assertion has")
    if not (flags & _PRESENT and flags & _VERIFIED):
        raise StatementError(FaultCode.STATEMENT_UNTRUSTED, "nobody was present and verified")
    # [PSK-5] the signature, by the algorithm of the registered key
    signed = assertion.authenticator + hashlib.sha256(assertion.client).digest()
    try:
        holds = signatures.verify(key, signed, assertion.signature)
    except BadKeyError:
        raise StatementError(FaultCode.STATEMENT_UNTRUSTED, "the registered key is unusable") from None
    if not holds:
        raise StatementError(FaultCode.STATEMENT_UNTRUSTED, "another signature")


def _client(raw: bytes, expected: bytes, party: RelyingParty) -> None:
    """Checks what the browser says of itself. Members of which nothing is said here may be there."""
    try:
        said = strict_json.read(raw, limit_bytes=CLIENT_BYTES, limit_depth=_CLIENT_DEPTH)
    except strict_json.JsonError as error:
        raise StatementError(FaultCode.STATEMENT_MALFORMED, error.detail) from None
    if not isinstance(said, dict):
        raise StatementError(FaultCode.STATEMENT_MALFORMED, "not an object")
    # [PSK-2] an assertion, not a registration; the challenge in its one spelling
    if said.get("type") != _GET:
        raise StatementError(FaultCode.STATEMENT_WRONG_KIND, "not an assertion")
    if said.get("challenge") != keys.b64u(expected):
        raise StatementError(FaultCode.STATEMENT_UNTRUSTED, "for something else")
    # [PSK-3] the pinned origin, in no frame of another one
    if said.get("origin") != party.origin or said.get("crossOrigin", False) is not False or "topOrigin" in said:
        raise StatementError(FaultCode.STATEMENT_UNTRUSTED, "made on another page")
