"""Signatures of a Biscuit's blocks by a key that never leaves its holder: root and attester behind the port.

The library wants raw private keys to build a block. So it builds one under a key that is thrown away, and the
signature of root or attester is put in its place here. What is signed is laid down in the Biscuit specification,
"Signature (blocks)": version 0 for an authority block, version 1 for a block that a third party signs. The bytes are
those that the library makes with the same key; a test holds the two together.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

from capabilities.keys import keys, signatures
from capabilities.token.wire import MESSAGES, THIRD_PARTY_SIGNATURE
from capabilities.values.errors import BadKeyError, FaultCode

if TYPE_CHECKING:
    from capabilities.keys.keys import PrivateKey

_ED25519: Final = 0
"""Number of the algorithm (schema.proto, `PublicKey.Algorithm`)."""


def by_root(token: bytes, root: PrivateKey) -> bytes:
    """The token of one block with the root's signature in place of the one that it has.

    Raises:
        BadKeyError: `KEY_MALFORMED` for a root that is no Ed25519 key, or made no signature.
    """
    _ed25519(root)
    message = MESSAGES["Biscuit"].FromString(token)
    block = message.authority
    block.signature = signatures.sign(root, block.block + _number(_ED25519) + block.nextKey.key)
    return bytes(message.SerializeToString())


def by_attester(token: bytes, extended: bytes, attester: PrivateKey) -> bytes:
    """The extended token with the attester's signature on its last block, in place of the one that it has.

    The key that `token` brings for its next block signs that block anew: its signature covers the attester's.

    Args:
        token: as it was before the block.
        extended: with one block more, signed by any key.
        attester: the attestation key.

    Raises:
        BadKeyError: `KEY_MALFORMED` for an attester that is no Ed25519 key, or made no signature.
    """
    raw = _ed25519(attester)
    message = MESSAGES["Biscuit"].FromString(extended)
    before, added = [message.authority, *message.blocks][-2:]
    after = b"\0PREVSIG\0" + before.signature
    outside = b"\0EXTERNAL\0" + _payload(added) + after
    added.externalSignature.signature = signatures.sign(attester, outside)
    added.externalSignature.publicKey.key = raw
    next_key = b"\0ALGORITHM\0" + _number(_ED25519) + b"\0NEXTKEY\0" + added.nextKey.key
    inside = b"\0BLOCK\0" + _payload(added) + next_key + after + b"\0EXTERNALSIG\0" + added.externalSignature.signature
    secret = MESSAGES["Biscuit"].FromString(token).proof.nextSecret
    added.signature = Ed25519PrivateKey.from_private_bytes(secret).sign(inside)
    return bytes(message.SerializeToString())


def _payload(block: Any) -> bytes:
    return b"\0VERSION\0" + _number(THIRD_PARTY_SIGNATURE) + b"\0PAYLOAD\0" + bytes(block.block)


def _number(value: int) -> bytes:
    return value.to_bytes(4, "little")


def _ed25519(key: PrivateKey) -> bytes:
    raw = keys.public_raw(key)
    if keys.algorithm_of(raw) is not keys.Algorithm.ED25519:
        raise BadKeyError(FaultCode.KEY_MALFORMED, "a root or attester that is no Ed25519 key")
    return raw
