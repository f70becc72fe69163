"""`ztpm audit`: the ledger is exported and verified, a journal verified, and each is told from the other."""

import hashlib
import json
import sqlite3
import zlib
from dataclasses import replace
from types import SimpleNamespace

import pytest
import rfc8785
from capabilities.statements import checkpoint
from capabilities.statements.people import picture
from tests.capabilities.statements.people.test_pictures import SHOWN
from tests.ztpm_idp.asks import Cell
from tests.ztpm_idp.journals import Journal
from tests.ztpm_idp.test_ledger import full, written
from tests.ztpm_idp.world import World
from ztpm_idp.client import ClientError, Operator

from capabilities.keys import keys
from ztpm.cli.provider import person


@pytest.fixture(scope="module")
def furnished(tmp_path_factory):
    """A provider with a ledger that the tests of this module read."""
    with World(tmp_path_factory.mktemp("furnished")) as world:
        full(world)
        yield world


@pytest.fixture
def cell(tmp_path, monkeypatch, furnished):
    """That provider, and carol, who may read its ledger."""
    return on(furnished, tmp_path, monkeypatch)


def on(world, tmp_path, monkeypatch):
    monkeypatch.setattr(person, "operator", lambda **asked: world.caller(Operator, asked["name"]))
    trust = tmp_path / "trust.json"
    trust.write_bytes(world.trust.to_json())
    return SimpleNamespace(world=world, trust=trust, out=tmp_path / "ledger.ndjson", tmp=tmp_path)


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
    def pages(_, **asked):
        yield b'{"seq":1}\n'
        raise ClientError("UNREACHABLE", 0)

    monkeypatch.setattr(Operator, "ledger_pages", pages)
    assert run("audit", "export", "--as", "carol", "--out", cell.out).status == 1
    assert not cell.out.exists()


def test_what_is_found_is_shown_and_goes_to_a_siem_in_pieces(run, cell):
    told = run("audit", "search", "--as", "carol", "--agent", "planner", "--kind", "token-issued")
    assert (told.status, "token-issued" in told.out, "alice" in told.out) == (0, True, True)
    told = run("audit", "search", "--as", "carol", "--limit", 3)
    assert (told.status, "--after 3" in told.out) == (0, True)
    told = run("audit", "search", "--as", "carol", "--kind", "revoked", "--since", "2027-01-15T08:00:00Z", "--json")
    assert [row["kind"] for row in told.lines] == ["revoked"]
    assert run("audit", "search", "--as", "carol", "--kind", "revoked", "--until", "2027-01-15", "--json").out == ""
    for form, size in (("lines", 2), ("cef", 3)):
        out = cell.tmp / f"out.{form}"
        asked = ("audit", "search", "--as", "carol", "--form", form, "--out", out)
        assert run(*asked).status == 0
        whole = out.read_bytes()
        out.write_bytes(b"\n".join(whole.split(b"\n")[:size]) + b"\n{half of a line")
        assert run(*asked, "--json").json["code"] == "EXISTS"
        told = run(*asked, "--resume", "--json")
        assert (told.status, told.json["entries"]) == (0, whole.count(b"\n") - size)
        assert out.read_bytes() == whole, "nothing twice, nothing lost, and no half line"
        assert run(*asked, "--resume", "--json").json["entries"] == 0
    assert run("audit", "search", "--as", "carol", "--form", "cef").out.startswith("CEF:0|ZTPM|ztpm_idp|1|")


@pytest.mark.parametrize(
    "wrong",
    [("--form", "xml"), ("--out", "x"), ("--resume",), ("--form", "cef", "--resume"), ("--since", "yesterday"), ("--since", "1960-01-01")],
)  # fmt: skip
def test_questions_that_are_none(run, wrong):
    assert run("audit", "search", "--as", "carol", *wrong).status == 2


def test_one_entry_is_proven_to_whoever_has_the_trust_bundle(run, cell):
    out = cell.tmp / "entry.tlog-proof"
    told = run("audit", "prove", 4, "--as", "carol", "--trust", cell.trust, "--out", out, "--json")
    assert (told.status, told.json["entry"]) == (0, 4)
    told = run("audit", "verify", out, "--trust", cell.trust, "--json")
    assert (told.status, told.json["read"], told.json["entry"]) == (0, "proof", 4)
    assert run("audit", "verify", out).status == 2
    text = out.read_text()
    for wrong in (
        text.replace("index 3", "index 2"),
        text.replace("extra e", "extra f"),
        text[:-5],
        text.replace("@v1", "@v1\nx"),
    ):
        out.write_text(wrong)
        assert run("audit", "verify", out, "--trust", cell.trust, "--json").json["code"] in {
            "PROOF_WRONG",
            "LINE_MALFORMED",
        }
    assert (
        run("audit", "prove", 4, "--as", "carol", "--trust", cell.trust, "--out", out, "--json").json["code"]
        == "EXISTS"
    )
    told = run("audit", "prove", 4_000, "--as", "carol", "--trust", cell.trust, "--out", cell.tmp / "x", "--json")
    assert told.json["code"] == "ENTRY_UNKNOWN"


