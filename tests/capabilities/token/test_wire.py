"""The form of a token on the wire, from messages made by hand."""

from __future__ import annotations

import pytest
from capabilities.token.checks import Alternative, Checks
from capabilities.values.errors import FaultCode, TokenError
from capabilities.values.scope import OneOf, Range
from tests.capabilities.world import SCOPE, SPONSOR, TOKEN_ID, chain_of_four, grant_to, key_of

from capabilities.token import biscuit, block, checks, symbols, wire


def field(number: int, value: bytes | int) -> bytes:
    if isinstance(value, int):
        return bytes([number << 3, value])
    assert len(value) < 128
    return bytes([number << 3 | 2, len(value)]) + value


def term(value: bytes | int) -> bytes:
    return field(2, field(2, value) if isinstance(value, int) else field(5, value))


ROOT_ID, SECRET = field(1, 7), field(4, field(1, b"s" * 32))
PLAIN = field(1, b"payload")
THIRD_PARTY = PLAIN + field(4, field(1, b"external")) + field(5, 1)
NAME = field(1, 5)
FACT = field(4, field(1, NAME + term(0) + term(b"abc")))
VERSION = field(3, 3)


def signed(block: bytes) -> wire.SignedBlock:
    return wire.read(field(2, block) + SECRET).blocks[0]


@pytest.mark.clause("TOK-2")
def test_a_token_is_read():
    found = wire.read(ROOT_ID + field(2, PLAIN) + field(3, THIRD_PARTY) + SECRET)
    assert found.root_key_id == 7
    assert [(b.third_party, b.payload) for b in found.blocks] == [(False, b"payload"), (True, b"payload")]
    assert wire.read(field(2, PLAIN) + SECRET).root_key_id is None
    assert len(wire.read(chain_of_four()).blocks) == 4


@pytest.mark.clause("TOK-2", "BLK-1")
@pytest.mark.parametrize(
    "token",
    [
        b"",
        ROOT_ID + SECRET,
        field(2, PLAIN),
        field(3, PLAIN) + SECRET,
        field(2, PLAIN) + field(4, field(2, b"sealed")),
        field(2, PLAIN) + field(4, b""),
        field(2, PLAIN) + field(4, field(1, b"s") + field(2, b"f")),
        field(2, PLAIN) + SECRET[:-1],
        field(2, PLAIN) + SECRET + b"\x80",
        field(2, PLAIN) + SECRET + b"\x08" + b"\xff" * 10 + b"\x01",
        field(2, b"\xff") + SECRET,
    ],
)
def test_anything_else_is_malformed(token):
    with pytest.raises(TokenError) as caught:
        wire.read(token)
    assert caught.value.code is FaultCode.TOKEN_MALFORMED


@pytest.mark.clause("TOK-4", "BLK-2")
@pytest.mark.parametrize("version", [b"", field(5, 0), field(5, 2)])
def test_an_external_signature_of_another_version_does_not_count(version):
    """Before version 1 it did not bind a block to its place (third-party key confusion, July 2024)."""
    assert not signed(PLAIN + field(4, field(1, b"external")) + version).third_party
    assert not signed(PLAIN + field(5, 1)).third_party


@pytest.mark.clause("BLK-3")
def test_the_contents_of_a_block():
    payload = field(1, b"one") + field(1, b"two") + VERSION + FACT + field(6, b"first") + field(6, b"second")
    assert wire.contents(payload, version=3) == wire.Contents(("one", "two"), 5, 0, (b"abc",), (b"first", b"second"), 3)


