"""Votes by passkey where they are counted: by the enforcement point itself, with the keys of its registry snapshot."""

from __future__ import annotations

from dataclasses import dataclass, field

import pytest
from capabilities.values.caps import DEFAULT
from capabilities.values.errors import FaultCode
from msgspec import structs
from pep.people.votes import Count, RejectedStatement, VoteFault, read_vote, registered, tally
from tests.authenticators import PRESENT, Authenticator
from tests.capabilities.statements.people.test_passkey_votes import ASK, PARTY, VOTE

from capabilities.keys import keys
from capabilities.statements.people import ask as asks
from capabilities.statements.people import vote as votes

pytestmark = pytest.mark.clause("PSK-6")


@dataclass
class Registry:
    """Approvers as a snapshot names them: carol with a key and two passkeys, bob with a passkey."""

    keys: dict = field(default_factory=dict)
    held: dict = field(default_factory=dict)

    def approvers(self):
        return self.keys

    def passkeys(self):
        return self.held


@pytest.fixture
def cell():
    made = type("Cell", (), {})()
    made.pep, made.operator = keys.generate(), keys.generate()
    made.phone, made.laptop, made.bobs = (Authenticator(PARTY) for _ in range(3))
    made.people = Registry(
        {keys.public_raw(made.operator): "carol"},
        {made.phone.key: "carol", made.laptop.key: "carol", made.bobs.key: "bob"},
    )
    made.text = asks.sign(ASK, made.pep)
    made.vote = structs.replace(VOTE, ask_digest=votes.digest_of(made.text))
    return made


def read(cell, text, *, ask=ASK, at=1_020.0):
    return read_vote(text, ask, cell.text, cell.people, at=at, caps=DEFAULT)


def count(cell, *ballots, approvers=1):
    return tally(ballots, structs.replace(ASK, approvers=approvers), registered(cell.people))


def test_all_passkeys_and_keys_of_a_person_are_one_voter(cell):
    ballots = [
        read(cell, cell.phone.vote(cell.vote, ASK)),
        read(cell, cell.laptop.vote(structs.replace(cell.vote, at=1_011), ASK)),
        read(cell, votes.sign(structs.replace(cell.vote, at=1_012), cell.operator)),
    ]
    counted = count(cell, *ballots, approvers=2)
    assert (counted.count, counted.approvers) == (Count.OPEN, ("carol",))
    bob = read(cell, cell.bobs.vote(structs.replace(cell.vote, approver="bob"), ASK))
    counted = count(cell, *ballots, bob, approvers=2)
    assert (counted.count, counted.approvers, counted.uses) == (Count.GRANTED, ("bob", "carol"), 1)
    assert count(cell, ballots[0], ballots[0]).uses == 1


def test_a_passkey_that_left_the_registry_counts_no_longer(cell):
    ballot = read(cell, cell.phone.vote(cell.vote, ASK))
    assert count(cell, ballot).count is Count.GRANTED
    del cell.people.held[cell.phone.key]
    assert count(cell, ballot).count is Count.OPEN
    assert read(cell, cell.phone.vote(cell.vote, ASK)) == RejectedStatement(FaultCode.STATEMENT_UNTRUSTED)


def test_defective_votes_by_passkey_are_rejected_with_their_reason(cell):
    def rejected(code, text, **changes):
        assert read(cell, text, **changes) == RejectedStatement(code)

    other = structs.replace(cell.vote, approver="bob")
    rejected(VoteFault.VOTE_NOT_YOURS, cell.phone.vote(other, ASK))
    rejected(FaultCode.STATEMENT_UNTRUSTED, cell.phone.vote(cell.vote, structs.replace(ASK, index_milli=1)))
    rejected(FaultCode.STATEMENT_UNTRUSTED, cell.phone.vote(cell.vote, ASK, flags=PRESENT))
    rejected(VoteFault.VOTE_NOT_FOR_THIS_ASK, cell.phone.vote(structs.replace(cell.vote, nonce="0" * 32), ASK))
    rejected(VoteFault.VOTE_OUT_OF_TIME, cell.phone.vote(structs.replace(cell.vote, at=1_026), ASK))
    rejected(VoteFault.VOTE_OUT_OF_TIME, cell.phone.vote(structs.replace(cell.vote, at=1_010, not_after=9_000), ASK))
    # the issuer of the ask pins the relying party, and an address has none
    for issuer in ("https://evil.example/ztpm", "http://127.0.0.1:8700/ztpm"):
        elsewhere = structs.replace(ASK, issuer=issuer)
        rejected(FaultCode.STATEMENT_UNTRUSTED, cell.phone.vote(cell.vote, elsewhere), ask=elsewhere)
    # a passkey opens no statement, and an operator key makes no assertion
    rejected(FaultCode.STATEMENT_UNTRUSTED, votes.sign(cell.vote, cell.phone.private))
    operator = Authenticator(PARTY, cell.operator)
    rejected(FaultCode.STATEMENT_UNTRUSTED, operator.vote(cell.vote, ASK))
    # nor does the agent's own key, registered as a passkey by a provider gone wrong
    agent = structs.replace(ASK, agent_key=keys.thumbprint(cell.phone.key))
    rejected(VoteFault.NOT_PERMITTED, cell.phone.vote(cell.vote, agent), ask=agent)
