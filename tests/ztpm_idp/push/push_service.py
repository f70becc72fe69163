"""A push service of the tests: each message for a device comes here by HTTPS, is checked and opened."""

from __future__ import annotations

import json
import ssl
import time
from dataclasses import dataclass, field

import jwt
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.ciphers.aead import AESGCM
from cryptography.hazmat.primitives.kdf.hkdf import HKDF
from tests.ztpm_idp.push.receiver import Receiver
from ztpm_idp.push.encryption import public_point, raw_point
from ztpm.cell.authority import machine_certificate, new_authority
from ztpm_idp.web_push_settings import WebPushSettings, load_web_push

from capabilities.keys.keys import b64u, unb64u

WORD = b"pass word of the tests"
CONTACT = "mailto:ops@works.example"


@dataclass
class Device:
    """A browser's subscription: its keys, and its place at the push service."""

    endpoint: str
    key: ec.EllipticCurvePrivateKey = field(default_factory=lambda: ec.generate_private_key(ec.SECP256R1()))
    secret: bytes = b"sixteen secret b"

    @property
    def form(self):
        """Fields of the form by which a page adds it."""
        point = raw_point(self.key.public_key())
        return {"endpoint": self.endpoint, "p256dh": b64u(point), "auth": b64u(self.secret)}

    def told(self, post):
        """The text of a request to the push service, opened as the browser does."""
        return json.loads(opened(post.raw, self.key, self.secret))


class PushService(Receiver):
    """A push service at `https://127.0.0.1:PORT`, with a certificate of an authority of its own.

    Args:
        folder: of its certificates.
        answers: as of a `Receiver`.
        name: that its certificate is for.
    """

    def __init__(self, folder, *answers, name="127.0.0.1"):
        authority = new_authority("push", WORD, at=time.time())
        own = machine_certificate(authority, WORD, [name], at=time.time())
        self.ca = folder / "push-ca.pem"
        self.ca.write_bytes(authority.certificate)
        (folder / "push.pem").write_bytes(own.certificate + own.key)
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        context.load_cert_chain(folder / "push.pem")
        super().__init__(*answers, tls=context)

    @property
    def origin(self):
        return self.url("", scheme="https")

    def device(self, name="one"):
        return Device(f"{self.origin}/push/{name}")

    @property
    def stated(self):
        return {"contact": CONTACT, "own_services": [f"127.0.0.1:{self.port}"], "ca_file": str(self.ca)}

    @property
    def web_push(self):
        return load_web_push(WebPushSettings(**self.stated), self.ca.parent)

    def sender(self, post, *, at_s):
        """The key of who sent a request, whose word is checked as RFC 8292 says."""
        scheme, _, words = post.headers["authorization"].partition(" ")
        said = dict(each.strip().split("=", 1) for each in words.split(","))
        claims = jwt.decode(
            said["t"], public_point(unb64u(said["k"])), ["ES256"], audience=self.origin, options={"verify_exp": False}
        )
        assert scheme == "vapid"
        assert claims["sub"] == CONTACT
        assert at_s < claims["exp"] <= at_s + 86_400
        return said["k"]


def opened(sealed, key, secret):
    """The text of a message that is encrypted by RFC 8291, read independently of what wrote it."""
    salt, size, sender = sealed[:16], sealed[20], sealed[21 : 21 + sealed[20]]
    shared = key.exchange(ec.ECDH(), ec.EllipticCurvePublicKey.from_encoded_point(ec.SECP256R1(), sender))

    def hkdf(keying, salt, info, length):
        return HKDF(hashes.SHA256(), length, salt, info).derive(keying)

    own = raw_point(key.public_key())
    keying = hkdf(shared, secret, b"WebPush: info\0" + own + sender, 32)
    content_key = hkdf(keying, salt, b"Content-Encoding: aes128gcm\0", 16)
    nonce = hkdf(keying, salt, b"Content-Encoding: nonce\0", 12)
    filled = AESGCM(content_key).decrypt(nonce, sealed[21 + size :], None).rstrip(b"\0")
    assert filled.endswith(b"\x02")
    return filled[:-1]
