"""JSON with one meaning."""

from __future__ import annotations

import json
import math
import random
import struct
import time
from datetime import UTC, datetime
from decimal import Decimal
from fractions import Fraction
from uuid import UUID

import pytest
import rfc8785
from capabilities.values.errors import FaultCode, StatementError
from capabilities.values.units import INT_LIMIT, Parameter, Unit

from capabilities.values import strict_json

pytestmark = pytest.mark.clause("PRF-1", "STM-1")


def test_depth_is_bounded_before_parsing():
    deep = strict_json.DEPTH_LIMIT
    assert strict_json.parse(b"[" * deep + b"]" * deep) is not None
    for raw in (b"[" * (deep + 1) + b"]" * (deep + 1), b"[" * 10**6, b'{"a":' * 10**5):
        with pytest.raises(StatementError) as caught:
            strict_json.parse(raw)
        assert caught.value.code is FaultCode.STATEMENT_MALFORMED


@pytest.mark.parametrize(
    "raw",
    [
        b"1.0",
        b"1e3",
        b"NaN",
        b"Infinity",
        b"-Infinity",
        b"1e999",
        b"9007199254740992",
        b"1" * 5_000,
        b"01",
        b"+1",
        b"'a'",
        b'"\\ud800',
        b'"\n"',
        b"",
        b"[1,]",
        b'{"a":1,"a":1}',
    ],
)
def test_other_spellings_are_refused(raw):
    with pytest.raises(StatementError):
        strict_json.parse(raw)


def test_the_largest_integers_pass():
    for number in (INT_LIMIT, -INT_LIMIT, 0):
        assert strict_json.parse(str(number).encode()) == number


@pytest.mark.clause("STM-4")
def test_what_has_no_utf8_has_no_canonical_form():
    with pytest.raises(StatementError):
        strict_json.canonical({"x": "\ud800"})


@pytest.mark.parametrize(
    "value",
    [
        {"b": [1, -1, 0, INT_LIMIT, -INT_LIMIT, True, None, ""], "a": {"": {}, "z": []}},
        {"é": '\x00\x1f\x7f\u2028/\\"', "\ue000": 1, "\U0001f600": 2, "z": "\U0001f600"},
        [0.5, 45.0, -0.0, 1e21, 1e-7, 5e-324, 1e16, 123456789012345680.0, 1_000_000_000_000_000.5],
        {"n": [1234567890123456, "1234567890123456", 12345678901234567890 / 1e5]},
        (1, ("a", 2)),
        [Unit.PASCAL, True],
    ],
)
def test_what_is_written_quickly_is_the_same_form(value):
    assert strict_json.canonical(value) == rfc8785.dumps(value)


@pytest.mark.parametrize(
    "value",
    [math.nan, [-math.inf], {1: 2}, {None: 1}, {"a", "b"}, b"raw", INT_LIMIT + 1, [2**63], Parameter("a", Unit.PASCAL)]
    + [Decimal(1), Fraction(1, 2), datetime.now(UTC), UUID(int=1)],
)
def test_what_is_no_plain_json_has_no_canonical_form(value):
    for each in (value, [value], {"member": [value]}):
        with pytest.raises(StatementError):
            strict_json.canonical(each)


def test_random_values_are_written_as_rfc_8785_says():
    draw = random.Random(8785)
    leaves = (
        lambda: draw.randint(-INT_LIMIT, INT_LIMIT),
        lambda: draw.choice((True, False, None, "", 0)),
        lambda: "".join(chr(draw.choice((draw.randrange(0x80), draw.randrange(0xD7FF), draw.randrange(0xE000, 0x110000)))) for _ in range(draw.randrange(5))),
        lambda: draw.choice((draw.uniform(-1e6, 1e6), round(draw.uniform(-99, 99), 1), float(draw.randint(-99, 99)), 10.0 ** draw.randint(-30, 30))),
    )  # fmt: skip

    def value(depth):
        kind = draw.randrange(4 if depth else 2)
        if kind == 2:
            return [value(depth - 1) for _ in range(draw.randrange(4))]
        if kind == 3:
            return {str(leaves[2]()): value(depth - 1) for _ in range(draw.randrange(5))}
        return draw.choice(leaves)()

    for _ in range(300):
        drawn = value(4)
        assert strict_json.canonical(drawn) == rfc8785.dumps(drawn), drawn


