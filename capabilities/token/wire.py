"""The form of a token on the wire, read without any cryptography and without any Datalog.

A Biscuit is a Protocol Buffers message (eclipse-biscuit/biscuit, schema.proto); its fields are declared here, and the
Protocol Buffers library reads them. This is no second opinion on signatures: those are the Biscuit library's alone.
The content of a block is read from the very bytes that were signed.
"""

from __future__ import annotations

import functools
from typing import TYPE_CHECKING, Any, Final

from google.protobuf import descriptor_pb2, descriptor_pool, message_factory
from google.protobuf.message import DecodeError

from capabilities.token import byte_layout
from capabilities.token.byte_layout import Contents, SignedBlock, Structure
from capabilities.values.errors import FaultCode, TokenError
from capabilities.values.hashed_tuple import HashedTuple

if TYPE_CHECKING:
    from collections.abc import Mapping

REMEMBERED: Final = 512
"""Openings of blocks whose content is remembered; the least recently used go first."""
THIRD_PARTY_SIGNATURE: Final = 1
"""Signature version that binds a third-party block to the signature of the block before it."""
CLOSURES: Final = 6
"""Version of Datalog in which a check may have functions (3.3), as the Biscuit library writes it."""

_FIELD: Final = descriptor_pb2.FieldDescriptorProto
_NUMBERS: Final = {
    "bool": _FIELD.TYPE_BOOL,
    "bytes": _FIELD.TYPE_BYTES,
    "int32": _FIELD.TYPE_INT32,
    "int64": _FIELD.TYPE_INT64,
    "string": _FIELD.TYPE_STRING,
    "uint32": _FIELD.TYPE_UINT32,
    "uint64": _FIELD.TYPE_UINT64,
}

# Messages of schema.proto with their field numbers: "?" optional, "*" repeated, "|" one of several. An enumeration is
# an int32 here, since only its number counts. Fields that this profile never has are declared where they have to be
# seen; an undeclared field counts as unknown, and unknown fields are refused.
_SCHEMA: Final[Mapping[str, str]] = {
    "PublicKey": "?algorithm=1:int32 ?key=2:bytes",
    "ExternalSignature": "?signature=1:bytes ?publicKey=2:PublicKey",
    "SignedBlock": (
        "?block=1:bytes ?nextKey=2:PublicKey ?signature=3:bytes ?externalSignature=4:ExternalSignature "
        "?version=5:uint32"
    ),
    "Proof": "|nextSecret=1:bytes |finalSignature=2:bytes",
    "Biscuit": "?rootKeyId=1:uint32 ?authority=2:SignedBlock *blocks=3:SignedBlock ?proof=4:Proof",
    "Block": (
        "*symbols=1:string ?context=2:string ?version=3:uint32 *facts=4:Fact *rules=5:bytes *checks=6:bytes "
        "*scope=7:bytes *publicKeys=8:bytes"
    ),
    # Part of the same message: its own facts and checks.
    "Body": "*facts=4:Fact *checks=6:bytes",
    "Fact": "?predicate=1:Predicate",
    "Rule": "?head=1:Predicate *body=2:Predicate *expressions=3:Expression *scope=4:bytes",
    "Check": "*queries=1:Rule ?kind=2:int32",
    "Predicate": "?name=1:uint64 *terms=2:Term",
    "Term": (
        "|variable=1:uint32 |integer=2:int64 |string=3:uint64 |date=4:uint64 |bytes=5:bytes |bool=6:bool |set=7:TermSet"
    ),
    "TermSet": "*set=1:Term",
    "Expression": "*ops=1:Op",
    "Op": "|value=1:Term |unary=2:OpUnary |binary=3:OpBinary |closure=4:OpClosure",
    "OpUnary": "?kind=1:int32 ?ffiName=2:uint64",
    "OpClosure": "*params=1:uint32 *ops=2:Op",
    "OpBinary": "?kind=1:int32 ?ffiName=2:uint64",
}


def _messages() -> dict[str, Any]:
    file = descriptor_pb2.FileDescriptorProto(name="biscuit.proto", package="biscuit", syntax="proto2")
    for name, fields in _SCHEMA.items():
        message = file.message_type.add(name=name)
        for field in fields.split():
            (label, left), kind = (field[0], field[1:].split(":")[0]), field.split(":")[1]
            field_name, number = left.split("=")
            added = message.field.add(
                name=field_name,
                number=int(number),
                label=_FIELD.LABEL_REPEATED if label == "*" else _FIELD.LABEL_OPTIONAL,
            )
            if kind in _NUMBERS:
                added.type = _NUMBERS[kind]
            else:
                added.type, added.type_name = _FIELD.TYPE_MESSAGE, f".biscuit.{kind}"
            if label == "|":
                added.oneof_index = 0
        if "|" in fields:
            message.oneof_decl.add(name="content")
    pool = descriptor_pool.DescriptorPool()
    pool.Add(file)
    return {name: message_factory.GetMessageClass(pool.FindMessageTypeByName(f"biscuit.{name}")) for name in _SCHEMA}