@pytest.mark.clause("TOK-6.1", "BLK-3", "BLK-4")
@pytest.mark.parametrize(
    ("payload", "code"),
    [
        (b"\xff", FaultCode.WRONG_PROFILE),
        (FACT + VERSION, FaultCode.WRONG_PROFILE),  # another order
        (VERSION + VERSION + FACT, FaultCode.WRONG_PROFILE),
        (b"\x18\x83\x00" + FACT, FaultCode.WRONG_PROFILE),  # an over-long number
        (VERSION + FACT + field(9, b"x"), FaultCode.WRONG_PROFILE),
        (VERSION + field(4, field(1, NAME + term(0)) + field(2, b"x")), FaultCode.WRONG_PROFILE),
        (VERSION + field(4, field(1, NAME + term(0) + field(3, 1))), FaultCode.WRONG_PROFILE),
        (field(2, b"context") + VERSION + FACT, FaultCode.WRONG_PROFILE),
        (VERSION + FACT + field(5, b"rule"), FaultCode.WRONG_PROFILE),
        (VERSION + FACT + field(7, b"scope"), FaultCode.WRONG_PROFILE),
        (VERSION + FACT + field(8, b"key"), FaultCode.WRONG_PROFILE),
        (field(3, 4) + FACT, FaultCode.WRONG_PROFILE),
        (FACT, FaultCode.WRONG_PROFILE),
        (VERSION, FaultCode.CHAIN_BROKEN),
        (VERSION + FACT + FACT, FaultCode.CHAIN_BROKEN),
        (VERSION + field(4, b""), FaultCode.CHAIN_BROKEN),
        (VERSION + field(4, field(1, NAME)), FaultCode.CHAIN_BROKEN),
        (VERSION + field(4, field(1, NAME + term(b"abc"))), FaultCode.CHAIN_BROKEN),
        (VERSION + field(4, field(1, NAME + term(0) + term(1))), FaultCode.CHAIN_BROKEN),
        (VERSION + field(4, field(1, NAME + term(0) + field(2, field(3, 1)))), FaultCode.CHAIN_BROKEN),
        (VERSION + field(4, field(1, NAME + term(0) + field(2, b""))), FaultCode.CHAIN_BROKEN),
    ],
)
def test_other_contents_are_refused(payload, code):
    with pytest.raises(TokenError) as caught:
        wire.contents(payload, version=3)
    assert caught.value.code is code


# --- checks as the library writes them -------------------------------------------------------------------------------

WORDS = (
    "read write resource operation right time role owner tenant namespace user team service admin email group member "
    "ip_address client client_ip domain path version cluster node hostname nonce query hop req req_ctx tier v0 v1"
).split()


def written(demanded: Checks) -> wire.Contents:
    made = block.AuthorityBlock(TOKEN_ID, SPONSOR, 0, grant_to("orchestrator", "alice"), SCOPE)
    token = biscuit.seal_authority(block.fact(made), demanded, root=key_of("root"), root_key_id=7)
    return wire.contents(wire.read(token).blocks[0].payload, version=3)


@pytest.mark.clause("BLK-3", "BLK-8")
@pytest.mark.parametrize("word", WORDS)
def test_words_that_every_block_knows_are_names_like_others(word):
    demanded = Checks((Alternative(word, "op", (Range(0, 1),)), Alternative("ur3e", word, ())), 1, 2, 3)
    found = written(demanded)
    assert checks.read(found.symbols, found.checks) == demanded
    assert symbols.text_of(found.symbols, found.predicate) == "hop"


@pytest.mark.clause("BLK-8", "BLK-9")
@pytest.mark.parametrize(
    "demanded",
    [
        Checks(None, None, None, None),
        Checks(None, 5, None, None),
        Checks(None, None, 5, None),
        Checks(None, None, None, 0),
        Checks(None, 5, None, 0),
        Checks((Alternative("ur3e", "stop", ()),), None, None, None),
        Checks((Alternative("ur3e", "m", (None, Range(-(2**53) + 1, 2**53 - 1), None)),), 0, 253_402_300_799, 4),
        Checks((Alternative("ur3e", "m", (OneOf(frozenset({-5, 0, 7})), Range(-1, -1))),), None, None, None),
        Checks((Alternative("ur3e", "m", tuple(Range(-i, i) for i in range(32))),), None, None, None),
        Checks((Alternative("ur3e", "m", (OneOf(frozenset(range(-32, 32))),)),), None, None, None),
    ],
)
def test_checks_are_read_as_they_were_written(demanded):
    found = written(demanded)
    assert checks.read(found.symbols, found.checks) == demanded


@pytest.mark.clause("BLK-3")
@pytest.mark.parametrize("symbols", [("hop", "hop"), ("hop", "read"), ("query",)])
def test_a_block_repeats_no_text(symbols):
    with pytest.raises(TokenError) as caught:
        checks.read(symbols, ())
    assert caught.value.code is FaultCode.CHAIN_BROKEN


@pytest.mark.clause("BLK-3")
@pytest.mark.parametrize("number", [28, 1_023, 1_026, 2**63])
def test_a_text_that_is_not_there(number):
    with pytest.raises(TokenError):
        symbols.text_of(("hop", "req"), number)
