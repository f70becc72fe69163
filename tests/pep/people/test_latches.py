"""Latch of a robot: it falls at once, survives every crash, and people alone clear it."""

from __future__ import annotations

import json
import os
from dataclasses import replace

import pytest
from capabilities.statements.people.clearing import Clearing
from capabilities.statements.people.latch import LatchCause, Retreat, Turn
from capabilities.statements.people.vote import digest_of
from capabilities.values.caps import DEFAULT as CAPS
from capabilities.values.scope import Tier
from pep.base.errors import JournalError
from pep.journal.file_journal import FileJournal
from pep.people.ask_composer import Asker
from pep.people.clearings import ClearingFault, read_clearing
from pep.people.latch_file import LatchFile
from pep.people.latches import CLEARED, LATCHED, LatchedStop, Latches
from tests.authenticators import Authenticator
from tests.pep.kit import AUDIENCE, FailingJournal, ManualClock, Person, Registry

from capabilities.keys import keys
from capabilities.statements.people import clearing as clearing_statement
from capabilities.statements.people import latch as latch_statement
from capabilities.statements.people import passkey_clearing
from capabilities.statements.people.assertion import relying_party

ISSUER = "https://idp.example/ztpm"
NAMED = frozenset(LatchCause) - {LatchCause.UNREADABLE}
WATCH = LatchedStop(LatchCause.WATCH, "IMPACT_ROSE", Tier.HIGH_CONSEQUENCE, "ab" * 16)
CRITICAL = LatchedStop(LatchCause.WATCH, "IMPACT_ROSE", Tier.SAFETY_CRITICAL, "ab" * 16)
WAY = Retreat((Turn(1, -100_000),), (0, -100_000, 0, 0, 0, 0), 100_000, Tier.REVERSIBLE, 800)


class Cell:
    """A directory with a journal and a latch, opened as often as a test says."""

    def __init__(self, path):
        self.path, self.clock, self.key, self.ids = path, ManualClock(), keys.generate(), 0
        self.registry = Registry()
        self.people = {name: Person(name) for name in ("bob", "carol")}
        self.registry.people = {person.raw: name for name, person in self.people.items()}
        self.journal = FileJournal.open(path / "journal.ndjson", pep_id="pep-1", clock=self.clock)
        self.latches = self.made()

    def made(self, *, journal=None, causes=NAMED):
        return Latches(
            LatchFile(self.path / "latch.json"),
            journal=journal or self.journal,
            clock=self.clock,
            author=Asker(pep="pep-1", audience=AUDIENCE, issuer=ISSUER, key=self.key),
            robot="ur3e",
            causes=causes,
            approvers=self.registry,
            caps=CAPS,
            new_id=self.next_id,
        )

    def next_id(self):
        self.ids += 1
        return f"{self.ids:032x}"

    def restarted(self, interrupted=(), **changes):
        """The next process over the same directory."""
        self.journal.close()
        self.journal = FileJournal.open(self.path / "journal.ndjson", pep_id="pep-1", clock=self.clock)
        self.latches = self.made(**changes)
        self.latches.recover(self.journal.records(), interrupted)
        return self.latches

    def fallen(self, stop=WATCH):
        """The latch after that stop, told to people."""
        assert self.latches.stopped(stop)
        self.latches.keep()
        self.latches.propose(WAY)
        return self.latches.in_force

    def clearing(self, who="bob", *, key=None, latch=None, text=None, **changes):
        found = self.latches.in_force
        latch, at = latch or found.latch, int(self.clock.wall_s())
        members = {
            "latch_id": latch.latch_id,
            "latch_digest": digest_of(text or found.text),
            "audience": latch.audience,
            "robot": latch.robot,
            "cause": latch.cause,
            "approver": who,
            "not_after": at + 300,
            "at": at,
        }
        return clearing_statement.sign(Clearing(**(members | changes)), key or self.people[who].key)

    def accept(self, *texts, stands=True):
        self.latches.accept(texts, stands=stands)
        return self.latches.in_force is None

    def kinds(self):
        return [record["kind"] for record in self.journal.records()]

    def faults(self):
        return [r["body"]["fault"] for r in self.journal.records() if r["kind"] == "incident"]


