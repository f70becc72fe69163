"""Every fault of steps 1 to 6 and 12, reached by a token that was built for it with the real keys."""

from __future__ import annotations

from dataclasses import replace

import biscuit_auth
import pytest

from capabilities import biscuit
from capabilities.block import Alternative, Checks
from capabilities.caps import DEFAULT
from capabilities.chain import Attestation, Chain, EvidenceKind
from capabilities.errors import Fault, FaultCode
from capabilities.scope import Grant, Limit, Range, Restriction, Tier
from capabilities.verify import Verifier
from tests.capabilities.world import (
    CELL,
    LAST,
    LEASE_MS,
    NOW,
    OTHER_CELL,
    QUIETER,
    SCOPE,
    SLOWER,
    SPEED,
    TRUST,
    VIEW,
    Forge,
    add_hop,
    chain_of,
    chain_of_four,
    check,
    key_of,
    mint_root,
    move,
    raw_of,
)

ED25519 = biscuit_auth.Algorithm.Ed25519


def found(token: bytes, **other: object) -> tuple[FaultCode, str]:
    fault = check(token, **other)
    assert isinstance(fault, Fault), fault
    return fault.code, fault.clause


def test_the_forge_itself_makes_good_tokens():
    assert isinstance(check(Forge.authority()), Chain)
    assert isinstance(check(Forge.hop(Forge.authority())), Chain)


# --- [TOK-1] to [TOK-5] ----------------------------------------------------------------------------------------------------


def test_tok_1_size():
    assert found(b"") == (FaultCode.TOKEN_MISSING, "TOK-1")
    assert found(b"\0" * 9_001) == (FaultCode.TOKEN_TOO_LARGE, "TOK-1")
    token = chain_of_four()
    assert isinstance(check(token, caps=replace(DEFAULT, token_bytes=len(token))), Chain)
    assert found(token, caps=replace(DEFAULT, token_bytes=len(token) - 1)) == (FaultCode.TOKEN_TOO_LARGE, "TOK-1")


def test_tok_2_count_before_any_signature():
    token = chain_of_four()
    assert found(token, caps=replace(DEFAULT, hops=2)) == (FaultCode.TOO_MANY_HOPS, "TOK-2")
    spoiled = token[:-40] + bytes(40)  # the signatures no longer matter
    assert check(spoiled, caps=replace(DEFAULT, hops=2)).clause == "TOK-2"
    assert isinstance(check(token, caps=replace(DEFAULT, hops=4, grants=64)), Chain)


@pytest.mark.parametrize(
    "token",
    [
        b"\x08",
        b"hello",
        b"\x08\x07",
        b"\xff" * 200,
        b"\x12\x00",
        bytes(100),
        b"\x08\x80\x80\x80\x80\x80\x80\x80\x80\x80\x80\x01",
    ],
)
def test_tok_2_malformed(token):
    assert found(token) == (FaultCode.TOKEN_MALFORMED, "TOK-2")


def test_tok_3_signatures():
    assert found(Forge.authority(signer="stranger")) == (FaultCode.SIGNATURE_INVALID, "TOK-3")
    assert found(Forge.authority(signer="attester")) == (FaultCode.SIGNATURE_INVALID, "TOK-3")
    assert found(Forge.authority(root_key_id=8)) == (FaultCode.UNKNOWN_ROOT_KEY, "TOK-3")
    builder = biscuit_auth.BiscuitBuilder("check if true;")
    unnamed = builder.build(biscuit_auth.PrivateKey.from_bytes(key_of("root").private_bytes_raw(), ED25519)).to_bytes()
    assert found(bytes(unnamed)) == (FaultCode.UNKNOWN_ROOT_KEY, "TOK-3")


def opened(token: bytes) -> biscuit_auth.Biscuit:
    return biscuit_auth.Biscuit.from_bytes(token, biscuit_auth.PublicKey.from_bytes(raw_of("root"), ED25519))


