"""JSON with one meaning."""

from __future__ import annotations

import pytest
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
