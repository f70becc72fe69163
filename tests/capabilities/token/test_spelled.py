"""Content read off the bytes of a token is the full reader's, for any bytes."""

from __future__ import annotations

import random
from dataclasses import replace
from typing import TYPE_CHECKING

import pytest
from capabilities.token.checks import Checks
from capabilities.values.errors import TokenError
from hypothesis import given
from hypothesis import strategies as st
from tests.capabilities.world import (
    MOVE,
    NOW,
    READ,
    SCOPE,
    SLOWER,
    SPONSOR,
    TOKEN_ID,
    add_hop,
    chain_of_four,
    grant_to,
    key_of,
    mint_root,
)

from capabilities.token import biscuit, block, byte_layout, checks, fact, wire

pytestmark = pytest.mark.version

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

SEED = 20_261_211
LARGEST = 2**63 - 1
"""Of a term of Datalog."""

TOKENS = (
    mint_root(),
    add_hop(mint_root(), "robotic", SLOWER),
    add_hop(mint_root(), "robotic", replace(SLOWER, not_after=NOW + 2_000, ceiling=SCOPE.ceiling)),
    chain_of_four(),
    mint_root(replace(SCOPE, grants=(READ,))),
    mint_root(replace(SCOPE, grants=(MOVE,), ceiling=SCOPE.ceiling)),
)


def payloads() -> list[tuple[bytes, int]]:
    return [
        (each.payload, fact.HOP_VERSION if index else fact.AUTHORITY_VERSION)
        for token in TOKENS
        for index, each in enumerate(wire._read(token).blocks)
    ]


def contexts() -> list[tuple[tuple[str, ...], bytes]]:
    found = [wire._contents(payload, version) for payload, version in payloads()]
    return [(each.symbols, encoded) for each in found for encoded in each.checks[1:]]


def spoiled(honest: bytes, values: range = range(256)) -> Iterator[bytes]:
    """One byte changed, removed, doubled or put in, and every beginning and end, at each place."""
    for at in range(len(honest)):
        for value in values:
            yield honest[:at] + bytes([honest[at] ^ value]) + honest[at + 1 :]
        yield honest[:at] + honest[at + 1 :]
        yield honest[:at] + honest[at : at + 1] + honest[at:]
        yield honest[:at] + b"\x80" + honest[at:]
        yield honest[:at] + b"\x00" + honest[at:]
        yield honest[:at]
        yield honest[at:]


def answer(read: Callable[[], object]) -> object:
    try:
        return read()
    except TokenError as error:
        return error.code


# --- what is issued --------------------------------------------------------------------------------------------------


@pytest.mark.clause("TOK-2", "TOK-6.1")
def test_what_is_issued_is_read_off():
    for token in TOKENS:
        assert byte_layout.structure(token) == wire._read(token)
    for payload, version in payloads():
        assert byte_layout.contents(payload, wire._opened, version) == wire._contents(payload, version)
    found = contexts()
    assert len(found) >= len(TOKENS)
    for symbols, encoded in found:
        assert byte_layout.context(encoded, checks._spelling(symbols)) == list(checks._context(symbols, encoded))


numbers = st.none() | st.integers(0, LARGEST) | st.sampled_from([0, 1, 127, 128, 2**14 - 1, 2**14, LARGEST])


@pytest.mark.clause("BLK-9")
@given(numbers, numbers, numbers)
def test_numbers_of_every_length(not_before, not_after, ceiling):
    demanded = Checks(None, not_before, not_after, ceiling)
    made = block.AuthorityBlock(TOKEN_ID, SPONSOR, 0, grant_to("orchestrator", "alice"), SCOPE)
    token = biscuit.seal_authority(block.fact(made), demanded, root=key_of("root"), root_key_id=7)
    found = wire.contents(wire.read(token).blocks[0].payload, version=fact.AUTHORITY_VERSION)
    assert checks.read(found.symbols, found.checks) == demanded
    if found.checks:
        context = byte_layout.context(found.checks[0], checks._spelling(found.symbols))
        assert context == [not_before, not_after, ceiling]


# --- what is not -----------------------------------------------------------------------------------------------------


@pytest.mark.clause("TOK-2", "BLK-1")
def test_a_token_is_read_off_as_it_is_read():
    chance = random.Random(SEED)
    told = 0
    for token in TOKENS[1:4]:
        heads = [chance.randrange(len(token)) for _ in range(200)] + [*range(8), *range(len(token) - 240, len(token))]
        for at in heads:
            for value in (0, 1, 0x7F, 0x80, 0xFF, token[at] ^ 1, token[at] ^ 0x80, token[at] + 1 & 0xFF):
                for other in (
                    token[:at] + bytes([value]) + token[at + 1 :],
                    token[:at] + bytes([value]) + token[at:],
                    token[:at] + token[at + 1 :],
                ):
                    found = byte_layout.structure(other)
                    told += found is not None
                    assert found is None or found == answer(lambda other=other: wire._read(other)), other.hex()
    assert told > 1_000  # payloads, keys and signatures that were changed are read off too