def third_party(
    token: bytes, source: str, parameters: dict | None = None, *, signer: str = "attester", algorithm=ED25519
) -> bytes:
    raw = key_of(signer).private_bytes_raw()
    private = biscuit_auth.PrivateKey.from_bytes(raw, algorithm)
    public = biscuit_auth.KeyPair.from_private_key(private).public_key
    made = opened(token).third_party_request().create_block(private, biscuit_auth.BlockBuilder(source, parameters))
    return bytes(opened(token).append_third_party(public, made).to_bytes())


def test_tok_4_a_block_that_the_holder_appended():
    token = bytes(opened(mint_root()).append(biscuit_auth.BlockBuilder("check if true;")).to_bytes())
    assert found(token) == (FaultCode.HOP_NOT_ATTESTED, "TOK-4")
    deep = bytes(
        opened(chain_of_four()).append(biscuit_auth.BlockBuilder("check if req_ctx($t, $k), $k <= 1;")).to_bytes()
    )
    assert found(deep) == (FaultCode.HOP_NOT_ATTESTED, "TOK-4")


@pytest.mark.parametrize("signer", ["stranger", "root", "orchestrator", "feed"])
def test_tok_4_a_block_that_someone_else_attested(signer):
    assert found(Forge.hop(mint_root(), signer=signer)) == (FaultCode.HOP_NOT_ATTESTED, "TOK-4")


def test_tok_4_a_block_attested_with_another_kind_of_key():
    token = third_party(mint_root(), "check if true;", signer="p256", algorithm=biscuit_auth.Algorithm.Secp256r1)
    assert found(token) == (FaultCode.HOP_NOT_ATTESTED, "TOK-4")


def test_tok_4_a_withdrawn_attester():
    later = replace(TRUST, version=2, attesters=frozenset({raw_of("attester-2")}))
    token = add_hop(mint_root(), "robotic", SLOWER)
    assert found(token, trust=later) == (FaultCode.HOP_NOT_ATTESTED, "TOK-4")


def test_tok_4_comes_before_any_datalog(monkeypatch):
    def never(*_: object) -> None:
        raise AssertionError("Datalog ran")

    monkeypatch.setattr(biscuit.OpenedToken, "rows", never)
    hostile = " ".join(f"n({i});" for i in range(60)) + " p($a, $b, $c) <- n($a), n($b), n($c), $a < 0;"
    token = bytes(opened(mint_root()).append(biscuit_auth.BlockBuilder(hostile)).to_bytes())
    assert found(token) == (FaultCode.HOP_NOT_ATTESTED, "TOK-4")


@pytest.mark.parametrize(
    "source",
    [
        "p($a) <- hop($a, $b, $c, $d, $e, $f, $g, $h, $i, $j, $k, $l);",
        'req("ur3e", "move_joint", $a) <- token($a, $b);',
        f"check if true trusting ed25519/{raw_of('root').hex()};",
    ],
)
def test_tok_4_even_an_attester_adds_no_rule_and_no_scope(source):
    assert found(third_party(mint_root(), source)) == (FaultCode.WRONG_PROFILE, "TOK-4")


def test_tok_5_other_bytes_of_the_same_token():
    token = mint_root()
    # An unknown field, an over-long number, a field twice: the library reads the same token from each.
    spellings = [token + b"\x50\x01", b"\x08\x87\x00" + token[2:], b"\x08\x07" + token, token[2:] + token[:2]]
    for spelling in spellings:
        fault = check(spelling)
        assert isinstance(fault, Fault)
        assert fault.code in {FaultCode.NOT_CANONICAL, FaultCode.TOKEN_MALFORMED}
    assert found(spellings[1]) == (FaultCode.NOT_CANONICAL, "TOK-5")
    assert found(spellings[2]) == (FaultCode.NOT_CANONICAL, "TOK-5")


# --- [TOK-6]: the facts of a block -----------------------------------------------------------------------------------------


