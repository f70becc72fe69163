"""`ztpm audit`: the ledger is exported and verified, a journal verified, and each is told from the other."""

import hashlib
import json
from types import SimpleNamespace

import pytest
from tests.ztpm_idp.test_ledger import full, written
from tests.ztpm_idp.world import World
from ztpm_idp.client import ClientError

from ztpm.cli.provider import person


@pytest.fixture
def cell(tmp_path, monkeypatch):
    """A provider with a ledger, and carol, who may read it."""
    with World(tmp_path) as world:
        full(world)
        monkeypatch.setattr(person, "operator", lambda **asked: world.people[asked["name"]])
        trust = tmp_path / "trust.json"
        trust.write_bytes(world.trust.to_json())
        yield SimpleNamespace(world=world, trust=trust, out=tmp_path / "ledger.ndjson", tmp=tmp_path)


def test_an_exported_ledger_verifies_and_is_told_as_one(run, cell):
    told = run("audit", "export", "--as", "carol", "--out", cell.out)
    assert told.status == 0
    assert str(cell.out) in told.out
    assert cell.out.stat().st_mode & 0o777 == 0o600
    size = len(cell.out.read_bytes().splitlines()) - 1
    told = run("audit", "verify", cell.out, "--trust", cell.trust)
    assert (told.status, told.out.startswith(f"A ledger: {size} entries")) == (0, True)
    told = run("audit", "verify", cell.out, "--trust", cell.trust, "--json")
    assert (told.json["read"], told.json["size"], told.json["first"]) == ("ledger", size, 1)


def test_a_ledger_goes_to_standard_output_and_nothing_else_does(run, cell):
    told = run("audit", "export", "--as", "carol")
    lines = told.out.splitlines()
    assert told.status == 0
    assert [json.loads(line).get("seq") for line in lines] == [*range(1, len(lines)), None]


def test_a_part_verifies_as_one_where_it_is_asked_for(run, cell):
    told = run("audit", "export", "--as", "carol", "--from", 3, "--to", 6, "--out", cell.out, "--json")
    assert told.json == {"ok": True, "out": str(cell.out), "first": 3, "entries": 4}
    told = run("audit", "verify", cell.out, "--trust", cell.trust, "--json")
    assert (told.status, told.json["code"], told.json["read"]) == (3, "OUT_OF_SEQUENCE", "ledger")
    told = run("audit", "verify", cell.out, "--trust", cell.trust, "--from", 3)
    assert (told.status, "entries 3 to 6, a part" in told.out) == (0, True)


def test_a_changed_entry_is_named(run, cell):
    run("audit", "export", "--as", "carol", "--out", cell.out)
    lines = cell.out.read_bytes().splitlines(keepends=True)
    lines[2] = lines[2].replace(b'"at_ms":1', b'"at_ms":2')
    cell.out.write_bytes(b"".join(lines))
    told = run("audit", "verify", cell.out, "--trust", cell.trust)
    assert (told.status, "entry 3" in told.err) == (3, True)


def test_a_journal_is_told_as_one_and_needs_no_trust(run, tmp_path):
    path, lines = tmp_path / "journal.ndjson", written(4)
    path.write_bytes(b"".join(lines) + b'{"at')
    head = hashlib.sha256(lines[-1][:-1]).hexdigest()
    told = run("audit", "verify", path, "--json")
    assert told.status == 0
    assert told.json == {
        "ok": True, "read": "journal", "pep": "cell-1", "size": 4, "head": head, "unfinished_bytes": 4
    }  # fmt: skip
    assert run("audit", "verify", path).out.startswith("A journal of cell-1: 4 records")
    path.write_bytes(b"".join([*lines[:2], *lines[3:]]))
    told = run("audit", "verify", path, "--json")
    assert (told.status, told.json["code"], told.json["read"]) == (3, "RECORD_GAP", "journal")


@pytest.mark.parametrize(
    ("arguments", "code"),
    [
        (("export", "--as", "carol", "--from", 4, "--to", 3), "USAGE"),
        (("export", "--as", "carol", "--json"), "USAGE"),
        (("export", "--as", "carol", "--out", "OUT"), "EXISTS"),
        (("export", "--as", "carol", "--out", "TMP/none/ledger"), "UNWRITABLE"),
        (("verify", "OUT"), "USAGE"),
        (("verify", "JOURNAL", "--from", 2), "USAGE"),
        (("verify", "OUT", "--trust", "OUT"), "TRUST_MALFORMED"),
    ],
)
def test_what_cannot_be_done_is_told(run, cell, arguments, code):
    cell.out.write_bytes(b"mine\n")
    journal = cell.tmp / "journal"
    journal.write_bytes(b"".join(written(1)))
    named = {"OUT": str(cell.out), "JOURNAL": str(journal)}
    told = run("audit", *(named.get(each, str(each).replace("TMP", str(cell.tmp))) for each in arguments))
    said = told.json["code"] if "--json" in arguments else told.err.split(":")[0]
    assert (told.status, said) == (2, code)
    assert cell.out.read_bytes() == b"mine\n"


def test_an_export_that_is_refused_leaves_no_file(run, cell):
    told = run("audit", "export", "--as", "bob", "--out", cell.out)
    assert (told.status, told.err.split(":")[0]) == (3, "NOT_PERMITTED")
    assert not cell.out.exists()


def test_an_export_that_breaks_off_leaves_no_file(run, cell, monkeypatch):
    def pages(**asked):
        yield b'{"seq":1}\n'
        raise ClientError("UNREACHABLE", 0)

    monkeypatch.setattr(cell.world.people["carol"], "ledger_pages", pages)
    assert run("audit", "export", "--as", "carol", "--out", cell.out).status == 1
    assert not cell.out.exists()
