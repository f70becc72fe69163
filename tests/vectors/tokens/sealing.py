"""Tokens signed byte by byte with the real keys, with any blocks: an issuer must never do so, and can.

The container and its signatures are those of eclipse-biscuit/biscuit (schema.proto; specification, section "Signature").
Nothing of `capabilities` is used to sign, so that a defect there cannot hide in a vector.
"""

from __future__ import annotations

import hashlib
import struct
from dataclasses import dataclass, field, replace

from cryptography.hazmat.primitives import serialization
from cryptography.hazmat.primitives.asymmetric import ec
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

ED25519 = 0


def key_of(name: str) -> Ed25519PrivateKey:
    """The private key of that name; for tests alone, since everybody can compute it."""
    return Ed25519PrivateKey.from_private_bytes(hashlib.sha256(b"ztpm vectors: " + name.encode()).digest())


def raw_of(name: str) -> bytes:
    """Its public half, 32 bytes."""
    return key_of(name).public_key().public_bytes_raw()


def p256_of(name: str) -> bytes:
    """The P-256 public key of that name, 33 bytes (SEC 1 section 2.3.3)."""
    secret = int.from_bytes(hashlib.sha256(b"ztpm vectors: " + name.encode()).digest(), "big")
    key = ec.derive_private_key(secret, ec.SECP256R1()).public_key()
    return key.public_bytes(serialization.Encoding.X962, serialization.PublicFormat.CompressedPoint)


# --- Protocol Buffers, as written ------------------------------------------------------------------------------------------


def varint(value: int, *, pad: int = 0) -> bytes:
    """The number (negative ones as 64 bits), with `pad` superfluous bytes."""
    value &= (1 << 64) - 1
    out = bytearray()
    while value > 127:
        out.append(value & 127 | 128)
        value >>= 7
    out.append(value)
    for _ in range(pad):
        out[-1] |= 128
        out.append(0)
    return bytes(out)


def tag(number: int, kind: int) -> bytes:
    return varint(number << 3 | kind)


def put(number: int, value: int | bytes | str) -> bytes:
    """One field: a number as varint, bytes and text with their length."""
    if isinstance(value, int):
        return tag(number, 0) + varint(value)
    raw = value.encode() if isinstance(value, str) else value
    return tag(number, 2) + varint(len(raw)) + raw


def cut(message: bytes) -> list[tuple[int, bytes]]:
    """The fields of a message in order, each as its number and its raw bytes, tag included."""

    def number(at: int) -> tuple[int, int]:
        value = shift = 0
        while True:
            value |= (message[at] & 127) << shift
            shift, at = shift + 7, at + 1
            if message[at - 1] < 128:
                return value, at

    at, fields = 0, []
    while at < len(message):
        start = at
        head, at = number(at)
        value, at = number(at)
        at += value if head & 7 == 2 else 0
        fields.append((head >> 3, message[start:at]))
    return fields


def inner(raw: bytes) -> bytes:
    """Content of a field of `cut`, without tag and length."""
    at = 1
    while raw[at] > 127:
        at += 1
    return raw[at + 1 :]


# --- containers ------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Block:
    """One signed block. `odd` is appended to its message, unsigned."""

    payload: bytes
    next_key: bytes
    signature: bytes
    external: tuple[bytes, bytes, int] | None = None  # signature, key, algorithm of the key
    version: int | None = None
    odd: bytes = b""

    def encode(self) -> bytes:
        out = put(1, self.payload) + put(2, put(1, ED25519) + put(2, self.next_key)) + put(3, self.signature)
        if self.external is not None:
            signature, key, algorithm = self.external
            out += put(4, put(1, signature) + put(2, put(1, algorithm) + put(2, key)))
        if self.version is not None:
            out += put(5, self.version)
        return out + self.odd


@dataclass(frozen=True)
class Sealed:
    """A token under construction: what it consists of, and the secret of the next block."""

    blocks: tuple[Block, ...]
    root_key_id: int | None = 7
    secret: bytes = b""
    odd: bytes = b""
    parts: tuple[bytes, ...] = field(default=())

    def fields(self) -> list[bytes]:
        """Its top-level fields in their order: root key id, authority block, further blocks, proof."""
        head = [] if self.root_key_id is None else [put(1, self.root_key_id)]
        blocks = [put(2 if i == 0 else 3, block.encode()) for i, block in enumerate(self.blocks)]
        return [*head, *blocks, put(4, put(1, self.secret))]

    def encode(self) -> bytes:
        return b"".join(self.fields()) + self.odd

    def swap(self, index: int, **other: object) -> Sealed:
        """The same with other fields of one block, and every signature as it was."""
        blocks = list(self.blocks)
        blocks[index] = replace(blocks[index], **other)
        return replace(self, blocks=tuple(blocks))


def _signed(block: bytes, version: int, next_key: bytes, previous: bytes | None, external: bytes | None) -> bytes:
    """Bytes that the signature of a block covers."""
    if version == 0:
        return block + (external or b"") + struct.pack("<i", ED25519) + next_key
    out = b"\0BLOCK\0\0VERSION\0" + struct.pack("<I", version) + b"\0PAYLOAD\0" + block
    out += b"\0ALGORITHM\0" + struct.pack("<i", ED25519) + b"\0NEXTKEY\0" + next_key
    out += b"" if previous is None else b"\0PREVSIG\0" + previous
    return out + (b"" if external is None else b"\0EXTERNALSIG\0" + external)


def seal(payload: bytes, *, signer: str = "root", root_key_id: int | None = 7, version: int | None = None) -> Sealed:
    """A token of one block with this payload."""
    following = key_of(f"next {hashlib.sha256(payload).hexdigest()}")
    next_key = following.public_key().public_bytes_raw()
    signature = key_of(signer).sign(_signed(payload, version or 0, next_key, None, None))
    return Sealed((Block(payload, next_key, signature, version=version),), root_key_id, following.private_bytes_raw())


def append(token: Sealed, payload: bytes, *, attester: str | None = "attester", version: int | None = 1) -> Sealed:
    """The token with one more block, attested by this key; None for a block that a holder appends alone."""
    previous = token.blocks[-1].signature
    following = key_of(f"next {hashlib.sha256(previous + payload).hexdigest()}")
    next_key = following.public_key().public_bytes_raw()
    external = None
    if attester is not None:
        key = key_of(attester)
        said = b"\0EXTERNAL\0\0VERSION\0" + struct.pack("<I", version or 0) + b"\0PAYLOAD\0" + payload
        said += b"\0PREVSIG\0" + previous
        if not version:  # the old form, bound to a key and to no place
            said = payload + struct.pack("<i", ED25519) + token.blocks[-1].next_key
        external = (key.sign(said), key.public_key().public_bytes_raw(), ED25519)
    secret = Ed25519PrivateKey.from_private_bytes(token.secret)
    covered = _signed(payload, version or 0, next_key, previous, None if external is None else external[0])
    block = Block(payload, next_key, secret.sign(covered), external, version)
    return replace(token, blocks=(*token.blocks, block), secret=following.private_bytes_raw())
