"""A token from sponsor to request: what holds, and who drew which line."""

from __future__ import annotations

import threading
from dataclasses import replace

import pytest
from capabilities.keys.windows import Window
from capabilities.statements.revocation import RevocationView, Revoked
from capabilities.token.hop_rules import NotNarrowerError
from capabilities.token.scope_check import disagreement
from capabilities.token.verify import Verifier, inspect_token, tightest, token_from_text, token_to_text
from capabilities.values.caps import DEFAULT
from capabilities.values.chain import Chain
from capabilities.values.errors import CapabilityError, Fault, FaultCode, TokenError
from capabilities.values.scope import Grant, Limit, OneOf, Range, Restriction, Tier
from capabilities.values.units import Quantity, Unit
from tests.capabilities.world import (
    CELL,
    FORCE,
    ISSUER,
    JOINTS,
    LAST,
    LEASE_MS,
    MOVE,
    NOW,
    OTHER_CELL,
    QUIETER,
    READ,
    SCOPE,
    SLOWER,
    SPEED,
    SPONSOR,
    STOP,
    TOKEN_ID,
    TRUST,
    VIEW,
    WIDTH,
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
    verifier,
)

from capabilities.keys import keys
from capabilities.token import biscuit, block, hop_rules


@pytest.mark.clause("BLK-1", "BLK-4")
def test_what_is_minted_verifies():
    chain = chain_of(mint_root())
    assert (chain.token_id, chain.sponsor, chain.scope, chain.root_key_id) == (TOKEN_ID, SPONSOR, SCOPE, 7)
    assert (chain.epoch, chain.view_age_ms) == (VIEW.epoch, VIEW.age_ms)
    assert chain.leaf.agent == "orchestrator"


@pytest.mark.clause("BLK-6", "VAL-12")
def test_a_chain_of_four_names_every_holder_and_only_shrinks():
    chain = chain_of(chain_of_four())
    assert [hop.agent for hop in chain.hops] == ["orchestrator", "robotic", "vision", "gripper"]
    assert [hop.delegator for hop in chain.hops] == ["alice", "orchestrator", "robotic", "vision"]
    assert [hop.scope.depth for hop in chain.hops] == [4, 3, 2, 1]
    assert [hop.key for hop in chain.hops] == [raw_of(hop.agent) for hop in chain.hops]
    assert chain.scope.grants == (
        Grant(
            "ur3e",
            "move_joint",
            (
                Limit(JOINTS[0], Range(-1_000, 2_000)),
                Limit(JOINTS[1], Range(-3_000_000, 3_000_000)),
                Limit(SPEED, OneOf(frozenset({5, 500_000}))),
            ),
        ),
        READ,
    )
    assert chain.scope.ceiling is Tier.CONSEQUENTIAL
    assert chain.scope.audiences == {CELL}
    assert chain.scope.not_after == NOW + 2_000


@pytest.mark.clause("BLK-7", "TOK-6.7")
def test_a_role_names_delegates_of_the_same_sponsor():
    token = add_hop(mint_root(), "anyone", SLOWER, role="planner")
    assert chain_of(token).leaf.role == "planner"
    with pytest.raises(TokenError) as caught:
        add_hop(mint_root(), "anyone", SLOWER)
    assert caught.value.code is FaultCode.DELEGATE_NOT_ALLOWED


@pytest.mark.clause("TOK-6.7")
def test_an_agent_without_role_has_not_the_role_without_name():
    nobody = replace(chain_of(mint_root()).leaf.scope, delegates=frozenset({"role:"}))
    parents = (replace(chain_of(mint_root()).leaf, scope=nobody),)
    added = block.HopBlock(1, grant_to("eve", "orchestrator"), Restriction(ceiling=Tier(1)))
    with pytest.raises(TokenError) as caught:
        hop_rules.next_hop(parents, added, reserved=frozenset(), caps=DEFAULT)
    assert caught.value.code is FaultCode.DELEGATE_NOT_ALLOWED


# --- step 11: who drew the line --------------------------------------------------------------------------------------------


def asked(token: bytes, operation: str = "move_joint", values: tuple[Quantity, ...] = move(5), **other: object):
    checker = verifier()
    chain = checker.verify(token, at=NOW, audience=CELL, view=VIEW, lease_ms=LEASE_MS)
    assert isinstance(chain, Chain)
    arguments = {"object": "ur3e", "operation": operation, "values": values, "base_tier": Tier.REVERSIBLE, "at": NOW}
    return checker.check_request(chain, **{**arguments, **other})


