"""Faults of steps 1 to 6 and 12, each reached by a token built for it with the real keys."""

from __future__ import annotations

from dataclasses import replace

import biscuit_auth
import pytest
from capabilities.token.verify import Verifier
from capabilities.values.caps import DEFAULT
from capabilities.values.chain import Attestation, Chain, EvidenceKind
from capabilities.values.errors import CapabilityError, Fault, FaultCode
from capabilities.values.scope import Grant, Limit, OneOf, Range, Restriction, Tier
from tests.capabilities.world import (
    CELL,
    LEASE_MS,
    NOW,
    OTHER_CELL,
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
    grant_to,
    key_of,
    mint_root,
    move,
    raw_of,
    saying,
    with_term,
)

from capabilities.token import biscuit, checks, wire

ED25519 = biscuit_auth.Algorithm.Ed25519


def found(token: bytes, **other: object) -> tuple[FaultCode, str]:
    fault = check(token, **other)
    assert isinstance(fault, Fault), fault
    return fault.code, fault.clause


@pytest.mark.clause(reason="the forge of the tests below")
def test_the_forge_itself_makes_good_tokens():
    assert isinstance(check(Forge.authority()), Chain)
    assert isinstance(check(Forge.hop(Forge.authority())), Chain)


# --- [TOK-1] to [TOK-5] ----------------------------------------------------------------------------------------------------


@pytest.mark.clause("TOK-1", "BLK-11")
def test_tok_1_size():
    assert found(b"") == (FaultCode.TOKEN_MISSING, "TOK-1")
    assert found(b"\0" * 12_289) == (FaultCode.TOKEN_TOO_LARGE, "TOK-1")
    token = chain_of_four()
    assert isinstance(check(token, caps=replace(DEFAULT, token_bytes=len(token))), Chain)
    assert found(token, caps=replace(DEFAULT, token_bytes=len(token) - 1)) == (FaultCode.TOKEN_TOO_LARGE, "TOK-1")


@pytest.mark.clause("TOK-2", "VFY-1")
def test_tok_2_count_before_any_signature():
    token = chain_of_four()
    assert found(token, caps=replace(DEFAULT, hops=2)) == (FaultCode.TOO_MANY_HOPS, "TOK-2")
    spoiled = token[:-40] + bytes(40)  # the signatures no longer matter
    assert check(spoiled, caps=replace(DEFAULT, hops=2)).clause == "TOK-2"
    assert isinstance(check(token, caps=replace(DEFAULT, hops=4, grants=64)), Chain)


@pytest.mark.clause("TOK-2")
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


@pytest.mark.clause("TOK-3", "BLK-1")
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


@pytest.mark.clause("TOK-4", "BLK-2")
def test_tok_4_a_block_that_the_holder_appended():
    token = bytes(opened(mint_root()).append(biscuit_auth.BlockBuilder("check if true;")).to_bytes())
    assert found(token) == (FaultCode.HOP_NOT_ATTESTED, "TOK-4")
    deep = bytes(
        opened(chain_of_four()).append(biscuit_auth.BlockBuilder("check if req_ctx($t, $k), $k <= 1;")).to_bytes()
    )
    assert found(deep) == (FaultCode.HOP_NOT_ATTESTED, "TOK-4")


@pytest.mark.clause("TOK-4", "BLK-2")
@pytest.mark.parametrize("signer", ["stranger", "root", "orchestrator", "feed"])
def test_tok_4_a_block_that_someone_else_attested(signer):
    assert found(Forge.hop(mint_root(), signer=signer)) == (FaultCode.HOP_NOT_ATTESTED, "TOK-4")


@pytest.mark.clause("TOK-4")
def test_tok_4_a_block_attested_with_another_kind_of_key():
    token = third_party(mint_root(), "check if true;", signer="p256", algorithm=biscuit_auth.Algorithm.Secp256r1)
    assert found(token) == (FaultCode.HOP_NOT_ATTESTED, "TOK-4")


@pytest.mark.clause("TOK-4")
def test_tok_4_a_withdrawn_attester():
    later = replace(TRUST, version=2, attesters=frozenset({raw_of("attester-2")}))
    token = add_hop(mint_root(), "robotic", SLOWER)
    assert found(token, trust=later) == (FaultCode.HOP_NOT_ATTESTED, "TOK-4")