MESSAGES: Final = _messages()
"""The message classes by name."""


def exactly(name: str, encoded: bytes) -> Any:
    """The message of this name, when these bytes are its one encoding: no unknown field, no other order or length.

    Raises:
        ValueError: when they are not.
    """
    try:
        message = MESSAGES[name].FromString(encoded)
    except DecodeError:
        raise ValueError("not a message") from None
    message.DiscardUnknownFields()
    if message.SerializeToString() != encoded:
        raise ValueError("another encoding")
    return message


def read(token: bytes) -> Structure:
    """The structure of a token that still has a next secret: a sealed one is not of this profile.

    Raises:
        TokenError: `TOKEN_MALFORMED` when the bytes are no such message.
    """
    return byte_layout.structure(token) or _read(token)


def _read(token: bytes) -> Structure:
    """Structure of a token in any spelling, read with the full parser."""
    try:
        message = MESSAGES["Biscuit"].FromString(token)
    except DecodeError:
        raise TokenError(FaultCode.TOKEN_MALFORMED, "not the message of a token") from None
    if not message.HasField("authority") or not message.proof.HasField("nextSecret"):
        raise TokenError(FaultCode.TOKEN_MALFORMED, "no authority block, or no next secret")
    return Structure(
        root_key_id=message.rootKeyId if message.HasField("rootKeyId") else None,
        blocks=(_signed(message.authority), *map(_signed, message.blocks)),
    )


def _signed(block: Any) -> SignedBlock:
    return SignedBlock(
        third_party=block.HasField("externalSignature") and block.version == THIRD_PARTY_SIGNATURE,
        payload=block.block,
    )


def contents(payload: bytes, *, version: int) -> Contents:
    """Content of a block of this version of Datalog or `CLOSURES`: one fact and checks, in the one encoding.

    Fields stand in the order of their numbers: the part before the fact, which is alike in many tokens, is read apart.

    Raises:
        TokenError: `WRONG_PROFILE` when it is of another version, or holds a rule, a scope, a key, a context or
            anything unknown; `CHAIN_BROKEN` when it has not one fact of an integer and byte strings.
    """
    return (
        byte_layout.contents(payload, _opened, version)
        or byte_layout.contents(payload, _opened, CLOSURES)
        or _contents(payload, version)
    )


def _contents(payload: bytes, version: int) -> Contents:
    """Content of a block in any spelling, read with the full parser."""
    try:
        body, opening = _parted(payload)
        symbols, stated = _opened(opening)
    except ValueError:
        raise TokenError(FaultCode.WRONG_PROFILE, "not a block in its one encoding") from None
    if stated not in {version, CLOSURES}:
        raise TokenError(FaultCode.WRONG_PROFILE, "a block of another version of Datalog")
    if len(body.facts) != 1:
        raise TokenError(FaultCode.CHAIN_BROKEN, "not one fact in a block")
    predicate = body.facts[0].predicate
    index, *further = predicate.terms or (None,)
    if index is None or not index.HasField("integer"):
        raise TokenError(FaultCode.CHAIN_BROKEN, "a fact without index")
    raw = tuple([term.bytes for term in further])
    if not all(raw):  # a term of another type reads as empty, too
        raise TokenError(FaultCode.CHAIN_BROKEN, "a term that is no byte string")
    return Contents(symbols, predicate.name, index.integer, raw, tuple(body.checks), stated)


def _parted(payload: bytes) -> tuple[Any, bytes]:
    """The fact and the checks of a block, which come last, and the bytes before them.

    Raises:
        ValueError: when they do not come last, in their one encoding.
    """
    try:
        body = MESSAGES["Body"].FromString(payload)
    except DecodeError:
        raise ValueError("not a message") from None
    body.DiscardUnknownFields()
    encoded = body.SerializeToString()
    if not payload.endswith(encoded):
        raise ValueError("another encoding, or something behind or between")
    return body, payload[: len(payload) - len(encoded)]


@functools.lru_cache(maxsize=REMEMBERED)
def _opened(opening: bytes) -> tuple[tuple[str, ...], int]:
    """The texts of a block and its version, out of the bytes before its fact.

    Remembered: those who lend the same operations use the same texts.

    Raises:
        ValueError: when that is not all that they hold, in the one encoding.
    """
    block = exactly("Block", opening)
    if block.facts or block.checks or block.rules or block.scope or block.publicKeys or block.HasField("context"):
        raise ValueError("a fact or check apart from the others, a rule, a scope, a key or a context")
    return HashedTuple(block.symbols), block.version