def without(predicate: str, nth: int = 0):
    def change(rows):
        at = [i for i, row in enumerate(rows) if row[0] == predicate][nth]
        return (*rows[:at], *rows[at + 1 :])

    return change


def altered(predicate: str, position: int, value: object, nth: int = 0):
    def change(rows):
        at = [i for i, row in enumerate(rows) if row[0] == predicate][nth]
        terms = rows[at][1]
        return (*rows[:at], (predicate, (*terms[:position], value, *terms[position + 1 :])), *rows[at + 1 :])

    return change


def added(*more):
    return lambda rows: (*rows, *more)


BROKEN_AUTHORITY = {
    "no hop": without("hop"),
    "no sponsor": without("sponsor"),
    "two sponsors": added(("sponsor", ("http://127.0.0.1:8000/ztpm", "bob", "operator-key", NOW))),
    "two hops": added(
        ("hop", (0, b"h" * 16, "eve", "", b"k" * 32, "alice", b"", "", b"d" * 32, "key", b"m" * 32, NOW))
    ),
    "no ceiling": without("bound", 0),
    "no audience count": without("bound", 4),
    "no grant count": without("bound", 6),
    "two ceilings": added(("bound", (0, "ceiling", 1))),
    "unknown dimension": added(("bound", (0, "weather", 1))),
    "a member too few": without("member"),
    "a member too many": added(("member", (0, "audiences", 2, "http://127.0.0.1:9002/mcp"))),
    "a member of nothing": added(("member", (0, "friends", 0, "x"))),
    "an ordinal twice": added(("member", (0, "delegates", 0, "zed"))),
    "a grant too few": without("grant"),
    "a limit too few": without("limit"),
    "a limit of no grant": added(("limit", (0, 9, 0, "speed", "urad_s", 1, 2))),
    "a limit twice": added(("limit", (0, 1, 2, "speed", "urad_s", 1, 2))),
    "a choice beside a limit": added(("choice", (0, 1, 2, "speed", "urad_s", 0, 2))),
    "a choice too many": added(("choice", (0, 0, 1, "force", "mN", 5, 80))),
    "limits empty": altered("limit", 6, -9_000_000, 1),
    "an unknown unit": altered("limit", 4, "furlong"),
    "a text for a number": altered("limit", 5, "0"),
    "a boolean": altered("bound", 2, True),
    "an unknown tier": altered("bound", 2, 9),
    "an empty name": altered("grant", 2, ""),
    "a name with a quote": altered("grant", 3, 'stop"'),
    "grants out of order": altered("grant", 3, "zzz"),
    "a role as agent": altered("hop", 2, "role:x"),
    "a short key": altered("hop", 4, b"k"),
    "a key of small order": altered("hop", 4, bytes(32)),
    "a short digest": altered("hop", 8, b""),
    "unknown evidence": altered("hop", 9, "word of honour"),
    "an audience that is no URL": altered("member", 3, "cell-1"),
    "another index": altered("hop", 0, 1),
    "a short token id": altered("token", 1, b"x"),
    "a fact about hop 1": added(("grant", (1, 0, "ur3e", "fly", 0))),
    "a negative index": added(("grant", (-1, 0, "ur3e", "fly", 0))),
    "a text as index": added(("grant", ("0", 0, "ur3e", "fly", 0))),
}


@pytest.mark.parametrize("defect", BROKEN_AUTHORITY)
def test_tok_6_an_authority_block_with_other_facts(defect):
    assert found(Forge.authority(rows=BROKEN_AUTHORITY[defect])) == (FaultCode.CHAIN_BROKEN, "TOK-6")


@pytest.mark.parametrize("profile", ["ztpm/2", "ztpm", "ZTPM/1", "", 1, b"ztpm/1"])
def test_tok_6_another_profile(profile):
    assert found(Forge.authority(rows=altered("token", 0, profile))) == (FaultCode.WRONG_PROFILE, "TOK-6")
    assert found(Forge.authority(rows=without("token"))) == (FaultCode.WRONG_PROFILE, "TOK-6")
    assert found(Forge.authority(rows=added(("token", (profile, b"x" * 16))))) == (FaultCode.WRONG_PROFILE, "TOK-6")


