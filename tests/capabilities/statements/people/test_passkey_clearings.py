"""Clearings by passkey: over one latch, every word of it, by one key, and never a vote."""

from __future__ import annotations

import pytest
from capabilities.statements.people.assertion import RelyingParty, Word, challenge
from capabilities.statements.people.clearing import Clearing
from capabilities.statements.people.latch import Latch, LatchCause
from capabilities.values.errors import FaultCode, StatementError
from capabilities.values.scope import Tier
from msgspec import structs
from tests.authenticators import Authenticator

from capabilities.keys import keys
from capabilities.statements.people import passkey_clearing, passkey_vote

pytestmark = pytest.mark.clause("PSK-7")
PARTY = RelyingParty("idp.example", "https://idp.example:8443")
LATCH = Latch(
    latch_id="1a" * 16,
    issuer=f"{PARTY.origin}/ztpm",
    pep="cell-1",
    audience="http://127.0.0.1:8800/mcp",
    robot="ur3e",
    cause=LatchCause.WATCH,
    reason="PERCEPTION_MISSING",
    tier=Tier.HIGH_CONSEQUENCE,
    approvers=1,
    request_id="",
    at=1_000,
    no_retreat="PERCEPTION_MISSING",
)
CLEARING = Clearing("1a" * 16, "2" * 64, LATCH.audience, "ur3e", LatchCause.WATCH, "carol", 1_100, 1_010)


def made(held: Authenticator, *, latch: Latch = LATCH, clearing: Clearing = CLEARING) -> str:
    assertion = held.assertion(passkey_clearing.challenge_of(clearing, latch))
    return passkey_clearing.compose(clearing, assertion, key=held.key)


def refused(text: str, held: Authenticator, *, latch: Latch = LATCH) -> FaultCode:
    with pytest.raises(StatementError) as raised:
        passkey_clearing.open(text, [held.key], latch=latch, party=PARTY)
    return raised.value.code


@pytest.mark.parametrize("algorithm", list(keys.Algorithm))
def test_a_clearing_comes_back_with_its_key(algorithm):
    held = Authenticator(PARTY, keys.generate(algorithm))
    opened = passkey_clearing.open(made(held), [held.key], latch=LATCH, party=PARTY)
    assert opened == (CLEARING, held.key)


def test_every_word_of_the_latch_is_bound():
    held = Authenticator(PARTY, keys.generate())
    for change in (
        {"latch_id": "1b" * 16},
        {"robot": "ur5e"},
        {"cause": LatchCause.SAFETY_STOP},
        {"tier": Tier.CONSEQUENTIAL},
        {"approvers": 2},
        {"at": 1_001},
    ):
        other = structs.replace(LATCH, **change)
        assert refused(made(held), held, latch=other) is FaultCode.STATEMENT_UNTRUSTED


def test_another_passkey_another_act_and_another_kind_are_refused():
    held, other = Authenticator(PARTY, keys.generate()), Authenticator(PARTY, keys.generate())
    assert refused(made(held), other) is FaultCode.STATEMENT_UNTRUSTED
    voted = held.assertion(challenge(Word.VOTE, {"a": 1}))
    assert refused(passkey_clearing.compose(CLEARING, voted, key=held.key), held) is FaultCode.STATEMENT_UNTRUSTED
    with pytest.raises(StatementError) as raised:
        passkey_vote.open(made(held), [held.key], ask=None, party=PARTY)
    assert raised.value.code is FaultCode.STATEMENT_WRONG_KIND


def test_a_clearing_that_lasts_too_long_is_none():
    held = Authenticator(PARTY, keys.generate())
    long = structs.replace(CLEARING, not_after=CLEARING.at + 601)
    assert refused(made(held, clearing=long), held) is FaultCode.STATEMENT_MALFORMED
