"""Locks of commands: everything by default, and never less than what its events change."""

from __future__ import annotations

import dataclasses

from ztpm_idp.domain import events as e
from ztpm_idp.domain.commands import GiveNonce, ResumeStore, Revoke, SuspendAgent
from ztpm_idp.domain.events import RevocationKind
from ztpm_idp.domain.locks import ASKS, EVERYTHING, REGISTRY, REVOCATIONS, WHOLE, Part, changed_by, locks_of, party
from ztpm_idp.domain.state import Wanted
from ztpm_idp.domain.wanted import wanted


def locks(command):
    return locks_of(command, wanted(command))


def test_a_command_that_is_not_named_runs_alone():
    assert locks(SuspendAgent("alice", "mover", "r")) == EVERYTHING
    assert locks(ResumeStore("alice", frozenset(), None)) == EVERYTHING


def test_what_is_read_is_shared_and_what_changes_is_held_alone():
    given = locks(GiveNonce("mover", "n"))
    assert (given.shared, given.alone) == ({WHOLE, REGISTRY}, {party("mover")})
    hop, agent = (locks(Revoke("alice", kind, "a", "r")) for kind in (RevocationKind.HOP, RevocationKind.AGENT))
    assert (REVOCATIONS in hop.alone, REGISTRY in hop.shared) == (True, True)
    assert {REVOCATIONS, REGISTRY} <= agent.alone


def test_events_that_were_not_expected_are_not_covered():
    given = locks(GiveNonce("mover", "n"))
    ended = e.Revoked(RevocationKind.MANDATE, "m", "contracted", None)
    assert given.cover((e.NonceGiven("n", "mover", 1),))
    assert not given.cover((e.NonceGiven("n", "other", 1),))
    assert not given.cover((ended,))
    assert not given.cover((e.AgentSuspended("mover", "r"),))
    assert EVERYTHING.cover((ended, e.AgentSuspended("mover", "r")))
    assert given.with_alone(frozenset({REVOCATIONS})).cover((ended,))


def test_the_end_of_a_party_changes_the_registry():
    changed = changed_by(e.Revoked(RevocationKind.AGENT, "mover", "r", "mover"))
    assert changed == {REVOCATIONS, REGISTRY}
    assert changed_by(e.Revoked(RevocationKind.HOP, "h", "r", None)) == {REVOCATIONS}
    assert changed_by(e.OpeningClosed("o", "r")) == {ASKS}


def test_locks_of_parties_come_last():
    """Agents whom records concern are locked when they are known: after every other lock, in the order of all."""
    assert max(Part) is Part.PARTY and sorted([party("a"), REGISTRY, WHOLE]) == [WHOLE, REGISTRY, party("a")]


def test_every_wanted_part_has_a_lock_or_never_changes():
    """A new part of `Wanted` is one that commands which run beside others must lock, or may not want."""
    alone_only = {
        "every_opening",
        "change",
        "mandates_from",
        "points",
        "empty",
        "sessions_of",
        "session",
        "offer",
        "devices",
        "tokens_from",
        "envelope",
        "envelopes_of",
        "latch",
        "session_keys_of",
        "login",
        "oauth",
    }
    locked = {
        "parties", "nonces_of", "crowd", "revocation", "revocations", "revocations_of", "ask", "asks_of", "opening",
        "openings_of", "conduct_of", "refusals_of", "mandate", "mandates_of", "mandates_by",
    }  # fmt: skip
    registry, unique = {"thumbprint", "thumbprints", "tool", "agents_of", "people"}, {"keys"}
    journal, unchanging = {"journal", "journal_seqs", "concerned"}, {"hop", "token"}
    counted = {"lent_by", "draws", "promised_by", "tree"}  # without locks: over by as many as run at once
    told = {"picture"}  # named by its digest: whoever brings its text brings the very same
    named = told | counted | alone_only | locked | registry | unique | journal | unchanging
    assert named == {field.name for field in dataclasses.fields(Wanted)}