BROKEN_HOP = {
    "no hop": without("hop"),
    "another index": altered("hop", 0, 2),
    "hop 0 again": altered("hop", 0, 0),
    "a fact about hop 0": added(("grant", (0, 9, "ur3e", "fly", 0))),
    "a bound of hop 0": added(("bound", (0, "ceiling", 4))),
    "two hops": added(
        ("hop", (1, b"h" * 16, "eve", "", b"k" * 32, "orchestrator", b"t" * 32, "", b"d" * 32, "key", b"m" * 32, NOW))
    ),
    "a grant without count": added(("grant", (1, 3, "ur3e", "fly", 0))),
    "no grant count": without("bound", 2),
    "a limit too many": added(("limit", (1, 0, 1, "q0", "urad", 0, 1))),
    "a kept dimension with members": added(("member", (1, "audiences", 0, CELL))),
    "another delegator": altered("hop", 5, "alice"),
    "another delegator's key": altered("hop", 6, b"t" * 32),
    "no delegator's key": altered("hop", 6, b""),
    "the same agent": altered("hop", 2, "orchestrator"),
    "the same key": altered("hop", 4, raw_of("orchestrator")),
    "no grants at all": lambda rows: tuple(
        (p, (1, "grants", 0)) if t[:2] == (1, "grants") else (p, t)
        for p, t in rows
        if p not in {"grant", "limit", "choice"}
    ),
}


@pytest.mark.parametrize("defect", BROKEN_HOP)
def test_tok_6_a_hop_block_with_other_facts(defect):
    code, clause = found(Forge.hop(mint_root(), rows=BROKEN_HOP[defect]))
    assert clause == "TOK-6"
    allowed = {"the same agent": {FaultCode.CHAIN_BROKEN, FaultCode.DELEGATE_NOT_ALLOWED}}
    assert code in allowed.get(defect, {FaultCode.CHAIN_BROKEN})


@pytest.mark.parametrize("predicate", ["token", "sponsor"])
def test_tok_6_a_hop_block_speaks_not_for_the_sponsor(predicate):
    row = {
        "token": ("token", ("ztpm/1", b"x" * 16)),
        "sponsor": ("sponsor", ("http://127.0.0.1:8000/ztpm", "bob", "m", NOW)),
    }[predicate]
    assert found(Forge.hop(mint_root(), rows=added(row))) == (FaultCode.CHAIN_BROKEN, "TOK-6")


def test_tok_6_a_hop_may_not_complete_another_block():
    """Block 1 leaves a fact out, block 2 asserts it for it: the facts add up, the blocks do not."""
    missing = ("grant", (1, 2, "ur3e", "stop", 0))
    first = Forge.hop(mint_root(), rows=lambda rows: tuple(row for row in rows if row != missing))
    parent = chain_of(add_hop(mint_root(), "robotic", SLOWER)).scope
    second = Forge.hop(first, QUIETER, rows=added(missing), index=2, agent="vision", delegator="robotic", parent=parent)
    assert found(second) == (FaultCode.CHAIN_BROKEN, "TOK-6")


def test_tok_6_an_attester_reads_only_its_own_blocks():
    """The second attester states a fact about block 1, which the first one signed."""
    first = add_hop(mint_root(), "robotic", SLOWER)
    parent = chain_of(first).scope
    second = Forge.hop(
        first,
        QUIETER,
        rows=added(("bound", (1, "depth", 3))),
        signer="attester-2",
        index=2,
        agent="vision",
        delegator="robotic",
        parent=parent,
    )
    assert found(second) == (FaultCode.CHAIN_BROKEN, "TOK-6")


