"""Encryption of messages for one browser, and the provider's word to its push service on sending them.

RFC 8291 (Message Encryption for Web Push) with the content coding aes128gcm of RFC 8188, and RFC 8292 (VAPID). The push
service sees neither text nor length of a message: only that one was sent, when, and how urgent it is.
"""

from __future__ import annotations

import struct
from typing import Final
from urllib.parse import urlsplit

import jwt
from cryptography.hazmat.primitives import hashes
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.ciphers.aead import AESGCM
from cryptography.hazmat.primitives.kdf.hkdf import HKDF
from cryptography.hazmat.primitives.serialization import Encoding, PublicFormat

from capabilities.keys.keys import b64u

KEY_BYTES: Final = 65
"""Length of an uncompressed point of P-256."""
SECRET_BYTES: Final = 16
"""Length of a browser's authentication secret (RFC 8291, section 3.2)."""
SALT_BYTES: Final = 16
PADDED_BYTES: Final = 1_024
"""Ours: length to which every message is filled, so that its length says nothing."""
SAID_S: Final = 3_600
"""Ours: seconds for which a word to a push service counts; RFC 8292 allows a day."""
_RECORD_BYTES: Final = 4_096
_LAST: Final = b"\x02"
"""Delimiter of the last record (RFC 8188, section 2)."""
_ORDER: Final = 0xFFFFFFFF00000000FFFFFFFFFFFFFFFFBCE6FAADA7179E84F3B9CAC2FC632551
"""Order of P-256 (FIPS 186-5)."""


def public_point(raw: bytes) -> ec.EllipticCurvePublicKey:
    """The public key of P-256 whose uncompressed point this is.

    Raises:
        ValueError: it is none.
    """
    if len(raw) != KEY_BYTES:
        raise ValueError("not an uncompressed point of P-256")
    return ec.EllipticCurvePublicKey.from_encoded_point(ec.SECP256R1(), raw)


def raw_point(key: ec.EllipticCurvePublicKey) -> bytes:
    """The uncompressed point of a public key."""
    return key.public_bytes(Encoding.X962, PublicFormat.UncompressedPoint)


def encrypt(
    text: bytes,
    *,
    key: bytes,
    secret: bytes,
    ephemeral: ec.EllipticCurvePrivateKey,
    salt: bytes,
    padded_bytes: int = PADDED_BYTES,
) -> bytes:
    """The message as its browser alone can read it.

    Args:
        text: of the message; a longer one than `padded_bytes` is not filled.
        key: of the browser's subscription: an uncompressed point.
        secret: likewise, its authentication secret.
        ephemeral: fresh key of P-256, for this message alone.
        salt: 16 fresh random bytes.
        padded_bytes: length to which the text is filled.

    Raises:
        ValueError: the key is no point, or the text too long for one record.
    """
    browser, sender = public_point(key), raw_point(ephemeral.public_key())
    shared = ephemeral.exchange(ec.ECDH(), browser)
    keying = _derived(shared, salt=secret, label=b"WebPush: info\x00" + key + sender, length=32)
    content_key = _derived(keying, salt=salt, label=b"Content-Encoding: aes128gcm\x00", length=16)
    nonce = _derived(keying, salt=salt, label=b"Content-Encoding: nonce\x00", length=12)
    filled = text + _LAST + bytes(max(0, padded_bytes - len(text)))
    sealed = AESGCM(content_key).encrypt(nonce, filled, None)
    if len(sealed) > _RECORD_BYTES:
        raise ValueError("too long for one record")
    return salt + struct.pack(">IB", _RECORD_BYTES, len(sender)) + sender + sealed


def signing_key(shared_secret: bytes) -> ec.EllipticCurvePrivateKey:
    """The key by which push services know this provider: the same for all workers and over restarts.

    Args:
        shared_secret: 32 random bytes that the workers of one store share.
    """
    # 16 bytes more than the order has, so that no number is likelier than another (FIPS 186-5, A.2.1).
    wide = _derived(shared_secret, salt=None, label=b"ztpm web push 1", length=48)
    return ec.derive_private_key(int.from_bytes(wide, "big") % (_ORDER - 1) + 1, ec.SECP256R1())


def authorization(endpoint: str, *, contact: str, key: ec.EllipticCurvePrivateKey, at_s: int) -> str:
    """The header by which the provider speaks to the push service of an endpoint (RFC 8292, section 3).

    Args:
        endpoint: URL of a subscription.
        contact: `mailto:` or `https:` address of people who answer for the provider.
        key: of `signing_key`.
        at_s: now, seconds since the epoch.
    """
    parts = urlsplit(endpoint)
    claims = {"aud": f"{parts.scheme}://{parts.netloc}", "exp": at_s + SAID_S, "sub": contact}
    return f"vapid t={jwt.encode(claims, key, algorithm='ES256')}, k={b64u(raw_point(key.public_key()))}"


def _derived(keying: bytes, *, salt: bytes | None, label: bytes, length: int) -> bytes:
    return HKDF(hashes.SHA256(), length, salt, label).derive(keying)