def test_a_byte_order_mark_is_named_and_taken_from_files_alone():
    raw = b"\xef\xbb\xbf{}"
    with pytest.raises(strict_json.JsonError) as caught:
        strict_json.read(raw, limit_bytes=9, limit_depth=1)
    assert caught.value.defect is strict_json.JsonDefect.MALFORMED and "mark" in caught.value.detail
    assert strict_json.read(strict_json.without_mark(raw), limit_bytes=9, limit_depth=1) == {}
    assert strict_json.without_mark(b"{}") == b"{}"


CANONICAL = [
    b'{"a":1}', b'{"a":1.5,"b":[1e-7,1e+21,0.00001]}', b'[5e-324,1.7976931348623157e+308,0.1,100]', b'"\\u0001\\n\x7f"',
    '{"\u20ac":"\u00e4","\U0001f600":1,"\ufb33":2}'.encode(), '["\u2028"]'.encode(), b'{"a":"5.0,e-7"}', b"[]",
]  # fmt: skip
NOT_CANONICAL = [
    b'{"a": 1}', b'{"b":1,"a":2}', b"[1.0]", b"[1.50]", b"[1e5]", b"[1E-7]", b"[1e-05]", b"[0.0000001]", b"[-0]", b"[-0.0]",
    b'["\\u0041"]', b'["\\/"]', '{"\ufb33":2,"\U0001f600":1}'.encode(), b"[1] ", b"[10000000000000000.0]", b"[1e-5]",
]  # fmt: skip


@pytest.mark.parametrize(("raw", "expected"), [(r, True) for r in CANONICAL] + [(r, False) for r in NOT_CANONICAL])
def test_canonical_bytes_are_told_as_by_their_one_writer(raw, expected):
    value = strict_json.read(raw, limit_bytes=1_000, limit_depth=8)
    assert (rfc8785.dumps(value) == raw) is expected
    assert strict_json.read_canonical(raw, limit_bytes=1_000, limit_depth=8) == (value, expected)


@pytest.mark.parametrize("seed", range(20))
def test_canonical_bytes_are_told_as_by_their_one_writer_of_any_float(seed):
    drawn = random.Random(seed)
    for _ in range(200):
        number = struct.unpack("<d", drawn.randbytes(8))[0]
        number = (
            number if math.isfinite(number) and abs(number) < 2**53 else drawn.random() * 10 ** drawn.randint(-9, 15)
        )
        for raw in (rfc8785.dumps([number]), json.dumps([number]).encode()):
            value = strict_json.read(raw, limit_bytes=1_000, limit_depth=8)
            found = strict_json.read_canonical(raw, limit_bytes=1_000, limit_depth=8)
            assert found == (value, rfc8785.dumps(value) == raw), raw


REFUSED = [
    b"", b"{", b'{"a":1,"a":1}', b"NaN", b"[Infinity]", b"[-Infinity]", b"[1e999]", b"[01]", b"[1,]", b"\xef\xbb\xbf[]", b'["\xff"]',
    b'["\xed\xa0\x80"]', b'["\xc0\x80"]', b'["\\ud800"]', b'["\\udc00\\ud800"]', b'["\x01"]', b"[9007199254740992]",
    b"9007199254740992", b"-9007199254740992", b'{"a":18446744073709551616}', b"[[[[[[[[[]]]]]]]]]", b'{"a":"' + b"x" * 1_000 + b'"}',
    b"[1" + b"0" * 400 + b"]", b"\x00", b'["a\nb"]',
]  # fmt: skip


@pytest.mark.parametrize("raw", REFUSED)
def test_what_is_refused_is_refused_in_the_same_words_by_the_quick_reader(raw):
    with pytest.raises(strict_json.JsonError) as slow:
        strict_json.read(raw, limit_bytes=1_000, limit_depth=8)
    with pytest.raises(strict_json.JsonError) as quick:
        strict_json.read_canonical(raw, limit_bytes=1_000, limit_depth=8)
    assert (quick.value.defect, quick.value.detail) == (slow.value.defect, slow.value.detail)


