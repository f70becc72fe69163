"""Decisions of a restore: what is taken back, who ends by it, what is awaited, and what is refused meanwhile."""

from __future__ import annotations

from dataclasses import replace

import pytest
from capabilities.values.caps import DEFAULT
from tests.ztpm_idp.domain.test_domain import ADMIN, AT_MS, CELL, RULES, agent, code, person, state
from ztpm_idp.domain.commands import Lost
from ztpm_idp.domain.core import decide
from ztpm_idp.domain.events import (
    AgentsHeld,
    AgentSuspended,
    AgentVouched,
    LineBegun,
    PointHeard,
    RevocationKind,
    Revoked,
    SignedRequest,
    StoreRestored,
    StoreResumed,
)
from ztpm_idp.domain.wanted import wanted
from ztpm_idp.domain.parties import Standing
from ztpm_idp.domain.restoring import LINES_AHEAD
from ztpm_idp.domain.state import Wanted
from ztpm_idp.domain.upkeep.acts import PartSuspended

from capabilities.keys import keys
from capabilities.statements import mark
from ztpm_idp.domain import commands as c

KEY = keys.generate()
POINT = replace(CELL, key=keys.public_raw(KEY), heard=False)
AGENT, SPONSOR, OF_KEY = RevocationKind.AGENT, RevocationKind.SPONSOR, RevocationKind.KEY
SIGNED = SignedRequest("POST", "u", "{}", "p")


