"""[TOK-6], item 3: every value keeps the rules of part 1, and both sides of every cap are shown."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

from capabilities.values.errors import FaultCode
from capabilities.values.scope import Grant, Limit, OneOf, Range, Scope
from capabilities.values.units import Parameter, Unit
from tests.vectors.tokens.cases import Accepted, Case, Group, Made, Permitted, faults, group
from tests.vectors.tokens.ordinary import (
    CELL,
    LESS,
    SMALL,
    SPEED,
    Texts,
    authority,
    hop,
    member,
    named_limits,
    one_operation,
    replaced,
    sponsor,
)

BROKEN = FaultCode.CHAIN_BROKEN
LONG = "n" * 256
LARGEST = 2**53 - 1
END_OF_TIME = 253_402_300_800


def broken(made: dict[str, Callable[[], Made]]):
    return faults(BROKEN, "TOK-6", made)


def scope_of(**other: Any) -> Scope:
    return replace(SMALL, **other)


def good(title: str, scope: Scope, **other: Any) -> Case:
    """A token for this scope is accepted, and the scope is what holds."""
    return Case(title, "TOK-6", lambda: authority(scope, **other), Accepted(scope))


def allowed(title: str, scope: Scope, request: dict[str, Any]) -> Case:
    """The same of a scope that is too long to print: a request under it is permitted."""
    return Case(title, "TOK-6", lambda: authority(scope), Permitted(), request=request)


# --- names, URLs, sentences ------------------------------------------------------------------------------------------------

EVERY_SIGN = "Az09._:@/|+=~%-"
ODD_NAMES = {
    "An empty name": "",
    "A name of 257 bytes": "n" * 257,
    "A name with a blank": "the boss",
    "A name that starts with a sign": ".boss",
    "A name with a quote": 'bo"ss',
    "A name with a dollar": "bo$s",
    "A name with a line end": "boss\n",
    "A name with a letter of another script": "\u0430lice",
    "A name with a digit of another script": "alice\u0663",
    "A name with a bracket": "boss[0]",
}
ODD_URLS = {
    "A name for a URL": "cell-1",
    "A URL with an upper case host": "http://CELL.example/mcp",
    "A URL with an upper case scheme": "HTTP://cell.example/mcp",
    "A URL with the default port of http": "http://cell.example:80/mcp",
    "A URL with the default port of https": "https://cell.example:443/mcp",
    "A URL with a slash behind": "http://cell.example/mcp/",
    "A URL of a slash alone": "http://cell.example/",
    "A URL with a segment of one dot": "http://cell.example/./mcp",
    "A URL with a segment of two dots": "http://cell.example/a/../mcp",
    "A URL with an empty segment": "http://cell.example//mcp",
    "A URL with a query": "http://cell.example/mcp?a=1",
    "A URL with an empty query": "http://cell.example/mcp?",
    "A URL with a fragment": "http://cell.example/mcp#a",
    "A URL with a user": "http://alice@cell.example/mcp",
    "A URL with a dot behind its host": "http://cell.example./mcp",
    "A URL without host": "http:///mcp",
    "A URL with an empty port": "http://cell.example:/mcp",
    "A URL with a port that is no number": "http://cell.example:a/mcp",
    "A URL with a port of zeros": "http://cell.example:0080/mcp",
    "A URL with too high a port": "http://cell.example:65536/mcp",
    "A URL with port zero": "http://cell.example:0/mcp",
    "A URL with a blank": "http://cell.example/m cp",
    "A URL with a letter of another script": "http://c\u0435ll.example/mcp",
    "A URL with a sign that segments have not": "http://cell.example/mcp;a",
    "A URL of 257 bytes": "http://cell.example/" + "a" * 237,
    "A URL with four numbers in brackets": "http://[1.2.3.4]/mcp",
    "A URL with no address in brackets": "http://[:::]/mcp",
    "A URL with something behind its brackets": "http://[::1]a/mcp",
    "A URL without scheme": "//cell.example/mcp",
    "A URL with one slash": "http:/cell.example/mcp",
    "A URL with a backslash": "http://cell.example\\mcp",
}
ODD_SENTENCES = {
    "A sentence that turns its direction": "a\u202eb",
    "A sentence with a zero width blank": "a\u200bb",
    "A sentence with a line end": "a\nb",
    "A sentence with a tabulator": "a\tb",
    "A sentence with a zero character": "a\0b",
    "A sentence with a line separator": "a\u2028b",
    "A sentence with a paragraph separator": "a\u2029b",
    "A sentence with a private character": "a\ue000b",
    "A sentence with a character that is none": "a\uffffb",
    "A sentence with a soft hyphen": "a\u00adb",
    "A sentence with a delete character": "a\x7fb",
    "A sentence not in normal form C": "e\u0301",
    "A sentence with a sign that normal form C replaces": "\u212b",
    "A sentence with a Hangul filler": "a\u3164b",
    "A sentence with a combining joiner": "a\u034fb",
    "A sentence with a variation selector": "a\ufe0fb",
    "A sentence with a variation selector of a later plane": "a\U000e0100b",
    "A sentence with a blank of no width": "a\u2800b",
    "A sentence with a space of another width": "a\u2003b",
    "A sentence of 513 bytes": "a" * 513,
    "A sentence of 513 bytes in fewer characters": "\u00e4" * 256 + "a",
}

TEXTS = group(
    "texts",
    "Names, URLs and sentences, wherever they stand.",
    broken({title: lambda name=name: authority(SMALL, says=member(agent=name)) for title, name in ODD_NAMES.items()}),
    broken(
        {
            "An agent that is called as a role": lambda: authority(SMALL, says=member(agent="role:planner")),
            "A role that is no name": lambda: authority(SMALL, role="the boss"),
            "A role of 252 bytes": lambda: authority(SMALL, role="r" * 252),
            "A sponsor that is no name": lambda: authority(SMALL, says=sponsor(subject="a b")),
            "A method that is no name": lambda: authority(SMALL, says=sponsor(method="")),
            "An issuer that is no URL": lambda: authority(SMALL, says=sponsor(issuer="idp")),
            "An issuer with a slash behind": lambda: authority(SMALL, says=sponsor(issuer="http://idp.example/")),
            "A delegate that is no name": lambda: authority(SMALL, says=member(delegates=["the boss"])),
            "A delegate of an empty role": lambda: authority(SMALL, says=member(delegates=["role:"])),
            "A delegate of a role that is no name": lambda: authority(SMALL, says=member(delegates=["role:.a"])),
            "A delegate of 257 bytes": lambda: authority(SMALL, says=member(delegates=["d" * 257])),
            "An object that is no name": lambda: authority(SMALL, texts=replaced('"ur3e"', '"ur 3e"')),
            "An object with a byte order mark": lambda: authority(SMALL, texts=replaced('"ur3e"', '"\ufeffur3e"')),
            "An operation that is no name": lambda: authority(SMALL, texts=replaced('"read_state"', '""')),
            "An agent of a hop that is no name": lambda: hop(
                authority(SMALL), LESS, parent=SMALL, says=member(agent="a b")
            ),
            "An audience of a hop that is no URL": lambda: hop(
                authority(SMALL), LESS, parent=SMALL, says=member(audiences=["cell-1"])
            ),
        }
    ),
    broken({title: lambda url=url: authority(SMALL, says=member(audiences=[url])) for title, url in ODD_URLS.items()}),
    broken({title: lambda said=said: authority(SMALL, purpose=said) for title, said in ODD_SENTENCES.items()}),
    good("A name of 256 bytes", SMALL, says=member(agent=LONG)),
    good("A name with every sign", SMALL, says=member(agent=EVERY_SIGN)),
    good("A name of one digit", SMALL, says=member(agent="0")),
    good("A role of 251 bytes", SMALL, role="r" * 251),
    good("No purpose at all", SMALL, purpose=""),
    good("A sentence of 512 bytes", SMALL, purpose="a" * 512),
    good("A sentence of 512 bytes in fewer characters", SMALL, purpose="\u00e4" * 256),
    good(
        "A sentence in other scripts",
        SMALL,
        purpose='\u628a\u7ea2\u8272\u7684\u96f6\u4ef6\u62ff\u8d77\u6765 \u2013 "caf\u00e9" \\ \U0001f916',
    ),
    good(
        "URLs of every form",
        scope_of(
            audiences=frozenset(
                {
                    CELL,
                    "http://cell.example",
                    "https://cell.example:80/A-Za-z0-9._~:@+=,%-/.../..a",
                    "http://[::1]:9000/mcp",
                    "ws+x-1.0://1.2.3.4:65535",
                    "http://cell.example:443",
                    "http://cell.example/" + "a" * 236,
                }
            )
        ),
    ),
    good(
        "Delegates of every form",
        scope_of(delegates=frozenset({"robotic", "role:planner", "role:role:x", "d" * 256, "Zeta", "alpha"})),
    ),
)


# --- numbers and counts ----------------------------------------------------------------------------------------------------


def counted(limits: int) -> tuple[Grant, ...]:
    return one_operation(*(Limit(Parameter(f"p{i}", Unit.COUNT), Range(0, 1)) for i in range(limits)))


def grants(count: int) -> tuple[Grant, ...]:
    return tuple(Grant("arm", f"op{i:02}") for i in range(count))


def bounded(bound: Range | OneOf) -> Scope:
    return scope_of(grants=one_operation(Limit(SPEED, bound)))


def go(*values: tuple[str, str, int]) -> dict[str, Any]:
    stated = [{"name": name, "unit": unit, "value": value} for name, unit, value in values]
    return {"object": "arm", "operation": "go", "values": stated, "base_tier": 0}


def in_text(old: str, new: str, scope: Scope = SMALL) -> Callable[[], Made]:
    change: Texts = replaced(old, new)
    return lambda: authority(scope, texts=change)


UNITS = tuple(Limit(Parameter(str(unit), unit), Range(-1, 1)) for unit in list(Unit)[:12])
"""Those of the robot; `kinds` has the others."""

NUMBERS = group(
    "numbers",
    "Integers, bounds, counts and times at the ends of what may be, and one beyond.",
    broken(
        {
            "No grant is kept": lambda: authority(
                SMALL,
                says=member(parameters=[]),
                texts=lambda checks: checks[1:],
            ),
            "Sixty-five grants": lambda: authority(scope_of(grants=grants(65))),
            "Grants out of order": lambda: authority(scope_of(grants=grants(3)[::-1])),
            "A grant twice": lambda: authority(scope_of(grants=grants(2)[:1] * 2)),
            "Thirty-three parameters": lambda: authority(scope_of(grants=counted(33))),
            "A parameter twice": lambda: authority(
                scope_of(grants=counted(2)), says=named_limits("p0:count", "p0:count")
            ),
            "A parameter with a quote": lambda: authority(scope_of(grants=counted(1)), says=named_limits('p"0:count')),
            "A parameter without name": lambda: authority(scope_of(grants=counted(1)), says=named_limits(":count")),
            "A parameter without unit": lambda: authority(scope_of(grants=counted(1)), says=named_limits("p0")),
            "A parameter of an unknown unit": lambda: authority(
                scope_of(grants=counted(1)), says=named_limits("p0:furlong")
            ),
            "A parameter of a unit in capitals": lambda: authority(
                scope_of(grants=counted(1)), says=named_limits("p0:COUNT")
            ),
            "A name too few": lambda: authority(scope_of(grants=counted(2)), says=named_limits("p0:count")),
            "A parameter that is a number": lambda: authority(scope_of(grants=counted(1)), says=named_limits(1)),
            "A range whose ends are exchanged": lambda: authority(bounded(Range(1, 0))),
            "A range from below the smallest": lambda: authority(bounded(Range(-LARGEST - 1, 0))),
            "A range to beyond the largest": lambda: authority(bounded(Range(0, LARGEST + 1))),
            "A set with a number beyond the largest": lambda: authority(bounded(OneOf(frozenset({0, LARGEST + 1})))),
            "A set with a number below the smallest": lambda: authority(bounded(OneOf(frozenset({0, -LARGEST - 1})))),
            "The smallest number of 64 bits": lambda: authority(bounded(Range(-(2**63), 0))),
            "A set of sixty-five": lambda: authority(bounded(OneOf(frozenset(range(0, 130, 2))))),
            "A parameter without bound": lambda: authority(
                bounded(Range(0, 5)), texts=replaced(", $v0 >= 0, $v0 <= 5", "")
            ),
            "A ceiling of five": in_text("$tier <= 1", "$tier <= 5"),
            "A ceiling below zero": in_text("$tier <= 1", "$tier <= -1"),
            "No ceiling": in_text(", $tier <= 1", ""),
            "No start of the window": in_text(f"$time >= {SMALL.not_before}, ", ""),
            "No end of the window": in_text(f"$time < {SMALL.not_after}, ", ""),
            "A window before the epoch": in_text(f">= {SMALL.not_before}", ">= -1"),
            "A window without any time": in_text(f"< {SMALL.not_after}", f"< {SMALL.not_before}"),
            "A window past the calendar": in_text(f"< {SMALL.not_after}", f"< {END_OF_TIME + 1}"),
            "No audience": lambda: authority(SMALL, says=member(audiences=[])),
            "Sixty-five audiences": lambda: authority(
                SMALL, says=member(audiences=sorted(f"http://a{i:02}.example" for i in range(65)))
            ),
            "Sixty-five delegates": lambda: authority(
                SMALL, says=member(delegates=sorted(f"a{i:02}" for i in range(65)))
            ),
            "A set of one number, which is a range": lambda: authority(bounded(OneOf(frozenset({-7})))),
            "A set of consecutive numbers, which are a range": lambda: authority(bounded(OneOf(frozenset({-1, 0, 1})))),
            "A depth of nine": lambda: authority(SMALL, says=member(depth=9)),
            "A depth below zero": lambda: authority(SMALL, says=member(depth=-1)),
            "Attested before the epoch": lambda: authority(SMALL, at=-1),
            "Attested past the calendar": lambda: authority(SMALL, at=END_OF_TIME),
            "Authenticated before the epoch": lambda: authority(SMALL, authenticated_at=-1),
            "Authenticated past the calendar": lambda: authority(SMALL, authenticated_at=END_OF_TIME),
            "A depth of nine in a hop": lambda: hop(authority(SMALL), LESS, parent=SMALL, says=member(depth=9)),
            "No audience in a hop": lambda: hop(authority(SMALL), LESS, parent=SMALL, says=member(audiences=[])),
            "A ceiling of minus one in a hop": lambda: hop(
                authority(SMALL), LESS, parent=SMALL, texts=replaced("<= 0", "<= -1")
            ),
            "A window before the epoch in a hop": lambda: hop(
                authority(SMALL), LESS, parent=SMALL, texts=replaced(", $tier <= 0", ", $time >= -1, $tier <= 0")
            ),
        }
    ),
    good("Authenticated at the epoch", SMALL, authenticated_at=0),
    good("A range of one number", bounded(Range(5, 5))),
    good("A range of all numbers", bounded(Range(-LARGEST, LARGEST))),
    good("A set from the smallest to the largest number", bounded(OneOf(frozenset({-LARGEST, -1, 0, 1, LARGEST})))),
    good("Every unit", scope_of(grants=one_operation(*UNITS))),
    good(
        "A parameter with a colon in its name",
        scope_of(grants=one_operation(Limit(Parameter("a:b:mN", Unit.MILLINEWTON), Range(0, 1)))),
    ),
    good("A ceiling of zero", scope_of(ceiling=SMALL.ceiling.NO_EFFECT)),
    good("No delegate and no depth", scope_of(delegates=frozenset(), depth=0)),
    good("A depth of eight", scope_of(depth=8)),
    good("Texts that Biscuit knows by itself", scope_of(grants=(Grant("admin", "write"), Grant("resource", "read")))),
    good("One operation of two objects", scope_of(grants=(Grant("arm-1", "stop"), Grant("arm-2", "stop")))),
    good(
        "Names in the order of code points",
        scope_of(grants=(Grant("Arm", "stop"), Grant("arm", "Stop"), Grant("arm", "stop"))),
    ),
    allowed("A set of sixty-four", bounded(OneOf(frozenset(range(0, 128, 2)))), go(("speed", "urad_s", 126))),
    allowed("Sixty-four grants", scope_of(grants=grants(64)), {**go(), "operation": "op63"}),
    allowed("Thirty-two parameters", scope_of(grants=counted(32)), go(*((f"p{i}", "count", i % 2) for i in range(32)))),
    allowed(
        "Sixty-four audiences and delegates",
        scope_of(
            audiences=frozenset({CELL, *(f"http://a{i:02}.example" for i in range(63))}),
            delegates=frozenset(f"a{i:02}" for i in range(64)),
            grants=grants(1),
        ),
        {**go(), "operation": "op00"},
    ),
)

GROUPS: tuple[Group, ...] = (TEXTS, NUMBERS)