@pytest.mark.clause("TOK-4", "VFY-1")
def test_tok_4_comes_before_any_datalog(monkeypatch):
    def never(*_: object) -> None:
        raise AssertionError("what the block says was read")

    monkeypatch.setattr(wire, "contents", never)
    hostile = " ".join(f"n({i});" for i in range(60)) + " p($a, $b, $c) <- n($a), n($b), n($c), $a < 0;"
    token = bytes(opened(mint_root()).append(biscuit_auth.BlockBuilder(hostile)).to_bytes())
    assert found(token) == (FaultCode.HOP_NOT_ATTESTED, "TOK-4")


@pytest.mark.clause("TOK-5")
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


# --- [TOK-6]: the contents of a block ----------------------------------------------------------------------------------


def without(member):
    return saying(lambda m: m.pop(member) and None)


def stating(**members):
    return saying(lambda m: m.update(members))


def with_sponsor(**members):
    return saying(lambda m: m["sponsor"].update(members))


def named(*parameters):
    """Other names for the parameters of `move_joint`, the second grant."""
    return saying(lambda m: m["parameters"].__setitem__(1, list(parameters)))


def spelled(raw: bytes):
    return saying(lambda _: raw)


def respelled(old: bytes, new: bytes):
    def change(found):
        predicate, (*terms, statement) = found
        assert old in statement
        return predicate, (*terms, statement.replace(old, new, 1))

    return change


def fact_of(predicate, *more):
    return lambda found: (predicate or found[0], (*found[1], *more))


BROKEN_EITHER = {
    "another predicate": fact_of("hops"),
    "a term more": fact_of(None, b""),
    "a term less": lambda found: (found[0], found[1][:-1]),
    "no index": lambda found: (found[0], found[1][1:]),
    "index alone": lambda found: (found[0], found[1][:1]),
    "another index": with_term(0, 7),
    "a negative index": with_term(0, -1),
    "a text as index": with_term(0, "0"),
    "bytes as index": with_term(0, b"\0"),
    "a text as hop id": with_term(1, "x" * 16),
    "a number as key": with_term(2, 5),
    "a short hop id": with_term(1, b"h" * 15),
    "a long hop id": with_term(1, b"h" * 17),
    "a short key": with_term(2, b"k"),
    "a key of small order": with_term(2, bytes(32)),
    "a short measurement": with_term(3, b"m" * 31),
    "a short digest": with_term(4, b""),
    "a text as statement": with_term(5, "{}"),
    "no JSON": spelled(b"hello"),
    "no statement": spelled(b""),
    "not UTF-8": spelled(b"\xff\xfe"),
    "a list": spelled(b"[]"),
    "a number": spelled(b"1"),
    "deep": spelled(b"[" * 5_000),
    "an empty object": spelled(b"{}"),
    "spaced": respelled(b":", b": "),
    "a member twice": respelled(b'{"agent"', b'{"agent":"eve","agent"'),
    "members out of order": respelled(b'"at":', b'"zt":'),
    "an escape that need not be": respelled(b"pick", b"\\u0070ick"),
    "a lone surrogate": respelled(b"pick", b"\\ud800"),
    "a number with a point": respelled(b'"at":1799999990', b'"at":1799999990.0'),
    "a boolean for a number": stating(at=True),
    "a text for a number": stating(at="1799999990"),
    "a time before the epoch": stating(at=-1),
    "a time outside the calendar": stating(at=253_402_300_800),
    "not a number": respelled(b'"at":1799999990', b'"at":NaN'),
    "a number for a text": stating(agent=5),
    "no agent": without("agent"),
    "no time": without("at"),
    "no evidence": without("evidence"),
    "no purpose": without("purpose"),
    "null for an agent": stating(agent=None),
    "an unknown member": stating(weather="fair"),
    "a delegator": stating(delegator="alice"),
    "an empty name": stating(agent=""),
    "a role as agent": stating(agent="role:x"),
    "an empty role": stating(role=""),
    "a role that is no name": stating(role="the boss"),
    "unknown evidence": stating(evidence="word of honour"),
    "a hidden character": stating(purpose="a\u202eb"),
    "no normal form": stating(purpose="e\u0301"),
    "audiences not in a list": stating(audiences=CELL),
    "an audience twice": stating(audiences=[CELL, CELL]),
    "audiences out of order": stating(audiences=[OTHER_CELL, CELL]),
    "an audience that is no URL": stating(audiences=["cell-1"]),
    "an audience that is a number": stating(audiences=[1]),
    "no audience at all": stating(audiences=[]),
    "a delegate twice": stating(delegates=["vision", "vision"]),
    "a delegate that is no name": stating(delegates=["the boss"]),
    "too many delegates": stating(delegates=sorted(f"a{i}" for i in range(65))),
    "a negative depth": stating(depth=-1),
    "a depth beyond the profile": stating(depth=9),
    "a boolean depth": stating(depth=True),
}
BROKEN_AUTHORITY = {
    **BROKEN_EITHER,
    "no sponsor": without("sponsor"),
    "a name for a sponsor": stating(sponsor="alice"),
    "a sponsor without issuer": saying(lambda m: m["sponsor"].pop("issuer") and None),
    "a sponsor with more": with_sponsor(mood="good"),
    "an issuer that is no URL": with_sponsor(issuer="idp"),
    "a subject that is no name": with_sponsor(subject="a b"),
    "a method that is no name": with_sponsor(method=""),
    "authenticated at no time": with_sponsor(authenticated_at="now"),
    "no token id": without("token"),
    "a member nested too deep": lambda fact: (
        fact[0],
        (*fact[1][:-1], b'{"profile":"ztpm/1","x":' + b"[" * 3_000 + b"]" * 3_000 + b"}"),
    ),
    "a short token id": stating(token="x"),
    "a token id in another spelling": stating(token="AAAAAAAAAAAAAAAAAAAAAB"),
    "no audiences": without("audiences"),
    "no delegates": without("delegates"),
    "no depth": without("depth"),
    "no parameters": without("parameters"),
    "parameters of no grant": saying(lambda m: m["parameters"].append([])),
    "a grant without parameters": saying(lambda m: m["parameters"].pop() and None),
    "parameters not in a list": stating(parameters="q0:urad"),
    "parameters that are numbers": stating(parameters=[[0]]),
    "parameters with a space": respelled(b'"q0:urad",', b'"q0:urad", '),
    "parameters with a space at the end": respelled(b']],"profile"', b']] ,"profile"'),
    "parameters with an escape that need not be": respelled(b'"q0:urad"', b'"\\u00710:urad"'),
    "parameters that are no UTF-8": respelled(b'"q0:urad"', b'"\xff0:urad"'),
    "parameters nested too deep": respelled(b'"parameters":[', b'"parameters":[' + b"[" * 3_000 + b"]" * 3_000 + b","),
    "an unknown unit": named("q0:urad", "q1:urad", "speed:furlong"),
    "no unit": named("q0:urad", "q1:urad", "speed"),
    "a parameter without name": named("q0:urad", "q1:urad", ":urad_s"),
    "a parameter twice": named("q0:urad", "q0:urad", "speed:urad_s"),
    "a name with a quote": named('q"0:urad', "q1:urad", "speed:urad_s"),
    "a name too few": named("q0:urad", "q1:urad"),
    "a name too many": named("q0:urad", "q1:urad", "speed:urad_s", "force:mN"),
}


