"""[TOK-6], items 1 to 3: the message of a block, its one fact, its statement."""

from __future__ import annotations

from collections.abc import Callable

from capabilities.values.errors import FaultCode
from tests.vectors.tokens.cases import Accepted, Case, Group, Made, faults, group
from tests.vectors.tokens.ordinary import (
    CELL,
    ISSUER,
    LESS,
    NOW,
    OTHER_CELL,
    SMALL,
    Says,
    Terms,
    authority,
    hexed,
    hop,
    member,
    message,
    respelled,
    spelled,
    sponsor,
    stating,
    term,
    without,
)
from tests.vectors.tokens.sealing import Sealed, append, cut, inner, put, raw_of, varint

WRONG = FaultCode.WRONG_PROFILE
BROKEN = FaultCode.CHAIN_BROKEN


def with_statements(*more: str) -> Callable[[], Sealed]:
    return lambda: authority(SMALL, texts=lambda checks: [*checks, *more])


def rewritten(change) -> Callable[[], Sealed]:
    return lambda: authority(SMALL, payload=message(change))


def hop_rewritten(change) -> Callable[[], Sealed]:
    return lambda: hop(authority(SMALL), LESS, parent=SMALL, payload=message(change))


def version(number: int):
    return lambda fields: [(n, put(3, number) if n == 3 else raw) for n, raw in fields]


def also(number: int, value: int | bytes):
    return lambda fields: sorted([*fields, (number, put(number, value))], key=lambda field: field[0])


def with_text(*texts: str):
    """These texts behind those of the block."""
    return lambda fields: sorted([*fields, *((1, put(1, text)) for text in texts)], key=lambda field: field[0])


def in_fact(more: bytes):
    """The fact's message with something behind."""
    return lambda fields: [(n, put(4, inner(raw) + more) if n == 4 else raw) for n, raw in fields]


def in_predicate(more: bytes):
    def change(fields):
        return [(n, put(4, put(1, inner(inner(raw)) + more)) if n == 4 else raw) for n, raw in fields]

    return change


