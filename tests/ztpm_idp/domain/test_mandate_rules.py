"""Rules of mandates, one by one, in the pure domain."""

from __future__ import annotations

from dataclasses import replace

import pytest
from capabilities.statements.people import mandate
from capabilities.values.algebra import narrows
from capabilities.values.scope import Grant, Scope, Tier
from hypothesis import example, given, settings
from hypothesis import strategies as st
from msgspec import structs
from policies.conduct.behaviour import BehaviourState
from policies.conduct.history import AgentHistory
from tests.ztpm_idp.domain.test_domain import (
    ADMIN,
    AGENT_KEY,
    CELL,
    DIGEST,
    RULES,
    agent,
    code,
    evidence,
    person,
    state,
)
from ztpm_idp.domain.agent_conduct import AgentConduct, Held
from ztpm_idp.domain.core import decide
from ztpm_idp.domain.entries import entry_of
from ztpm_idp.domain.events import MandateSigned, NonceConsumed, RevocationKind, Revoked, SignedRequest, TokenIssued
from ztpm_idp.domain.lending.mandates import MANDATES_OF_ONE
from ztpm_idp.domain.parties import PersonRole, RegisteredPerson, Standing
from ztpm_idp.domain.state import Drawn, Nonce

from capabilities.keys import keys
from ztpm_idp.domain import commands as c
from ztpm_idp.domain.lending import mandates

pytestmark = pytest.mark.clause("STM-16")

AT = 1_800_000_000
HOUR, DAY, WEEK = 3_600, 86_400, 604_800
AUDIENCE = "http://127.0.0.1/mcp"
OTHER = "http://127.0.0.1:9/mcp"
SIGNED = SignedRequest("POST", "http://127.0.0.1:8700/ztpm/mandates", "{}", "proof")
BOB_KEY = keys.generate()
BOB = RegisteredPerson(
    "bob", keys.public_raw(BOB_KEY), keys.thumbprint(keys.public_raw(BOB_KEY)), Standing.ACTIVE, "Bob",
    frozenset({PersonRole.SPONSOR}),
)  # fmt: skip
MOVER = agent(standing=Standing.ACTIVE)
SCOPE = Scope(
    (Grant("plant", "read"), Grant("plant", "write")), Tier(3), frozenset({AUDIENCE, OTHER}), frozenset({"helper"}), 1,
    AT - 5, AT + WEEK,
)  # fmt: skip
PROMISED = mandate.Mandate("0a" * 16, RULES.issuer, "bob", "mover", MOVER.thumbprint, "tidy", SCOPE, AT)
NONCE = Nonce("n" * 32, "mover", 0, consumed=False)


def text_of(key=BOB_KEY, **changes):
    return mandate.sign(structs.replace(PROMISED, **changes), key)


def sign(found=None, at=AT, by="bob", key=BOB_KEY, **changes):
    found = state(ADMIN, BOB, MOVER) if found is None else found
    return decide(RULES, found, c.SignMandate(by, text_of(key, **changes), SIGNED), at * 1_000)


def record(**changes):
    (event,) = sign(at=changes.get("at", AT), **changes)
    return event.mandate


def drawable(at, *, promised=None, parties=(BOB, MOVER), **more):
    given = {"n" * 32: replace(NONCE, given_ms=at * 1_000)}
    return state(*parties, nonces=given, mandate=promised or record(), **more)


def draw(found, at, *, by="mover", lifetime_s=HOUR, rules=RULES, **changes):
    about = dict(delegator="bob", request_digest=DIGEST, at=at) | changes
    command = c.DrawToken(by, "0a" * 16, lifetime_s, DIGEST, evidence(**about), "A" * 22, "0b" * 16, SIGNED)
    return decide(rules, found, command, at * 1_000)


def drawn(found, at, **more):
    spent, made = draw(found, at, **more)
    assert (spent, type(made)) == (NonceConsumed("n" * 32, "0b" * 16), TokenIssued)
    return made


def contracted():
    """Conduct of an agent that holds the minimum safe set."""
    return Held(agents={"mover": AgentConduct(behaviour=BehaviourState({"mover": AgentHistory(contracted=True)}))})