@pytest.mark.clause("TOK-6.1", "TOK-6.3", "TOK-6.4", "BLK-4", "BLK-5")
@pytest.mark.parametrize("defect", BROKEN_AUTHORITY)
def test_tok_6_an_authority_block_with_other_contents(defect):
    code = found(Forge.authority(fact=BROKEN_AUTHORITY[defect]))
    # Where nothing can be read, there is no profile to be seen either.
    unread = defect in {"an empty object"}
    assert code == (FaultCode.WRONG_PROFILE if unread else FaultCode.CHAIN_BROKEN, "TOK-6")


@pytest.mark.clause("TOK-6.2")
@pytest.mark.parametrize("profile", ["ztpm/2", "ztpm", "ZTPM/1", "", 1, None, "ztpm/1 "])
def test_tok_6_another_profile(profile):
    assert found(Forge.authority(fact=stating(profile=profile))) == (FaultCode.WRONG_PROFILE, "TOK-6")
    assert found(Forge.authority(fact=without("profile"))) == (FaultCode.WRONG_PROFILE, "TOK-6")


BROKEN_HOP = {
    **BROKEN_EITHER,
    "hop 0 again": with_term(0, 0),
    "the next index but one": with_term(0, 2),
    "the same agent": stating(agent="orchestrator"),
    "the same key": with_term(2, raw_of("orchestrator")),
    "the same hop id": with_term(1, bytes.fromhex(grant_to("orchestrator", "alice").hop_id)),
    "another sponsor": stating(sponsor={"authenticated_at": NOW, "issuer": CELL, "method": "m", "subject": "bob"}),
    "another token id": stating(token="x" * 22),
    "a profile": stating(profile="ztpm/1"),
    "other names": stating(parameters=[]),
    "null audiences": stating(audiences=None),
    "null depth": stating(depth=None),
}


