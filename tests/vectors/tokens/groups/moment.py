"""[TOK-7] to [TOK-9]: the same token at other times, for other servers, under other views of what is revoked."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

from capabilities.keys import keys
from capabilities.values.errors import FaultCode
from capabilities.values.scope import Scope
from tests.vectors.tokens.cases import Accepted, Case, Faulty, Group, group
from tests.vectors.tokens.ordinary import (
    CELL,
    LESS,
    NOW,
    OTHER_CELL,
    SCOPE,
    SLOWER,
    SMALL,
    TOKEN_ID,
    authority,
    hop,
    hop_id_of,
    member,
)
from tests.vectors.tokens.sealing import p256_of, raw_of

FIRST = "Inside the window"
SHORT = replace(SMALL, not_before=NOW - 20, not_after=NOW + 30)
BELOW = replace(SHORT, ceiling=SHORT.ceiling.NO_EFFECT, depth=1)


def short():
    first = authority(SMALL, at=NOW - 40, authenticated_at=NOW - 40)
    return hop(first, replace(LESS, not_before=NOW - 20, not_after=NOW + 30), parent=SMALL, at=NOW - 40)


def at(title: str, time: int, code: FaultCode | None, token: Any = FIRST) -> Case:
    expected = Accepted(BELOW) if code is None else Faulty(code, "TOK-7")
    return Case(title, "TOK-7", token, expected, {"time": time})


def ahead(seconds: int, name: str) -> Any:
    return lambda: authority(SMALL, **{name: NOW + seconds})


TIMES = group(
    "times",
    "The window is that of the narrowest hop, without any allowance; attestations may lie a little in the future.",
    at(FIRST, NOW, None, short),
    at("The first second", NOW - 20, None),
    at("A second before", NOW - 21, FaultCode.NOT_YET_VALID),
    at("The last second", NOW + 29, None),
    at("The end itself", NOW + 30, FaultCode.EXPIRED),
    at("Long after", NOW + 31_536_000, FaultCode.EXPIRED),
    at("At the epoch", 0, FaultCode.NOT_YET_VALID),
    at("Inside the first hop's window but not the leaf's", NOW + 300, FaultCode.EXPIRED),
    *(
        Case(f"{who} five seconds ahead", "TOK-7", ahead(5, name), Accepted(SMALL))
        for who, name in (("Attested", "at"), ("Authenticated", "authenticated_at"))
    ),
    *(
        Case(f"{who} six seconds ahead", "TOK-7", ahead(6, name), Faulty(FaultCode.NOT_YET_VALID, "TOK-7"))
        for who, name in (("Attested", "at"), ("Authenticated", "authenticated_at"))
    ),
    Case(
        "A hop attested six seconds ahead",
        "TOK-7",
        lambda: hop(authority(SMALL), LESS, parent=SMALL, at=NOW + 6),
        Faulty(FaultCode.NOT_YET_VALID, "TOK-7"),
    ),
    Case(
        "A first hop attested ahead of a later one",
        "TOK-7",
        lambda: hop(authority(SMALL, at=NOW + 6), LESS, parent=SMALL),
        Faulty(FaultCode.NOT_YET_VALID, "TOK-7"),
    ),
    Case(
        "A lifetime too long is found before the end of the window",
        "TOK-7",
        lambda: authority(replace(SMALL, not_before=NOW - 60, not_after=NOW + 3_591)),
        Faulty(FaultCode.LIFETIME_TOO_LONG, "TOK-7"),
        {"time": NOW + 9_000},
    ),
)


KEYS = "Under keys without end"


def two_signers():
    return hop(authority(SMALL), LESS, parent=SMALL)


def under(title: str, trust: str, time: int, fault: tuple[FaultCode, str] | None) -> Case:
    expected = Accepted(ONE_LESS) if fault is None else Faulty(*fault)
    return Case(title, "TRB-3" if "taint" in trust else "TRB-2", KEYS, expected, {"trust": trust, "time": time})


ONE_LESS = replace(SMALL, ceiling=SMALL.ceiling.NO_EFFECT, depth=1)
NO_ROOT = FaultCode.UNKNOWN_ROOT_KEY
NO_ATTESTER = FaultCode.HOP_NOT_ATTESTED
TRUSTED = group(
    "trusted",
    "Each key is trusted for a while, and a tainted one for what it signed before; asked when the token is presented.",
    Case(KEYS, "TRB-2", two_signers, Accepted(ONE_LESS)),
    *(
        case
        for who, trust, code in (
            ("The root", "root for a while", NO_ROOT),
            ("The attester", "attester for a while", NO_ATTESTER),
        )
        for case in (
            under(f"{who} a second before its window", trust, NOW - 6, (code, "TRB-2")),
            under(f"{who} in the first second of its window", trust, NOW - 5, None),
            under(f"{who} in the last second of its window", trust, NOW + 4, None),
            under(f"{who} at the end of its window", trust, NOW + 5, (code, "TRB-2")),
        )
    ),
    under("The bundle in its last second", "bundle for a while", NOW + 4, None),
    under("The bundle at its end", "bundle for a while", NOW + 5, (NO_ROOT, "TRB-2")),
    under("A root that was tainted when it signed", "root tainted", NOW, (NO_ROOT, "TRB-3")),
    under("A root that was tainted a second after it signed", "root tainted later", NOW, None),
    under("An attester that was tainted when it signed", "attester tainted", NOW, (NO_ATTESTER, "TRB-3")),
    under("An attester that was tainted a second after it signed", "attester tainted later", NOW, None),
)


WHERE = "At one of its servers"


def server(title: str, audience: str, *, accepted: bool = False, token: Any = WHERE) -> Case:
    expected = Accepted(SCOPE) if accepted else Faulty(FaultCode.WRONG_AUDIENCE, "TOK-8")
    return Case(title, "TOK-8", token, expected, {"audience": audience})


AUDIENCES = group(
    "audiences",
    "A server is named byte by byte.",
    server(WHERE, CELL, accepted=True, token=authority),
    server("At the other of its servers", OTHER_CELL, accepted=True),
    server("At another server", "http://127.0.0.1:9002/mcp"),
    server("With a slash behind", CELL + "/"),
    server("With the name of a folder below", CELL + "/a"),
    server("With the folder above", "http://127.0.0.1:9000"),
    server("Over another scheme", CELL.replace("http", "https")),
    server("In capitals", CELL.upper()),
    server("Under another name of the machine", CELL.replace("127.0.0.1", "localhost")),
    server("Nowhere", ""),
    Case(
        "At a server that a hop has left out",
        "TOK-8",
        lambda: hop(authority(), replace(SLOWER, audiences=frozenset({CELL}))),
        Faulty(FaultCode.WRONG_AUDIENCE, "TOK-8"),
        {"audience": OTHER_CELL},
    ),
    Case(
        "The wrong server for a token that is too late",
        "TOK-7",
        WHERE,
        Faulty(FaultCode.EXPIRED, "TOK-7"),
        {"audience": "http://127.0.0.1:9002/mcp", "time": NOW + 3_000},
    ),
)


LIVE = "Nothing is revoked"
NARROW = replace(
    SCOPE,
    grants=tuple(
        replace(grant, limits=(*grant.limits[:2], replace(grant.limits[2], bound=SLOWER.grants[0].limits[0].bound)))
        if grant.operation == "move_joint"
        else grant
        for grant in SCOPE.grants[1:]
    ),
    delegates=frozenset({"vision", "gripper"}),
    not_after=NOW + 2_000,
    depth=3,
)


def view(*revoked: tuple[str, str], age_ms: int = 100, epoch: int = 4) -> dict[str, Any]:
    return {"view": {"epoch": epoch, "age_ms": age_ms, "revoked": sorted(map(list, revoked))}}


def dead(title: str, kind: str, name: str, *, age_ms: int = 100) -> Case:
    return Case(title, "TOK-9", LIVE, Faulty(FaultCode.REVOKED, "TOK-9"), view((kind, name), age_ms=age_ms))


def alive(title: str, *revoked: tuple[str, str], age_ms: int = 100, **given: Any) -> Case:
    return Case(title, "TOK-9", LIVE, Accepted(NARROW), {**view(*revoked, age_ms=age_ms), **given})


def stale(title: str, age_ms: int, **given: Any) -> Case:
    fault = Faulty(FaultCode.REVOCATION_VIEW_STALE, "TOK-9")
    return Case(title, "TOK-9", LIVE, fault, {**view(age_ms=age_ms), **given})


REVOCATION = group(
    "revocation",
    "What is revoked kills every chain that it stands in, however old the view; a view too old allows nothing.",
    Case(LIVE, "TOK-9", lambda: hop(authority(), SLOWER), Accepted(NARROW)),
    dead("The sponsor", "sponsor", "alice"),
    dead("The token", "token", TOKEN_ID),
    dead("The server", "audience", CELL),
    dead("The first hop", "hop", hop_id_of("orchestrator").hex()),
    dead("The last hop", "hop", hop_id_of("robotic").hex()),
    dead("The first agent", "agent", "orchestrator"),
    dead("The last agent", "agent", "robotic"),
    dead("The key of the first holder", "key", keys.thumbprint(raw_of("orchestrator"))),
    dead("The key of the last holder", "key", keys.thumbprint(raw_of("robotic"))),
    dead("Revoked in a view that is too old", "token", TOKEN_ID, age_ms=2_001),
    alive(
        "Others of each kind",
        ("sponsor", "bob"),
        ("token", "A" * 22),
        ("audience", "http://127.0.0.1:9002/mcp"),
        ("hop", "0" * 32),
        ("agent", "eve"),
        ("key", keys.thumbprint(raw_of("stranger"))),
    ),
    alive("Another of its servers", ("audience", OTHER_CELL)),
    alive(
        "The same words of other kinds",
        ("agent", "alice"),
        ("sponsor", "robotic"),
        ("hop", TOKEN_ID),
        ("key", "robotic"),
    ),
    alive("A hop in capitals", ("hop", hop_id_of("robotic").hex().upper())),
    alive("A key by its bytes", ("key", keys.b64u(raw_of("robotic")))),
    alive("A view of no age", age_ms=0),
    alive("As old as the lease", age_ms=2_000),
    stale("A millisecond older than the lease", 2_001),
    stale("An age below zero", -1),
    stale("Never seen", 2**53 - 1),
    stale("A shorter lease", 101, lease_ms=100),
    alive("A longer lease", age_ms=30_000, lease_ms=30_000),
    Case(
        "The wrong server for a token that is revoked",
        "TOK-8",
        LIVE,
        Faulty(FaultCode.WRONG_AUDIENCE, "TOK-8"),
        {**view(("token", TOKEN_ID)), "audience": "http://127.0.0.1:9002/mcp"},
    ),
)

FIELD = 2**256 - 2**224 + 2**192 + 2**96 - 1  # of P-256 (SP 800-186 section 3.2.1.3)
CURVE = "Holders with keys on P-256"


def on_curve():
    return hop(authority(SMALL, key=p256_of("orchestrator")), LESS, parent=SMALL, key=p256_of("robotic"))


def odd_key(title: str, raw: bytes) -> Case:
    return Case(title, "TOK-6", lambda: authority(SMALL, key=raw), Faulty(FaultCode.CHAIN_BROKEN, "TOK-6"))


P256 = group(
    "p256",
    "A holder's key may be a compressed point of P-256; its thumbprint has both coordinates.",
    Case(CURVE, "TOK-6", on_curve, Accepted(ONE_LESS)),
    *(
        Case(
            f"The key of {name}, revoked",
            "TOK-9",
            CURVE,
            Faulty(FaultCode.REVOKED, "TOK-9"),
            view(("key", keys.thumbprint(p256_of(name)))),
        )
        for name in ("orchestrator", "robotic")
    ),
    Case("The key of somebody else, revoked", "TOK-9", CURVE, Accepted(ONE_LESS), view(("key", "A" * 43))),
    odd_key("A point without compression", b"\4" + p256_of("orchestrator")[1:]),
    odd_key("A point of a hybrid form", b"\6" + p256_of("orchestrator")[1:]),
    odd_key("A point with a prefix that a library takes for another", b"\5" + p256_of("orchestrator")[1:]),
    odd_key("A point at infinity", bytes(33)),
    odd_key("An x that no point has", b"\2" + (1).to_bytes(32, "big")),
    odd_key("An x of the field's size", b"\2" + FIELD.to_bytes(32, "big")),
    odd_key("An x beyond the field, of a point", b"\2" + (FIELD + 5).to_bytes(32, "big")),
)

MANDATE = "0123456789abcdef" * 2
DRAWN = "A token drawn from a mandate"
DRAWN_ON = "A hop under a drawn token"
ISSUED = "A token that its sponsor issued"


def drawn(**changed: Any) -> Any:
    return authority(SMALL, says=member(**{"mandate": MANDATE, **changed}))


def of(token: str, title: str, *revoked: tuple[str, str], age_ms: int = 100, scope: Scope | None = None) -> Case:
    expected = Faulty(FaultCode.REVOKED, "TOK-9") if scope is None else Accepted(scope)
    return Case(title, "TOK-9", token, expected, view(*revoked, age_ms=age_ms))


def odd_mandate(title: str, found: Any) -> Case:
    return Case(title, "TOK-6", lambda: drawn(mandate=found), Faulty(FaultCode.CHAIN_BROKEN, "TOK-6"))


MANDATES = group(
    "mandates",
    "A drawn token names its mandate, whose revocation kills it and every hop under it.",
    Case(DRAWN, "TOK-6", drawn, Accepted(SMALL)),
    Case(DRAWN_ON, "TOK-6", lambda: hop(drawn(), LESS, parent=SMALL), Accepted(ONE_LESS)),
    Case(ISSUED, "TOK-6", lambda: authority(SMALL), Accepted(SMALL)),
    of(DRAWN, "The mandate, revoked", ("mandate", MANDATE)),
    of(DRAWN_ON, "The mandate of a hop above, revoked", ("mandate", MANDATE)),
    of(DRAWN, "The mandate, revoked in a view that is too old", ("mandate", MANDATE), age_ms=2_001),
    of(DRAWN, "The token of a mandate, revoked", ("token", TOKEN_ID)),
    of(DRAWN, "Another mandate, revoked", ("mandate", "0" * 32), scope=SMALL),
    of(DRAWN, "The id of the mandate as a hop's", ("hop", MANDATE), scope=SMALL),
    of(DRAWN, "A mandate by the id of the token", ("mandate", TOKEN_ID), scope=SMALL),
    of(DRAWN, "The mandate in capitals, revoked", ("mandate", MANDATE.upper()), scope=SMALL),
    of(ISSUED, "A mandate, revoked, of a token that has none", ("mandate", MANDATE), scope=SMALL),
    odd_mandate("A mandate in capitals", MANDATE.upper()),
    odd_mandate("A mandate of 31 digits", MANDATE[1:]),
    odd_mandate("A mandate of 33 digits", MANDATE + "0"),
    odd_mandate("A mandate with a line end", MANDATE + "\n"),
    odd_mandate("A mandate in base64url", TOKEN_ID),
    odd_mandate("A mandate of digits that are not ASCII", "\u0661" * 32),
    odd_mandate("An empty mandate", ""),
    odd_mandate("A mandate of null", None),
    odd_mandate("A mandate that is a number", 12345678901234567890123456789012),
    odd_mandate("Mandates in a list", [MANDATE]),
    Case(
        "A hop that names a mandate",
        "TOK-6",
        lambda: hop(authority(SMALL), LESS, parent=SMALL, says=member(mandate=MANDATE)),
        Faulty(FaultCode.CHAIN_BROKEN, "TOK-6"),
    ),
)

GROUPS: tuple[Group, ...] = (TIMES, TRUSTED, AUDIENCES, REVOCATION, P256, MANDATES)
