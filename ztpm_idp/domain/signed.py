"""Request or word of a person as auditors verify it."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class SignedRequest:
    """The caller's request, kept for auditors to verify.

    The body is in canonical form; of one that came so, the proof's `bdg` is the SHA-256.
    """

    method: str
    url: str
    body: str
    proof: str


@dataclass(frozen=True, slots=True)
class AssertedAct:
    """A person's word by passkey on one act of administration, kept for auditors to verify ([CON-12]).

    Attributes:
        said: what the passkey asserts, in canonical form; its challenge is that of the word of administration.
        key: thumbprint of the passkey.
        authenticator, client, signature: the assertion's parts, in base64url.
    """

    said: str
    key: str
    authenticator: str
    client: str
    signature: str