@pytest.mark.clause("TOK-6.3", "TOK-6.4", "TOK-6.6", "BLK-4", "BLK-5")
@pytest.mark.parametrize("defect", BROKEN_HOP)
def test_tok_6_a_hop_block_with_other_contents(defect):
    code, clause = found(Forge.hop(mint_root(), fact=BROKEN_HOP[defect]))
    assert clause == "TOK-6"
    allowed = {"the same agent": {FaultCode.CHAIN_BROKEN, FaultCode.DELEGATE_NOT_ALLOWED}}
    assert code in allowed.get(defect, {FaultCode.CHAIN_BROKEN})


# --- [TOK-6]: the checks of a block ------------------------------------------------------------------------------------


def raw_authority(*, extra: str = "", drop: tuple[int, ...] = (), old: str = "", new: str = "") -> bytes:
    """An authority block signed by the root key whose statements are left out, added to, or written differently."""
    from tests.capabilities.world import ROOT_ID, SPONSOR, TOKEN_ID, grant_to  # noqa: PLC0415

    from capabilities.token import block  # noqa: PLC0415

    made = block.AuthorityBlock(TOKEN_ID, SPONSOR, 0, grant_to("orchestrator", "alice"), SCOPE)
    source = biscuit._source(block.fact(made), block.checks(made, None))  # noqa: SLF001
    statements = [line for i, line in enumerate(source.text.split("\n")) if i not in drop]
    text = "\n".join(statements)
    assert old in text
    text = text.replace(old, new, 1) + extra
    bound = {name: value for name, value in source.bound.items() if f"{{{name}}}" in text}
    builder = biscuit_auth.BiscuitBuilder(text, bound)
    builder.set_root_key_id(ROOT_ID)
    return bytes(
        builder.build(biscuit_auth.PrivateKey.from_bytes(key_of("root").private_bytes_raw(), ED25519)).to_bytes()
    )


@pytest.mark.clause(reason="the forge of the tests below")
def test_tok_6_the_raw_forge_itself_makes_a_good_token():
    assert isinstance(check(raw_authority()), Chain)


@pytest.mark.clause("TOK-6.1", "BLK-3")
@pytest.mark.parametrize(
    "extra",
    [
        'req("ur3e", "move_joint", 0, 0, 5);',  # would satisfy every later check
        "req_ctx(1800000000, 0);",
        "unknown(1);",
        'hop("short");',
        "check if true;",
        "check if req_ctx($time, $tier), $tier <= 3;",
        'check if req("ur3e", "stop");',
    ],
)
def test_tok_6_a_block_holds_nothing_more(extra):
    assert found(raw_authority(extra=extra)) == (FaultCode.CHAIN_BROKEN, "TOK-6")


@pytest.mark.clause("TOK-6.1", "BLK-3")
@pytest.mark.parametrize(
    ("extra", "code"),
    [
        # A reject is of the version of functions, which a block may have; a check for all is of one that none has.
        ("reject if false;", FaultCode.CHAIN_BROKEN),
        ("check all req_ctx($time, $tier), $tier <= 3;", FaultCode.WRONG_PROFILE),
    ],
)
def test_tok_6_a_block_is_of_one_version_of_datalog(extra, code):
    assert found(raw_authority(extra=extra)) == (code, "TOK-6")


@pytest.mark.clause("TOK-6.1", "BLK-3")
@pytest.mark.parametrize(
    "extra",
    [
        "p($a) <- hop($a, $b, $c, $d, $e, $f);",
        'req("ur3e", "move_joint", $a) <- hop($a, $b, $c, $d, $e, $f);',
        f"check if true trusting ed25519/{raw_of('root').hex()};",
    ],
)
def test_tok_6_even_an_issuer_adds_no_rule_and_no_scope(extra):
    assert found(raw_authority(extra=extra)) == (FaultCode.WRONG_PROFILE, "TOK-6")


