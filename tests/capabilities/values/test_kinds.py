"""Kinds of parameters: one spelling for one value, and the lines of bounds of words, flags, lists and free values."""

from __future__ import annotations

from dataclasses import replace

import pytest
from capabilities import (
    DEFAULT_CAPS,
    Argument,
    DeclaredUnit,
    Each,
    Fault,
    FaultCode,
    Fingerprint,
    Flags,
    Grant,
    Limit,
    ListOf,
    OneOf,
    Parameter,
    Quantity,
    Range,
    Refusal,
    Restriction,
    ScopeError,
    Sort,
    Stems,
    Tier,
    TokenError,
    Unit,
    Words,
    argument,
    scope_from_json,
    scope_to_json,
)
from capabilities.values.arguments import WORD_BYTES, is_of
from capabilities.values.errors import QuantityError
from capabilities.values.units import kind_of
from capabilities.values.well_formed import LIST_LENGTH
from tests.capabilities.world import (
    CELL,
    LEASE_MS,
    NOW,
    ROOT_ID,
    SCOPE,
    TRUST,
    VIEW,
    add_hop,
    chain_of,
    mint_root,
    verifier,
)

from capabilities.token import biscuit, scope_check

BAR = DeclaredUnit("x-bar", 1_000)


def words(*values):
    return Words(frozenset(values))


def under(*values):
    return Stems(frozenset(values), "/")


def starting(*values):
    return Stems(frozenset(values), "")


def flags(*values):
    return Flags(frozenset(values))


def code_of(call):
    with pytest.raises((QuantityError, ScopeError)) as caught:
        call()
    return caught.value.code


# --- kinds -----------------------------------------------------------------------------------------------------------

SPELLED = ["um", "mdegC", "Hz", "x-bar/1000", "cur-EUR/100", "cur-JPY/1", "flag", "text", "path", "url", "free"]


@pytest.mark.clause("VAL-17")
@pytest.mark.parametrize("spelled", [*SPELLED, *(f"[{each}]" for each in SPELLED if each != "free")])
def test_a_kind_is_its_spelling(spelled):
    assert str(kind_of(spelled)) == spelled


@pytest.mark.clause("VAL-17")
@pytest.mark.parametrize(
    "spelled",
    [
        *("", "bar", "x-bar", "x-bar/", "x-bar/0", "x-bar/01", "x-bar/1000000001", "x-Bar/10", "x-/10", "cur-eur/100"),
        *("cur-EURO/1", "[free]", "[[text]]", "[text", "text]", "[]", "Text", "x-bar/1000\n"),
    ],
)
def test_there_is_no_other_kind(spelled):
    assert code_of(lambda: kind_of(spelled)) is FaultCode.STATEMENT_MALFORMED


# --- values ----------------------------------------------------------------------------------------------------------