@pytest.fixture
def cell(tmp_path):
    cell = Cell(tmp_path)
    yield cell
    cell.journal.close()


# --- falling


@pytest.mark.clause("LSD-21")
def test_a_stop_latches_at_once_and_is_on_disk_and_on_record_with_cause_and_act(cell):
    assert cell.latches.latch_id is None
    assert cell.latches.stopped(WATCH)
    assert cell.latches.latch_id == f"{1:032x}", "before any disk was asked"
    cell.latches.keep()
    (record,) = [r for r in cell.journal.records() if r["kind"] == LATCHED]
    body = record["body"]
    assert (body["cause"], body["reason"], body["request_id"], body["tier"]) == ("watch", "IMPACT_ROSE", "ab" * 16, 3)
    assert json.loads((cell.path / "latch.json").read_bytes())["latch"] == body


@pytest.mark.clause("LSD-21")
def test_what_the_policies_do_not_name_latches_nothing(cell):
    cell.latches = cell.made(causes={LatchCause.AUTHORITY})
    assert not cell.latches.stopped(WATCH)
    cell.latches.keep()
    assert (cell.latches.latch_id, cell.kinds(), os.listdir(cell.path)) == (None, [], ["journal.ndjson"])


@pytest.mark.clause("LSD-21", "STM-22")
def test_after_tier_four_and_after_an_unknown_tier_two_people_are_wanted(cell):
    assert cell.fallen(CRITICAL).latch.approvers == 2
    assert cell.restarted().in_force.latch.approvers == 2


@pytest.mark.clause("LSD-21")
def test_an_unknown_tier_counts_as_the_highest(cell):
    latch = cell.fallen(LatchedStop(LatchCause.CLIENT_LOST)).latch
    assert (latch.tier, latch.approvers) == (Tier.SAFETY_CRITICAL, 2)


@pytest.mark.clause("LSD-21")
def test_a_further_stop_is_part_of_the_same_until_people_were_told_and_a_latch_of_its_own_afterwards(cell):
    assert cell.latches.stopped(CRITICAL)
    assert not cell.latches.stopped(WATCH)
    cell.latches.keep()
    cell.latches.propose(WAY)
    old = [cell.clearing("bob"), cell.clearing("carol")]
    assert cell.latches.stopped(LatchedStop(LatchCause.SAFETY_STOP, tier=Tier.NO_EFFECT))
    cell.latches.keep()
    cell.latches.propose(WAY)
    assert cell.latches.in_force.latch.tier is Tier.SAFETY_CRITICAL, "a milder stop asks no fewer people"
    assert not cell.accept(*old)
    assert cell.accept(cell.clearing("bob"), cell.clearing("carol"))


@pytest.mark.clause("LSD-21")
def test_a_further_stop_raises_the_tier_of_a_latch_that_nobody_was_told_of(cell):
    cell.latches.stopped(WATCH)
    cell.latches.keep()
    latch_id = cell.latches.latch_id
    assert not cell.latches.stopped(CRITICAL)
    cell.latches.keep()
    latch = cell.restarted().in_force.latch
    assert (latch.latch_id, latch.tier, latch.approvers) == (latch_id, Tier.SAFETY_CRITICAL, 2)
    (cell.path / "latch.json").unlink()
    assert cell.restarted().in_force.latch == latch