@pytest.mark.clause("TOK-6.1", "BLK-3")
@pytest.mark.parametrize("extra", ["n(1);", "p($a) <- hop($a, $b, $c, $d, $e, $f);", "check if true;"])
def test_tok_6_even_an_attester_adds_nothing(extra):
    source = biscuit._source(*hop_parts())  # noqa: SLF001
    good = third_party(mint_root(), source.text, source.bound)
    assert isinstance(check(good), Chain)
    fault = check(third_party(mint_root(), source.text + extra, source.bound))
    assert (fault.code, fault.clause) in {(FaultCode.CHAIN_BROKEN, "TOK-6"), (FaultCode.WRONG_PROFILE, "TOK-6")}


def hop_parts():
    from capabilities.token import block  # noqa: PLC0415

    made = block.HopBlock(1, grant_to("robotic", "orchestrator"), SLOWER)
    return block.fact(made), block.checks(made, SCOPE)


# Statements 1 and 2 are the two checks; the first limits of the first one are those of `gripper_move`.
WRITTEN_DIFFERENTLY = {
    "no check over the request": {"drop": (1,)},
    "no check over its context": {"drop": (2,)},
    "no check at all": {"drop": (1, 2)},
    "an upper end alone": {"old": "$v0 >= {p8}, ", "new": ""},
    "a lower end alone": {"old": ", $v0 <= {p9}", "new": ""},
    "ends exchanged": {"old": "$v0 >= {p8}, $v0 <= {p9}", "new": "$v0 <= {p8}, $v0 >= {p9}"},
    "a strict end": {"old": "$v0 <= {p9}", "new": "$v0 < {p9}"},
    "an equation": {"old": "$v0 >= {p8}", "new": "$v0 == {p8}"},
    "sides exchanged": {"old": "$v0 >= {p8}", "new": "{p8} <= $v0"},
    "two conditions in one": {"old": "$v0 >= {p8}, $v0 <= {p9}", "new": "$v0 >= {p8} && $v0 <= {p9}"},
    "arithmetic": {"old": "$v0 >= {p8}", "new": "$v0 + 1 >= {p8}"},
    "brackets": {"old": "$v0 >= {p8}", "new": "($v0) >= {p8}"},
    "a negation": {"old": "$v0 >= {p8}", "new": "!($v0 < {p8})"},
    "a range of two parameters": {"old": "$v0 <= {p9}", "new": "$v1 <= {p9}"},
    "a limit twice": {"old": "$v0 >= {p8}", "new": "$v0 >= {p8}, $v0 <= {p9}, $v0 >= {p8}"},
    "limits out of order": {
        "old": "$v0 >= {p8}, $v0 <= {p9}, {p10}.contains($v1)",
        "new": "{p10}.contains($v1), $v0 >= {p8}, $v0 <= {p9}",
    },
    "another name for a parameter": {"old": "$v0, $v1), $v0 >= {p8}, $v0 <=", "new": "$w, $v1), $w >= {p8}, $w <="},
    "one variable twice": {"old": "{p7}, $v0, $v1)", "new": "{p7}, $v0, $v0)"},
    "a constant parameter": {"old": "{p7}, $v0, $v1), $v0 >= {p8}, $v0 <= {p9}", "new": "{p7}, 5, $v1)"},
    "a list for a set": {"old": "{p10}.contains", "new": "[10, 20, 40].contains"},
    "a set of texts": {"old": "{p10}.contains", "new": '{"a", "b"}.contains'},
    "an empty set": {"old": "{p10}.contains", "new": "{,}.contains"},
    "the wrong way round": {"old": "{p10}.contains($v1)", "new": "{p10}.contains($v1), {p10}.contains($v0)"},
    "a second fact in an alternative": {
        "old": "{p7}, $v0, $v1)",
        "new": "{p7}, $v0, $v1), hop($a, $b, $c, $d, $e, $f)",
    },
    "no operation": {"old": "req({p6}, {p7}, $v0, $v1)", "new": "req({p6})"},
    "an operation that is bytes": {"old": "req({p6}, {p7}, $v0, $v1)", "new": "req({p6}, hex:00, $v0, $v1)"},
    "any operation": {"old": "req({p6}, {p7}, $v0, $v1)", "new": "req({p6}, $op, $v0, $v1)"},
    "any object": {"old": "req({p6}, {p7}, $v0, $v1)", "new": "req($o, {p7}, $v0, $v1)"},
    "an alternative over the context": {"old": "check if req(", "new": "check if req_ctx($time, $tier) or req("},
    "a reject": {"old": "check if req(", "new": "reject if req("},
    "check all": {"old": "check if req(", "new": "check all req("},
    "a scope": {"old": "{p25}", "new": "{p25} trusting previous"},
    "context exchanged": {"old": "req_ctx($time, $tier)", "new": "req_ctx($tier, $time)"},
    "context with more": {"old": "req_ctx($time, $tier)", "new": "req_ctx($time, $tier, $place)"},
    "window out of order": {"old": "$time >= ", "new": "$tier <= 4, $time >= "},
    "a ceiling twice": {"old": "$tier <= ", "new": "$tier <= 4, $tier <= "},
    "an inclusive end": {"old": "$time < ", "new": "$time <= "},
    "an exclusive start": {"old": "$time >= ", "new": "$time > "},
}