# --- signing ---------------------------------------------------------------------------------------------------------------


def test_a_sponsor_signs_and_the_ledger_has_the_text():
    (event,) = sign()
    assert isinstance(event, MandateSigned)
    assert (event.mandate.sponsor, event.mandate.agent, event.mandate.key) == ("bob", "mover", BOB.thumbprint)
    kind, body = entry_of(event)
    assert (kind, mandate.open(body["mandate"], BOB.keys, RULES.caps)) == ("mandate-signed", PROMISED)


@pytest.mark.parametrize(
    ("changes", "expected"),
    [
        ({"by": "alice"}, "NOT_PERMITTED"),
        ({"by": "mover"}, "NOT_PERMITTED"),
        ({"key": AGENT_KEY}, "STATEMENT_UNTRUSTED"),
        ({"sponsor": "alice"}, "MANDATE_NOT_YOURS"),
        ({"issuer": "http://127.0.0.1:1/ztpm"}, "STATEMENT_UNTRUSTED"),
        ({"agent": "nobody"}, "NOT_FOUND"),
        ({"agent_key": "A" * 43}, "MANDATE_NOT_YOURS"),
        ({"at": AT - 31, "scope": replace(SCOPE, not_after=AT + 60)}, "MANDATE_OUT_OF_TIME"),
        ({"at": AT + 6}, "MANDATE_OUT_OF_TIME"),
        ({"at": AT - 30, "scope": replace(SCOPE, not_after=AT)}, "MANDATE_OVER"),
    ],
)
def test_a_mandate_that_is_not_taken(changes, expected):
    at = changes.pop("at", None)
    stated = changes if at is None else changes | {"at": at}
    promised = {name: value for name, value in stated.items() if name not in {"by", "key"}}
    command = c.SignMandate(changes.get("by", "bob"), text_of(changes.get("key", BOB_KEY), **promised), SIGNED)
    assert code(decide(RULES, state(ADMIN, BOB, MOVER), command, AT * 1_000)) == expected


@pytest.mark.parametrize(
    ("standing", "expected"),
    [
        (Standing.REGISTERED, "HOP_NOT_ATTESTED"),
        (Standing.SUSPENDED, "AGENT_SUSPENDED"),
        (Standing.REVOKED, "AGENT_INACTIVE"),
    ],
)
def test_nothing_is_promised_to_an_agent_that_may_receive_nothing(standing, expected):
    assert code(sign(state(BOB, replace(MOVER, standing=standing)))) == expected


def test_nothing_is_promised_to_a_contracted_agent():
    assert code(sign(state(BOB, MOVER, held=contracted()))) == "SCOPE_CONTRACTED"


def test_one_id_is_one_text():
    known = state(BOB, MOVER, mandate=record())
    assert sign(known) == ()
    assert code(sign(known, purpose="more")) == "MANDATE_DIFFERS"


def test_an_agent_has_few_mandates():
    many = tuple(replace(record(), mandate_id=f"{n:032x}") for n in range(MANDATES_OF_ONE))
    assert code(sign(state(BOB, MOVER, mandates=many))) == "TOO_MANY_MANDATES"
    others = tuple(replace(each, agent="helper") for each in many)
    for few in (many[1:], others, (*many[1:], replace(many[0], not_after=AT))):
        assert isinstance(sign(state(BOB, MOVER, mandates=few))[0], MandateSigned)


# --- drawing ---------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("later", [0, HOUR, DAY])
def test_a_drawn_token_is_the_sponsors_of_the_time_of_the_signature(later):
    made = drawn(drawable(AT + later), AT + later)
    assert (made.mandate_id, made.sponsor.subject, made.sponsor.authenticated_at) == ("0a" * 16, "bob", AT)
    assert (made.hop.delegator, made.hop.purpose, made.hop.attestation.at) == ("bob", "tidy", AT + later)
    assert (made.scope.not_before, made.scope.not_after) == (AT + later - 5, AT + later + HOUR)
    kind, body = entry_of(made)
    assert (kind, body["mandate_id"], body["sponsor"]) == ("token-drawn", "0a" * 16, "bob")