def test_a_checkpoint_that_is_held_goes_on_and_shows_a_rewritten_ledger(run, cell):
    held = cell.tmp / "held"
    asked = ("audit", "hold", held, "--as", "bob", "--trust", cell.trust)
    first = run(*asked, "--json")
    assert (first.status, first.json["held"]) == (0, 0)
    cell.world.person("frank", "sponsor")
    run("audit", "export", "--as", "carol", "--out", cell.out)
    told = run("audit", "verify", cell.out, "--trust", cell.trust, "--held", held, "--json")
    assert (told.status, told.json["held"]) == (0, first.json["size"])
    assert run("audit", "verify", cell.out, "--trust", cell.trust, "--held", held, "--from", 2).status == 2
    assert "1 of them since" in run(*asked).out
    other = rewritten(cell, "frank")
    cell.out.write_bytes(b"".join(line + b"\n" for line in other))
    told = run("audit", "verify", cell.out, "--trust", cell.trust, "--json")
    assert told.status == 0, "its own key signed the rewritten ledger, and nothing in it is wrong"
    told = run("audit", "verify", cell.out, "--trust", cell.trust, "--held", held, "--json")
    assert (told.status, told.json["code"]) == (3, "LEDGER_FORKED")
    cell.out.write_bytes(b"".join(line + b"\n" for line in rewritten(cell, None)))
    assert run("audit", "verify", cell.out, "--trust", cell.trust, "--held", held, "--json").json["code"] == "CUT"
    held.write_text(held.read_text().replace("\n", " ", 1))
    assert run(*asked, "--json").json["code"] == "CHECKPOINT_UNTRUSTED"


def test_a_provider_that_lost_entries_is_found_by_who_holds_a_checkpoint(run, tmp_path, monkeypatch, world_of_its_own):
    cell = on(world_of_its_own, tmp_path, monkeypatch)
    held = cell.tmp / "held"
    asked = ("audit", "hold", held, "--as", "bob", "--trust", cell.trust, "--json")
    run(*asked)
    text = held.read_text()
    with sqlite3.connect(cell.world.folder / "idp.sqlite") as base:
        base.execute("UPDATE ledger_tiles SET hashes = zeroblob(length(hashes))")
    cell.world.person("frank", "sponsor")
    assert run(*asked).json["code"] == "LEDGER_FORKED"
    assert held.read_text() == text, "the held one stays"


@pytest.fixture
def world_of_its_own(tmp_path):
    with World(tmp_path) as world:
        yield world


def rewritten(cell, name):
    """The ledger with the last entry changed, or gone, chained anew and signed by its very key."""
    lines = [json.loads(line) for line in cell.world.people["carol"].export_ledger().splitlines()[:-1]]
    made, prev = [], "0" * 64
    for entry in lines:
        if name is None and entry is lines[-1]:
            break
        if name is not None and entry["body"].get("id") == name:
            entry["body"]["name"] = "Another"
        entry["prev"] = prev
        made.append(rfc8785.dumps(entry))
        prev = hashlib.sha256(made[-1]).hexdigest()
    point = checkpoint.Checkpoint(cell.world.trust.issuer, len(made), prev, 1)
    return [*made, rfc8785.dumps({"checkpoint": checkpoint.sign(point, cell.world.idp_keys.ledger)})]


@pytest.mark.clause("CON-9")
def test_a_motion_is_drawn_from_its_proven_record_or_not_at_all(run, tmp_path, monkeypatch):
    with World(tmp_path) as world:
        cell, text = on(world, tmp_path, monkeypatch), picture.write(SHOWN)
        point, journal = Cell(world), Journal(world, registered=True)
        token = world.people["alice"].issue(world.agents["mover"], world.scope(), purpose="p").token
        request, unmade, alone = (journal.acted(token).request_id for _ in range(3))
        journal.record("picture", {"request_id": request, "digest": (digest := picture.digest_of(text))})
        journal.record("picture", {"request_id": unmade, "reason": "PICTURE_CROWDED"})
        journal.ship()
        out = cell.tmp / "motion.html"

        def drawn(of, trust=cell.trust):
            return run("audit", "picture", of, "--as", "carol", "--trust", trust, "--out", out, "--json")

        assert [drawn(of).json["code"] for of in (request, unmade, alone)] == ["PICTURE_AWAITED", *["NO_PICTURE"] * 2]
        assert point.post("cell-1", "/ledger/pictures", {"picture": text}).status_code == 201
        other = cell.tmp / "other.json"
        other.write_bytes(replace(world.trust, ledger=frozenset({keys.public_raw(keys.generate())})).to_json())
        assert drawn(request, other).json["code"] == "PROOF_WRONG"
        with monkeypatch.context() as changed:
            changed.setattr(Operator, "entry", lambda self, number, real=Operator.entry: real(self, number - 1))
            assert drawn(request).json["code"] == "PROOF_WRONG"
        with monkeypatch.context() as changed:
            changed.setattr(Operator, "search_rows", lambda *_, **__: [{"seq": record_of(world, unmade)}])
            assert drawn(request).json["code"] == "NO_PICTURE", "the record is about another request"
        assert not out.exists()
        told = drawn(request)
        assert (told.status, told.json["digest"]) == (0, digest), told.err
        html = out.read_text()
        assert digest in html and json.loads(html.split('id="picture">')[1].split("</script>")[0]) == json.loads(text)
        assert out.stat().st_mode & 0o777 == 0o600
        world.sql("UPDATE pictures SET packed = :packed", packed=zlib.compress(text.replace("p1", "p2").encode()))
        out.unlink()
        assert drawn(request).json["code"] == "ANSWER_MALFORMED" and not out.exists()


def record_of(world, request_id):
    ((seq,),) = world.sql(f"SELECT seq FROM ledger_index WHERE kind = 'picture' AND request = '{request_id}'")
    return seq
