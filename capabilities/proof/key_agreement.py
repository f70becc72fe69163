"""Keys of a session: an X25519 secret (RFC 7748) of two one-use keys, expanded by HKDF-SHA256 (RFC 5869).

Clauses [SES-3] and [SES-5] in docs/spec.md. The keys depend on every value of the transcript, so two ends that differ
in one of them (token, audience, a nonce, a key) share no key at all, and the first frame tells.
"""

from __future__ import annotations

import hashlib
import hmac
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Final

from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric.x25519 import X25519PrivateKey, X25519PublicKey
from cryptography.hazmat.primitives.kdf.hkdf import HKDF

from capabilities.keys import jws, keys
from capabilities.values.errors import BadKeyError, CapabilityError, Fault, FaultCode

if TYPE_CHECKING:
    from capabilities.keys.keys import PrivateKey

PROFILE: Final = "ztpm-session/1"
KEY_BYTES: Final = 32
NONCE_BYTES: Final = 32
ANSWER_TYPE: Final = "ztpm-session+jwt"
_SIGNATURE_BYTES: Final = 1_024
"""Most bytes of a signature as text; one has about 240."""
_P: Final = 2**255 - 19
"""The field of Curve25519 (RFC 7748 section 4.1)."""


def public_of(private: bytes) -> bytes:
    """The 32 bytes of the public key of an X25519 private key of 32 random bytes."""
    return X25519PrivateKey.from_private_bytes(private).public_key().public_bytes_raw()


def agree(private: bytes, public: bytes) -> bytes:
    """The 32 bytes that both ends compute, each from its own private key and the other's public key.

    Args:
        private: 32 random bytes of one use.
        public: the other end's, 32 bytes in their canonical spelling.

    Raises:
        BadKeyError: `KEY_MALFORMED` for a public key of another length, with a u coordinate of the field's size or more
            (RFC 7748 section 5 would reduce it: a second spelling), or of low order (the secret would be all zeros
            for every private key; section 6.1).
    """
    if len(public) != KEY_BYTES or int.from_bytes(public, "little") >= _P:
        raise BadKeyError(FaultCode.KEY_MALFORMED, "not a canonical X25519 key")
    try:
        secret = X25519PrivateKey.from_private_bytes(private).exchange(X25519PublicKey.from_public_bytes(public))
    except ValueError:
        raise BadKeyError(FaultCode.KEY_MALFORMED, "an X25519 key of low order") from None
    if not any(secret):
        raise BadKeyError(FaultCode.KEY_MALFORMED, "an X25519 key of low order")
    return secret


@dataclass(frozen=True, slots=True)
class Transcript:
    """Transcript of a session: the values that its two ends agree on.

    Attributes:
        audience: canonical URL of the verifier.
        token: base64url SHA-256 of the token's text, as `ath`.
        proof: SHA-256 of the text of the opening's proof.
        holder_key: raw key of the token's leaf hop, which signed that proof.
        verifier_key: raw key that signs the answer, or nothing where the verifier has none.
        holder_public, holder_nonce: the holder's X25519 key of one use and its nonce, 32 bytes each.
        verifier_public, verifier_nonce: the verifier's.
        not_after: end of the session, seconds since the epoch.
    """

    audience: str
    token: str
    proof: bytes
    holder_key: bytes
    verifier_key: bytes
    holder_public: bytes
    holder_nonce: bytes
    verifier_public: bytes
    verifier_nonce: bytes
    not_after: int

    def digest(self) -> bytes:
        """SHA-256 over the profile and each value in the order above, every one after its length in four bytes."""
        parts = (
            PROFILE.encode(),
            self.audience.encode(),
            self.token.encode(),
            self.proof,
            self.holder_key,
            self.verifier_key,
            self.holder_public,
            self.holder_nonce,
            self.verifier_public,
            self.verifier_nonce,
            self.not_after.to_bytes(8, "big"),
        )
        return hashlib.sha256(b"".join(len(part).to_bytes(4, "big") + part for part in parts)).digest()


@dataclass(frozen=True, slots=True)
class SessionKeys:
    """Three keys of 32 bytes, each for one use: frames to the verifier, frames to the holder, the answer."""

    to_verifier: bytes = field(repr=False)
    to_holder: bytes = field(repr=False)
    answer: bytes = field(repr=False)


def derive(secret: bytes, transcript: Transcript) -> SessionKeys:
    """The keys of a session: HKDF-SHA256 with both nonces as salt, the profile and the transcript's digest as info."""
    salt = transcript.holder_nonce + transcript.verifier_nonce
    label = PROFILE.encode() + b" keys" + transcript.digest()
    derived = HKDF(algorithm=hashes.SHA256(), length=3 * KEY_BYTES, salt=salt, info=label).derive(secret)
    return SessionKeys(derived[:32], derived[32:64], derived[64:])


def confirmation(derived: SessionKeys, transcript: Transcript, signature: str) -> bytes:
    """The MAC of an answer: the verifier has the keys of this very transcript."""
    return hmac.digest(derived.answer, transcript.digest() + signature.encode("utf-8", "surrogatepass"), "sha256")


def sign(transcript: Transcript, signer: PrivateKey) -> str:
    """A compact JWS over the transcript's digest by the transcript's verifier, of a type that nothing else has."""
    header: dict[str, object] = {"kid": keys.thumbprint(transcript.verifier_key), "typ": ANSWER_TYPE}
    return jws.sign(header, transcript.digest(), signer)


def check_answer(derived: SessionKeys, transcript: Transcript, signature: str, mac: bytes) -> Fault | None:
    """None when who answered has the keys of this transcript and is its verifier; else `PROOF_WRONG_KEY`.

    Where the transcript names no verifier, there must be no signature: nobody could check it, so it would mean nothing.
    """
    wrong = Fault(FaultCode.PROOF_WRONG_KEY, "SES-5", "not answered by the expected verifier")
    if not hmac.compare_digest(mac, confirmation(derived, transcript, signature)):
        return wrong
    if not transcript.verifier_key:
        return wrong if signature else None
    try:
        unverified = jws.split(signature, most_bytes=_SIGNATURE_BYTES)
        payload = jws.check(unverified, transcript.verifier_key)
    except CapabilityError:
        return wrong
    expected = {"alg": unverified.header["alg"], "kid": keys.thumbprint(transcript.verifier_key), "typ": ANSWER_TYPE}
    if unverified.header != expected or not hmac.compare_digest(payload, transcript.digest()):
        return wrong
    return None