@pytest.mark.clause("LIV-7", "LSD-21")
def test_a_known_persons_word_latches_what_no_policy_names_and_names_the_person_over_every_restart(cell):
    cell.latches = cell.made(causes=frozenset())
    assert not cell.latches.stopped(LatchedStop(LatchCause.ASKED, tier=Tier.NO_EFFECT))
    latch = cell.fallen(LatchedStop(LatchCause.ASKED, tier=Tier.NO_EFFECT, person="bob")).latch
    assert (latch.cause, latch.person, latch.approvers) == (LatchCause.ASKED, "bob", 1)
    assert cell.latches.summary()["person"] == "bob"
    assert cell.restarted(causes=frozenset()).in_force.latch == latch
    (cell.path / "latch.json").unlink()
    assert cell.restarted(causes=frozenset()).in_force.latch.person == "bob"
    cell.latches.propose(WAY)
    assert cell.accept(cell.clearing("bob")), "who stopped it may clear it, as any approver may"


@pytest.mark.clause("LIV-7", "LSD-21")
def test_a_persons_word_on_a_latch_that_nobody_was_told_of_names_the_person_and_keeps_its_cause(cell):
    cell.latches.stopped(WATCH)
    cell.latches.keep()
    asked = LatchedStop(LatchCause.ASKED, tier=Tier.NO_EFFECT, person="bob")
    assert not cell.latches.stopped(asked)
    assert cell.latches.unkept
    cell.latches.keep()
    assert not cell.latches.stopped(replace(asked, person="carol")), "the first word counts"
    cell.latches.keep()
    latch = cell.restarted().in_force.latch
    assert (latch.cause, latch.tier, latch.person) == (LatchCause.WATCH, Tier.HIGH_CONSEQUENCE, "bob")


# --- crash points


@pytest.mark.clause("LSD-21")
def test_a_crash_before_the_first_byte_latches_by_the_act_that_was_under_way(cell):
    cell.latches.stopped(WATCH)  # and nothing is written: the process is gone
    again = cell.restarted([LatchedStop(LatchCause.INTERRUPTED, tier=Tier.CONSEQUENTIAL, request_id="cd" * 16)])
    assert (again.in_force.latch.cause, again.in_force.latch.tier) == (LatchCause.INTERRUPTED, Tier.CONSEQUENTIAL)
    assert again.in_force.latch.approvers == 1


@pytest.mark.clause("LSD-21")
def test_a_crash_between_file_and_journal_keeps_the_latch_and_records_nothing_twice(cell):
    cell.latches = cell.made(journal=FailingJournal(cell.journal))
    cell.latches.stopped(WATCH)
    with pytest.raises(JournalError):
        cell.latches.keep()
    assert cell.latches.latch_id == f"{1:032x}", "a disk that is full clears nothing"
    assert cell.restarted().latch_id == f"{1:032x}"


@pytest.mark.clause("LSD-21")
def test_a_file_that_is_gone_is_made_again_out_of_the_journal(cell):
    latch_id = cell.fallen().latch.latch_id
    (cell.path / "latch.json").unlink()
    assert cell.restarted().latch_id == latch_id
    assert (cell.path / "latch.json").exists()
    assert cell.restarted().latch_id == latch_id


@pytest.mark.clause("LSD-22")
def test_a_crash_between_record_and_file_of_a_clearing_leaves_it_cleared(cell):
    cell.fallen()
    left = (cell.path / "latch.json").read_bytes()
    assert cell.accept(cell.clearing())
    (cell.path / "latch.json").write_bytes(left)
    assert cell.restarted().latch_id is None
    assert not (cell.path / "latch.json").exists()


@pytest.mark.clause("LSD-22")
def test_a_clearing_that_cannot_be_recorded_clears_nothing(cell):
    cell.fallen()
    found = cell.latches.in_force
    failing = cell.made(journal=FailingJournal(cell.journal))
    failing.recover(cell.journal.records(), ())
    assert failing.in_force == found
    with pytest.raises(JournalError):
        failing.accept([cell.clearing()], stands=True)
    assert failing.in_force == found
    assert (cell.path / "latch.json").exists()


BROKEN = {
    "empty": b"",
    "no JSON": b"latched",
    "cut": None,
    "no latch in it": b'{"form":1,"latch":{},"text":""}',
    "another form": b'{"form":2,"latch":{},"text":""}',
    "no text": b'{"form":1,"latch":{}}',
    "a flag": b"false",
    "too long": b" " * 20_000,
}