@given(
    later=st.integers(0, DAY),
    lasts=st.integers(1, WEEK),
    lifetime_s=st.integers(1, HOUR),
    ceiling=st.sampled_from(Tier),
    dead=st.booleans(),
)
@example(later=0, lasts=HOUR, lifetime_s=60, ceiling=Tier.SAFETY_CRITICAL, dead=True)
@settings(max_examples=30)
def test_it_never_has_more_than_the_mandate_and_ends_with_it(later, lasts, lifetime_s, ceiling, dead):
    scope = replace(SCOPE, not_after=AT + lasts, ceiling=ceiling)
    revoked = frozenset({("audience", OTHER)} if dead else ())
    found = drawable(AT + later, promised=record(scope=scope), revoked=revoked)
    if later >= lasts:
        assert code(draw(found, AT + later)) == "MANDATE_OVER"
        return
    made = drawn(found, AT + later, lifetime_s=lifetime_s)
    assert narrows(made.scope, scope).widenings == ()
    assert made.scope.not_after == AT + min(lasts, later + lifetime_s)
    assert made.scope.ceiling <= Tier(3)
    assert (OTHER in made.scope.audiences) is not dead


def test_the_deployments_lifetime_bounds_a_draw():
    made = drawn(drawable(AT), AT, rules=replace(RULES, token_lifetime_s=600))
    assert made.scope.not_after == AT + 600


def test_evidence_of_kind_key_draws_for_a_day():
    drawn(drawable(AT + DAY), AT + DAY)
    assert code(draw(drawable(AT + DAY + 1), AT + DAY + 1)) == "MANDATE_NEEDS_PLATFORM"


def live(*ends, **changes):
    return tuple(replace(Drawn("T" * 22, "0c" * 16, 0, end, revoked=False), **changes) for end in ends)


def test_two_are_live_at_once():
    assert code(draw(drawable(AT, drawn=live(AT + 1, AT + 9)), AT)) == "MANDATE_TOKENS_LIVE"
    for room in (live(AT + 1), live(AT, AT + 1), (*live(AT + 1), *live(AT + 1, revoked=True))):
        drawn(drawable(AT, drawn=room), AT)


@pytest.mark.parametrize(
    ("found", "expected"),
    [
        (lambda: drawable(AT, parties=(BOB, MOVER)).__class__(parties={"mover": MOVER, "bob": BOB}), "MANDATE_UNKNOWN"),
        (lambda: drawable(AT, promised=replace(record(), agent="helper")), "MANDATE_NOT_YOURS"),
        (lambda: drawable(AT, promised=replace(record(), revoked=True)), "MANDATE_REVOKED"),
        (lambda: drawable(AT, revoked=frozenset({("mandate", "0a" * 16)})), "MANDATE_REVOKED"),
        (lambda: drawable(AT, parties=(replace(BOB, standing=Standing.REVOKED), MOVER)), "SPONSOR_INACTIVE"),
        (lambda: drawable(AT, parties=(replace(BOB, roles=frozenset({PersonRole.ADMIN})), MOVER)), "SPONSOR_INACTIVE"),
        (
            lambda: drawable(AT, parties=(replace(BOB, further=frozenset({bytes(32)}), first_ended=True), MOVER)),
            "STATEMENT_UNTRUSTED",
        ),
        (lambda: drawable(AT, parties=(BOB, replace(MOVER, held=True))), "AGENT_HELD"),
        (lambda: drawable(AT, parties=(BOB, replace(MOVER, standing=Standing.SUSPENDED))), "AGENT_SUSPENDED"),
        (lambda: drawable(AT, parties=(BOB, replace(MOVER, standing=Standing.REVOKED))), "CALLER_INACTIVE"),
        (lambda: drawable(AT, held=contracted()), "SCOPE_CONTRACTED"),
        (lambda: drawable(AT, promised=record(scope=replace(SCOPE, not_before=AT + 1))), "NOT_YET_VALID"),
        (
            lambda: drawable(AT, revoked=frozenset({("audience", AUDIENCE), ("audience", OTHER)})),
            "MANDATE_LEAVES_NOTHING",
        ),
        (lambda: replace(drawable(AT), nonces={}), "ATTESTATION_INVALID"),
    ],
)
def test_a_draw_that_is_refused(found, expected):
    assert code(draw(found(), AT)) == expected