def raw_authority(extra: str) -> bytes:
    """A good authority block with more Datalog in it, signed by the root key."""
    from capabilities import block  # noqa: PLC0415
    from tests.capabilities.world import ROOT_ID, SPONSOR, TOKEN_ID, grant_to  # noqa: PLC0415

    made = block.AuthorityBlock(TOKEN_ID, SPONSOR, block.HopFacts(0, grant_to("orchestrator", "alice"), b""), SCOPE)
    source = biscuit._source(block.rows(made), block.checks(made, None))  # noqa: SLF001
    builder = biscuit_auth.BiscuitBuilder(source.text, source.bound)
    builder.add_code(extra)
    builder.set_root_key_id(ROOT_ID)
    return bytes(
        builder.build(biscuit_auth.PrivateKey.from_bytes(key_of("root").private_bytes_raw(), ED25519)).to_bytes()
    )


def test_tok_6_the_raw_forge_itself_makes_a_good_token():
    assert isinstance(check(raw_authority("")), Chain)


@pytest.mark.parametrize(
    "extra",
    [
        'req("ur3e", "move_joint", 0, 0, 5);',  # would satisfy every later check
        "req_ctx(1800000000, 0);",
        "unknown(1);",
        'hop("short");',
        "grant(0, 9);",
        "check if true;",
        "check if true trusting authority;",
        "reject if false;",
        "bound(0, true, 1);",
        "bound(0, {1, 2}, 1);",
        "bound(0, [1, 2], 1);",
        "bound(0, null, 1);",
        "bound(0, 2026-01-01T00:00:00Z, 1);",
    ],
)
def test_tok_6_a_block_holds_nothing_that_was_not_read(extra):
    assert found(raw_authority(extra)) == (FaultCode.CHAIN_BROKEN, "TOK-6")


def test_tok_6_hop_0_continues_the_sponsor():
    assert found(Forge.authority(delegator="bob")) == (FaultCode.CHAIN_BROKEN, "TOK-6")
    assert found(Forge.authority(thumbprint=b"t" * 32)) == (FaultCode.CHAIN_BROKEN, "TOK-6")


# --- [TOK-6]: narrowing ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "restriction",
    [
        Restriction(),
        Restriction(depth=1, not_after=NOW + 9),
        replace(SLOWER, ceiling=Tier.SAFETY_CRITICAL),
        replace(SLOWER, depth=4),
        replace(SLOWER, depth=8),
        replace(SLOWER, audiences=frozenset({CELL, "http://127.0.0.1:9002/mcp"})),
        replace(SLOWER, delegates=frozenset({"eve"})),
        replace(SLOWER, not_after=NOW + 3_001),
        replace(SLOWER, not_before=NOW - 61),
        replace(SLOWER, not_before=NOW + 2_000),
        Restriction(grants=(Grant("ur3e", "move_joint", (Limit(SPEED, Range(1, 1_000_001)),)),)),
        Restriction(grants=(Grant("ur3e", "move_joint", (Limit(SPEED, Range(2_000_000, 2_000_001)),)),)),
        Restriction(grants=(Grant("ur3e", "set_payload"),)),
        Restriction(grants=(Grant("ur3e", "stop", (Limit(SPEED, Range(1, 2)),)),)),
    ],
)
def test_tok_6_not_narrower(restriction):
    assert found(Forge.hop(mint_root(), restriction)) == (FaultCode.NOT_NARROWER, "TOK-6")


def test_tok_6_delegates_and_depth():
    assert found(Forge.hop(mint_root(), agent="eve")) == (FaultCode.DELEGATE_NOT_ALLOWED, "TOK-6")
    assert found(Forge.hop(mint_root(), agent="eve", role="boss")) == (FaultCode.DELEGATE_NOT_ALLOWED, "TOK-6")
    assert isinstance(check(Forge.hop(mint_root(), agent="eve", role="planner")), Chain)
    shallow = replace(SCOPE, depth=0)
    assert found(Forge.hop(mint_root(shallow), parent=shallow)) == (FaultCode.TOO_MANY_HOPS, "TOK-6")