def any_value(drawn, depth=0):
    """A value of any form, its texts of any characters but halves of pairs."""
    texts = [
        "",
        "a",
        "\u00e4",
        "\u20ac",
        "\U0001f600",
        "\ufb33",
        '"',
        "\\",
        "/",
        "\x7f",
        "\x00",
        "\x1f",
        "\n",
        "\u2028",
        "1e5",
        ":1",
    ]
    text = "".join(drawn.choice(texts) for _ in range(drawn.randint(0, 4)))
    numbers = [0, -1, 2**53 - 1, 1 - 2**53, 1e15, 123456789012345, 0.5, -1e-7, 1e21, 12345678.25, 5e-324]
    plain = [None, True, False, text, drawn.choice(numbers), drawn.uniform(-10, 10)]
    if depth > 3 or drawn.random() < 0.5:
        return drawn.choice(plain)
    inner = [any_value(drawn, depth + 1) for _ in range(drawn.randint(0, 3))]
    return inner if drawn.random() < 0.5 else {text + str(k): each for k, each in enumerate(inner)}


@pytest.mark.parametrize("seed", range(10))
def test_the_quick_reader_is_the_strict_one_on_canonical_texts_and_others(seed):
    drawn, limits, told = random.Random(seed), {"limit_bytes": 10_000, "limit_depth": 9}, set()
    for _ in range(300):
        raw = rfc8785.dumps(any_value(drawn))
        assert strict_json.read_canonical(raw, **limits) == (strict_json.read(raw, **limits), True), raw
        raw = bytearray(raw)
        at = drawn.randrange(len(raw))
        raw[at : at + 1] = drawn.choice(
            [b"", b" ", b"0", b"e", b"-", b'"', b"\\", b"[", b":", bytes([drawn.randrange(256)])]
        )
        try:
            value = strict_json.read(bytes(raw), **limits)
        except strict_json.JsonError:
            with pytest.raises(strict_json.JsonError):
                strict_json.read_canonical(bytes(raw), **limits)
            continue
        told.add(rfc8785.dumps(value) == raw)
        assert strict_json.read_canonical(bytes(raw), **limits) == (value, rfc8785.dumps(value) == raw), raw
    assert told == {True, False}


@pytest.mark.parametrize("inside", [b"[" * 9, b'\\"' * 5 + b"[" * 9, b"\\\\", b"{}[]" * 9])
def test_brackets_of_a_text_are_no_nesting(inside):
    raw = b'["' + inside + b'",[]]'
    assert strict_json.read(raw, limit_bytes=1_000, limit_depth=2)[1] == []
    with pytest.raises(strict_json.JsonError):
        strict_json.read(raw, limit_bytes=1_000, limit_depth=1)


@pytest.mark.parametrize(
    "raw", [b'["' + b"a" * 200_000, b'["' + b'\\"' * 100_000, b'"' * 200_001, b"[" + b'"\\' * 100_000]
)
def test_a_text_without_an_end_costs_one_reading(raw):
    began = time.process_time()
    with pytest.raises(strict_json.JsonError):
        strict_json.read(raw, limit_bytes=262_144, limit_depth=8)
    assert time.process_time() - began < 1.0


@pytest.mark.parametrize("seed", range(20))
def test_nesting_is_that_of_a_slow_twin(seed):
    """Texts of quotes, brackets and backslashes in any order: as deep as one sign after the other says."""
    drawn = random.Random(seed)
    for _ in range(300):
        raw = bytes(drawn.choice(b'"""[[]{}a\\' if seed % 2 else b'"""[[]{}a') for _ in range(drawn.randint(1, 40)))
        depth, deepest, inside, skip = 0, 0, False, False
        for sign in raw:
            if skip:
                skip = False
            elif inside:
                skip, inside = sign == ord("\\"), sign != ord('"')
            elif sign == ord('"'):
                inside = True
            else:
                depth += (sign in b"[{") - (sign in b"]}")
                deepest = max(deepest, depth)
        for limit in (deepest - 1, deepest):
            try:
                strict_json._refuse_deep(raw, limit)
            except strict_json.JsonError:
                assert limit < deepest, raw
            else:
                assert limit >= deepest or deepest == 0, raw
