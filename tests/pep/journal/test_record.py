"""The journal: durable, chained, repaired where writing was cut short, refused where anything else was changed."""

import asyncio
import hashlib
import json
import multiprocessing
import os
import signal

import pytest
from capabilities.proof.proof import Proof, check_proof
from capabilities.values.caps import DEFAULT as CAPS
from pep.base.clock import SystemClock
from pep.base.errors import JournalError, PepFault
from pep.journal.file_journal import FileJournal
from pep.provider.journal_shipper import JournalShipper
from tests.pep.kit import ISSUER, PEP, FakeIssuer, ManualClock, issuer_keys

from capabilities.keys import keys
from pep.gate import records


def opened(path, clock=None):
    return FileJournal.open(path, pep_id=PEP, clock=clock or ManualClock())


@pytest.fixture
def path(tmp_path):
    return tmp_path / "journal.ndjson"


def filled(path, count=3):
    journal = opened(path)
    hashes = [journal.append("incident", {"n": n}) for n in range(count)]
    journal.close()
    return hashes


def refused(path, code=PepFault.JOURNAL_CORRUPT):
    with pytest.raises(JournalError) as raised:
        opened(path)
    assert raised.value.code is code


def test_records_are_chained(path):
    hashes = filled(path)
    lines = path.read_bytes().splitlines()
    assert [hashlib.sha256(line).hexdigest() for line in lines] == hashes
    rows = [json.loads(line) for line in lines]
    assert [row["seq"] for row in rows] == [1, 2, 3]
    assert [row["prev"] for row in rows] == ["0" * 64, *hashes[:2]]
    assert {row["pep"] for row in rows} == {PEP}


def test_opening_again_continues(path):
    hashes = filled(path)
    journal = opened(path)
    journal.append("incident", {"n": 3})
    assert [r["seq"] for r in journal.records()] == [1, 2, 3, 4]
    assert list(journal.records())[-1]["prev"] == hashes[-1]
    journal.close()


def test_a_torn_tail_is_cut_off_wherever_it_was_torn(path):
    filled(path)
    whole = path.read_bytes()
    third = whole.rindex(b"\n", 0, -1) + 1
    for length in range(third + 1, len(whole)):
        path.write_bytes(whole[:length])
        journal = opened(path)
        assert journal.repaired_bytes == length - third
        assert journal.last_seq == 2
        journal.append("incident", {"after": "repair"})
        journal.close()
        journal = opened(path)
        assert (journal.repaired_bytes, journal.last_seq) == (0, 3)
        journal.close()


def test_zeros_after_a_power_cut_are_a_torn_tail(path):
    filled(path)
    path.write_bytes(path.read_bytes() + b"\0" * 512)
    journal = opened(path)
    assert (journal.repaired_bytes, journal.last_seq) == (512, 3)
    journal.close()


def test_one_flipped_bit_is_refused(path):
    """In every record that has a successor. The newest is held by the ledger, where it has been shipped to."""
    filled(path, 2)
    whole = path.read_bytes()
    for position in range(whole.index(b"\n") + 1):
        changed = bytearray(whole)
        changed[position] ^= 1
        path.write_bytes(bytes(changed))
        refused(path)


def test_a_record_taken_out_of_the_middle_is_refused(path):
    filled(path)
    lines = path.read_bytes().splitlines(keepends=True)
    path.write_bytes(lines[0] + lines[2])
    refused(path)


def test_records_in_another_order_are_refused(path):
    filled(path)
    lines = path.read_bytes().splitlines(keepends=True)
    path.write_bytes(lines[1] + lines[0] + lines[2])
    refused(path)


def test_the_same_json_spelled_otherwise_is_refused(path):
    filled(path, 1)
    path.write_bytes(path.read_bytes().replace(b'":', b'": ', 1))
    refused(path)


def test_another_pep_does_not_continue_it(path):
    filled(path)
    with pytest.raises(JournalError):
        FileJournal.open(path, pep_id="other", clock=ManualClock())


def test_two_at_once_are_refused(path):
    journal = opened(path)
    refused(path, PepFault.JOURNAL_LOCKED)
    journal.close()


def test_after_a_failed_sync_nothing_is_accepted_any_more(path, monkeypatch):
    journal = opened(path)
    journal.append("incident", {})
    with monkeypatch.context() as broken:
        broken.setattr(os, "fdatasync", lambda _: (_ for _ in ()).throw(OSError("no space")))
        with pytest.raises(JournalError):
            journal.append("incident", {})
    with pytest.raises(JournalError) as raised:
        journal.append("incident", {})
    assert raised.value.code is PepFault.JOURNAL_BROKEN
    journal.close()


def test_it_is_synced_before_append_returns(path, monkeypatch):
    journal, order = opened(path), []
    write, sync = os.write, os.fdatasync
    monkeypatch.setattr(os, "write", lambda *a: (order.append("write"), write(*a))[1])
    monkeypatch.setattr(os, "fdatasync", lambda *a: (order.append("sync"), sync(*a))[1])
    journal.append("incident", {})
    assert order == ["write", "sync"]
    journal.close()


class Disk:
    """Counts syncs of the journal's disk, or breaks it."""

    def __init__(self, monkeypatch):
        self.syncs, self.broken, sync = 0, False, os.fdatasync

        def synced(descriptor):
            if self.broken:
                raise OSError("no space")
            self.syncs += 1
            sync(descriptor)

        monkeypatch.setattr(os, "fdatasync", synced)


