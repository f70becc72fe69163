"""Kinds of parameters beside the robot's units: requests at their lines, hops, forms of checks, claims at corners."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

from capabilities.values.errors import FaultCode
from capabilities.values.scope import (
    Bound,
    Each,
    Flags,
    Limit,
    OneOf,
    Range,
    Restriction,
    Scope,
    Stems,
    Tier,
    Words,
)
from capabilities.values.units import DeclaredUnit, Kind, ListOf, Parameter, Sort, Unit
from tests.vectors.tokens.cases import Accepted, Case, Faulty, Group, Made, Permitted, Refused, faults, group
from tests.vectors.tokens.ordinary import (
    LESS,
    SMALL,
    Texts,
    authority,
    hop,
    message,
    named_limits,
    one_operation,
    replaced,
)
from tests.vectors.tokens.sealing import put

BAR, CENT = DeclaredUnit("x-bar", 1_000), DeclaredUnit("cur-EUR", 100)
PATHS, TEXTS, COUNTS = ListOf(Sort.PATH), ListOf(Sort.TEXT), ListOf(Unit.COUNT)


def words(*values: str) -> Words:
    return Words(frozenset(values))


def under(*values: str) -> Stems:
    return Stems(frozenset(values), "/")


def starting(*values: str) -> Stems:
    return Stems(frozenset(values), "")


def flags(*values: bool) -> Flags:
    return Flags(frozenset(values))


def limits(*bounds: tuple[Kind, Bound]) -> tuple[Limit, ...]:
    return tuple(Limit(Parameter(f"p{n}", kind), bound) for n, (kind, bound) in enumerate(bounds))


def scope_of(*bounds: tuple[Kind, Bound], **other: Any) -> Scope:
    return replace(SMALL, grants=one_operation(*limits(*bounds)), **other)


def asks(*values: tuple[Kind, Any]) -> dict[str, Any]:
    stated = [
        {"name": f"p{n}", "unit" if isinstance(kind, (Unit, DeclaredUnit)) else "kind": str(kind), "value": value}
        for n, (kind, value) in enumerate(values)
    ]
    return {"object": "arm", "operation": "go", "values": stated, "base_tier": 0}


# --- requests --------------------------------------------------------------------------------------------------------

Line = tuple[Any, Any]
"""A value outside, and what is nearest to it."""
LINES: tuple[tuple[str, Kind, Bound, tuple[Any, ...], tuple[Line, ...], tuple[Any, ...]], ...] = (
    (
        "a directory",
        Sort.PATH,
        under("/srv"),
        ("/srv", "/srv/a/b", "/srv/...", "/srv/é b"),
        (("/srvx", "/srv"), ("/", "/srv"), ("/a/srv", "/srv"), ("/Srv", "/srv")),
        (
            "/srv/",
            "/srv/../etc",
            "/srv//a",
            "/srv/./a",
            "srv/a",
            "/srv/a%2fb",
            "/srv/%2E%2e",
            "/srv\\a",
            "/srv/e\u0301",
            "",
        ),
    ),
    ("two directories", Sort.PATH, under("/a/b", "/c"), ("/a/b/c", "/c"), (("/a", "/a/b"), ("/b", "/a/b")), (None, 1)),
    ("any path", Sort.PATH, under(""), ("/", "/a"), (), ("a", "//", "/a\0", "/a\u200b", "/" + "x" * 1_024)),
    ("two paths", Sort.PATH, words("/", "/a"), ("/", "/a"), (("/a/b", "/a"), ("/b", "/")), ("/a/",)),
    (
        "an origin",
        Sort.URL,
        under("https://a.example"),
        ("https://a.example", "https://a.example/x/y", "https://a.example/%C3%A9"),
        (
            ("https://a.example.org", "https://a.example"),
            ("https://a.example:8443/x", "https://a.example"),
            ("s3://b", None),
        ),
        (
            *(
                "https://A.example",
                "https://a.example/",
                "https://a.example:443",
                "https://u@a.example",
                "https://a.example?x",
            ),
            *(
                "https://a.example#x",
                "https://a.example/../x",
                "https://a.example/%2e",
                "https://a.example/%41",
                "https://é.a",
            ),
        ),
    ),
    (
        "any URL",
        Sort.URL,
        under(""),
        ("http://1.2.3.4", "http://[2001:db8::1]:9/x", "https://xn--bcher-kva.example", "http://[1:0:0:2::3]"),
        (),
        (
            *(
                "http://127.1",
                "http://0x7f.1",
                "http://01.2.3.4",
                "http://2130706433",
                "http://[::0001]",
                "http://[1::0:2]",
            ),
            *(
                "http://[::ffff:102:304]",
                "http://[::ffff:1.2.3.4]",
                "https://a..b",
                "https://-a.b",
                "ws://a.example:80",
            ),
            *(
                "https://a.example/%252F",
                "https://a.example/%C0%AF",
                "https://a.example/%",
                "https://a.example/e%CC%81",
            ),
        ),
    ),
    (
        "two beginnings",
        Sort.TEXT,
        starting("ab", "cé"),
        ("ab", "abc", "cé!"),
        (("a", "ab"), ("b", None), ("", None), ("ce", "cé"), ("Ab", None)),
        ("ab\n", "abe\u0301", "ab\u202e", 1, None, True, "ab" + "x" * 1_023),
    ),
    ("three texts", Sort.TEXT, words("", "read", "é"), ("", "read", "é"), (("rea", "read"), ("x", None)), ()),
    ("one truth value", Sort.FLAG, flags(False), (False,), ((True, False),), (0, "false", None)),
    ("any truth value", Sort.FLAG, flags(False, True), (False, True), (), (1,)),
    ("five bytes", Sort.FREE, Range(1, 5), ("abc", [1, 2], None, 1.5), (("abcd", None), ({"a": 1}, None)), ()),
    ("thousandths of a bar", BAR, Range(-5, 900), (-5, 900), ((901, 900), (-6, -5)), (1.5, "1", True)),
    ("cents", CENT, OneOf(frozenset({1, 5})), (1, 5), ((3, 1), (4, 5)), (1.5,)),
    (
        "a list of paths",
        PATHS,
        Each(under("/a"), 1, 2),
        (["/a"], ["/a/b", "/a"]),
        (([], None), (["/a"] * 3, ["/a"] * 2), (["/ab", "/a"], ["/a", "/a"])),
        (["/a/"], "/a", None, [1], ["/a", None]),
    ),
    ("no member", TEXTS, Each(None, 0, 0), ([],), ((["a"], []),), ("",)),
    (
        "a list of counts",
        COUNTS,
        Each(Range(-1, 3), 0, 2),
        ([], [3, -1]),
        (([4, -2], [3, -1]),),
        ([1.5], [True], ["1"]),
    ),
    (
        "a list of flags",
        ListOf(Sort.FLAG),
        Each(flags(True), 0, 2),
        ([], [True, True]),
        (([True, False], [True, True]),),
        ([1],),
    ),
)


def _lines() -> list[Case]:
    found: list[Case] = []
    for name, kind, bound, good, bad, strange in LINES:
        token: Callable[[], Made] | str = lambda kind=kind, bound=bound: authority(scope_of((kind, bound)))
        for n, value in enumerate(good):
            title = f"Inside {name}, {n + 1}"
            found.append(Case(title, "TOK-11", token, Permitted(), request=asks((kind, value))))
            token = found[-1].title if n == 0 else token
        for n, (value, nearest) in enumerate(bad):
            of = {
                "parameter": "p0",
                "value": len(str(value).replace("'", '"').replace(" ", "")) + 2 * isinstance(value, str)
                if kind is Sort.FREE
                else value,
                "unit" if isinstance(kind, DeclaredUnit) else "kind": str(kind),
                "bound": _json(bound),
                "nearest": nearest,
            }
            expected = Refused(FaultCode.LIMIT_EXCEEDED_BY_REQUEST, 0, of)
            found.append(Case(f"Outside {name}, {n + 1}", "TOK-11", token, expected, request=asks((kind, value))))
        for n, value in enumerate(strange):
            expected = Refused(FaultCode.PARAMETERS_WRONG, 0)
            found.append(Case(f"No value for {name}, {n + 1}", "TOK-11", token, expected, request=asks((kind, value))))
    return found


def _json(bound: Bound | None) -> Any:
    match bound:
        case Range(low, high):
            return {"low": low, "high": high}
        case OneOf(values) | Flags(values) | Words(values):
            return {"one_of": sorted(values)}
        case Stems(values, divider):
            return {"under" if divider else "starts_with": sorted(values)}
        case Each(element, least, most):
            return {"each": _json(element), "least": least, "most": most}
    return None


OTHER_KINDS: tuple[tuple[str, Kind, Any], ...] = (
    ("A path for a text", Sort.PATH, "/a"),
    ("A URL for a text", Sort.URL, "https://a.example"),
    ("A free value for a text", Sort.FREE, "/a"),
    ("A flag for a text", Sort.FLAG, True),
    ("A count for a text", Unit.COUNT, 1),
    ("A list of texts for a text", TEXTS, ["/a"]),
    ("A bar for a text", BAR, 1),
)

VALUES = group(
    "kinds",
    "Requests with values of every kind: inside, outside with what is nearest, and in another type or spelling.",
    _lines(),
    Case(
        "A text of any kind",
        "TOK-11",
        lambda: authority(scope_of((Sort.TEXT, starting("")))),
        Permitted(),
        {},
        asks((Sort.TEXT, "/a")),
    ),
    [
        Case(title, "TOK-11", "A text of any kind", Refused(FaultCode.PARAMETERS_WRONG, 0), {}, asks((kind, value)))
        for title, kind, value in OTHER_KINDS
    ],
    Case("A count of bar", "TOK-11", lambda: authority(scope_of((BAR, Range(0, 9)))), Permitted(), {}, asks((BAR, 1))),
    Case(
        "A bar of another scale",
        "TOK-11",
        "A count of bar",
        Refused(FaultCode.PARAMETERS_WRONG, 0),
        {},
        asks((DeclaredUnit("x-bar", 1), 1)),
    ),
)

# --- hops ------------------------------------------------------------------------------------------------------------

HOPS: tuple[tuple[str, Kind, Bound, Bound, bool], ...] = (
    ("A directory below", Sort.PATH, under("/srv"), under("/srv/a"), True),
    ("Paths below", Sort.PATH, under("/srv"), words("/srv", "/srv/a"), True),
    ("A directory that only begins so", Sort.PATH, under("/srv"), under("/srvx"), False),
    ("A directory above", Sort.PATH, under("/srv/a"), under("/srv"), False),
    ("Two directories of any", Sort.PATH, under(""), under("/srv", "/home/x"), True),
    ("Any of one directory", Sort.PATH, under("/srv"), under(""), False),
    ("One of two directories", Sort.PATH, under("/a", "/b"), under("/b"), True),
    ("A directory of paths", Sort.PATH, words("/a", "/a/b"), under("/a"), False),
    ("One path of two", Sort.PATH, words("/a", "/b"), words("/b"), True),
    ("A path more", Sort.PATH, words("/a"), words("/a", "/b"), False),
    ("A part of an origin", Sort.URL, under("https://a.example"), under("https://a.example/x"), True),
    ("Another port", Sort.URL, under("https://a.example"), under("https://a.example:8443"), False),
    ("Another scheme", Sort.URL, under("https://a.example"), under("http://a.example"), False),
    ("A longer host", Sort.URL, under("https://a.example"), words("https://a.example.org"), False),
    ("A longer beginning", Sort.TEXT, starting("ab", "c"), starting("abc"), True),
    ("A shorter beginning", Sort.TEXT, starting("ab"), starting("a"), False),
    ("A beginning of texts", Sort.TEXT, words("a", "b"), starting("a"), False),
    ("Texts with a beginning", Sort.TEXT, starting("a"), words("a", "ab"), True),
    ("The same beginnings", Sort.TEXT, starting("a", "b"), starting("a", "b"), False),
    ("One truth value", Sort.FLAG, flags(True, False), flags(True), True),
    ("The other truth value", Sort.FLAG, flags(True), flags(False), False),
    ("Fewer bytes", Sort.FREE, Range(1, 4_096), Range(1, 100), True),
    ("More bytes", Sort.FREE, Range(1, 100), Range(1, 101), False),
    ("Longer and of less", PATHS, Each(under("/srv"), 0, 9), Each(under("/srv/a"), 1, 9), True),
    ("Too long a list", PATHS, Each(under("/srv"), 0, 9), Each(under("/srv/a"), 0, 10), False),
    ("Too short a list", PATHS, Each(under("/srv"), 1, 9), Each(under("/srv/a"), 0, 9), False),
    ("Members outside", PATHS, Each(under("/srv"), 0, 9), Each(under("/home"), 0, 1), False),
    ("The empty list of some", PATHS, Each(under("/srv"), 0, 9), Each(None, 0, 0), True),
    ("The empty list of one at least", PATHS, Each(under("/srv"), 1, 9), Each(None, 0, 0), False),
    ("A list of the empty one", PATHS, Each(None, 0, 0), Each(under("/srv"), 0, 1), False),
    ("Counts in a list", COUNTS, Each(Range(0, 9), 2, 2), Each(OneOf(frozenset({1, 5})), 2, 2), True),
    ("Fewer cents", CENT, Range(0, 900), Range(0, 800), True),
)


def _hop(title: str, kind: Kind, parent: Bound, child: Bound, may: bool) -> Case:
    above, below = scope_of((kind, parent)), scope_of((kind, child))
    expected: Any = Accepted(replace(below, depth=1)) if may else Faulty(FaultCode.NOT_NARROWER, "TOK-6")
    token = lambda: hop(authority(above), Restriction(grants=below.grants), parent=above)  # noqa: E731 - as its neighbours
    return Case(title, "TOK-6", token, expected)


ATTENUATION = group(
    "attenuation", "One hop below one bound of each kind: accepted, or not narrower.", [_hop(*each) for each in HOPS]
)

# --- forms -----------------------------------------------------------------------------------------------------------


def broken(bound: tuple[Kind, Bound], old: str, new: str, parameter: str | None = None) -> Callable[[], Made]:
    change: Texts = replaced(old, new)
    more = {} if parameter is None else {"says": named_limits(parameter)}
    return lambda: authority(scope_of(bound), texts=change, **more)


def spelled(parameter: str, kind: Kind, bound: Bound) -> Callable[[], Made]:
    return lambda: authority(scope_of((kind, bound)), says=named_limits(parameter))


TEXT, PATH = (Sort.TEXT, starting("ab")), (Sort.PATH, under("/a"))
LIST = (COUNTS, Each(Range(1, 5), 1, 2))
STEMS = '{"ab"}.any($p -> $v0.starts_with($p))'
TREES = '{"/a/"}.any($p -> ($v0 + "/").starts_with($p))'
FORMS: dict[str, Callable[[], Made]] = {
    "Another name for a stem": broken(TEXT, STEMS, '{"ab"}.any($q -> $v0.starts_with($q))'),
    "Another function of stems": broken(TEXT, STEMS, '{"ab"}.all($p -> $v0.starts_with($p))'),
    "Ends with": broken(TEXT, STEMS, '{"ab"}.any($p -> $v0.ends_with($p))'),
    "Contains": broken(TEXT, STEMS, '{"ab"}.any($p -> $v0.contains($p))'),
    "A pattern": broken(TEXT, STEMS, '{"ab"}.any($p -> $v0.matches($p))'),
    "A stem that starts with the value": broken(TEXT, STEMS, '{"ab"}.any($p -> $p.starts_with($v0))'),
    "A beginning without function": broken(TEXT, STEMS, '$v0.starts_with("ab")'),
    "A constant function": broken(TEXT, STEMS, '{"ab"}.any($p -> true)'),
    "Not a beginning": broken(TEXT, STEMS, '{"ab"}.any($p -> !$v0.starts_with($p))'),
    "Stems of numbers": broken(TEXT, STEMS, "{1}.any($p -> $v0.starts_with($p))"),
    "An array of stems": broken(TEXT, STEMS, '["ab"].any($p -> $v0.starts_with($p))'),
    "A divider of a text": broken(TEXT, STEMS, '{"ab/"}.any($p -> ($v0 + "/").starts_with($p))'),
    "No divider of a path": broken(PATH, TREES, '{"/a"}.any($p -> $v0.starts_with($p))'),
    "Another divider": broken(PATH, TREES, '{"/a/"}.any($p -> ($v0 + ".").starts_with($p))'),
    "A stem without divider": broken(PATH, TREES, '{"/a"}.any($p -> ($v0 + "/").starts_with($p))'),
    "The divider before": broken(PATH, TREES, '{"/a/"}.any($p -> ("/" + $v0).starts_with($p))'),
    "All paths as a slash": broken(PATH, TREES, '{"/"}.any($p -> ($v0 + "/").starts_with($p))'),
    "A stem inside another": broken(PATH, '{"/a/"}', '{"/a/", "/a/b/"}'),
    "The empty stem beside another": broken(TEXT, '{"ab"}', '{"", "ab"}'),
    "A path with two slashes": broken(PATH, '{"/a/"}', '{"/a//"}'),
    "A directory that is none": broken(PATH, '{"/a/"}', '{"a/"}'),
    "A directory above itself": broken(PATH, '{"/a/"}', '{"/a/../"}'),
    "An origin in capitals": broken((Sort.URL, under("https://a")), '{"https://a/"}', '{"https://A/"}'),
    "An origin with its default port": broken((Sort.URL, under("https://a")), '{"https://a/"}', '{"https://a:443/"}'),
    "A text that is not in normal form": broken((Sort.TEXT, words("a")), '{"a"}', '{"e\u0301"}'),
    "A text with an invisible character": broken((Sort.TEXT, words("a")), '{"a"}', '{"a\u200b"}'),
    "A text of 257 bytes": broken((Sort.TEXT, words("a")), '{"a"}', '{"' + "x" * 257 + '"}'),
    "A set of words and numbers for a text": broken((Sort.TEXT, words("a")), '{"a"}', "{1, 5}"),
    "A range of texts": broken((Sort.TEXT, words("a")), '{"a"}.contains($v0)', "$v0 >= 0, $v0 <= 1"),
    "Equal to a text": broken((Sort.TEXT, words("a")), '{"a"}.contains($v0)', '$v0 === "a"'),
    "A truth value as number": broken((Sort.FLAG, flags(True)), "{true}", "{1, 5}"),
    "A free value of no byte": broken((Sort.FREE, Range(1, 5)), "$v0 >= 1", "$v0 >= 0"),
    "A set of sizes": broken((Sort.FREE, Range(1, 5)), "$v0 >= 1, $v0 <= 5", "{1, 5}.contains($v0)"),
    "A list without its length": broken(LIST, "$v0.length() >= 1, $v0.length() <= 2, ", ""),
    "A list without a least length": broken(LIST, "$v0.length() >= 1, ", ""),
    "A list without members": broken(LIST, ", $v0.all($x -> $x >= 1), $v0.all($x -> $x <= 5)", ""),
    "Members before the length": broken(
        LIST,
        "$v0.length() >= 1, $v0.length() <= 2, $v0.all($x -> $x >= 1)",
        "$v0.all($x -> $x >= 1), $v0.length() >= 1, $v0.length() <= 2",
    ),
    "Members without an upper end": broken(LIST, ", $v0.all($x -> $x <= 5)", ""),
    "Any member": broken(LIST, "$v0.all($x -> $x >= 1)", "$v0.any($x -> $x >= 1)"),
    "Another name for a member": broken(LIST, "$v0.all($x -> $x >= 1)", "$v0.all($y -> $y >= 1)"),
    "A function of the list itself": broken(LIST, "$v0.all($x -> $x >= 1)", "$v0.all($x -> $v0.length() >= 1)"),
    "Both ends in one function": broken(
        LIST, "$v0.all($x -> $x >= 1), $v0.all($x -> $x <= 5)", "$v0.all($x -> $x >= 1 && $x <= 5)"
    ),
    "A longest list of 257": broken(LIST, "$v0.length() <= 2", "$v0.length() <= 257"),
    "A list that is at least longer than at most": broken(LIST, "$v0.length() >= 1", "$v0.length() >= 3"),
    "The empty list with members": broken(
        LIST, "$v0.length() >= 1, $v0.length() <= 2", "$v0.length() >= 0, $v0.length() <= 0"
    ),
    "A list for a count": spelled("p0:count", *LIST),
    "A count for a list": spelled("p0:[count]", Unit.COUNT, Range(0, 1)),
    "A path for a text": spelled("p0:path", *TEXT),
    "A text for a path": spelled("p0:text", *PATH),
    "A flag for a count": spelled("p0:flag", Unit.COUNT, Range(0, 1)),
    "A list of lists": spelled("p0:[[count]]", *LIST),
    "A list of free values": spelled("p0:[free]", *LIST),
    "A kind in capitals": spelled("p0:Text", *TEXT),
    "A unit of one's own without scale": spelled("p0:x-bar", BAR, Range(0, 1)),
    "A scale of nought": spelled("p0:x-bar/0", BAR, Range(0, 1)),
    "A scale with a leading zero": spelled("p0:x-bar/01000", BAR, Range(0, 1)),
    "A scale above a thousand million": spelled("p0:x-bar/1000000001", BAR, Range(0, 1)),
    "A unit of one's own in capitals": spelled("p0:x-Bar/1000", BAR, Range(0, 1)),
    "A currency in small letters": spelled("p0:cur-eur/100", CENT, Range(0, 1)),
}


def _earlier(number: int) -> Callable[[], Made]:
    """A block whose checks have a function, of the version of Datalog that others have."""
    change = message(lambda fields: [(n, put(3, 5 if number else 3)) if n == 3 else (n, raw) for n, raw in fields])
    above = scope_of((Sort.PATH, under("/a")))
    if number == 0:
        return lambda: authority(above, payload=change)
    below = Restriction(grants=scope_of((Sort.PATH, under("/a/b"))).grants)
    return lambda: hop(authority(above), below, parent=above, payload=change)


def _later(number: int) -> Callable[[], Made]:
    """A block whose checks have no function, of a later version of Datalog."""
    change = message(lambda fields: [(n, put(3, 6)) if n == 3 else (n, raw) for n, raw in fields])
    if number == 0:
        return lambda: authority(SMALL, payload=change)
    return lambda: hop(authority(SMALL), LESS, parent=SMALL, payload=change)


ALL_KINDS = scope_of(
    (Sort.FLAG, flags(True)),
    (Sort.TEXT, starting("ab", "zz")),
    (Sort.TEXT, words("", "read", "é", "\U0001f600", "\ufb00")),
    (Sort.PATH, under("/srv", "/home/x")),
    (Sort.PATH, words("/")),
    (Sort.URL, under("https://a.example", "https://[::1]:9/x")),
    (Sort.FREE, Range(1, 4_096)),
    (TEXTS, Each(starting("ab"), 0, 3)),
    (ListOf(Unit.PASCAL), Each(Range(-5, 7), 2, 256)),
    (ListOf(Sort.URL), Each(None, 0, 0)),
    (ListOf(Sort.FLAG), Each(flags(True, False), 0, 2)),
    (ListOf(CENT), Each(OneOf(frozenset({1, 5})), 1, 1)),
    *((unit, Range(-1, 1)) for unit in list(Unit)[12:]),
    (BAR, Range(0, 9)),
)

FUNCTIONS = group(
    "functions",
    "Kinds and the forms of their conditions, each with one thing wrong; the last ones are right.",
    faults(FaultCode.CHAIN_BROKEN, "TOK-6", FORMS),
    faults(
        FaultCode.WRONG_PROFILE,
        "TOK-6",
        {
            "A later version of Datalog than needed": _later(0),
            "A later version in a hop than needed": _later(1),
            "An earlier version of Datalog than needed": _earlier(0),
            "An earlier version in a hop than needed": _earlier(1),
        },
    ),
    Case("Every kind and form", "TOK-6", lambda: authority(ALL_KINDS), Accepted(ALL_KINDS)),
    Case(
        "A hop without a function below one with",
        "TOK-6",
        lambda: hop(authority(ALL_KINDS), LESS, parent=ALL_KINDS),
        Accepted(replace(ALL_KINDS, ceiling=Tier.NO_EFFECT, depth=1)),
    ),
)

# --- corners ---------------------------------------------------------------------------------------------------------

CLAIMS: tuple[tuple[str, Kind, Bound, Bound | None], ...] = (
    ("a directory", Sort.PATH, under("/a"), None),
    ("a directory, claimed above", Sort.PATH, under("/a/b"), under("/a")),
    ("a directory, claimed below", Sort.PATH, under("/a"), under("/a/b")),
    ("a directory, claimed as any", Sort.PATH, under("/a"), under("")),
    ("any, claimed as a directory", Sort.PATH, under(""), under("/a")),
    ("a directory, claimed as a beginning", Sort.PATH, under("/a"), starting("/a")),
    ("a directory, claimed as a path", Sort.PATH, under("/a"), words("/a")),
    ("a path, claimed as a directory", Sort.PATH, words("/a"), under("/a")),
    ("a beginning", Sort.TEXT, starting("ab"), None),
    ("a beginning, claimed shorter", Sort.TEXT, starting("ab"), starting("a")),
    ("a beginning, claimed longer", Sort.TEXT, starting("ab"), starting("abc")),
    ("texts, one too many claimed", Sort.TEXT, words("a"), words("a", "b")),
    ("a flag", Sort.FLAG, flags(True), None),
    ("a flag, claimed otherwise", Sort.FLAG, flags(True), flags(False)),
    ("a flag, claimed as any", Sort.FLAG, flags(True), flags(True, False)),
    ("any flag, claimed as one", Sort.FLAG, flags(True, False), flags(True)),
    ("bytes, one too many claimed", Sort.FREE, Range(1, 5), Range(1, 6)),
    ("lists", PATHS, Each(under("/a"), 1, 3), None),
    ("lists, claimed longer", PATHS, Each(under("/a"), 1, 3), Each(under("/a"), 1, 4)),
    ("lists, claimed shorter", PATHS, Each(under("/a"), 1, 3), Each(under("/a"), 1, 2)),
    ("lists, claimed with none", PATHS, Each(under("/a"), 1, 3), Each(under("/a"), 0, 3)),
    ("lists, claimed with two at least", PATHS, Each(under("/a"), 1, 3), Each(under("/a"), 2, 3)),
    ("lists, claimed with other members", PATHS, Each(under("/a"), 1, 3), Each(under("/b"), 1, 3)),
    ("lists, claimed with more members", PATHS, Each(under("/a"), 1, 3), Each(under(""), 1, 3)),
    ("the empty list", PATHS, Each(None, 0, 0), None),
    ("the empty list, claimed longer", PATHS, Each(None, 0, 0), Each(under("/a"), 0, 1)),
    ("counts in a list", COUNTS, Each(Range(0, 5), 0, 2), None),
    ("counts in a list, claimed higher", COUNTS, Each(Range(0, 5), 0, 2), Each(Range(0, 6), 0, 2)),
    ("counts in a list, claimed lower", COUNTS, Each(Range(0, 5), 0, 2), Each(Range(0, 4), 0, 2)),
)


def _claim(name: str, kind: Kind, bound: Bound, claimed: Bound | None) -> Case:
    expected = Permitted() if claimed is None else Faulty(FaultCode.ENGINES_DISAGREE, "TOK-12")
    # A claim need not be well formed of its kind: a text stands for a path that is claimed by its beginning.
    of = Sort.TEXT if isinstance(claimed, Stems) and not claimed.divider else kind
    claims = scope_of((of, bound if claimed is None else claimed))
    title = f"Step 12 of {name}"
    return Case(title, "TOK-12", lambda: authority(scope_of((kind, bound))), expected, request=asks(), claimed=claims)


CORNERS = group(
    "corners",
    "Step 12 for each kind, for scopes that are the token's and for others.",
    [_claim(*each) for each in CLAIMS],
)

GROUPS: tuple[Group, ...] = (VALUES, ATTENUATION, FUNCTIONS, CORNERS)