MESSAGE = group(
    "message",
    "Blocks of a trusted signer whose message has more, less or other than the profile's, or is written otherwise.",
    faults(
        WRONG,
        "TOK-6",
        {
            "A rule in the authority block": with_statements("p($a) <- hop($a, $b, $c, $d, $e, $f)"),
            "A rule that makes a request": with_statements('req("ur3e", "stop") <- hop($a, $b, $c, $d, $e, $f)'),
            "A scope and a key": with_statements(f"check if true trusting ed25519/{raw_of('root').hex()}"),
        },
    ),
    faults(FaultCode.CHAIN_BROKEN, "TOK-6", {"A reject": with_statements("reject if false")}),
    faults(
        WRONG,
        "TOK-6",
        {
            "A check all": with_statements("check all req_ctx($time, $tier), $tier <= 3"),
            "A context": rewritten(also(2, b"hello")),
            "An empty context": rewritten(also(2, b"")),
            "Another version of Datalog in the authority block": rewritten(version(4)),
            "The version of a hop in the authority block": rewritten(version(5)),
            "The version of an authority block in a hop": hop_rewritten(version(4)),
            "A later version in a hop": hop_rewritten(version(6)),
            "An earlier version": rewritten(version(2)),
            "A version that Biscuit has not": rewritten(version(7)),
            "No version": rewritten(lambda fields: [field for field in fields if field[0] != 3]),
            "A version in a hop that Biscuit has not": hop_rewritten(version(7)),
            "A longer number for the version": rewritten(
                lambda fields: [(n, b"\x18" + varint(3, pad=1) if n == 3 else raw) for n, raw in fields]
            ),
            "A scope of the whole block": hop_rewritten(also(7, put(1, 0))),
            "A key that nothing uses": hop_rewritten(also(8, put(1, 0) + put(2, raw_of("root")))),
            "An unknown field": rewritten(lambda fields: [*fields, (15, put(15, 1))]),
            "An unknown field in a hop": hop_rewritten(lambda fields: [*fields, (15, b"\x7a\x01x")]),
            "An unknown field in the fact": rewritten(in_fact(put(9, 1))),
            "An unknown field in the predicate": rewritten(in_predicate(put(9, 1))),
            "Fields in another order": rewritten(lambda fields: fields[::-1]),
            "The version before the texts": rewritten(lambda fields: sorted(fields, key=lambda field: field[0] != 3)),
            "The version twice": rewritten(lambda fields: [*fields, *(each for each in fields if each[0] == 3)]),
            "A rule in a hop": lambda: append(
                authority(SMALL), stating("p($a) <- hop($a, $b, $c, $d, $e, $f)", version=5)
            ),
        },
    ),
    faults(
        BROKEN,
        "TOK-6",
        {
            "A request as a fact": with_statements('req("ur3e", "read_state")'),
            "A context of a request as a fact": with_statements("req_ctx(1800000000, 0)"),
            "A second fact": with_statements("unknown(1)"),
            "The same fact again": rewritten(
                lambda fields: sorted([*fields, next(f for f in fields if f[0] == 4)], key=lambda field: field[0])
            ),
            "No fact": rewritten(lambda fields: [field for field in fields if field[0] != 4]),
            "A third check": with_statements("check if true"),
            "The context check twice": with_statements("check if req_ctx($time, $tier), $tier <= 3"),
            "The request check twice": with_statements('check if req("ur3e", "read_state")'),
            "A text twice": rewritten(lambda fields: [*fields[:1], *fields]),
            "A text twice, though nothing uses the second": rewritten(with_text("hop")),
            "A text that Biscuit knows by itself": hop_rewritten(with_text("nonce")),
            "A text twice in a hop": hop_rewritten(with_text("agent-x", "agent-x")),
            "A hop with a second fact": lambda: hop(
                authority(SMALL), LESS, parent=SMALL, texts=lambda checks: [*checks, "n(1)"]
            ),
            "A hop with a check too many": lambda: hop(
                authority(SMALL), LESS, parent=SMALL, texts=lambda checks: [*checks, "check if true"]
            ),
        },
    ),
    Case("A text that nothing uses", "TOK-6", rewritten(with_text("unused")), Accepted(SMALL)),
)


# --- the fact --------------------------------------------------------------------------------------------------------------


def predicate(payload_name: str) -> Callable[[], Sealed]:
    """The whole block with its fact under another name."""

    def change(payload: bytes) -> bytes:
        return b"".join(
            put(1, payload_name) if number == 1 and inner(raw) == b"hop" else raw for number, raw in cut(payload)
        )

    return lambda: authority(SMALL, payload=change)


TERMS: dict[str, Terms] = {
    "A term more": lambda found: [*found, "hex:00"],
    "A term less": lambda found: found[:-1],
    "No index": lambda found: found[1:],
    "Index alone": lambda found: found[:1],
    "A text as index": term(0, '"0"'),
    "Bytes as index": term(0, "hex:00"),
    "A date as index": term(0, "2027-01-15T08:00:00Z"),
    "A boolean as index": term(0, "false"),
    "A text as hop id": term(1, f'"{"x" * 16}"'),
    "A set as hop id": term(1, "{1}"),
    "A number as key": term(2, "5"),
    "A short hop id": term(1, hexed(b"h" * 15)),
    "A long hop id": term(1, hexed(b"h" * 17)),
    "No key": term(2, "hex:"),
    "A key of 31 bytes": term(2, hexed(raw_of("orchestrator")[:31])),
    "A key of 34 bytes": term(2, hexed(raw_of("orchestrator") + b"\0\0")),
    "A short measurement": term(3, hexed(b"m" * 31)),
    "A long measurement": term(3, hexed(b"m" * 33)),
    "No request digest": term(4, "hex:"),
    "A long request digest": term(4, hexed(b"d" * 33)),
    "A text as statement": term(5, '"{}"'),
}
P = 2**255 - 19
ORDER_EIGHT = 0x05FC536D880238B13933C6D305ACDFD5F098EFF289F4C345B027B2C28F95E826
KEYS = {
    "The neutral point as key": 1,
    "A key of order two": P - 1,
    "A key of order four": 0,
    "A key of order four with the other sign": 1 << 255,
    "A key of order eight": ORDER_EIGHT,
    "A key of order eight with the other sign": ORDER_EIGHT | 1 << 255,
    "Another key of order eight": P - ORDER_EIGHT,
    "Another key of order eight with the other sign": (P - ORDER_EIGHT) | 1 << 255,
    "A key whose y is the field's size": P,
    "A key whose y is larger than the field": P + 3,
    "The largest key": 2**255 - 1,
}