@pytest.mark.clause("TOK-11", "TOK-12")
def test_a_request_inside_is_allowed_by_both_engines():
    assert asked(chain_of_four()) is None
    assert asked(chain_of_four(), "read_state", ()) is None
    assert (
        asked(
            mint_root(),
            "gripper_move",
            (Quantity("width", Unit.MICROMETRE, 5), Quantity("force", Unit.MILLINEWTON, 40)),
        )
        is None
    )


@pytest.mark.clause("TOK-11")
def test_a_limit_names_the_hop_that_set_that_side():
    token = add_hop(
        mint_root(),
        "robotic",
        Restriction(grants=(Grant("ur3e", "move_joint", (Limit(JOINTS[0], Range(-3_000_000, 7)),)),)),
    )
    above = asked(token, values=move(5, q0=8))
    assert (above.code, above.parameter, above.value, above.unit) == (
        FaultCode.LIMIT_EXCEEDED_BY_REQUEST,
        "q0",
        8,
        Unit.MICRORADIAN,
    )
    assert (above.bound, above.nearest, above.hop, above.agent, above.sponsor) == (
        Range(-3_000_000, 7),
        7,
        1,
        "robotic",
        "alice",
    )
    assert above.hop_id == chain_of(token).hops[1].hop_id
    below = asked(token, values=move(5, q0=-3_000_001))
    assert (below.hop, below.agent, below.nearest) == (0, "orchestrator", -3_000_000)


@pytest.mark.clause("TOK-11")
def test_a_finite_set_names_its_nearest_member():
    refused = asked(chain_of_four(), values=move(6))
    assert (refused.code, refused.nearest, refused.hop, refused.agent) == (
        FaultCode.LIMIT_EXCEEDED_BY_REQUEST,
        5,
        2,
        "vision",
    )


@pytest.mark.clause("TOK-11")
def test_tightest_names_the_last_hop_that_changed_the_bound():
    chain = chain_of(chain_of_four())
    bound, hop = tightest(chain, "ur3e", "move_joint", "speed")
    assert (bound, hop.agent) == (OneOf(frozenset({5, 500_000})), "vision")
    bound, hop = tightest(chain, "ur3e", "move_joint", "q1")
    assert (bound, hop.agent) == (Range(-3_000_000, 3_000_000), "orchestrator")
    with pytest.raises(KeyError):
        tightest(chain, "ur3e", "stop", "speed")


@pytest.mark.clause("TOK-11")
def test_a_dropped_grant_names_the_hop_that_dropped_it():
    assert (asked(chain_of_four(), "gripper_move", ()).hop, asked(chain_of_four(), "stop", ()).hop) == (1, 2)
    unknown = asked(chain_of_four(), "fly", ())
    assert (unknown.code, unknown.hop) == (FaultCode.NOT_GRANTED, 0)
    assert asked(chain_of_four(), object="ur5e").code is FaultCode.NOT_GRANTED


@pytest.mark.clause("TOK-11")
def test_the_ceiling_names_the_hop_that_set_it():
    refused = asked(chain_of_four(), base_tier=Tier.HIGH_CONSEQUENCE)
    assert (refused.code, refused.hop, refused.agent) == (FaultCode.ABOVE_CEILING, 2, "vision")


@pytest.mark.clause("TOK-11")
@pytest.mark.parametrize(
    "values",
    [
        (),
        move(5)[:-1],
        (*move(5), Quantity("more", Unit.COUNT, 1)),
        move(5)[::-1],
        (Quantity("q9", Unit.MICRORADIAN, 0), *move(5)[1:]),
        (Quantity("q0", Unit.MICROMETRE, 0), *move(5)[1:]),
        (Quantity("q0", Unit.MICRORADIAN, True), *move(5)[1:]),
        (Quantity("q0", Unit.MICRORADIAN, 0.0), *move(5)[1:]),
        (Quantity("q0", Unit.MICRORADIAN, float("nan")), *move(5)[1:]),
        (Quantity("q0", Unit.MICRORADIAN, "0"), *move(5)[1:]),
        (Quantity("q0", Unit.MICRORADIAN, None), *move(5)[1:]),
    ],
)
def test_the_world_of_parameters_is_closed(values):
    assert asked(chain_of_four(), values=values).code is FaultCode.PARAMETERS_WRONG


