"""The outer form of a token, from messages made by hand."""

from __future__ import annotations

import pytest

from capabilities import structure
from capabilities.errors import FaultCode, TokenError


def field(number: int, value: bytes | int) -> bytes:
    if isinstance(value, int):
        return bytes([number << 3, value])
    assert len(value) < 128
    return bytes([number << 3 | 2, len(value)]) + value


ROOT_ID, SECRET = field(1, 7), field(4, field(1, b"s" * 32))
PLAIN = field(1, field(4, b"fact") + field(6, b"check"))
THIRD_PARTY = PLAIN + field(4, b"external") + field(5, 1)


def shape_of(signed_block: bytes) -> structure.BlockShape:
    return structure.read(field(2, signed_block) + SECRET).blocks[0]


def test_a_token_is_counted():
    found = structure.read(ROOT_ID + field(2, PLAIN) + field(3, THIRD_PARTY) + SECRET)
    assert found.root_key_id == 7
    assert [(b.third_party, b.facts, b.rules, b.checks, b.scoped) for b in found.blocks] == [
        (False, 1, 0, 1, False),
        (True, 1, 0, 1, False),
    ]


@pytest.mark.parametrize(
    "token",
    [
        b"",
        ROOT_ID + SECRET,
        field(2, PLAIN),
        field(2, PLAIN) + field(2, PLAIN) + SECRET,
        field(3, PLAIN) + field(2, PLAIN) + SECRET,
        field(3, PLAIN) + SECRET,
        field(2, PLAIN) + field(4, field(2, b"sealed")),
        field(2, PLAIN) + field(4, b""),
        field(2, PLAIN) + field(4, field(1, b"s") + field(2, b"f")),
        field(2, PLAIN) + SECRET + field(5, b"x"),
        field(1, b"seven") + field(2, PLAIN) + SECRET,
        field(2, 1) + SECRET,
        field(2, PLAIN) + field(4, 1),
        field(2, field(2, b"no payload")) + SECRET,
        field(2, field(1, 5)) + SECRET,
        field(2, field(1, field(9, b"x"))) + SECRET,
        field(2, field(1, field(0, b"x"))) + SECRET,
        field(2, PLAIN) + SECRET + b"\x0d\0\0\0\0",
        field(2, PLAIN) + SECRET + b"\x0b",
        field(2, PLAIN) + SECRET[:-1],
        field(2, PLAIN) + SECRET + b"\x80",
        field(2, PLAIN) + SECRET + b"\x08" + b"\xff" * 10 + b"\x01",
    ],
)
def test_anything_else_is_malformed(token):
    with pytest.raises(TokenError) as caught:
        structure.read(token)
    assert caught.value.code is FaultCode.TOKEN_MALFORMED


@pytest.mark.parametrize("version", [b"", field(5, 0), field(5, 2)])
def test_an_external_signature_of_another_version_does_not_count(version):
    """Before version 1 it did not bind a block to its place (third-party key confusion, July 2024)."""
    assert not shape_of(PLAIN + field(4, b"external") + version).third_party
    assert not shape_of(PLAIN + field(5, 1)).third_party


def test_rules_and_scopes_are_seen():
    assert shape_of(field(1, field(5, b"rule"))).rules == 1
    assert shape_of(field(1, field(7, b"scope"))).scoped
    assert shape_of(field(1, field(8, b"key"))).scoped