def test_tok_6_a_key_with_another_role():
    for role in ("root", "attester", "feed", "registry", "ledger"):
        assert found(Forge.authority(key=raw_of(role))) == (FaultCode.KEY_WRONG_ROLE, "TOK-6")
        assert found(Forge.hop(mint_root(), key=raw_of(role))) == (FaultCode.KEY_WRONG_ROLE, "TOK-6")


def test_evidence_bounds_ceiling_and_lifetime():
    assert found(Forge.authority(replace(SCOPE, ceiling=Tier.SAFETY_CRITICAL))) == (FaultCode.HOP_NOT_ATTESTED, "TOK-6")
    assert found(Forge.authority(replace(SCOPE, not_after=NOW + 3_591))) == (FaultCode.LIFETIME_TOO_LONG, "TOK-7")
    assert isinstance(check(Forge.authority(replace(SCOPE, not_after=NOW + 3_590))), Chain)
    old = Attestation(EvidenceKind.KEY, b"\2" * 32, NOW - 3_000)
    assert found(Forge.hop(mint_root(), attestation=old)) == (FaultCode.LIFETIME_TOO_LONG, "TOK-7")
    assert found(Forge.authority(replace(SCOPE, not_before=NOW - 86_000))) == (FaultCode.LIFETIME_TOO_LONG, "TOK-7")


JWT = Attestation(EvidenceKind.JWT, b"\2" * 32, NOW - 10)
TIER_4 = replace(SCOPE, ceiling=Tier.SAFETY_CRITICAL)


def test_a_hop_is_bounded_by_its_own_kind_of_evidence():
    """A platform's word carries tier 4, for the hop that has it and for no other."""
    top = Forge.authority(TIER_4, attestation=JWT)
    assert chain_of(top).scope.ceiling is Tier.SAFETY_CRITICAL
    below = Forge.hop(top, parent=TIER_4, attestation=JWT)
    assert chain_of(below).scope.ceiling is Tier.SAFETY_CRITICAL
    # A `key` hop below a `jwt` hop: refused at 4, whether it keeps the ceiling or states it; taken at 3.
    assert found(Forge.hop(top, parent=TIER_4)) == (FaultCode.HOP_NOT_ATTESTED, "TOK-6")
    stated = replace(SLOWER, ceiling=Tier.SAFETY_CRITICAL)
    assert found(Forge.hop(top, stated, parent=TIER_4)) == (FaultCode.HOP_NOT_ATTESTED, "TOK-6")
    capped = Forge.hop(top, replace(SLOWER, ceiling=Tier.HIGH_CONSEQUENCE), parent=TIER_4)
    assert chain_of(capped).scope.ceiling is Tier.HIGH_CONSEQUENCE
    # A `jwt` hop below a `key` hop has what is left, and cannot bring the tier back.
    assert found(Forge.hop(mint_root(), stated, attestation=JWT)) == (FaultCode.NOT_NARROWER, "TOK-6")
    # A kind that nobody knows is no kind.
    other = lambda rows: tuple(("hop", (*t[:9], "x509", *t[10:])) if p == "hop" else (p, t) for p, t in rows)
    assert found(Forge.authority(rows=other))[0] is FaultCode.CHAIN_BROKEN


def test_the_lifetime_of_a_hop_with_a_platforms_word():
    assert DEFAULT.jwt_evidence_lifetime_s <= DEFAULT.key_evidence_lifetime_s
    longest = Forge.authority(replace(SCOPE, not_after=NOW + 3_590), attestation=JWT)
    assert isinstance(check(longest), Chain)
    over = Forge.authority(replace(SCOPE, not_after=NOW + 3_591), attestation=JWT)
    assert found(over) == (FaultCode.LIFETIME_TOO_LONG, "TOK-7")
    short = replace(DEFAULT, jwt_evidence_lifetime_s=100)
    assert check(longest, caps=short).code is FaultCode.LIFETIME_TOO_LONG
    assert isinstance(check(Forge.authority(), caps=short), Chain)


# --- blocks moved about ----------------------------------------------------------------------------------------------------