def test_a_key_that_is_not_the_promised_one_draws_nothing():
    other = keys.generate()
    found = drawable(AT, parties=(BOB, agent(standing=Standing.ACTIVE, key=other)))
    assert code(draw(found, AT)) == "MANDATE_NOT_YOURS"


@pytest.mark.parametrize("changes", [{"delegator": "alice"}, {"request_digest": bytes(32)}, {"measurement": bytes(32)}])
def test_evidence_for_something_else_draws_nothing(changes):
    about = {"request_digest": DIGEST} | changes
    command = c.DrawToken(
        "mover",
        "0a" * 16,
        HOUR,
        DIGEST,
        evidence(**({"delegator": "bob", "at": AT} | about)),
        "A" * 22,
        "0b" * 16,
        SIGNED,
    )
    assert code(decide(RULES, drawable(AT), command, AT * 1_000)) == "ATTESTATION_INVALID"


def test_people_and_points_draw_nothing():
    for by in ("bob", "cell-1"):
        assert code(draw(drawable(AT, parties=(BOB, MOVER, CELL)), AT, by=by)) in {"NOT_PERMITTED"}


# --- its end ---------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("by", "good"),
    [("bob", True), ("alice", True), ("mover", True), ("eve", False), ("helper", False), ("cell-1", False)],
)
def test_a_mandate_is_its_sponsors_its_agents_and_the_administrators(by, good):
    everybody = (ADMIN, BOB, MOVER, CELL, person("eve", "sponsor", "approver"))
    helper = agent("helper", standing=Standing.ACTIVE, key=keys.generate())
    found = state(*everybody, helper, mandate=record())
    outcome = decide(RULES, found, c.Revoke(by, RevocationKind.MANDATE, "0a" * 16, "r"), AT * 1_000)
    if good:
        assert outcome == (Revoked(RevocationKind.MANDATE, "0a" * 16, "r", None),)
    else:
        assert code(outcome) == "NOT_PERMITTED"


def test_a_persons_key_takes_the_mandates_along_that_it_signed():
    second = keys.generate()
    bob = replace(BOB, further=frozenset({keys.public_raw(second)}))
    mine, other = record(), replace(record(), mandate_id="0d" * 16, key="k" * 43)
    found = state(ADMIN, bob, MOVER, mandates=(mine, other), owner_of_thumbprint="bob")
    outcome = decide(RULES, found, c.Revoke("bob", RevocationKind.KEY, BOB.thumbprint, "lost"), AT * 1_000)
    assert outcome == (
        Revoked(RevocationKind.KEY, BOB.thumbprint, "lost", None),
        Revoked(RevocationKind.MANDATE, "0a" * 16, "lost", None),
    )


@pytest.mark.parametrize(
    ("mandate_", "found", "expected"),
    [
        (lambda: record(), (BOB, MOVER), "in force"),
        (lambda: replace(record(), revoked=True), (BOB, MOVER), "revoked"),
        (lambda: replace(record(), not_after=AT), (BOB, MOVER), "over"),
        (lambda: record(), (replace(BOB, standing=Standing.REVOKED), MOVER), "ended"),
        (lambda: replace(record(), key="k" * 43), (BOB, MOVER), "ended"),
        (lambda: record(), (BOB, replace(MOVER, standing=Standing.REVOKED)), "ended"),
        (lambda: record(), (BOB, replace(MOVER, standing=Standing.SUSPENDED)), "suspended"),
        (lambda: record(), (BOB, replace(MOVER, held=True)), "suspended"),
    ],
)
def test_people_are_told_how_it_stands(mandate_, found, expected):
    assert mandates.standing(state(*found), mandate_(), AT * 1_000) == expected


def test_every_restored_line_knows_mandates():
    lost = (c.Lost(RevocationKind.MANDATE, "0a" * 16, "r"),)
    (event,) = decide(RULES, state(BOB, restoring=True), c.TakeBack(lost), AT * 1_000)
    assert (event.kind, event.id, event.party) == (RevocationKind.MANDATE, "0a" * 16, None)