FACT = group(
    "fact",
    "Facts of a trusted signer that are not the profile's.",
    faults(BROKEN, "TOK-6", {"Another predicate": predicate("hops")}),
    faults(BROKEN, "TOK-6", {t: lambda c=c: authority(SMALL, terms=c) for t, c in TERMS.items()}),
    faults(
        BROKEN,
        "TOK-6",
        {t: lambda y=y: authority(SMALL, key=y.to_bytes(32, "little")) for t, y in KEYS.items()},
    ),
    faults(
        BROKEN,
        "TOK-6",
        {
            "A key of small order in a hop": lambda: hop(authority(SMALL), LESS, parent=SMALL, key=bytes(32)),
            "A short hop id in a hop": lambda: hop(authority(SMALL), LESS, parent=SMALL, hop_id=b"h" * 15),
        },
    ),
)


# --- the statement ---------------------------------------------------------------------------------------------------------

AT = b'"at":1799999990'
EITHER: dict[str, Says] = {
    "No JSON": spelled(b"hello"),
    "Nothing": spelled(b""),
    "Not UTF-8": respelled(b"pick", b"\xffick"),
    "Half a character in UTF-8": respelled(b"pick", b"\xed\xa0\x80"),
    "UTF-16": lambda found: __import__("json").dumps(found, sort_keys=True, separators=(",", ":")).encode("utf-16-le"),
    "A byte order mark": respelled(b"{", b"\xef\xbb\xbf{"),
    "A list": spelled(b"[]"),
    "A number": spelled(b"1"),
    "Null": spelled(b"null"),
    "Open brackets": spelled(b"[" * 5_000),
    "Deep": spelled(b"[" * 3_000 + b"]" * 3_000),
    "Deep in a member": member(weather=[[[[[[[[[[[[[[[[[[[[[]]]]]]]]]]]]]]]]]]]]]),
    "A blank": respelled(b":", b": "),
    "A line end behind": lambda found: respelled(b"{", b"{")(found) + b"\n",
    "A member twice": respelled(b'{"agent"', b'{"agent":"eve","agent"'),
    "Members out of order": respelled(b'{"agent":"', b'{"zagent":"'),
    "An escape that need not be": respelled(b"pick", b"\\u0070ick"),
    "An escaped slash": respelled(b"pick", b"\\/ick"),
    "Half a character escaped": respelled(b"pick", b"\\ud800"),
    "A number with a point": respelled(AT, AT + b".0"),
    "A fraction": respelled(AT, AT + b".5"),
    "A number with an exponent": respelled(AT, b'"at":1.79999999e9'),
    "A negative zero": respelled(AT, b'"at":-0'),
    "A number beyond the doubles": respelled(AT, b'"at":1e999'),
    "A leading zero": respelled(AT, b'"at":01799999990'),
    "Not a number": respelled(AT, b'"at":NaN'),
    "An integer that doubles round": respelled(AT, b'"at":9007199254740993'),
    "A boolean for a number": member(at=True),
    "A text for a number": member(at="1799999990"),
    "A number for a text": member(agent=5),
    "Null for an agent": member(agent=None),
    "No agent": without("agent"),
    "No time": without("at"),
    "No evidence": without("evidence"),
    "No purpose": without("purpose"),
    "An unknown member": member(weather="fair"),
    "A member with a hidden name": respelled(b'{"agent"', b'{"__proto__":{},"agent"'),
    "A delegator": member(delegator="alice"),
    "Unknown evidence": member(evidence="word of honour"),
    "Evidence in capitals": member(evidence="KEY"),
    "A role of null": member(role=None),
    "An empty role": member(role=""),
    "Audiences not in a list": member(audiences=CELL),
    "An audience that is a number": member(audiences=[1]),
    "A list in a list": member(audiences=[[CELL]]),
    "Audiences out of order": member(audiences=[OTHER_CELL, CELL]),
    "An audience twice": member(audiences=[CELL, CELL]),
    "Delegates out of order": member(delegates=["vision", "robotic"]),
    "A delegate twice": member(delegates=["vision", "vision"]),
    "Null delegates": member(delegates=None),
    "A boolean depth": member(depth=True),
    "A depth as text": member(depth="1"),
}
AUTHORITY: dict[str, Says] = {
    "No sponsor": without("sponsor"),
    "A name for a sponsor": member(sponsor="alice"),
    "A sponsor without issuer": lambda found: found["sponsor"].pop("issuer") and None,
    "A sponsor with more": sponsor(mood="good"),
    "Authenticated at no time": sponsor(authenticated_at="now"),
    "No token id": without("token"),
    "A token id of 15 bytes": member(token="A" * 20),
    "A token id of 17 bytes": member(token="A" * 23),
    "A token id in another spelling": member(token="A" * 21 + "B"),
    "A token id with padding": member(token="A" * 22 + "=="),
    "A token id in hex": member(token="0" * 32),
    "No audiences": without("audiences"),
    "No delegates": without("delegates"),
    "No depth": without("depth"),
    "No parameters": without("parameters"),
    "Parameters of no grant": member(parameters=[[], []]),
    "A grant without parameters": member(parameters=[]),
    "Parameters not in a list": member(parameters="q0:urad"),
    "Parameters in no list of their own": member(parameters=["q0:urad"]),
    "A name too many": member(parameters=[["force:mN"]]),
}
HOP: dict[str, Says] = {
    "Another sponsor": member(
        sponsor={"authenticated_at": NOW, "issuer": ISSUER, "method": "m", "subject": "bob"},
    ),
    "Another token id": member(token="A" * 22),
    "A profile": member(profile="ztpm/1"),
    "Other parameters": member(parameters=[]),
    "Null audiences": member(audiences=None),
    "Null depth": member(depth=None),
}
PROFILES = {
    "The next profile": "ztpm/2",
    "A profile without version": "ztpm",
    "A profile in capitals": "ZTPM/1",
    "A profile with a blank": "ztpm/1 ",
    "An empty profile": "",
    "A profile that is a number": 1,
    "A profile of null": None,
    "Profiles in a list": ["ztpm/1"],
}