def mark_of(*entries, line=0, epoch=0, remaining=0, issuer=RULES.issuer, key=KEY):
    told = tuple(mark.MarkEntry(kind, id_) for kind, id_ in sorted(entries))
    return mark.sign(mark.Mark(issuer, line, epoch, "", told, remaining, AT_MS // 1_000), key)


def took(found, *entries, by="cell-1", **more):
    return decide(RULES, found, c.TakeMark(by, mark_of(*entries, **more)), AT_MS)


def restoring(*parties, **more):
    points = tuple(party for party in parties if isinstance(party, type(CELL)))
    return state(*parties, **({"restoring": True, "line": 1, "points": points} | more))


def test_a_restore_begins_a_line_above_every_known_one_and_holds_agents_that_were_named_later():
    dead = agent("dead", standing=Standing.REVOKED)
    found = state(ADMIN, agent("mover"), dead, CELL, line=2, epoch=7, points=(CELL,))
    command = c.RestoreStore(4, frozenset({"mover", "dead", "alice", "nobody"}), frozenset(), ("a ledger",))
    assert decide(RULES, found, command, AT_MS) == (
        StoreRestored(5, 7, ("cell-1",), ("a ledger",)),
        AgentsHeld(("mover",)),
    )
    first, *_ = decide(RULES, found, replace(command, line=0), AT_MS)
    assert first.line == 3


def test_what_was_suspended_after_the_copy_is_suspended_again_once():
    dead, already = agent("dead", standing=Standing.REVOKED), agent("already", standing=Standing.SUSPENDED)
    found = state(ADMIN, agent("mover"), dead, already, points=())
    lost = frozenset({"mover", "dead", "already", "alice", "nobody"})
    _, *events = decide(RULES, found, c.RestoreStore(0, lost, lost, ()), AT_MS)
    assert events[0] == AgentsHeld(("already", "mover"))
    assert [(type(event), event.agent) for event in events[1:]] == [(AgentSuspended, "mover")]


def test_a_point_that_was_suspended_after_the_copy_is_suspended_again():
    command = c.RestoreStore(0, frozenset(), frozenset({"cell-1"}), ())
    _, again = decide(RULES, state(ADMIN, CELL, points=(CELL,)), command, AT_MS)
    assert (type(again), again.id, again.audiences) == (PartSuspended, "cell-1", CELL.audiences)
    known = state(ADMIN, replace(CELL, standing=Standing.SUSPENDED), points=(CELL,))
    assert len(decide(RULES, known, command, AT_MS)) == 1


def test_what_the_store_lacks_is_taken_back_once_with_the_parties_that_end_by_it():
    bob, mover, key = person("bob", "sponsor"), agent("mover"), person("carol", "approver")
    found = state(
        bob,
        mover,
        key,
        owners={mover.thumbprint: "mover", key.thumbprint: "carol"},
        revoked=frozenset({("hop", "a" * 32)}),
    )
    lost = [
        Lost(RevocationKind.HOP, "a" * 32, "known"),
        Lost(AGENT, "mover", "odd"),
        Lost(AGENT, "mover", "odd"),
        Lost(AGENT, "bob", "a slip"),
        Lost(SPONSOR, "bob", "left"),
        Lost(OF_KEY, key.thumbprint, "lost"),
        Lost(OF_KEY, mover.thumbprint, "stolen"),
        Lost(OF_KEY, "A" * 43, "unknown"),
        Lost(AGENT, "registered-later", "x" * 512),
    ]
    events = decide(RULES, found, c.TakeBack(tuple(lost)), AT_MS)
    assert all(isinstance(event, Revoked) and len(event.reason) <= 512 for event in events)
    assert [(event.kind, event.id, event.party) for event in events] == [
        (AGENT, "mover", "mover"),
        (AGENT, "bob", None),
        (SPONSOR, "bob", "bob"),
        (OF_KEY, key.thumbprint, "carol"),
        (OF_KEY, mover.thumbprint, "mover"),
        (OF_KEY, "A" * 43, None),
        (AGENT, "registered-later", None),
    ]


def test_one_of_several_keys_ends_alone_and_the_last_one_with_its_person():
    second = keys.public_raw(keys.generate())
    carol = replace(person("carol", "approver"), further=frozenset({second}))
    prints = carol.thumbprint, keys.thumbprint(second)
    found = state(carol, owners=dict.fromkeys(prints, "carol"))
    both = tuple(Lost(OF_KEY, print_, "lost") for print_ in prints)
    assert [event.party for event in decide(RULES, found, c.TakeBack(both[:1]), AT_MS)] == [None]
    assert [event.party for event in decide(RULES, found, c.TakeBack(both), AT_MS)] == ["carol", "carol"]


@pytest.mark.clause("STM-15")
def test_a_mark_takes_back_what_its_point_knows_and_the_point_is_heard_with_its_last_part():
    found = restoring(POINT, agent("mover"))
    revoked, heard = took(found, ("agent", "mover"), line=0, epoch=9)
    assert (revoked.kind, revoked.id, revoked.party) == (AGENT, "mover", "mover")
    assert (heard.pep, heard.line, heard.epoch) == ("cell-1", 0, 9)
    part = took(found, ("agent", "mover"), remaining=1)
    assert [type(event) for event in part] == [Revoked]
    assert [type(event) for event in took(found)] == [PointHeard]


@pytest.mark.clause("STM-15")
def test_a_point_that_was_heard_revokes_nothing_at_any_time():
    heard = replace(POINT, heard=True)
    assert took(restoring(heard, agent("mover")), ("agent", "mover")) == ()
    assert took(state(heard, agent("mover")), ("agent", "mover")) == ()
    late = took(state(POINT, agent("mover"), line=1), ("agent", "mover"))
    assert [type(event) for event in late] == [Revoked, PointHeard], "one that comes after the end is heard once"


@pytest.mark.clause("STM-15")
def test_a_line_that_a_point_has_followed_is_never_begun_again():
    found = restoring(POINT)
    assert [type(event) for event in took(found, line=0)] == [PointHeard]
    for line in (1, 5):
        begun, _ = took(found, line=line)
        assert begun == LineBegun(line + 1)
    assert code(took(found, line=2 + LINES_AHEAD)) == "STATEMENT_MALFORMED"


@pytest.mark.clause("STM-15")
def test_only_the_points_own_word_on_this_feed_counts():
    found = restoring(POINT, ADMIN)
    assert code(took(found, key=keys.generate())) == "STATEMENT_UNTRUSTED"
    assert code(took(found, issuer="http://127.0.0.1:1/other")) == "STATEMENT_UNTRUSTED"
    assert code(took(found, by="alice")) == "NOT_PERMITTED"
    assert code(decide(RULES, found, c.TakeMark("cell-1", "x.y.z"), AT_MS)) == "STATEMENT_MALFORMED"
    gone = replace(POINT, standing=Standing.REVOKED)
    assert code(took(restoring(gone))) == "CALLER_INACTIVE"


def test_an_administrator_resumes_and_names_exactly_the_points_that_were_not_heard():
    second = replace(POINT, id="cell-2", heard=True)
    found = restoring(ADMIN, person("bob", "sponsor"), POINT, second)
    said = lambda *unheard, by="alice", at=found: decide(
        RULES, at, c.ResumeStore(by, frozenset(unheard), SIGNED), AT_MS
    )
    assert said("cell-1") == (StoreResumed(("cell-1",), SIGNED),)
    for wrong in ((), ("cell-2",), ("cell-1", "cell-2"), ("nobody",)):
        assert code(said(*wrong)) == "POINTS_UNHEARD"
    assert code(said("cell-1", by="bob")) == code(said("cell-1", by="cell-1")) == "NOT_PERMITTED"
    assert code(said(at=replace(found, restoring=False))) == "NOT_RESTORING"


def test_an_administrator_vouches_for_a_held_agent():
    bob, held = person("bob", "sponsor"), replace(agent(), held=True)
    said = lambda who, at, by="alice": decide(RULES, at, c.VouchAgent(by, who, "seen"), AT_MS)
    assert said("mover", state(ADMIN, bob, held)) == (AgentVouched("mover", "seen"),)
    assert said("mover", state(ADMIN, bob, agent())) == ()
    assert code(said("mover", state(ADMIN, bob, held), by="bob")) == "NOT_PERMITTED"
    assert code(said("nobody", state(ADMIN))) == "NOT_FOUND"
    assert code(said("mover", state(ADMIN, replace(held, standing=Standing.REVOKED)))) == "AGENT_INACTIVE"


def test_a_held_agent_receives_nothing():
    held = replace(agent(standing=Standing.ACTIVE), held=True)
    found, alice = state(ADMIN, person("bob", "sponsor"), held), person("alice", "sponsor")
    found = replace(found, parties=dict(found.parties) | {"alice": alice})
    issue = c.Issue("alice", "mover", "p", None, bytes(32), "", "A" * 22, "a" * 32, SIGNED)
    assert code(decide(RULES, found, issue, AT_MS)) == "AGENT_HELD"


def test_meanwhile_only_what_restoring_needs_is_done_and_authority_is_taken_back():
    found = restoring(ADMIN, POINT, agent(), person("bob", "sponsor"))
    for command in (
        c.GiveNonce("mover", "n" * 32),
        c.Issue("bob", "mover", "p", None, bytes(32), "", "A" * 22, "a" * 32, SIGNED),
        c.RegisterPep("alice", "new", bytes(32), frozenset({"http://127.0.0.1/mcp"})),
        c.TakeAsk("cell-1", "x.y.z"),
        c.TakeRecords("cell-1", ()),
        c.VouchAgent("alice", "mover", "seen"),
    ):
        refused = decide(RULES, found, command, AT_MS)
        assert code(refused) == "RESTORING"
        assert "cell-1" in refused.detail, "which says what it waits for"
    done = decide(RULES, found, c.Revoke("alice", AGENT, "mover", "odd"), AT_MS)
    assert [type(event) for event in done] == [Revoked]


def test_the_rows_of_a_mark_are_those_that_it_names():
    text = mark_of(("agent", "mover"), ("sponsor", "bob"), ("key", "A" * 43), ("hop", "a" * 32))
    assert wanted(c.TakeMark("cell-1", text)) == Wanted(
        parties=frozenset({"cell-1", "mover", "bob"}), thumbprints=frozenset({"A" * 43}), revocations=True
    )
    assert wanted(c.TakeMark("cell-1", "x" * DEFAULT.statement_bytes)).parties == frozenset({"cell-1"})
