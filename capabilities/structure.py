"""The outer form of a token, read without any cryptography and without any Datalog.

A Biscuit is a Protocol Buffers message (eclipse-biscuit/biscuit, schema.proto). This reader knows just enough of it to
count blocks before a signature is checked and to count facts, rules and checks before Datalog runs. It is no second
opinion on the contents: those are read by the Biscuit library alone, and the counts only have to agree with what it
found.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from capabilities.errors import FaultCode, TokenError

if TYPE_CHECKING:
    from collections.abc import Iterator

_VARINT: Final = 0
_BYTES: Final = 2
_VARINT_BYTES: Final = 10
"""Most bytes of a number: seven bits each, 64 bits in all."""

# Field numbers of schema.proto.
_ROOT_KEY_ID: Final = 1
_AUTHORITY: Final = 2
_BLOCKS: Final = 3
_PROOF: Final = 4
_PAYLOAD: Final = 1
_EXTERNAL: Final = 4
_SIGNATURE_VERSION: Final = 5
_FACTS: Final = 4
_RULES: Final = 5
_CHECKS: Final = 6
_SCOPE: Final = 7
_PUBLIC_KEYS: Final = 8
_NEXT_SECRET: Final = 1
THIRD_PARTY_SIGNATURE: Final = 1
"""Signature version that binds a third-party block to the signature of the block before it."""


@dataclass(frozen=True, slots=True)
class BlockShape:
    """What one block consists of.

    Attributes:
        third_party: the block carries an external signature, in the version that binds it to its place.
        facts, rules, checks: how many.
        scoped: the block names a scope or a public key, so that its Datalog could see other blocks.
    """

    third_party: bool
    facts: int
    rules: int
    checks: int
    scoped: bool


@dataclass(frozen=True, slots=True)
class Structure:
    """What a token consists of: the root key id that it claims and its blocks in order, the authority block first."""

    root_key_id: int | None
    blocks: tuple[BlockShape, ...]


def read(token: bytes) -> Structure:
    """The structure of a token that still has a next secret: a sealed one is not of this profile.

    Raises:
        TokenError: `TOKEN_MALFORMED` when the bytes are no such message.
    """
    root_key_id: int | None = None
    blocks: list[BlockShape] = []
    proven = False
    for number, value in _fields(token):
        if number == _ROOT_KEY_ID and isinstance(value, int):
            root_key_id = value
        elif number in {_AUTHORITY, _BLOCKS} and isinstance(value, bytes):
            if (number == _AUTHORITY) is bool(blocks):
                raise TokenError(FaultCode.TOKEN_MALFORMED, "not one authority block, or not first")
            blocks.append(_shape(value))
        elif number == _PROOF and isinstance(value, bytes):
            proven = [field for field, _ in _fields(value)] == [_NEXT_SECRET]
        else:
            raise TokenError(FaultCode.TOKEN_MALFORMED, "an unknown field")
    if not blocks or not proven:
        raise TokenError(FaultCode.TOKEN_MALFORMED, "no authority block, or no next secret")
    return Structure(root_key_id, tuple(blocks))


def _shape(signed_block: bytes) -> BlockShape:
    parts = dict(_fields(signed_block))
    payload = parts.get(_PAYLOAD)
    if not isinstance(payload, bytes):
        raise TokenError(FaultCode.TOKEN_MALFORMED, "a block without payload")
    counts = [0] * (_PUBLIC_KEYS + 1)
    for number, _ in _fields(payload):
        if not 1 <= number <= _PUBLIC_KEYS:
            raise TokenError(FaultCode.TOKEN_MALFORMED, "an unknown field in a block")
        counts[number] += 1
    return BlockShape(
        third_party=_EXTERNAL in parts and parts.get(_SIGNATURE_VERSION) == THIRD_PARTY_SIGNATURE,
        facts=counts[_FACTS],
        rules=counts[_RULES],
        checks=counts[_CHECKS],
        scoped=counts[_SCOPE] + counts[_PUBLIC_KEYS] > 0,
    )


def _fields(message: bytes) -> Iterator[tuple[int, int | bytes]]:
    """Field numbers and values of a message, in order. Only the two wire types that a Biscuit uses."""
    position, end = 0, len(message)
    while position < end:
        key, position = _varint(message, position)
        value, position = _varint(message, position)
        wire_type = key & 7
        if wire_type == _VARINT:
            yield key >> 3, value
        elif wire_type == _BYTES and value <= end - position:
            yield key >> 3, message[position : position + value]
            position += value
        else:
            raise TokenError(FaultCode.TOKEN_MALFORMED, "cut short, or a wire type that no Biscuit uses")


def _varint(message: bytes, position: int) -> tuple[int, int]:
    first = message[position : position + 1]
    if first < b"\x80" and first:  # nearly every number of a token is one byte long
        return first[0], position + 1
    value = 0
    for count, byte in enumerate(message[position : position + _VARINT_BYTES]):
        value |= (byte & 0x7F) << (7 * count)
        if byte < 0x80:
            return value, position + count + 1
    raise TokenError(FaultCode.TOKEN_MALFORMED, "a number that does not end")
