"""Bytes that nobody issued are refused in any form, by a fault and never by an exception."""

from __future__ import annotations

import random
from dataclasses import replace

import pytest
from capabilities.values.caps import DEFAULT
from capabilities.values.errors import Fault, FaultCode, TokenError
from capabilities.values.scope import Grant, Tier
from tests.capabilities.world import (
    CELL,
    NOW,
    READ,
    SCOPE,
    SLOWER,
    Forge,
    add_hop,
    chain_of_four,
    check,
    mint_root,
    raw_of,
)

from capabilities.token import biscuit, wire

pytestmark = pytest.mark.clause("TOK-3", "TOK-5")

SEED = 20_261_120
MUTANTS = 20_000


def mutate(token: bytes, others: list[bytes], chance: random.Random) -> bytes:
    at = chance.randrange(len(token))
    match chance.randrange(8):
        case 0:
            return token[:at] + bytes([token[at] ^ (1 << chance.randrange(8))]) + token[at + 1 :]
        case 1:
            return token[:at] + bytes([chance.randrange(256)]) + token[at + 1 :]
        case 2:
            return token[:at] + token[at + chance.randrange(1, 9) :]
        case 3:
            return token[:at] + chance.randbytes(chance.randrange(1, 9)) + token[at:]
        case 4:
            return token[:at]
        case 5:
            length = chance.randrange(1, 64)
            return token[:at] + bytes(length) + token[at + length :]
        case 6:
            other = chance.choice(others)
            return token[:at] + other[chance.randrange(len(other)) :]
        case _:
            return chance.randbytes(chance.randrange(1, 400))


@pytest.mark.long
def test_no_mutant_is_accepted():
    shapes = [
        mint_root(),
        add_hop(mint_root(), "robotic", SLOWER),
        chain_of_four(),
        mint_root(replace(SCOPE, grants=(READ,))),
    ]
    issued = set(shapes)
    chance = random.Random(SEED)
    codes = set()
    for _ in range(MUTANTS):
        mutant = mutate(chance.choice(shapes), shapes, chance)
        if mutant in issued:
            continue
        fault = check(mutant)
        assert isinstance(fault, Fault), mutant.hex()
        codes.add(fault.code)
    assert {FaultCode.SIGNATURE_INVALID, FaultCode.TOKEN_MALFORMED} <= codes


def small_token() -> bytes:
    scope = replace(
        SCOPE,
        grants=(Grant("r", "s"),),
        audiences=frozenset({CELL}),
        delegates=frozenset(),
        ceiling=Tier.NO_EFFECT,
        depth=0,
    )
    return Forge.authority(scope)


def is_refused(token: bytes) -> bool:
    """Steps 2, 3 and 5 alone, which is what malleable bytes must not pass."""
    try:
        wire.read(token)
        return biscuit.open_token(token, raw_of("root")).encode() != token
    except TokenError:
        return True


@pytest.mark.long
def test_every_single_byte_is_what_it_must_be():
    """Each byte replaced by eight others (every bit flipped alone): exhaustive over bits and positions."""
    token = small_token()
    assert not is_refused(token)
    accepted = []
    for at in range(2, len(token)):  # bytes 0 and 1 are the root key id, which step 3 reads
        for bit in range(8):
            mutant = token[:at] + bytes([token[at] ^ (1 << bit)]) + token[at + 1 :]
            if not is_refused(mutant):
                accepted.append((at, bit))
    assert accepted == []


def test_every_deletion_and_insertion_is_refused():
    token = small_token()
    for at in range(len(token)):
        assert is_refused(token[:at] + token[at + 1 :]), at
        for byte in (0x00, 0x01, 0x08, 0x50, 0x80, 0xFF):
            assert is_refused(token[:at] + bytes([byte]) + token[at:]) or at < 2, (at, byte)


@pytest.mark.parametrize("number", [1, 5, 6, 7, 8, 9, 10, 15])
@pytest.mark.parametrize("tail", [b"\x00", b"\x01", b"\x7f"])
def test_appended_fields_are_refused(number, tail):
    token = small_token()
    for field in (bytes([number << 3]) + tail, bytes([number << 3 | 2]) + b"\x01" + tail):
        assert isinstance(check(token + field), Fault)
        assert isinstance(check(field + token), Fault)


@pytest.mark.clause("TOK-3", "TOK-5")
def test_the_root_key_id_is_not_malleable():
    """The id is not signed, so two ids of one key would be two spellings of one token."""
    token = small_token()
    for value in (b"\x08\x06", b"\x08\x08", b"\x08\x87\x00", b""):
        assert isinstance(check(value + token[2:]), Fault)
    assert token[:2] == b"\x08\x07"
    assert DEFAULT.hops == 8
    assert NOW > 0