def in_authority(changes: dict[str, Says]) -> dict[str, Callable[[], Made]]:
    return {title: lambda change=change: authority(SMALL, says=change) for title, change in changes.items()}


def in_hop(changes: dict[str, Says], suffix: str = "") -> dict[str, Callable[[], Made]]:
    return {
        title + suffix: lambda change=change: hop(authority(SMALL), LESS, parent=SMALL, says=change)
        for title, change in changes.items()
    }


STATEMENT = group(
    "statement",
    "Statements of a trusted signer that are not in the one form, or have not the members of their block.",
    faults(WRONG, "TOK-6", in_authority({title: member(profile=found) for title, found in PROFILES.items()})),
    faults(WRONG, "TOK-6", in_authority({"No profile": without("profile"), "An empty object": spelled(b"{}")})),
    faults(BROKEN, "TOK-6", in_authority(EITHER)),
    faults(BROKEN, "TOK-6", in_authority(AUTHORITY)),
    faults(BROKEN, "TOK-6", in_hop(HOP)),
    faults(
        BROKEN,
        "TOK-6",
        in_hop(
            {
                title: EITHER[title]
                for title in (
                    "No JSON",
                    "A list",
                    "A blank",
                    "A member twice",
                    "An escape that need not be",
                    "A number with a point",
                    "A boolean for a number",
                    "No agent",
                    "No purpose",
                    "An unknown member",
                    "A delegator",
                    "Unknown evidence",
                    "An empty role",
                    "Audiences out of order",
                    "A delegate twice",
                    "A boolean depth",
                )
            },
            " in a hop",
        ),
    ),
)

GROUPS: tuple[Group, ...] = (MESSAGE, FACT, STATEMENT)