@pytest.mark.clause("LSD-21")
@pytest.mark.parametrize("what", BROKEN)
def test_a_file_that_cannot_be_read_is_a_latch_that_two_people_clear(cell, what):
    cell.fallen()
    path = cell.path / "latch.json"
    path.write_bytes(path.read_bytes()[:-9] if BROKEN[what] is None else BROKEN[what])
    again = cell.restarted(causes=frozenset())
    latch = again.in_force.latch
    assert (latch.cause, latch.approvers, cell.faults()) == (LatchCause.UNREADABLE, 2, ["STATE_UNREADABLE"])
    assert path.with_suffix(".unreadable").exists(), "kept for people to look at"
    assert cell.restarted(causes=frozenset()).latch_id == latch.latch_id
    again = cell.latches
    again.propose(WAY)
    assert not cell.accept(cell.clearing("bob"))
    assert cell.accept(cell.clearing("bob"), cell.clearing("carol"))


@pytest.mark.clause("LSD-21")
@pytest.mark.parametrize("name", ["latch_id", "cause", "tier", "approvers", "robot", "at"])
def test_a_file_without_one_of_its_members_is_unreadable(cell, name):
    cell.fallen()
    path = cell.path / "latch.json"
    stored = json.loads(path.read_bytes())
    del stored["latch"][name]
    path.write_bytes(json.dumps(stored).encode())
    assert cell.restarted().in_force.latch.cause is LatchCause.UNREADABLE


@pytest.mark.clause("LSD-21")
def test_another_policy_set_clears_nothing(cell):
    latch_id = cell.fallen().latch.latch_id
    assert cell.restarted(causes=frozenset()).latch_id == latch_id


@pytest.mark.clause("LSD-23")
def test_the_way_out_is_signed_once_and_the_same_after_a_restart(cell):
    found = cell.fallen()
    assert latch_statement.open(found.text, [keys.public_raw(cell.key)], CAPS).retreat == (WAY,)
    cell.latches.propose("UNPROVEN")
    assert cell.restarted().in_force == found


# --- clearing


@pytest.mark.clause("LSD-22", "STM-22")
def test_an_approver_clears_it_once_by_name_on_record(cell):
    cell.fallen()
    text = cell.clearing("bob")
    assert cell.accept(text)
    (record,) = [r for r in cell.journal.records() if r["kind"] == CLEARED]
    assert (record["body"]["approvers"], record["body"]["clearings"]) == (["bob"], [text])
    assert not (cell.path / "latch.json").exists()
    assert cell.restarted().latch_id is None
    cell.fallen()
    assert not cell.accept(text), "of the latch before"
    assert cell.faults() == ["CLEARING_NOT_FOR_THIS_LATCH"]


@pytest.mark.clause("STM-22")
def test_one_person_with_two_keys_is_one_person(cell):
    second = Person("bob")
    cell.registry.people = {**cell.registry.people, second.raw: "bob"}
    cell.fallen(CRITICAL)
    assert not cell.accept(cell.clearing("bob"), cell.clearing("bob", key=second.key))
    assert cell.accept(cell.clearing("bob"), cell.clearing("carol"))


@pytest.mark.clause("LSD-22")
def test_two_clearings_at_once_clear_once(cell):
    cell.fallen()
    assert cell.accept(cell.clearing("bob"), cell.clearing("carol"))
    assert cell.accept()
    assert cell.kinds().count(CLEARED) == 1


@pytest.mark.clause("LSD-22")
def test_while_the_arm_moves_nothing_is_cleared(cell):
    cell.fallen()
    text = cell.clearing()
    assert not cell.accept(text, stands=False)
    assert cell.accept(text)


@pytest.mark.clause("STM-22")
def test_two_clearings_that_never_held_together_are_not_two(cell):
    cell.fallen(CRITICAL)
    first = cell.clearing("bob")
    assert not cell.accept(first)
    cell.clock.advance(301_000)
    assert not cell.accept(first, cell.clearing("carol"))
    assert cell.accept(cell.clearing("bob"), cell.clearing("carol"))