def test_a_note_waits_for_no_disk_and_is_settled_by_what_comes_next(path, monkeypatch):
    journal, disk = opened(path), Disk(monkeypatch)
    journal.append("decision", {})
    assert disk.syncs == 1
    journal.note("outcome", {"n": 1})
    assert [r["kind"] for r in journal.records()] == ["decision", "outcome"], "it is in the file at once"
    assert (disk.syncs, journal.settled, len(journal.after(0, most_bytes=1 << 20))) == (1, False, 1), "no ledger hears"
    journal.append("decision", {})
    assert (disk.syncs, journal.settled, len(journal.after(0, most_bytes=1 << 20))) == (2, True, 3)
    journal.settle()
    assert disk.syncs == 2, "nothing was left to settle"
    journal.note("outcome", {})
    journal.settle()
    journal.note("outcome", {})
    journal.close()
    assert disk.syncs == 4
    journal = opened(path)
    assert (disk.syncs, journal.last_seq, journal.settled) == (5, 5, True), "what a killed process left is settled"
    journal.close()


def test_a_note_that_cannot_be_settled_ends_the_journal(path, monkeypatch):
    journal, disk = opened(path), Disk(monkeypatch)
    journal.note("outcome", {})
    disk.broken = True
    for act in (journal.settle, lambda: journal.append("decision", {}), lambda: journal.note("outcome", {})):
        with pytest.raises(JournalError) as raised:
            act()
        assert raised.value.code is PepFault.JOURNAL_BROKEN
    assert journal.after(0, most_bytes=1) == []
    journal.close()


def test_a_batch_has_as_many_lines_as_fit_and_at_least_one(path):
    journal = opened(path)
    for n in range(4):
        journal.append("incident", {"n": n})
    line = len(path.read_bytes()) // 4
    counts = [len(journal.after(seq, most_bytes=size)) for seq in (0, 2) for size in (1, line, 2 * line, 3 * line)]
    assert counts == [1, 1, 2, 3, 1, 1, 2, 2]
    assert journal.after(4, most_bytes=1) == []
    journal.close()


@pytest.mark.parametrize("body", [{"n": float("nan")}, {"n": 2**60}, {"n": object()}, {"n": "\ud800"}])
def test_what_is_no_plain_json_is_refused_and_harms_nothing(path, body):
    journal = opened(path)
    with pytest.raises(JournalError):
        journal.append("incident", body)
    journal.append("incident", {"n": 1})
    journal.close()
    journal = opened(path)
    assert journal.last_seq == 1
    journal.close()


def _append_for_ever(path, pipe):
    journal = FileJournal.open(path, pep_id=PEP, clock=SystemClock())
    while True:
        pipe.send(journal.append("incident", {"padding": "x" * 200}))


def test_a_killed_process_loses_nothing_that_was_acknowledged(path):
    context = multiprocessing.get_context("spawn")
    ours, theirs = context.Pipe(duplex=False)
    child = context.Process(target=_append_for_ever, args=(path, theirs))
    child.start()
    theirs.close()
    acknowledged = [ours.recv() for _ in range(50)]
    os.kill(child.pid, signal.SIGKILL)
    child.join()
    journal = opened(path)
    kept = [r["prev"] for r in journal.records()][1:] + [journal._head]
    assert kept[: len(acknowledged)] == acknowledged
    journal.close()


def test_what_was_left_open_is_found(path):
    journal = opened(path)

    def decided(request_id, effect, **more):
        body = {"request": {"id": request_id, "digest": "d"}, "decision": {"effect": effect}, **more}
        return journal.append("decision", body)

    decided("a", "PERMIT")
    journal.append("outcome", {"request_id": "a"})
    left = decided("b", "PERMIT")
    decided("c", "DENY")
    decided("d", "DEFER", ask={"ask_id": "d"})
    decided("e", "DEFER", ask={"ask_id": "e"})
    journal.append("ask-expired", {"ask_id": "e"})
    assert records.unfinished(journal.records()) == [("b", left)]
    journal.close()


# -- shipping


class Ledger(FakeIssuer):
    """Also checks the proof of each request."""

    def __init__(self, key):
        self.clock = ManualClock()
        super().__init__(issuer_keys()[0], self.clock)
        self.key = key

    def handle(self, request):
        if not self.down:
            proof = check_proof(
                request.headers["dpop"],
                key=keys.public_raw(self.key),
                method="POST",
                url=f"{ISSUER}/ledger/records",
                body=request.content,
                token=None,
                at=self.clock.wall_s(),
                caps=CAPS,
            )
            assert isinstance(proof, Proof)
        return super().handle(request)


@pytest.fixture
def shipping(path):
    key = keys.generate()
    ledger, journal = Ledger(key), opened(path)
    yield (
        ledger,
        journal,
        JournalShipper(journal, ledger.client(), issuer=ISSUER, key=key, clock=ledger.clock, incident=print),
    )
    journal.close()


def test_everything_is_shipped_once_and_in_order(shipping, monkeypatch):
    ledger, journal, shipper = shipping
    monkeypatch.setattr("pep.provider.journal_shipper.BATCH_BYTES", 1_000)
    for n in range(20):
        journal.append("incident", {"n": n})

    async def all_of_it():
        while await shipper.ship():
            pass

    asyncio.run(all_of_it())
    assert [r["seq"] for r in ledger.shipped] == list(range(1, 21))
    assert ledger.shipped == list(journal.records())


def test_a_ledger_that_lost_its_end_gets_it_again(shipping):
    ledger, journal, shipper = shipping
    for n in range(4):
        journal.append("incident", {"n": n})
    asyncio.run(shipper.ship())
    ledger.through, ledger.shipped = 2, ledger.shipped[:2]
    journal.append("incident", {"n": 4})
    with pytest.raises(JournalError) as raised:
        asyncio.run(shipper.ship())
    assert raised.value.code is PepFault.LEDGER_REFUSED
    asyncio.run(shipper.ship())
    assert [r["seq"] for r in ledger.shipped] == [1, 2, 3, 4, 5]