GOOD = {
    Sort.TEXT: ["", "a", "é", "two words", "x" * WORD_BYTES, "%2f", "/a/../b"],
    Sort.PATH: ["/", "/a", "/a/b.c", "/...", "/.a", "/é", "/a b", "/%", "/%41", "/~", "/" + "x" * (WORD_BYTES - 1)],
    Sort.URL: [
        *("https://a.example", "https://a.example/x", "https://a.example:8443/x", "http://1.2.3.4", "http://[::1]:9/x"),
        *("https://a.example/%C3%A9", "https://a.example/a%20b", "https://xn--bcher-kva.example", "s3://bucket/key"),
        *("http://[2001:db8::1]", "http://[1:0:0:2::3]", "https://a.example/%3F", "http://1.a", "http://a-b.example"),
    ],
}
BAD = {
    Sort.TEXT: ["e\u0301", "a\u200b", "a\nb", "\u00a0", "\u202e", "x" * (WORD_BYTES + 1), "\ud800"],
    Sort.PATH: [
        *("", "a", "a/b", "./a", "/a/", "//", "//a", "/a//b", "/.", "/..", "/a/.", "/a/..", "/a/../b", "/./a", "C:/a"),
        *("\\a", "/a\\b", "/a\0b", "/a%2fb", "/a%2Fb", "/%2e%2e/a", "/%2E", "/a%5cb", "/a%00", "/e\u0301", "/a\u200bb"),
        "/" + "x" * WORD_BYTES,
    ],
    Sort.URL: [
        *("", "a", "https://", "https://A.example", "HTTPS://a.example", "https://a.example/", "https://a.example/x/"),
        *("https://a.example:443", "http://a.example:80", "wss://a.example:443", "ftp://a:21", "https://u@a.example"),
        *("https://a.example?x", "https://a.example#x", "https://a.example/x?y=1", "https://a.example/./x"),
        *("https://a.example/../x", "https://a.example//x", "https://a.example.", "https://bücher.example"),
        *("https://a..b", "https://-a.example", "https://a-.example", "https://xn--a-/x", "http://127.1"),
        *(
            "http://2130706433",
            "http://0x7f.1",
            "http://0x7f000001",
            "http://01.2.3.4",
            "http://1.2.3",
            "http://256.1.1.1",
        ),
        *("http://[::0001]", "http://[0:0:0:0:0:0:0:1]", "http://[::ffff:1.2.3.4]", "http://[::ffff:102:304]"),
        *("http://[1::0:2]", "https://a.example/%c3%a9", "https://a.example/%41", "https://a.example/%2F"),
        *("https://a.example/%2f", "https://a.example/%5C", "https://a.example/%2E%2E", "https://a.example/%252F"),
        *("https://a.example/%00", "https://a.example/%C0%AF", "https://a.example/%", "https://a.example/%zz"),
        *("https://a.example/e%CC%81", "https://a.example/%E2%80%8B", "https://a.example/é", "https://a.example\\x"),
        "https://a.example/" + "x" * WORD_BYTES,
    ],
}


@pytest.mark.clause("VAL-18")
@pytest.mark.parametrize(("kind", "value"), [(kind, value) for kind, some in GOOD.items() for value in some])
def test_a_canonical_word_is_a_value(kind, value):
    assert argument("p", kind, value) == Argument("p", kind, value)
    assert is_of(kind, argument("p", kind, value))
    assert is_of(ListOf(kind), argument("p", ListOf(kind), [value, value]))


@pytest.mark.clause("VAL-18")
@pytest.mark.parametrize(("kind", "value"), [(kind, value) for kind, some in BAD.items() for value in some])
def test_another_spelling_is_refused(kind, value):
    assert code_of(lambda: argument("p", kind, value)) is FaultCode.NOT_CANONICAL
    assert code_of(lambda: argument("p", ListOf(kind), [value])) is FaultCode.NOT_CANONICAL
    assert not is_of(kind, Argument("p", kind, value))


@pytest.mark.clause("VAL-18")
@pytest.mark.parametrize(
    ("kind", "value"),
    [
        *((kind, value) for kind in Sort if kind is not Sort.FREE for value in (None, 1, 1.0, b"a", [], {})),
        *((Sort.FLAG, value) for value in (0, 1, "true")),
        *((kind, True) for kind in (Sort.TEXT, Sort.PATH, Sort.URL, Unit.COUNT, BAR)),
        *((kind, value) for kind in (Unit.COUNT, BAR) for value in (1.0, "1", None)),
        *((ListOf(Unit.COUNT), value) for value in ("a", 1, {}, None, [1.0], [True], ["1"], [[1]])),
        (ListOf(Sort.FLAG), [1]),
    ],
)
def test_another_type_is_refused(kind, value):
    assert code_of(lambda: argument("p", kind, value)) is FaultCode.PARAMETERS_WRONG