@pytest.mark.clause("TOK-11")
def test_a_request_after_the_end_is_refused_whatever_was_verified_before():
    assert asked(chain_of_four(), at=NOW + 2_000) == Fault(FaultCode.EXPIRED, "TOK-11")
    assert asked(chain_of_four(), at=NOW - 61).code is FaultCode.NOT_YET_VALID
    assert asked(chain_of_four(), at=float("nan")).code is FaultCode.NOT_YET_VALID


# --- steps 7 to 9 ----------------------------------------------------------------------------------------------------------


@pytest.mark.clause("TOK-7")
@pytest.mark.parametrize(
    ("at", "code"),
    [
        (NOW - 61, FaultCode.NOT_YET_VALID),
        (NOW - 60 - 1e-6, FaultCode.NOT_YET_VALID),
        (NOW + 3_000, FaultCode.EXPIRED),
        (NOW + 1e9, FaultCode.EXPIRED),
        (float("nan"), FaultCode.NOT_YET_VALID),
        (float("inf"), FaultCode.EXPIRED),
        (float("-inf"), FaultCode.NOT_YET_VALID),
    ],
)
def test_time(at, code):
    fault = check(mint_root(), at=at)
    assert (fault.code, fault.clause) == (code, "TOK-7")


@pytest.mark.clause("TOK-7", "VAL-10")
def test_the_window_is_half_open():
    token = mint_root(replace(SCOPE, not_before=NOW, not_after=NOW + 1))
    assert isinstance(check(token, at=NOW), Chain)
    assert isinstance(check(token, at=NOW + 0.999), Chain)
    assert check(token, at=NOW + 1).code is FaultCode.EXPIRED


@pytest.mark.clause("TOK-7")
def test_evidence_from_the_future_is_refused():
    ahead = replace(grant_to("orchestrator", "alice").attestation, at=NOW + 6)
    fault = check(mint_root(hop=grant_to("orchestrator", "alice", attestation=ahead)))
    assert (fault.code, fault.clause) == (FaultCode.NOT_YET_VALID, "TOK-7")
    fault = check(mint_root(sponsor=replace(SPONSOR, authenticated_at=NOW + 6)))
    assert fault.code is FaultCode.NOT_YET_VALID


@pytest.mark.clause("TOK-8", "VAL-3")
@pytest.mark.parametrize(
    "audience",
    [
        "",
        "http://127.0.0.1:9000/mc",
        CELL + "/",
        CELL.upper(),
        "http://127.0.0.1:9000",
        "http://127.0.0.1:9000/mcp.",
        ISSUER,
    ],
)
def test_an_audience_is_matched_whole(audience):
    fault = check(mint_root(), audience=audience)
    assert (fault.code, fault.clause) == (FaultCode.WRONG_AUDIENCE, "TOK-8")


@pytest.mark.clause("TOK-8")
def test_an_audience_that_a_hop_took_away_is_gone():
    assert isinstance(check(mint_root(), audience=OTHER_CELL), Chain)
    assert check(chain_of_four(), audience=OTHER_CELL).code is FaultCode.WRONG_AUDIENCE


def revoked(kind: Revoked, name: str) -> RevocationView:
    return RevocationView(epoch=4, age_ms=0, revoked=frozenset({(str(kind), name)}))


AGENTS = ["orchestrator", "robotic", "vision", "gripper"]


@pytest.mark.clause("TOK-9")
@pytest.mark.parametrize(
    ("kind", "name"),
    [
        (Revoked.TOKEN, TOKEN_ID),
        (Revoked.SPONSOR, "alice"),
        (Revoked.AUDIENCE, CELL),
        *((Revoked.AGENT, agent) for agent in AGENTS),
        *((Revoked.HOP, grant_to(agent, "x").hop_id) for agent in AGENTS),
        *((Revoked.KEY, keys.thumbprint(raw_of(agent))) for agent in AGENTS),
    ],
)
def test_a_revocation_at_any_hop_kills_the_leaf(kind, name):
    fault = check(chain_of_four(), view=revoked(kind, name))
    assert (fault.code, fault.clause, fault.detail) == (FaultCode.REVOKED, "TOK-9", f"{kind}:{name}")
    stale = replace(revoked(kind, name), age_ms=10**9)
    assert check(chain_of_four(), view=stale).code is FaultCode.REVOKED