def fields(message: bytes) -> list[tuple[int, bytes]]:
    """The top-level fields of a token, each with its raw bytes."""
    at, cut = 0, []
    while at < len(message):
        start, number = at, message[at] >> 3
        kind, at = message[at] & 7, at + 1
        value = shift = 0
        while True:
            byte, at = message[at], at + 1
            value |= (byte & 127) << shift
            shift += 7
            if byte < 128:
                break
        at += value if kind == 2 else 0
        cut.append((number, message[start:at]))
    return cut


def joined(parts: list[tuple[int, bytes]]) -> bytes:
    return b"".join(raw for _, raw in parts)


def test_blocks_cannot_be_moved_cut_doubled_or_grafted():
    token = chain_of_four()
    other = add_hop(mint_root(replace(SCOPE, ceiling=Tier.REVERSIBLE)), "robotic", SLOWER)
    head, authority, one, two, three, proof = fields(token)
    their_head, their_authority, their_one, their_proof = fields(other)
    assert joined(fields(token)) == token
    spliced = {
        "cut the last hop": [head, authority, one, two, proof],
        "cut all hops": [head, authority, proof],
        "swap two hops": [head, authority, two, one, three, proof],
        "double a hop": [head, authority, one, one, two, three, proof],
        "drop a middle hop": [head, authority, one, three, proof],
        "their authority": [head, their_authority, one, two, three, proof],
        "their hop": [head, authority, their_one, proof],
        "their hop and proof": [head, authority, their_one, their_proof],
        "our hop on theirs": [their_head, their_authority, one, their_proof],
        "their proof": [head, authority, one, two, three, their_proof],
        "no proof": [head, authority, one, two, three],
        "two proofs": [head, authority, one, two, three, proof, proof],
        "two authority blocks": [head, authority, authority, one, two, three, proof],
        "no authority": [head, one, two, three, proof],
        "hop first": [head, one, authority, two, three, proof],
        "nothing": [head],
    }
    for name, parts in spliced.items():
        assert isinstance(check(joined(parts)), Fault), name


def test_a_hop_signed_for_one_token_fits_no_other():
    """Two tokens with equal contents; the attested block of one does not verify in the other."""
    ours, theirs = add_hop(mint_root(), "robotic", SLOWER), mint_root()
    head, authority, proof = fields(theirs)
    _, _, hop, their_proof = fields(ours)
    for parts in ([head, authority, hop, proof], [head, authority, hop, their_proof]):
        assert found(joined(parts)) == (FaultCode.SIGNATURE_INVALID, "TOK-3")


def test_the_attesters_key_cannot_be_exchanged():
    token = add_hop(mint_root(), "robotic", SLOWER)
    assert raw_of("attester") in token
    swapped = token.replace(raw_of("attester"), raw_of("attester-2"))
    assert found(swapped) == (FaultCode.SIGNATURE_INVALID, "TOK-3")


# --- [TOK-12] --------------------------------------------------------------------------------------------------------------


def other_alternative(change) -> object:
    def apply(checks: Checks) -> Checks:
        kept = tuple(change(a) if a.operation == "move_joint" else a for a in checks.alternatives)
        return replace(checks, alternatives=kept)

    return apply


def with_bound(position: int, bound: object):
    def change(alternative: Alternative) -> Alternative:
        bounds = list(alternative.bounds)
        bounds[position] = bound
        return replace(alternative, bounds=tuple(bounds))

    return change