@pytest.mark.clause("VAL-18")
def test_a_free_value_is_its_fingerprint():
    one = argument("p", Sort.FREE, {"b": [1, 2.0], "a": "é"})
    assert one == argument("p", Sort.FREE, {"a": "é", "b": [1, 2]})
    assert one.value.size_bytes == len('{"a":"é","b":[1,2]}'.encode())
    assert argument("p", Sort.FREE, None).value.size_bytes == 4
    for strange in (float("nan"), {1: 2}, b"a", 2**60, "\ud800", object()):
        assert code_of(lambda strange=strange: argument("p", Sort.FREE, strange)) is FaultCode.NOT_CANONICAL
    assert not is_of(Sort.FREE, Argument("p", Sort.FREE, Fingerprint(0, "0" * 64)))


@pytest.mark.clause("VAL-18")
def test_the_longest_list():
    assert is_of(ListOf(Unit.COUNT), argument("p", ListOf(Unit.COUNT), [1] * LIST_LENGTH))
    assert code_of(lambda: argument("p", ListOf(Unit.COUNT), [1] * (LIST_LENGTH + 1))) is FaultCode.OUT_OF_RANGE
    assert code_of(lambda: argument("p", Unit.COUNT, 2**53)) is FaultCode.OUT_OF_RANGE


# --- bounds ----------------------------------------------------------------------------------------------------------

ALL = (
    (Sort.FLAG, flags(True)),
    (Sort.FLAG, flags(True, False)),
    (Sort.TEXT, starting("ab", "zz")),
    (Sort.TEXT, starting("")),
    (Sort.TEXT, words("", "é", "read")),
    (Sort.PATH, under("/srv", "/home/x")),
    (Sort.PATH, under("")),
    (Sort.PATH, words("/", "/a")),
    (Sort.URL, under("https://a.example", "https://[::1]:9/x")),
    (Sort.URL, under("")),
    (Sort.URL, words("https://a.example")),
    (Sort.FREE, Range(1, 4_096)),
    (BAR, Range(-5, 900)),
    (DeclaredUnit("cur-EUR", 100), OneOf(frozenset({1, 5}))),
    (ListOf(Sort.TEXT), Each(starting("ab"), 0, 3)),
    (ListOf(Sort.PATH), Each(under("/a"), 1, 1)),
    (ListOf(Sort.URL), Each(None, 0, 0)),
    (ListOf(Sort.FLAG), Each(flags(False), 2, LIST_LENGTH)),
    (ListOf(Unit.PASCAL), Each(Range(-5, 7), 2, 3)),
    (ListOf(BAR), Each(OneOf(frozenset({1, 5})), 0, 2)),
)
"""Bounds of every kind and form."""


def scope_of(*limits, **other):
    made = tuple(Limit(Parameter(f"p{n}", kind), bound) for n, (kind, bound) in enumerate(limits))
    return replace(SCOPE, grants=(Grant("tool", "act", made),), **other)


@pytest.mark.clause("BLK-8", "VAL-13")
def test_every_bound_is_carried_and_read_back():
    scope = scope_of(*ALL)
    assert chain_of(mint_root(scope)).scope == scope
    assert scope_from_json(scope_to_json(scope)) == scope


@pytest.mark.clause("TOK-12")
@pytest.mark.parametrize(("kind", "bound"), ALL)
def test_the_authorizer_draws_the_same_lines(kind, bound):
    """Step 12 agrees for the scope itself, and for no other bound of that kind."""
    scope = scope_of((kind, bound))
    opened = biscuit.open_token(mint_root(scope), TRUST.roots[ROOT_ID])
    assert scope_check.disagreement(opened, scope, scope.grants[0], DEFAULT_CAPS) is None
    for other_kind, other in ALL:
        if other_kind == kind and other != bound:
            claimed = scope_of((kind, other))
            found = scope_check.disagreement(opened, claimed, claimed.grants[0], DEFAULT_CAPS)
            assert isinstance(found, Fault)
            assert found.code is FaultCode.ENGINES_DISAGREE