@pytest.mark.clause("TOK-6.3", "BLK-8", "BLK-9", "BLK-10")
@pytest.mark.parametrize("defect", WRITTEN_DIFFERENTLY)
def test_tok_6_a_check_has_one_form(defect):
    token = raw_authority(**WRITTEN_DIFFERENTLY[defect])
    code, clause = found(token)
    assert clause == "TOK-6"
    # What is new in another Datalog makes the block one of another version, but for that of functions.
    later = {"check all", "a scope"}
    assert code is (FaultCode.WRONG_PROFILE if defect in later else FaultCode.CHAIN_BROKEN)


@pytest.mark.clause("TOK-6.3", "BLK-8", "BLK-9")
@pytest.mark.parametrize(
    "change",
    [
        lambda c: replace(c, alternatives=c.alternatives[::-1]),
        lambda c: replace(c, alternatives=(*c.alternatives, c.alternatives[-1])),
        lambda c: replace(c, alternatives=c.alternatives[:-1]),
        lambda c: replace(c, ceiling=5),
        lambda c: replace(c, ceiling=-1),
        lambda c: replace(c, ceiling=None),
        lambda c: replace(c, not_before=None),
        lambda c: replace(c, not_after=None),
        lambda c: replace(c, not_before=-1),
        lambda c: replace(c, not_after=c.not_before),
        lambda c: replace(c, not_after=253_402_300_801),
    ],
)
def test_tok_6_checks_that_state_no_scope(change):
    assert found(Forge.authority(checks=change)) == (FaultCode.CHAIN_BROKEN, "TOK-6")


@pytest.mark.clause("TOK-6.3", "VAL-1", "VAL-8")
@pytest.mark.parametrize(
    "bound",
    [Range(1, 0), Range(-(2**53), 5), Range(0, 2**53), OneOf(frozenset({2**53})), OneOf(frozenset(range(65))), None],
)
def test_tok_6_a_bound_outside_the_profile(bound):
    assert found(Forge.authority(checks=other_alternative(with_bound(2, bound)))) == (FaultCode.CHAIN_BROKEN, "TOK-6")


@pytest.mark.clause("BLK-6")
def test_tok_6_hop_0_is_the_sponsors():
    assert chain_of(Forge.authority()).hops[0].delegator == "alice"
    assert chain_of(add_hop(mint_root(), "robotic", SLOWER)).leaf.delegator == "orchestrator"
    with pytest.raises(CapabilityError) as caught:
        mint_root(hop=grant_to("orchestrator", "bob"))
    assert caught.value.code is FaultCode.CHAIN_BROKEN


# --- [TOK-6]: narrowing ----------------------------------------------------------------------------------------------------


@pytest.mark.clause("TOK-6.8", "TOK-6.5", "VAL-12")
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
    ],
)
def test_tok_6_not_narrower(restriction):
    assert found(Forge.hop(mint_root(), restriction)) == (FaultCode.NOT_NARROWER, "TOK-6")


@pytest.mark.clause("TOK-6.7", "BLK-7")
def test_tok_6_delegates_and_depth():
    assert found(Forge.hop(mint_root(), agent="eve")) == (FaultCode.DELEGATE_NOT_ALLOWED, "TOK-6")
    assert found(Forge.hop(mint_root(), agent="eve", role="boss")) == (FaultCode.DELEGATE_NOT_ALLOWED, "TOK-6")
    assert isinstance(check(Forge.hop(mint_root(), agent="eve", role="planner")), Chain)
    shallow = replace(SCOPE, depth=0)
    assert found(Forge.hop(mint_root(shallow), parent=shallow)) == (FaultCode.TOO_MANY_HOPS, "TOK-6")