@pytest.mark.clause("TOK-9")
@pytest.mark.parametrize(
    ("kind", "name"),
    [(Revoked.AGENT, "alice"), (Revoked.TOKEN, "robotic"), (Revoked.AUDIENCE, OTHER_CELL), (Revoked.HOP, "robotic")],
)
def test_a_revocation_of_something_else_does_not(kind, name):
    assert isinstance(check(chain_of_four(), view=revoked(kind, name)), Chain)


@pytest.mark.clause("TOK-9")
def test_revoking_a_lower_hop_leaves_the_upper_token():
    view = revoked(Revoked.AGENT, "vision")
    assert isinstance(check(add_hop(mint_root(), "robotic", SLOWER), view=view), Chain)


@pytest.mark.clause("TOK-9")
def test_a_view_older_than_the_lease_is_refused():
    assert isinstance(check(mint_root(), view=replace(VIEW, age_ms=LEASE_MS)), Chain)
    for view in (replace(VIEW, age_ms=LEASE_MS + 1), RevocationView.never(), replace(VIEW, age_ms=-1)):
        fault = check(mint_root(), view=view)
        assert (fault.code, fault.clause) == (FaultCode.REVOCATION_VIEW_STALE, "TOK-9")


# --- what is remembered ----------------------------------------------------------------------------------------------------


@pytest.mark.clause("VFY-2")
def test_a_remembered_token_answers_to_every_changed_input():
    checker = verifier()
    token = chain_of_four()
    fresh = {"at": NOW, "audience": CELL, "view": VIEW, "lease_ms": LEASE_MS}
    for _ in range(2):
        assert isinstance(checker.verify(token, **fresh), Chain)
        assert checker.verify(token, **{**fresh, "at": NOW + 2_000}).code is FaultCode.EXPIRED
        assert checker.verify(token, **{**fresh, "audience": OTHER_CELL}).code is FaultCode.WRONG_AUDIENCE
        assert checker.verify(token, **{**fresh, "view": revoked(Revoked.AGENT, "robotic")}).code is FaultCode.REVOKED
        assert checker.verify(token, **{**fresh, "lease_ms": 99}).code is FaultCode.REVOCATION_VIEW_STALE
        assert isinstance(checker.verify(token, **fresh), Chain)


@pytest.mark.clause("VFY-2", "TOK-12")
def test_memory_is_bounded_and_forgetting_fails_closed():
    checker = Verifier(TRUST, DEFAULT, remembered=1)
    first = checker.verify(mint_root(), at=NOW, audience=CELL, view=VIEW, lease_ms=LEASE_MS)
    checker.verify(chain_of_four(), at=NOW, audience=CELL, view=VIEW, lease_ms=LEASE_MS)
    fault = checker.check_request(first, object="ur3e", operation="stop", values=(), base_tier=Tier.NO_EFFECT, at=NOW)
    assert (fault.code, fault.clause) == (FaultCode.LIMIT_EXCEEDED, "TOK-12")


