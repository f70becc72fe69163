"""Authenticators in software, for tests: what a browser and a security key would make, and anything of it changed."""

from __future__ import annotations

import hashlib
import json
import secrets
from dataclasses import dataclass, field

import cbor2
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

from capabilities.keys import keys
from capabilities.statements.people import assertion, passkey_vote

PRESENT, VERIFIED, ATTESTED = 0x01, 0x04, 0x40


@dataclass
class Authenticator:
    """One credential at one relying party."""

    party: assertion.RelyingParty
    private: object = field(default_factory=lambda: keys.generate(keys.Algorithm.P256))
    credential: bytes = field(default_factory=lambda: secrets.token_bytes(32))

    @property
    def key(self) -> bytes:
        return keys.public_raw(self.private)

    @property
    def id(self) -> str:
        return keys.b64u(self.credential)

    def client(self, expected: bytes, *, type="webauthn.get", **changes) -> bytes:
        said = {"type": type, "challenge": keys.b64u(expected), "origin": self.party.origin, "crossOrigin": False}
        return json.dumps(said | changes).encode()

    def parts(self, expected: bytes, *, flags=PRESENT | VERIFIED, counter=1, rp_id=None, client=None, **changes):
        """Authenticator data, client JSON and signature, as a browser gives them."""
        rp_hash = hashlib.sha256((rp_id or self.party.rp_id).encode()).digest()
        data = rp_hash + bytes([flags]) + counter.to_bytes(4, "big")
        client = self.client(expected, **changes) if client is None else client
        signed = data + hashlib.sha256(client).digest()
        ed = isinstance(self.private, Ed25519PrivateKey)
        return data, client, self.private.sign(signed) if ed else self.private.sign(signed, ec.ECDSA(hashes.SHA256()))

    def assertion(self, expected: bytes, **changes) -> assertion.Assertion:
        return assertion.of_browser(*self.parts(expected, **changes), key=self.key)

    def body(self, expected: bytes, **changes) -> dict[str, str]:
        """The body that a page sends."""
        data, client, signature = map(keys.b64u, self.parts(expected, **changes))
        return {"credential": self.id, "authenticator": data, "client": client, "signature": signature}

    def vote(self, vote, ask, **changes) -> str:
        made = self.assertion(passkey_vote.challenge_of(vote, ask), **changes)
        return passkey_vote.compose(vote, made, key=self.key)

    def registration(self, challenge: bytes, *, flags=PRESENT | VERIFIED | ATTESTED, algorithm=None, **changes) -> dict:
        """A new credential, as `PublicKeyCredential.toJSON` gives it."""
        if isinstance(self.private, Ed25519PrivateKey):
            cose = {1: 1, 3: algorithm or -8, -1: 6, -2: self.key}
        else:
            x, y = keys.p256_coordinates(self.key)
            cose = {1: 2, 3: algorithm or -7, -1: 1, -2: x, -3: y}
        rp_hash = hashlib.sha256(self.party.rp_id.encode()).digest()
        attested = bytes(16) + len(self.credential).to_bytes(2, "big") + self.credential + cbor2.dumps(cose)
        data = rp_hash + bytes([flags]) + bytes(4) + attested
        made = cbor2.dumps({"fmt": "none", "attStmt": {}, "authData": data})
        client = self.client(challenge, **({"type": "webauthn.create"} | changes))
        return {
            "id": self.id,
            "rawId": self.id,
            "type": "public-key",
            "response": {"clientDataJSON": keys.b64u(client), "attestationObject": keys.b64u(made), "transports": []},
            "clientExtensionResults": {},
        }