@pytest.mark.clause("TOK-6.6")
def test_tok_6_a_key_with_another_role():
    for role in ("root", "attester", "feed", "registry", "ledger"):
        assert found(Forge.authority(key=raw_of(role))) == (FaultCode.KEY_WRONG_ROLE, "TOK-6")
        assert found(Forge.hop(mint_root(), key=raw_of(role))) == (FaultCode.KEY_WRONG_ROLE, "TOK-6")


@pytest.mark.clause("TOK-6.9", "TOK-7", "BLK-11")
def test_evidence_bounds_ceiling_and_lifetime():
    assert found(Forge.authority(replace(SCOPE, ceiling=Tier.SAFETY_CRITICAL))) == (FaultCode.HOP_NOT_ATTESTED, "TOK-6")
    assert found(Forge.authority(replace(SCOPE, not_after=NOW + 3_591))) == (FaultCode.LIFETIME_TOO_LONG, "TOK-7")
    assert isinstance(check(Forge.authority(replace(SCOPE, not_after=NOW + 3_590))), Chain)
    old = Attestation(EvidenceKind.KEY, b"\2" * 32, NOW - 3_000)
    assert found(Forge.hop(mint_root(), attestation=old)) == (FaultCode.LIFETIME_TOO_LONG, "TOK-7")
    assert found(Forge.authority(replace(SCOPE, not_before=NOW - 86_000))) == (FaultCode.LIFETIME_TOO_LONG, "TOK-7")


JWT = Attestation(EvidenceKind.JWT, b"\2" * 32, NOW - 10)
TIER_4 = replace(SCOPE, ceiling=Tier.SAFETY_CRITICAL)


@pytest.mark.clause("TOK-6.9", "BLK-12")
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
    assert found(Forge.authority(fact=stating(evidence="tpm")))[0] is FaultCode.CHAIN_BROKEN


@pytest.mark.clause("TOK-6.9", "TOK-7", "BLK-11", "BLK-12")
def test_an_oauth_client_has_tier_1_for_ten_minutes():
    client = Attestation(EvidenceKind.CLIENT, bytes(32), NOW - 10)
    low = replace(SCOPE, ceiling=Tier.REVERSIBLE, not_after=NOW + 590)
    assert chain_of(Forge.authority(low, attestation=client)).leaf.attestation.kind is EvidenceKind.CLIENT
    higher = replace(low, ceiling=Tier.CONSEQUENTIAL)
    assert found(Forge.authority(higher, attestation=client)) == (FaultCode.HOP_NOT_ATTESTED, "TOK-6")
    longer = replace(low, not_after=NOW + 591)
    assert found(Forge.authority(longer, attestation=client)) == (FaultCode.LIFETIME_TOO_LONG, "TOK-7")


@pytest.mark.clause("TOK-7", "BLK-11")
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


@pytest.mark.clause("TOK-3", "BLK-2")
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


@pytest.mark.clause("TOK-3", "BLK-2")
def test_a_hop_signed_for_one_token_fits_no_other():
    """Two tokens with equal contents; the attested block of one does not verify in the other."""
    ours, theirs = add_hop(mint_root(), "robotic", SLOWER), mint_root()
    head, authority, proof = fields(theirs)
    _, _, hop, their_proof = fields(ours)
    for parts in ([head, authority, hop, proof], [head, authority, hop, their_proof]):
        assert found(joined(parts)) == (FaultCode.SIGNATURE_INVALID, "TOK-3")


@pytest.mark.clause("TOK-3")
def test_the_attesters_key_cannot_be_exchanged():
    token = add_hop(mint_root(), "robotic", SLOWER)
    assert raw_of("attester") in token
    swapped = token.replace(raw_of("attester"), raw_of("attester-2"))
    assert found(swapped) == (FaultCode.SIGNATURE_INVALID, "TOK-3")


# --- [TOK-12] --------------------------------------------------------------------------------------------------------------


def other_alternative(change) -> object:
    def apply(stated: checks.Checks) -> checks.Checks:
        kept = tuple(change(a) if a.operation == "move_joint" else a for a in stated.alternatives)
        return replace(stated, alternatives=kept)

    return apply


def with_bound(position: int, bound: object):
    def change(alternative: checks.Alternative) -> checks.Alternative:
        bounds = list(alternative.bounds)
        bounds[position] = bound
        return replace(alternative, bounds=tuple(bounds))

    return change


def misread(change):
    """Biscuit's checks read as something else: an error of our reader, or a new meaning of the library's."""
    return lambda real: lambda symbols, encoded: change(real(symbols, encoded))