@pytest.mark.clause("VAL-9", "VAL-19")
@pytest.mark.parametrize(
    ("kind", "bound"),
    [
        *(
            (kind, bound)
            for kind, bound in ((Sort.FLAG, Range(0, 1)), (Unit.COUNT, flags(True)), (Sort.TEXT, under("a")))
        ),
        *((Sort.PATH, bound) for bound in (starting("/a"), under("/"), under("/a", "/a/b"), under("a"), words("/a/"))),
        *((Sort.URL, bound) for bound in (under("https://a.example/"), under("/a"), words(""), words("https://A"))),
        *(
            (Sort.TEXT, bound)
            for bound in (starting("a", "ab"), starting("", "a"), words("e\u0301"), starting("x" * 257))
        ),
        *(
            (Sort.FREE, bound)
            for bound in (Range(0, 5), Range(2, 5), Range(1, 0), OneOf(frozenset({1, 5})), words("a"))
        ),
        *((ListOf(Sort.TEXT), bound) for bound in (words("a"), Each(None, 0, 1), Each(words("a"), 0, 0))),
        *(
            (ListOf(Sort.TEXT), bound)
            for bound in (Each(words("a"), 2, 1), Each(words("a"), 0, 257), Each(Range(0, 1), 0, 1))
        ),
        *((Sort.TEXT, bound) for bound in (words(), starting(), words(*(f"{n}" for n in range(65))))),
        (Sort.FLAG, flags()),
        (Sort.FLAG, Flags(frozenset({1}))),
        (Unit.COUNT, OneOf(frozenset({"a"}))),
    ],
)
def test_another_bound_is_refused(kind, bound):
    with pytest.raises(ScopeError):
        mint_root(scope_of((kind, bound)))


@pytest.mark.clause("VAL-13")
@pytest.mark.parametrize(
    "other",
    [
        {"kind": "text", "unit": "um"},
        {"kind": "um", "low": 0, "high": 1},
        {"unit": "text"},
        {"kind": "text", "one_of": ["a"], "starts_with": ["a"]},
        {"kind": "text", "one_of": ["b", "a"]},
        {"kind": "text", "one_of": ["a", 1]},
        {"kind": "flag", "one_of": [True, False]},
        {"kind": "flag", "one_of": [0, 1]},
        {"kind": "[text]", "each": {"one_of": ["a"]}, "least": 0},
        {"kind": "[text]", "each": {"one_of": ["a"]}, "least": 0, "most": 2, "low": 1},
        {"kind": "[text]", "each": {"each": None, "least": 0, "most": 0}, "least": 0, "most": 2},
        {"kind": "text", "any": True},
    ],
)
def test_a_bound_has_one_form_on_the_wire(other):
    written = scope_to_json(scope_of((Sort.TEXT, words("a"))))
    limit = written["grants"][0]["limits"][0]
    del limit["one_of"], limit["kind"]
    limit |= other
    assert code_of(lambda: scope_from_json(written)) is FaultCode.STATEMENT_MALFORMED


# --- requests --------------------------------------------------------------------------------------------------------

REQUESTS = {
    "under": (Sort.PATH, under("/srv"), ["/srv", "/srv/a/b"], ["/srvx", "/", "/sr", "/a/srv"], "/srv"),
    "any path": (Sort.PATH, under(""), ["/", "/a"], [], None),
    "origin": (
        Sort.URL,
        under("https://a.example"),
        ["https://a.example", "https://a.example/x"],
        ["https://a.example.org", "https://a.example:8443", "http://a.example", "https://b.a.example"],
        "https://a.example",
    ),
    "start": (Sort.TEXT, starting("ab"), ["ab", "abc"], ["a", "b", "", "Ab"], "ab"),
    "flag": (Sort.FLAG, flags(False), [False], [True], False),
    "free": (Sort.FREE, Range(1, 5), ["abc", 12_345, None], ["abcd", {"a": 1}], None),
    "lists": (
        ListOf(Sort.PATH),
        Each(under("/a"), 1, 2),
        [["/a"], ["/a", "/a/b"]],
        [[], ["/a"] * 3, ["/b"], ["/a", "/ab"]],
        None,
    ),
}