DISAGREEING = {
    "a limit not checked": other_alternative(with_bound(2, None)),
    "a looser high": other_alternative(with_bound(2, Range(1, 1_000_001))),
    "a looser low": other_alternative(with_bound(0, Range(-3_000_001, 3_000_000))),
    "a tighter high": other_alternative(with_bound(2, Range(1, 999_999))),
    "a tighter low": other_alternative(with_bound(1, Range(-2_999_999, 3_000_000))),
    "another operation": other_alternative(lambda a: replace(a, operation="move_linear")),
    "a parameter more": other_alternative(lambda a: replace(a, bounds=(*a.bounds, None))),
    "a parameter less": other_alternative(lambda a: replace(a, bounds=a.bounds[:-1])),
    "a later end": lambda checks: replace(checks, not_after=checks.not_after + 1),
    "an earlier end": lambda checks: replace(checks, not_after=checks.not_after - 1),
    "an earlier start": lambda checks: replace(checks, not_before=checks.not_before - 1),
    "a later start": lambda checks: replace(checks, not_before=checks.not_before + 1),
    "no end": lambda checks: replace(checks, not_after=None),
    "a higher ceiling": lambda checks: replace(checks, ceiling=checks.ceiling + 1),
    "a lower ceiling": lambda checks: replace(checks, ceiling=checks.ceiling - 1),
}


def asked(token: bytes) -> object:
    checker = Verifier(TRUST, DEFAULT)
    chain = checker.verify(token, at=NOW, audience=CELL, view=VIEW, lease_ms=LEASE_MS)
    assert isinstance(chain, Chain), chain
    return checker.check_request(
        chain, object="ur3e", operation="move_joint", values=move(5), base_tier=Tier.REVERSIBLE, at=NOW
    )


@pytest.mark.parametrize("defect", DISAGREEING)
def test_tok_12_typed_facts_and_datalog_that_differ_are_a_fault(defect):
    assert asked(Forge.authority()) is None
    fault = asked(Forge.authority(checks=DISAGREEING[defect]))
    assert (fault.code, fault.clause) == (FaultCode.ENGINES_DISAGREE, "TOK-12")


def test_tok_12_a_disagreement_is_never_remembered_as_agreement():
    token = Forge.authority(checks=DISAGREEING["a limit not checked"])
    checker = Verifier(TRUST, DEFAULT)
    for _ in range(3):
        chain = checker.verify(token, at=NOW, audience=CELL, view=VIEW, lease_ms=LEASE_MS)
        fault = checker.check_request(
            chain, object="ur3e", operation="move_joint", values=move(5), base_tier=Tier(1), at=NOW
        )
        assert fault.code is FaultCode.ENGINES_DISAGREE


def test_tok_12_runs_once_for_each_operation(monkeypatch):
    probes = []
    decide = biscuit.OpenedToken.decide
    monkeypatch.setattr(
        biscuit.OpenedToken, "decide", lambda self, probe, caps: probes.append(probe) or decide(self, probe, caps)
    )
    checker = Verifier(TRUST, DEFAULT)
    chain = checker.verify(mint_root(), at=NOW, audience=CELL, view=VIEW, lease_ms=LEASE_MS)
    for speed in (5, 6, 7):
        assert (
            checker.check_request(
                chain, object="ur3e", operation="move_joint", values=move(speed), base_tier=Tier(1), at=NOW
            )
            is None
        )
    once = len(probes)
    assert once > 0
    assert checker.check_request(chain, object="ur3e", operation="stop", values=(), base_tier=Tier(0), at=NOW) is None
    assert len(probes) > once
    later = checker.verify(mint_root(), at=NOW, audience=CELL, view=replace(VIEW, epoch=4), lease_ms=LEASE_MS)
    before = len(probes)
    assert checker.check_request(later, object="ur3e", operation="stop", values=(), base_tier=Tier(0), at=NOW) is None
    assert len(probes) > before


def test_a_panic_of_the_library_is_contained(monkeypatch):
    class PanicException(BaseException):
        pass

    def panic(*_: object) -> None:
        raise PanicException("a Rust panic")

    monkeypatch.setattr(biscuit, "_rows_of", panic)
    assert found(mint_root()) == (FaultCode.CHAIN_BROKEN, "TOK-6")

    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(biscuit, "_rows_of", interrupt)
    with pytest.raises(KeyboardInterrupt):
        check(mint_root())
    assert LAST.delegates == frozenset()
    assert OTHER_CELL != CELL