DISAGREEING = {
    "a looser high": other_alternative(with_bound(2, Range(1, 1_000_001))),
    "a looser low": other_alternative(with_bound(0, Range(-3_000_001, 3_000_000))),
    "a tighter high": other_alternative(with_bound(2, Range(1, 999_999))),
    "a tighter low": other_alternative(with_bound(1, Range(-2_999_999, 3_000_000))),
    "a set for a range": other_alternative(with_bound(2, OneOf(frozenset({1, 5, 1_000_000})))),
    "a later end": lambda checks: replace(checks, not_after=checks.not_after + 1),
    "an earlier end": lambda checks: replace(checks, not_after=checks.not_after - 1),
    "an earlier start": lambda checks: replace(checks, not_before=checks.not_before - 1),
    "a later start": lambda checks: replace(checks, not_before=checks.not_before + 1),
    "a higher ceiling": lambda checks: replace(checks, ceiling=checks.ceiling + 1),
    "a lower ceiling": lambda checks: replace(checks, ceiling=checks.ceiling - 1),
}
JWT_SCOPE = replace(SCOPE, ceiling=Tier.CONSEQUENTIAL)


def asked(token: bytes) -> object:
    checker = Verifier(TRUST, DEFAULT)
    chain = checker.verify(token, at=NOW, audience=CELL, view=VIEW, lease_ms=LEASE_MS)
    assert isinstance(chain, Chain), chain
    return checker.check_request(
        chain, object="ur3e", operation="move_joint", values=move(5), base_tier=Tier.REVERSIBLE, at=NOW
    )


@pytest.mark.clause("TOK-12")
@pytest.mark.parametrize("defect", DISAGREEING)
def test_tok_12_a_reading_that_biscuit_does_not_share_is_a_fault(defect, monkeypatch):
    token = Forge.authority(JWT_SCOPE)
    assert asked(token) is None
    monkeypatch.setattr(checks, "read", misread(DISAGREEING[defect])(checks.read))
    fault = asked(token)
    assert (fault.code, fault.clause) == (FaultCode.ENGINES_DISAGREE, "TOK-12")


@pytest.mark.clause("TOK-12")
def test_tok_12_a_disagreement_is_never_remembered_as_agreement(monkeypatch):
    monkeypatch.setattr(checks, "read", misread(DISAGREEING["a looser high"])(checks.read))
    checker = Verifier(TRUST, DEFAULT)
    for _ in range(3):
        chain = checker.verify(Forge.authority(), at=NOW, audience=CELL, view=VIEW, lease_ms=LEASE_MS)
        fault = checker.check_request(
            chain, object="ur3e", operation="move_joint", values=move(5), base_tier=Tier(1), at=NOW
        )
        assert fault.code is FaultCode.ENGINES_DISAGREE


@pytest.mark.clause("TOK-12")
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
    # Another token with checks of the same form, whatever their numbers, tells nothing new; another form does.
    before = len(probes)
    for token in (mint_root(token_id="A" * 22), mint_root(replace(SCOPE, not_after=NOW + 2_500, ceiling=Tier(2)))):
        later = checker.verify(token, at=NOW, audience=CELL, view=replace(VIEW, epoch=4), lease_ms=LEASE_MS)
        assert (
            checker.check_request(later, object="ur3e", operation="stop", values=(), base_tier=Tier(0), at=NOW) is None
        )
    assert len(probes) == before
    narrower = checker.verify(
        add_hop(mint_root(), "robotic", SLOWER), at=NOW, audience=CELL, view=VIEW, lease_ms=LEASE_MS
    )
    assert (
        checker.check_request(narrower, object="ur3e", operation="stop", values=(), base_tier=Tier(0), at=NOW) is None
    )
    assert len(probes) > before


@pytest.mark.clause("TOK-3")
def test_a_panic_of_the_library_is_contained(monkeypatch):
    class PanicException(BaseException):
        pass

    def panic(*_: object) -> None:
        raise PanicException("a Rust panic")

    token = mint_root()
    monkeypatch.setattr(biscuit, "OpenedToken", panic)
    assert found(token) == (FaultCode.SIGNATURE_INVALID, "TOK-3")

    def interrupt(*_: object) -> None:
        raise KeyboardInterrupt

    monkeypatch.setattr(biscuit, "OpenedToken", interrupt)
    with pytest.raises(KeyboardInterrupt):
        check(token)