@pytest.mark.clause("VFY-2")
def test_threads_share_one_verifier():
    checker, token, answers = verifier(), chain_of_four(), []

    def ask() -> None:
        for _ in range(20):
            chain = checker.verify(token, at=NOW, audience=CELL, view=VIEW, lease_ms=LEASE_MS)
            answers.append(
                checker.check_request(
                    chain, object="ur3e", operation="move_joint", values=move(5), base_tier=Tier(1), at=NOW
                )
            )

    threads = [threading.Thread(target=ask) for _ in range(4)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    assert answers == [None] * 80


# --- issuing ---------------------------------------------------------------------------------------------------------------


@pytest.mark.clause("VFY-3", "TOK-6.8")
@pytest.mark.parametrize(
    ("restriction", "other", "code"),
    [
        (Restriction(), {}, FaultCode.NOT_NARROWER),
        (Restriction(depth=0, not_after=NOW + 5), {}, FaultCode.NOT_NARROWER),
        (Restriction(grants=(Grant("ur3e", "fly"),)), {}, FaultCode.NOT_NARROWER),
        (replace(SLOWER, ceiling=Tier.SAFETY_CRITICAL), {}, FaultCode.NOT_NARROWER),
        (replace(SLOWER, depth=4), {}, FaultCode.NOT_NARROWER),
        (replace(SLOWER, not_before=NOW + 2_000), {}, FaultCode.NOT_NARROWER),
        (SLOWER, {"delegator": "vision"}, FaultCode.CHAIN_BROKEN),
        (SLOWER, {"key": raw_of("orchestrator")}, FaultCode.CHAIN_BROKEN),
        (SLOWER, {"hop_id": grant_to("orchestrator", "x").hop_id}, FaultCode.CHAIN_BROKEN),
        (SLOWER, {"key": raw_of("attester")}, FaultCode.KEY_WRONG_ROLE),
        (SLOWER, {"key": b"\0" * 32}, FaultCode.KEY_MALFORMED),
        (SLOWER, {"key": b"short"}, FaultCode.KEY_MALFORMED),
        (SLOWER, {"hop_id": "zz"}, FaultCode.TOKEN_MALFORMED),
        (SLOWER, {"hop_id": "AB" * 16}, FaultCode.TOKEN_MALFORMED),
        (SLOWER, {"request_digest": b""}, FaultCode.TOKEN_MALFORMED),
        (SLOWER, {"attester": key_of("stranger")}, FaultCode.KEY_WRONG_ROLE),
        (SLOWER, {"caps": replace(DEFAULT, token_bytes=2_000)}, FaultCode.TOKEN_TOO_LARGE),
        (SLOWER, {"caps": replace(DEFAULT, key_evidence_lifetime_s=100)}, FaultCode.LIFETIME_TOO_LONG),
        (SLOWER, {"caps": replace(DEFAULT, key_evidence_ceiling=2)}, FaultCode.HOP_NOT_ATTESTED),
        (SLOWER, {"caps": replace(DEFAULT, hops=0)}, FaultCode.TOO_MANY_HOPS),
    ],
)
def test_delegate_refuses(restriction, other, code):
    with pytest.raises(CapabilityError) as caught:
        add_hop(mint_root(), "robotic", restriction, **other)
    assert caught.value.code is code


@pytest.mark.clause("VFY-3")
def test_a_refused_widening_is_told():
    with pytest.raises(NotNarrowerError) as caught:
        add_hop(mint_root(), "robotic", replace(SLOWER, ceiling=Tier.SAFETY_CRITICAL, delegates=frozenset({"eve"})))
    assert [widening.dimension for widening in caught.value.widenings] == ["ceiling", "delegates"]


@pytest.mark.clause("VFY-3")
def test_delegate_refuses_the_chain_of_another_token():
    with pytest.raises(TokenError) as caught:
        add_hop(mint_root(), "robotic", SLOWER, chain=chain_of(mint_root(replace(SCOPE, ceiling=Tier.REVERSIBLE))))
    assert caught.value.code is FaultCode.CHAIN_BROKEN


@pytest.mark.clause("TOK-6.6", "VFY-3")
def test_no_agent_twice():
    scope = replace(SCOPE, delegates=frozenset({"orchestrator", "robotic"}))
    with pytest.raises(TokenError) as caught:
        add_hop(mint_root(scope), "orchestrator", Restriction(ceiling=Tier(1)), key=raw_of("new"), hop_id="0" * 32)
    assert caught.value.code is FaultCode.CHAIN_BROKEN


@pytest.mark.clause("TOK-6.7", "VFY-3")
def test_depth_runs_out():
    token = mint_root(replace(SCOPE, depth=1))
    token = add_hop(token, "robotic", SLOWER)
    with pytest.raises(TokenError) as caught:
        add_hop(token, "vision", QUIETER)
    assert caught.value.code is FaultCode.TOO_MANY_HOPS


@pytest.mark.clause("VFY-3")
@pytest.mark.parametrize(
    ("other", "code"),
    [
        ({"scope": replace(SCOPE, not_after=NOW + 86_400)}, FaultCode.LIFETIME_TOO_LONG),
        ({"scope": replace(SCOPE, not_after=NOW + 3_591)}, FaultCode.LIFETIME_TOO_LONG),
        ({"scope": replace(SCOPE, ceiling=Tier.SAFETY_CRITICAL)}, FaultCode.HOP_NOT_ATTESTED),
        ({"scope": replace(SCOPE, not_after=NOW - 60)}, FaultCode.OUT_OF_RANGE),
        ({"scope": replace(SCOPE, grants=())}, FaultCode.STATEMENT_MALFORMED),
        ({"scope": replace(SCOPE, grants=(STOP, MOVE))}, FaultCode.STATEMENT_MALFORMED),
        ({"scope": replace(SCOPE, audiences=frozenset())}, FaultCode.STATEMENT_MALFORMED),
        ({"hop": grant_to("orchestrator", "bob")}, FaultCode.CHAIN_BROKEN),
        ({"hop": grant_to("role:boss", "alice")}, FaultCode.STATEMENT_MALFORMED),
        ({"hop": grant_to("orchestrator", "alice", purpose="x" * 513)}, FaultCode.STATEMENT_MALFORMED),
        ({"token_id": "short"}, FaultCode.TOKEN_MALFORMED),
        ({"token_id": keys.b64u(b"x" * 15)}, FaultCode.TOKEN_MALFORMED),
        ({"caps": replace(DEFAULT, token_bytes=500)}, FaultCode.TOKEN_TOO_LARGE),
    ],
)
def test_mint_refuses(other, code):
    with pytest.raises(CapabilityError) as caught:
        mint_root(**{"scope": SCOPE, **other})
    assert caught.value.code is code


# --- text ------------------------------------------------------------------------------------------------------------------


@pytest.mark.clause("TOK-1", "VAL-6")
def test_a_token_has_one_text():
    token = chain_of_four()
    text = token_to_text(token)
    assert "=" not in text
    assert token_from_text(text, DEFAULT) == token
    assert token_from_text("", DEFAULT) == Fault(FaultCode.TOKEN_MISSING, "TOK-1")
    assert token_from_text("A" * 16_385, DEFAULT).code is FaultCode.TOKEN_TOO_LARGE
    for other in (
        text + "=",
        text + "==",
        text + "\n",
        " " + text,
        text[:-1] + "/",
        text.replace(text[5], "+", 1),
        text + "A" * 3,
        "ä" + text,
        text + ".",
    ):
        found = token_from_text(other, DEFAULT)
        assert isinstance(found, Fault) or isinstance(check(found), Fault)
    assert token_from_text("AB", DEFAULT).code is FaultCode.TOKEN_MALFORMED  # spare bits


@pytest.mark.clause(reason="what we show of a token, no rule of the profile")
def test_inspecting_tells_the_structure_and_never_the_secret():
    token = chain_of_four()
    told = repr(inspect_token(token, TRUST))
    assert "gripper" in told
    secret = token[-32:]
    assert secret.hex() not in told
    assert token_to_text(token) not in told
    assert repr(secret) not in told
    with pytest.raises(TokenError) as caught:
        inspect_token(token[:-1], TRUST)
    assert caught.value.code is FaultCode.TOKEN_MALFORMED
    assert repr(biscuit.open_token(token, raw_of("root"))) == "OpenedToken(...)"


# --- step 12 ---------------------------------------------------------------------------------------------------------------


@pytest.mark.clause("TOK-12")
def test_both_engines_agree_on_every_operation_at_every_hop():
    for token in (mint_root(), add_hop(mint_root(), "robotic", SLOWER), chain_of_four()):
        chain = chain_of(token)
        opened = biscuit.open_token(token, raw_of("root"))
        for grant in chain.scope.grants:
            assert disagreement(opened, chain.scope, grant, DEFAULT) is None


@pytest.mark.clause("TOK-12")
def test_a_datalog_limit_has_its_own_reason():
    token = chain_of_four()
    chain = chain_of(token)
    opened = biscuit.open_token(token, raw_of("root"))
    fault = disagreement(opened, chain.scope, chain.scope.find("ur3e", "move_joint"), replace(DEFAULT, datalog_ms=0))
    assert (fault.code, fault.clause) == (FaultCode.LIMIT_EXCEEDED, "TOK-12")


@pytest.mark.clause("VAL-8", "TOK-12")
def test_a_finite_set_may_have_its_full_size():
    wide = OneOf(frozenset(range(-6_400, 0, 100)))
    scope = replace(SCOPE, grants=(Grant("ur3e", "gripper_move", (Limit(WIDTH, Range(0, 5)), Limit(FORCE, wide))),))
    values = (Quantity("width", Unit.MICROMETRE, 5), Quantity("force", Unit.MILLINEWTON, -6_400))
    assert asked(mint_root(scope), "gripper_move", values) is None
    assert LAST.audiences == {CELL}


# --- P-256 -----------------------------------------------------------------------------------------------------------------


@pytest.mark.clause("BLK-4", "VAL-5")
def test_every_holder_may_have_a_p256_key():
    first, second = (keys.public_raw(keys.generate(keys.Algorithm.P256)) for _ in range(2))
    token = mint_root(hop=grant_to("orchestrator", "alice", key=first))
    further = chain_of(add_hop(token, "robotic", SLOWER, key=second))
    assert [hop.key for hop in further.hops] == [first, second]
    assert len(first) == keys.P256_BYTES
    for odd in (b"\5" + first[1:], b"\2" + b"\xff" * 32, first + b"\0"):
        assert check(Forge.authority(key=odd)).code is FaultCode.CHAIN_BROKEN


@pytest.mark.clause("BLK-1", "TRB-1")
@pytest.mark.parametrize("role", ["roots", "attesters"])
def test_roots_and_attesters_are_ed25519(role):
    other = keys.public_raw(keys.generate(keys.Algorithm.P256))
    with pytest.raises(CapabilityError) as caught:
        replace(TRUST, windows={}, **{role: {9: other} if role == "roots" else frozenset({other})})
    assert caught.value.code is FaultCode.KEY_MALFORMED


@pytest.mark.clause("TRB-2", "TRB-3", "VFY-2")
def test_a_key_counts_only_while_the_bundle_says_so():
    """An earlier result about a token is no answer: the same verifier asks for each key anew."""
    token = add_hop(mint_root(), "robotic", SLOWER)
    windows = {raw_of("attester"): Window(not_after=NOW + 10), raw_of("root"): Window(not_after=NOW + 20)}
    checker = Verifier(replace(TRUST, windows=windows), DEFAULT)
    for at, code in (
        (NOW + 9, None),
        (NOW + 10, FaultCode.HOP_NOT_ATTESTED),
        (NOW + 20, FaultCode.UNKNOWN_ROOT_KEY),
    ):
        found = checker.verify(token, at=at, audience=CELL, view=VIEW, lease_ms=LEASE_MS)
        assert (found.code if isinstance(found, Fault) else None) is code
    tainted = replace(TRUST, windows={raw_of("attester"): Window(tainted_at=NOW - 10)})
    assert check(token, trust=tainted).code is FaultCode.HOP_NOT_ATTESTED
    assert isinstance(
        check(token, trust=replace(TRUST, windows={raw_of("attester"): Window(tainted_at=NOW - 9)})), Chain
    )


@pytest.mark.clause("VFY-2")
def test_a_chain_is_asked_about_again_without_its_token():
    checker = verifier()
    ask = {"audience": CELL, "lease_ms": LEASE_MS}
    chain = checker.verify(chain_of_four(), at=NOW, view=VIEW, **ask)
    assert isinstance(chain, Chain)
    later = checker.still(chain, at=NOW + 1, view=replace(VIEW, epoch=4, age_ms=7), **ask)
    assert isinstance(later, Chain)
    assert (later.epoch, later.view_age_ms, later.hops) == (4, 7, chain.hops)
    assert isinstance(checker.still(later, at=NOW + 1, view=replace(VIEW, epoch=4), **ask), Chain)
    revoked = replace(VIEW, epoch=5, revoked=frozenset({("hop", chain.hops[1].hop_id)}))
    for other, code in (
        ({"at": NOW + 2_000}, FaultCode.EXPIRED),
        ({"audience": OTHER_CELL}, FaultCode.WRONG_AUDIENCE),
        ({"view": revoked}, FaultCode.REVOKED),
        ({"view": replace(VIEW, age_ms=LEASE_MS + 1)}, FaultCode.REVOCATION_VIEW_STALE),
    ):
        fault = checker.still(chain, **{"at": NOW, "view": VIEW, **ask, **other})
        assert fault.code is code
    assert verifier().still(chain, at=NOW, view=VIEW, **ask).code is FaultCode.LIMIT_EXCEEDED
    assert (
        Verifier(replace(TRUST, version=2), DEFAULT).still(chain, at=NOW, view=VIEW, **ask).code
        is FaultCode.LIMIT_EXCEEDED
    )
