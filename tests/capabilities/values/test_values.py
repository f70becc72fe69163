"""The values that a token may hold, at the edges of their grammar."""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

import pytest
from capabilities.values.errors import FaultCode, ScopeError
from capabilities.values.invisible import INVISIBLE
from capabilities.values.scope import Grant, Limit, OneOf, Range
from capabilities.values.units import INT_LIMIT, Parameter, Unit
from hypothesis import given
from hypothesis import strategies as st
from tests.capabilities.world import SCOPE, chain_of, mint_root

from capabilities.values import text

SPEC = (Path(__file__).parents[3] / "docs" / "spec.md").read_text()
NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9._:@/|+=~%-]*")


def refused(call, value, **other):
    with pytest.raises(ScopeError) as caught:
        call(value, **{"most_bytes": 256, **other})
    return caught.value.code is FaultCode.STATEMENT_MALFORMED


@pytest.mark.clause("VAL-1")
@pytest.mark.parametrize("value", [-INT_LIMIT, INT_LIMIT, 0])
def test_the_largest_integers_are_carried(value):
    grant = Grant("ur3e", "op", (Limit(Parameter("p", Unit.COUNT), Range(value, value)),))
    assert chain_of(mint_root(replace(SCOPE, grants=(grant,)))).scope.grants == (grant,)


@pytest.mark.clause("VAL-1")
@pytest.mark.parametrize("bound", [Range(-INT_LIMIT - 1, 0), Range(0, INT_LIMIT + 1), Range(0, True), Range(0, 1.0)])
def test_no_other_integer_is(bound):
    grant = Grant("ur3e", "op", (Limit(Parameter("p", Unit.COUNT), bound),))
    with pytest.raises(ScopeError) as caught:
        mint_root(replace(SCOPE, grants=(grant,)))
    assert caught.value.code is FaultCode.OUT_OF_RANGE


@pytest.mark.clause("VAL-1")
def test_a_time_is_inside_the_calendar():
    for window in ((-1, 5), (253_402_300_799, 253_402_300_801)):
        with pytest.raises(ScopeError) as caught:
            mint_root(replace(SCOPE, not_before=window[0], not_after=window[1]))
        assert caught.value.code is FaultCode.OUT_OF_RANGE


@pytest.mark.clause("VAL-2")
@given(st.text(max_size=4) | st.text(alphabet="aZ09._:@/|+=~%- \n*é", max_size=5))
def test_a_name_is_of_its_grammar(value):
    if value.isascii() and NAME.fullmatch(value):
        assert text.name(value, most_bytes=256) == value
    else:
        assert refused(text.name, value)


@pytest.mark.clause("VAL-2")
def test_the_length_of_a_name_and_the_word_role():
    assert text.name("x" * 256, most_bytes=256) == "x" * 256
    assert refused(text.name, "x" * 257)
    assert refused(text.name, None)
    assert refused(text.agent_id, "role:x")
    assert text.agent_id("roles", most_bytes=256) == "roles"
    assert text.delegate("role:x", most_bytes=256) == "role:x"
    assert refused(text.delegate, "role:")


GOOD_URLS = [
    "http://a",
    "https://a.example",
    "https://a.example:8443/x/y",
    "http://a.example:443/x",
    "https://a.example:80",
    "https://[::1]:9/x",
    "https://a.example/A-Za~z0.9_:@+=,%-",
    "stdio://cell",
    "https://a.example/...",
    "https://a/" + "b" * 246,
]
BAD_URLS = [
    "",
    "a",
    "//a",
    "HTTPS://a",
    "https://A",
    "https://a.",
    "https://a..",
    "https://u@a",
    "https://u:p@a",
    "https://@a",
    "http://a:80",
    "https://a:443",
    "https://a:",
    "https://a:0",
    "https://a:65536",
    "https://a:08443",
    "https://a?",
    "https://a/x?y",
    "https://a/x#y",
    "https://a/x#",
    "https://a/",
    "https://a/x/",
    "https://a//x",
    "https://a/./x",
    "https://a/../x",
    "https://a/x/..",
    "https://a/x y",
    "https://a/x;y",
    "https://a/x*",
    "https://a/x\n",
    "https://a/\\x",
    "https://a\\x",
    "https://ä",
    "https://a/ä",
    "https://-a",
    "https://a_b",
    "https://[::1",
    "https://[::1]]",
    "https://",
    "https:///x",
    "1https://a",
    " https://a",
    "https://a/" + "b" * 247,
    7,
    None,
]