@pytest.mark.long
@pytest.mark.clause("TOK-6.1", "BLK-3")
@pytest.mark.parametrize("which", range(2))
def test_a_block_is_read_off_as_it_is_read(which):
    payload, version = [each for each in payloads() if each[1] == (3, 5)[which]][-1]
    told = 0
    for other in spoiled(payload, range(1, 256, 1 if len(payload) < 500 else 9)):
        found = byte_layout.contents(other, wire._opened, version)
        told += found is not None
        assert found is None or found == answer(lambda other=other: wire._contents(other, version)), other.hex()
    assert told > 1_000


@pytest.mark.clause("BLK-9")
def test_a_check_is_read_off_as_it_is_read():
    told = 0
    for symbols, encoded in contexts()[:3]:
        spelling = checks._spelling(symbols)
        for other in spoiled(encoded):
            found = byte_layout.context(other, spelling)
            told += found is not None
            full = answer(lambda other=other, symbols=symbols: list(checks._context(symbols, other)))
            assert found is None or found == full, other.hex()
    assert told > 1_000


@pytest.mark.clause("TOK-2", "TOK-5")
@pytest.mark.parametrize("cut", [1, 2, 33, 40, 200])
def test_lengths_that_reach_behind_the_end(cut):
    token = TOKENS[3]
    assert byte_layout.structure(token[:-cut]) is None
    assert byte_layout.structure(token + bytes(cut)) is None
    for payload, version in payloads():
        assert byte_layout.contents(payload[:-cut], wire._opened, version) is None
        assert byte_layout.contents(payload + bytes(cut), wire._opened, version) is None


@pytest.mark.clause("BLK-9")
def test_a_number_in_more_bytes_than_it_needs_is_not_read_off():
    symbols, encoded = contexts()[0]
    spelling = checks._spelling(symbols)
    ceiling = encoded.rindex(b"\x0a\x04\x0a\x02\x10")
    longer = (
        encoded[:ceiling] + b"\x0a\x05\x0a\x03\x10" + bytes([encoded[ceiling + 5] | 0x80, 0]) + encoded[ceiling + 6 :]
    )
    last = longer.rindex(b"\x1a\x13", 0, ceiling)
    longer = bytes([longer[0], longer[1] + 1, *longer[2:last], 0x1A, 0x14, *longer[last + 2 :]])
    assert wire.MESSAGES["Check"].FromString(longer).SerializeToString() == encoded
    assert byte_layout.context(longer, spelling) is None
    assert isinstance(answer(lambda: checks._context(symbols, longer)), str)


@pytest.mark.clause("TOK-6.1")
def test_a_length_in_more_bytes_than_it_needs_is_not_read_off():
    payload, version = payloads()[0]
    last = wire._contents(payload, version).checks[-1]
    assert len(last) < 0x80
    longer = payload[: -len(last) - 1] + bytes([len(last) | 0x80, 0]) + last
    assert wire.MESSAGES["Body"].FromString(longer) == wire.MESSAGES["Body"].FromString(payload)
    assert byte_layout.contents(longer, wire._opened, version) is None


@pytest.mark.clause("BLK-9")
def test_a_check_that_demands_nothing_is_not_read_off():
    symbols, encoded = contexts()[0]
    spelling = checks._spelling(symbols)
    demanding_nothing = bytes([0x0A, len(spelling.head)]) + spelling.head
    assert encoded[2:].startswith(spelling.head)
    assert byte_layout.context(demanding_nothing, spelling) is None
    assert isinstance(answer(lambda: checks._context(symbols, demanding_nothing)), str)


@pytest.mark.clause("TOK-2", "TOK-5")
def test_a_block_with_something_behind_is_not_read_off():
    token = TOKENS[0]
    message = wire.MESSAGES["Biscuit"].FromString(token)
    block_bytes = message.authority.SerializeToString()
    low, high = len(block_bytes) + 2 & 0x7F | 0x80, len(block_bytes) + 2 >> 7
    at = token.index(block_bytes)
    more = token[: at - 2] + bytes([low, high]) + block_bytes + b"\x30\x01" + token[at + len(block_bytes) :]
    assert byte_layout.structure(more) is None
    assert wire._read(more) == wire._read(token)


@pytest.mark.clause("TOK-3")
@pytest.mark.parametrize("number", [0, 1, 127, 128, 300, 2**32 - 1])
def test_root_key_ids_of_every_length(number):
    made = block.AuthorityBlock(TOKEN_ID, SPONSOR, 0, grant_to("orchestrator", "alice"), SCOPE)
    token = biscuit.seal_authority(block.fact(made), block.checks(made, None), root=key_of("root"), root_key_id=number)
    assert wire.read(token) == wire._read(token)
    assert wire.read(token).root_key_id == number