def refusal(cell, text):
    found = cell.latches.in_force
    at = cell.clock.wall_s()
    return read_clearing(text, found.latch, found.text, cell.registry, at=at, caps=CAPS)


@pytest.mark.clause("STM-22")
@pytest.mark.parametrize(
    ("changes", "code"),
    [
        ({"latch_id": "9" * 32}, ClearingFault.CLEARING_NOT_FOR_THIS_LATCH),
        ({"latch_digest": "9" * 64}, ClearingFault.CLEARING_NOT_FOR_THIS_LATCH),
        ({"robot": "ur5e"}, ClearingFault.CLEARING_NOT_FOR_THIS_LATCH),
        ({"audience": "http://127.0.0.1:1/other"}, ClearingFault.CLEARING_NOT_FOR_THIS_LATCH),
        ({"cause": LatchCause.AUTHORITY}, ClearingFault.CLEARING_NOT_FOR_THIS_LATCH),
        ({"approver": "carol"}, ClearingFault.CLEARING_NOT_YOURS),
        ({"approver": "robotic"}, ClearingFault.CLEARING_NOT_YOURS),
    ],
)
def test_what_is_about_something_else_or_by_somebody_else_counts_for_nothing(cell, changes, code):
    cell.fallen()
    text = cell.clearing("bob", key=cell.people["bob"].key, **changes)
    assert refusal(cell, text) is code
    assert not cell.accept(text)
    assert cell.faults() == [str(code)]


@pytest.mark.clause("STM-22")
def test_no_agent_no_enforcement_point_and_nobody_who_was_revoked_clears_it(cell):
    cell.fallen()
    for stranger in (keys.generate(), cell.key):
        assert refusal(cell, cell.clearing("bob", key=stranger)) == "STATEMENT_UNTRUSTED"
    text = cell.clearing("bob")
    cell.registry.people = {raw: who for raw, who in cell.registry.people.items() if who != "bob"}
    assert refusal(cell, text) == "STATEMENT_UNTRUSTED"
    assert not cell.accept(text)


@pytest.mark.clause("STM-22")
def test_a_clearing_counts_in_its_time_alone(cell):
    cell.fallen()
    at = int(cell.clock.wall_s())
    early = cell.clearing(at=at - 6, not_after=at + 300)
    ahead = cell.clearing(at=at + 7, not_after=at + 300)
    over = cell.clearing(not_after=at + 1)
    cell.clock.advance(2_000)
    assert {refusal(cell, text) for text in (early, over)} == {ClearingFault.CLEARING_OUT_OF_TIME}
    cell.clock.advance(-1_000)
    assert refusal(cell, ahead) is ClearingFault.CLEARING_OUT_OF_TIME


@pytest.mark.clause("PSK-7", "STM-22")
def test_a_passkey_clears_it_for_its_person_alone(cell):
    held = Authenticator(relying_party(ISSUER), keys.generate())
    cell.registry.held = {held.key: "carol"}
    found = cell.fallen()
    at = int(cell.clock.wall_s())

    def by(who):
        stated = Clearing(
            found.latch.latch_id, digest_of(found.text), AUDIENCE, "ur3e", LatchCause.WATCH, who, at + 60, at
        )
        assertion = held.assertion(passkey_clearing.challenge_of(stated, found.latch))
        return passkey_clearing.compose(stated, assertion, key=held.key)

    assert refusal(cell, by("bob")) is ClearingFault.CLEARING_NOT_YOURS
    assert cell.accept(by("carol"))


@pytest.mark.clause("STM-22")
@pytest.mark.parametrize("text", ["", "a.b.c", "....", "ä", "x" * 300_000])
def test_what_is_no_clearing_is_told_once(cell, text):
    cell.fallen()
    assert not cell.accept(text)
    assert not cell.accept(text)
    assert len(cell.faults()) == 1