@pytest.mark.clause("VAL-3")
@pytest.mark.parametrize("value", GOOD_URLS)
def test_a_url_has_one_spelling(value):
    assert text.url(value, most_bytes=256) == value


@pytest.mark.clause("VAL-3")
@pytest.mark.parametrize("value", BAD_URLS)
def test_any_other_spelling_of_a_url_is_refused(value):
    assert refused(text.url, value)


@pytest.mark.clause("VAL-4")
def test_a_sentence_is_bounded_in_bytes():
    assert text.prose("ä" * 256, most_bytes=512) == "ä" * 256
    assert text.prose("", most_bytes=512) == ""
    for value in ("ä" * 256 + "x", "x" * 513, "a\u0308", "a\nb", "\u200b", 5):
        assert refused(text.prose, value, most_bytes=512)


@pytest.mark.clause("VAL-4")
@pytest.mark.parametrize(
    "code", [0x3164, 0x115F, 0xFFA0, 0x2800, 0x34F, 0xFE00, 0xFE0F, 0xE0100, 0xE01EF, 0xA0, 0x2003]
)
def test_a_sentence_holds_nothing_invisible(code):
    for value in (chr(code), f"a{chr(code)}b", f"ä{chr(code)}ö"):
        assert refused(text.prose, value, most_bytes=512)


@pytest.mark.clause("VAL-4")
def test_no_character_that_is_drawn_as_nothing_stands_in_a_sentence():
    assert len(INVISIBLE) > 4_000
    for character in INVISIBLE:
        assert refused(text.prose, f"a{character}b", most_bytes=512), hex(ord(character))


@pytest.mark.clause("VAL-4")
@pytest.mark.parametrize(
    "value", ["Greife die Schraube M3 (2 mm)", "Возьми деталь", "部品を取る", "m/s²", "a  b", "👍 ok"]
)
def test_a_sentence_that_was_valid_stays_valid(value):
    assert text.prose(value, most_bytes=512) == value


@pytest.mark.clause("VAL-7")
def test_the_units_are_those_of_the_table():
    table = SPEC.split("Table 1, units:", 1)[1].split("\n\n", 1)[0]
    assert set(re.findall(r"`(\w+)`", table)) == set(map(str, Unit))


@pytest.mark.clause("VAL-8")
def test_a_set_has_at_most_64_members():
    def scope(size):
        some = OneOf(frozenset(range(0, 2 * size, 2)))
        return replace(SCOPE, grants=(Grant("ur3e", "op", (Limit(Parameter("p", Unit.COUNT), some),)),))

    assert chain_of(mint_root(scope(64))).scope == scope(64)
    for size in (0, 65):
        with pytest.raises(ScopeError) as caught:
            mint_root(scope(size))
        assert caught.value.code is FaultCode.OUT_OF_RANGE


@pytest.mark.clause("VAL-9", "VAL-10")
def test_grants_and_parameters_are_counted():
    def scope(grants, limits):
        some = tuple(Limit(Parameter(f"p{i}", Unit.COUNT), Range(0, 1)) for i in range(limits))
        return replace(SCOPE, grants=tuple(Grant("ur3e", f"s{i:02}", some) for i in range(grants)))

    for good in (scope(64, 0), scope(1, 32)):
        assert chain_of(mint_root(good)).scope == good
    for bad in (scope(65, 0), scope(1, 33)):
        with pytest.raises(ScopeError) as caught:
            mint_root(bad)
        assert caught.value.code is FaultCode.OUT_OF_RANGE


@pytest.mark.clause("VAL-10")
@pytest.mark.parametrize("dimension", ["audiences", "delegates"])
def test_audiences_and_delegates_are_counted(dimension):
    def scope(count):
        return replace(SCOPE, **{dimension: frozenset(f"https://a{i}" for i in range(count))})

    names = {"audiences": scope, "delegates": lambda n: replace(SCOPE, delegates=frozenset(f"a{i}" for i in range(n)))}
    make = names[dimension]
    minted = mint_root(make(64))
    assert len(minted) > 0
    with pytest.raises(ScopeError) as caught:
        mint_root(make(65))
    assert caught.value.code is FaultCode.OUT_OF_RANGE
