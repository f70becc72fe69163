"""Joint commands: those of which none changes what another one reads, in the order in which they came."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

from ztpm_idp.domain import joint
from ztpm_idp.domain.commands import Delegate, GiveNonce, Revoke, SuspendAgent
from ztpm_idp.domain.events import RevocationKind
from ztpm_idp.domain.joint import apart, claim, union
from ztpm_idp.domain.locks import REVOCATIONS, WHOLE, Locks, locks_of, party
from ztpm_idp.domain.wanted import wanted

HOP, TOKEN = RevocationKind.HOP, RevocationKind.TOKEN


def claimed(command):
    return claim(command, locks_of(command, wanted(command)))


def delegating(names):
    signed = SimpleNamespace(body="")
    return Delegate(
        by="planner", key=b"", token=b"", delegate="mover", purpose="x", restriction=None, request_digest=b"",
        evidence="", hop_id="h", signed=signed, agents=frozenset(), names=names,
    )  # fmt: skip


def test_a_command_that_meets_an_earlier_one_waits():
    nonces = [claimed(GiveNonce(agent, str(n))) for n, agent in enumerate("abacdb")]
    assert apart(nonces) == [0, 1, 3, 4]


def test_nobody_is_overtaken_by_whom_it_meets():
    """The second waits for the first, and the third may not go before the second."""
    first, second, third = (
        Locks(frozenset(), frozenset(map(party, held))) for held in ("a", "ab", "b")
    )  # fmt: skip
    assert apart([first, second, third]) == [0]
    assert apart([second, third]) == [0]
    assert apart([first, third]) == [0, 1]


def test_who_reads_waits_for_who_changes():
    reads = Locks(frozenset({party("a")}), frozenset({party("b")}))
    changes = Locks(frozenset({WHOLE}), frozenset({party("a")}))
    assert apart([reads, changes]) == apart([changes, reads]) == [0]
    assert apart([reads, replace(reads, alone=frozenset({party("c")}))]) == [0, 1]


def test_revocations_of_different_hops_are_joint():
    hops = [
        claimed(Revoke("alice", kind, id_, "x")) for kind, id_ in ((HOP, "a"), (HOP, "b"), (TOKEN, "a"), (HOP, "a"))
    ]
    assert apart(hops) == [0, 1, 2]


def test_what_is_not_named_is_never_joint():
    assert claimed(SuspendAgent("alice", "mover", "x")) is None
    assert claimed(Revoke("alice", RevocationKind.AGENT, "mover", "x")) is None
    assert claimed(delegating(None)) is None  # of a token that cannot be read: it asks for every revocation
    assert claimed(delegating(frozenset())) is not None


def test_one_transaction_has_so_many_at_most():
    assert apart([claimed(GiveNonce(f"agent-{n}", "n")) for n in range(joint.MOST + 5)]) == [*range(joint.MOST)]


def test_a_transaction_locks_what_each_of_its_commands_does():
    both = union(locks_of(command, wanted(command)) for command in (Revoke("a", HOP, "h", "x"), GiveNonce("a", "n")))
    assert both.alone == {REVOCATIONS, party("a")}
    assert WHOLE in both.shared and not both.shared & both.alone