@pytest.mark.clause("TOK-11")
@pytest.mark.parametrize(("kind", "bound", "good", "bad", "nearest"), REQUESTS.values(), ids=REQUESTS)
def test_requests_at_the_lines(kind, bound, good, bad, nearest):
    checker, token = verifier(), mint_root(scope_of((kind, bound)))
    chain = checker.verify(token, at=NOW, audience=CELL, view=VIEW, lease_ms=LEASE_MS)

    def ask(*values):
        return checker.check_request(
            chain, object="tool", operation="act", values=values, base_tier=Tier.NO_EFFECT, at=NOW
        )

    for value in good:
        assert ask(argument("p0", kind, value)) is None
    for value in bad:
        found = ask(argument("p0", kind, value))
        assert isinstance(found, Refusal)
        assert found.code is FaultCode.LIMIT_EXCEEDED_BY_REQUEST
        assert found.bound == bound
    if bad and nearest is not None:
        assert ask(argument("p0", kind, bad[0])).nearest == nearest
    for strange in (Quantity("p0", Unit.COUNT, 1), Quantity("p0", BAR, 1), Argument("p0", Sort.FLAG, 1)):
        assert ask(strange).code is FaultCode.PARAMETERS_WRONG
    assert ask(argument("p0", kind, (good or bad)[0]), Quantity("p1", Unit.COUNT, 1)).code is FaultCode.PARAMETERS_WRONG


# --- attenuation -----------------------------------------------------------------------------------------------------

HOPS = [
    (Sort.PATH, under("/srv"), under("/srv/a"), True),
    (Sort.PATH, under("/srv"), words("/srv"), True),
    (Sort.PATH, under("/srv"), under("/srvx"), False),
    (Sort.PATH, under("/srv"), under(""), False),
    (Sort.TEXT, starting("a", "b"), starting("a"), True),
    (Sort.TEXT, starting("ab"), starting("a"), False),
    (Sort.TEXT, words("a", "b"), starting("a"), False),
    (Sort.FLAG, flags(True, False), flags(True), True),
    (Sort.FLAG, flags(True), flags(True, False), False),
    (Sort.FREE, Range(1, 9), Range(1, 5), True),
    (ListOf(Sort.TEXT), Each(starting(""), 0, 9), Each(words("a"), 0, 9), True),
    (ListOf(Sort.TEXT), Each(starting("a"), 0, 9), Each(None, 0, 0), True),
    (ListOf(Sort.TEXT), Each(starting("a"), 1, 9), Each(None, 0, 0), False),
    (ListOf(Sort.TEXT), Each(starting("a"), 0, 2), Each(starting("a"), 0, 3), False),
    (BAR, Range(0, 9), Range(0, 8), True),
]


@pytest.mark.clause("VAL-12", "VAL-19")
@pytest.mark.parametrize(("kind", "parent", "child", "may"), HOPS)
def test_a_hop_has_a_part_of_a_bound(kind, parent, child, may):
    token = mint_root(scope_of((kind, parent)))
    restriction = Restriction(grants=scope_of((kind, child)).grants)
    if may:
        assert chain_of(add_hop(token, "robotic", restriction)).scope.grants == restriction.grants
    else:
        with pytest.raises(TokenError) as caught:
            add_hop(token, "robotic", restriction)
        assert caught.value.code is FaultCode.NOT_NARROWER


@pytest.mark.clause("VAL-17")
def test_another_scale_is_another_parameter():
    """A limit of 900 thousandths of a bar is none of 900 bar."""
    token = mint_root(scope_of((BAR, Range(0, 900))))
    with pytest.raises(TokenError) as caught:
        add_hop(token, "robotic", Restriction(grants=scope_of((DeclaredUnit("x-bar", 1), Range(0, 9))).grants))
    assert caught.value.code is FaultCode.NOT_NARROWER
