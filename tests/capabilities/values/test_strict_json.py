"""JSON with one meaning."""

from __future__ import annotations

import json
import math
import random
import struct
import time

import pytest
import rfc8785
from capabilities.values.errors import FaultCode, StatementError
from capabilities.values.units import INT_LIMIT

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
    assert strict_json.is_canonical(raw, value) is expected


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
            assert strict_json.is_canonical(raw, value) is (rfc8785.dumps(value) == raw), raw


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
