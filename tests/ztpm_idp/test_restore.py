"""A copy of the store that is put back: it takes back what is known elsewhere before it lends anything."""

from __future__ import annotations

import json
import sqlite3
import stat
from contextlib import closing

import pytest
import sqlalchemy as sa
from alembic.autogenerate import compare_metadata
from alembic.runtime.migration import MigrationContext
from policies.decision.load import load_shipped
from tests.ztpm_idp.asks import Cell
from tests.ztpm_idp.test_revoking import index
from tests.ztpm_idp.world import AUDIENCE, ISSUER, SLOWER, World
from ztpm_idp.restore import StoppedProvider, RestoreError, backup, place_of, restore
from ztpm_idp.store.database.copies import copy_file
from ztpm_idp.store.schema import metadata

from capabilities.keys import keys
from capabilities.statements import mark
from ztpm_idp import ledger_file
from ztpm_idp.client import Agent, ClientError, Operator

pytestmark = pytest.mark.long


def copied(world, name="copy.sqlite"):
    backup(world.settings.database_url, world.folder / name)
    return world.folder / name


def put_back(world, copy=None, **more):
    """The service ends, the copy is put back, and the service starts."""
    world.stop()
    deployment = StoppedProvider(world.settings, world.idp_keys, load_shipped("paper-default"), world.clock)
    done = restore(deployment, copy, **more)
    begin(world)
    return done


def begin(world):
    world.start()
    for callers in (world.people, world.peps):
        callers |= {name: world.caller(Operator, name) for name in callers}
    world.agents |= {name: world.caller(Agent, name, agent.measurement) for name, agent in world.agents.items()}


def tell(world, name="cell-1", *entries, **more):
    """An enforcement point tells its mark."""
    told = tuple(mark.MarkEntry(kind, id_) for kind, id_ in sorted(entries))
    stated = {"line": 0, "epoch": 9, "head": "", "remaining": 0, "at": int(world.clock())} | more
    text = mark.sign(mark.Mark(issuer=ISSUER, entries=told, **stated), world.private[name])
    assert world.peps[name]._post("/restoring/marks", {"mark": text}) == {"taken": True}


def refused(act):
    with pytest.raises(ClientError) as caught:
        act()
    return caught.value.code


def entries(world):
    lines = world.people["carol"].export_ledger().splitlines()
    assert isinstance(ledger_file.verify(lines, world.trust), ledger_file.Verified)
    return [json.loads(line) for line in lines[:-1]]


def revoked(world):
    return {(entry.kind, entry.id) for entry in index(world).entries}


@pytest.fixture
def furnished(world, monkeypatch):
    """Two agents, one point, a token; then a copy; then what the copy does not hold."""
    monkeypatch.chdir(world.folder)
    world.pep()
    world.agent("planner")
    world.agent("mover")
    world.agent("early", attested=False)
    world.people["alice"].revoke("agent", "early", "r")
    world.copy = copied(world)
    return world


def test_a_copy_is_whole_private_and_made_while_it_serves(furnished):
    copy = furnished.copy
    assert stat.S_IMODE(copy.stat().st_mode) == 0o600
    assert sorted(path.name for path in furnished.folder.glob("copy*")) == ["copy.sqlite"]
    with closing(sqlite3.connect(copy)) as base:
        assert base.execute("SELECT kind, id FROM revocations").fetchall() == [("agent", "early")]
    with pytest.raises(RestoreError) as caught:
        copied(furnished)
    assert caught.value.code == "EXISTS"
    for nothing in ("postgresql+asyncpg://idp@/ztpm?host=/no/such/socket", "sqlite+aiosqlite:////no/such.sqlite"):
        with pytest.raises(RestoreError) as caught:
            backup(nothing, furnished.folder / "other")
        assert caught.value.code == "UNREADABLE"
        assert not (furnished.folder / "other").exists()


def test_an_agent_that_was_suspended_after_the_copy_is_suspended_in_it(furnished):
    alice = furnished.people["alice"]
    alice.suspend_agent("mover", "look into it")
    alice.suspend_agent("planner", "look into it")
    alice.restore_agent("planner", "nothing found")
    put_back(furnished, furnished.copy)
    tell(furnished)
    furnished.people["alice"].resume([])
    standing = {row["id"]: row["status"] for row in furnished.people["alice"].agents()}
    assert standing == {"planner": "active", "mover": "suspended", "early": "revoked"}


def test_what_the_store_before_had_revoked_is_revoked_in_the_copy(furnished):
    alice = furnished.people["alice"]
    alice.revoke("agent", "mover", "odd")
    alice.revoke("hop", "a" * 32, "r")
    furnished.agent("late", attested=False)
    alice.set_trust("planner", 500)
    done = put_back(furnished, furnished.copy)
    assert (done.line, done.taken_back, done.waits_for, done.held, done.before) == (1, 2, ("cell-1",), 1, "whole")
    assert done.kept.name.endswith(".before-1")
    tell(furnished)
    furnished.people["alice"].resume([])
    assert index(furnished).line == 1
    assert revoked(furnished) == {("agent", "early"), ("agent", "mover"), ("hop", "a" * 32)}
    status = {row["id"]: (row["status"], row["held"]) for row in furnished.people["alice"].agents()}
    assert status == {"planner": ("active", True), "mover": ("revoked", False), "early": ("revoked", False)}
    told = [(e["kind"], e["actor"]) for e in entries(furnished)]
    begun = told.index(("store-restored", "restore"))
    assert told[begun:] == [
        ("store-restored", "restore"),
        ("agents-held", "restore"),
        ("revoked", "restore"),
        ("revoked", "restore"),
        ("point-heard", "cell-1"),
        ("store-resumed", "alice"),
    ]


@pytest.mark.parametrize("gone", [False, True])
def test_a_damaged_or_missing_store_is_made_up_from_ledgers_and_marks(furnished, gone):
    furnished.people["alice"].revoke("agent", "mover", "odd")
    exported, signed = furnished.folder / "ledger.ndjson", furnished.folder / "mark"
    exported.write_bytes(furnished.people["carol"].export_ledger())
    told = mark.Mark(ISSUER, 0, 3, "", (mark.MarkEntry("key", "A" * 43),), 0, int(furnished.clock()))
    signed.write_text(mark.sign(told, furnished.private["cell-1"]) + "\n")
    furnished.stop()
    furnished.lose(damaged=not gone)
    deployment = StoppedProvider(furnished.settings, furnished.idp_keys, load_shipped("paper-default"), furnished.clock)
    wrong = furnished.folder / "wrong"
    for content, code in (
        (exported.read_bytes().replace(b"odd", b"ode"), "CHAIN_BROKEN"),
        (b"".join(exported.read_bytes().splitlines(keepends=True)[:-1]), "CHECKPOINT_MISSING"),
        (b"", "ENTRY_MALFORMED"),
    ):
        wrong.write_bytes(content)
        with pytest.raises(RestoreError) as caught:
            restore(deployment, furnished.copy, ledgers=[wrong])
        assert caught.value.code == code
    wrong.write_text(mark.sign(told, keys.generate()))
    with pytest.raises(RestoreError) as caught:
        restore(deployment, furnished.copy, marks=[wrong])
    assert caught.value.code == "STATEMENT_UNTRUSTED"
    assert furnished.lost, "nothing was put in its place"
    done = restore(deployment, furnished.copy, ledgers=[exported], marks=[signed])
    assert (done.taken_back, done.waits_for, done.before) == (2, (), "nothing")
    assert (done.kept is None) is gone
    begin(furnished)
    furnished.people["alice"].resume([])
    assert revoked(furnished) == {("agent", "early"), ("agent", "mover"), ("key", "A" * 43)}


def test_it_is_refused_while_it_serves_and_with_a_copy_that_is_none(furnished):
    deployment = StoppedProvider(furnished.settings, furnished.idp_keys, load_shipped("paper-default"), furnished.clock)
    with pytest.raises(RestoreError) as caught:
        restore(deployment, furnished.copy)
    assert caught.value.code == "STORE_IN_USE"
    furnished.stop()
    other = furnished.folder / "other.sqlite"
    with closing(sqlite3.connect(other)) as base:
        base.execute("CREATE TABLE ledgers (x)")
    for content in (other.read_bytes(), b"no database " * 999, b""):
        other.write_bytes(content)
        with pytest.raises(RestoreError) as caught:
            restore(deployment, other)
        assert caught.value.code == "COPY_UNUSABLE"
    furnished.start()
    assert index(furnished).line == 0
    assert not list(furnished.folder.glob("*.restoring*"))


def test_until_it_resumes_it_lends_nothing_and_tells_nothing(furnished):
    lent = furnished.people["alice"].issue(furnished.agents["planner"], furnished.scope(), purpose="p")
    cell = Cell(furnished, furnished=True)
    put_back(furnished, furnished.copy)
    alice, planner, point = furnished.people["alice"], furnished.agents["planner"], furnished.peps["cell-1"]
    for act in (
        lambda: alice.issue(planner, furnished.scope(), purpose="p"),
        lambda: planner.delegate(lent.token, furnished.agents["mover"], SLOWER, purpose="p"),
        lambda: point._post("/approvals", {"ask": cell.text(agent="mover")}),
        lambda: point._send("GET", f"/registry?audience={AUDIENCE}", b"", None),
        lambda: point._send("GET", f"/conduct?since=0&nonce={'n' * 32}", b"", None),
        lambda: point._send("GET", f"/approvals/answers?audience={AUDIENCE}&nonce={'n' * 32}", b"", None),
    ):
        assert refused(act) == "RESTORING"
    with furnished.anonymous() as http:
        answer = http.get(f"{ISSUER}/revocations", params={"since": "0", "nonce": "n" * 32})
        assert (answer.status_code, answer.json()["code"]) == (503, "RESTORING")
        assert "cell-1" not in answer.text, "strangers are not told who is awaited"
    alice.revoke("hop", "b" * 32, "authority is taken back at any time")
    furnished.stop()
    begin(furnished)
    assert refused(lambda: furnished.people["alice"].resume([])) == "POINTS_UNHEARD", "over a restart, too"
    tell(furnished)
    furnished.people["alice"].resume([])
    assert ("hop", "b" * 32) in revoked(furnished)


def test_while_a_point_was_not_heard_every_agent_waits_for_an_administrator(furnished):
    furnished.pep("cell-2")
    lent = furnished.people["alice"].issue(furnished.agents["planner"], furnished.scope(), purpose="p")
    copy = copied(furnished, "second.sqlite")
    put_back(furnished, copy)
    tell(furnished)
    alice, bob = furnished.people["alice"], furnished.people["bob"]
    for wrong in ([], ["cell-1"], ["cell-1", "cell-2"]):
        assert refused(lambda wrong=wrong: alice.resume(wrong)) == "POINTS_UNHEARD"
    assert refused(lambda: bob.resume(["cell-2"])) == "NOT_PERMITTED"
    alice.resume(["cell-2"])
    planner, mover = furnished.agents["planner"], furnished.agents["mover"]
    assert refused(lambda: alice.issue(planner, furnished.scope(), purpose="p")) == "AGENT_HELD"
    assert refused(lambda: planner.delegate(lent.token, mover, SLOWER, purpose="p")) == "AGENT_HELD"
    assert refused(lambda: bob.vouch("mover", "mine")) == "NOT_PERMITTED"
    alice.vouch("mover", "looked into")
    assert refused(lambda: planner.delegate(lent.token, mover, SLOWER, purpose="p")) == "AGENT_HELD", (
        "its lender is held"
    )
    alice.vouch("planner", "looked into")
    assert planner.delegate(lent.token, mover, SLOWER, purpose="p").token
    assert alice.issue(planner, furnished.scope(), purpose="p").token
    # The other point comes after all: once, and for what it knows.
    tell(furnished, "cell-2", ("agent", "mover"))
    tell(furnished, "cell-2", ("agent", "planner"))
    assert revoked(furnished) == {("agent", "early"), ("agent", "mover")}
    assert [e["kind"] for e in entries(furnished)].count("point-heard") == 2


@pytest.mark.clause("STM-15")
def test_a_copy_that_is_put_back_twice_begins_no_line_that_was_followed(furnished):
    assert put_back(furnished, furnished.copy).line == 1
    tell(furnished)
    furnished.people["alice"].resume([])
    assert put_back(furnished, furnished.copy).line == 2, "the ledger of the store before names the line"
    furnished.stop()
    furnished.lose()
    furnished.start()
    furnished.stop()
    furnished.lose()
    deployment = StoppedProvider(furnished.settings, furnished.idp_keys, load_shipped("paper-default"), furnished.clock)
    assert restore(deployment, furnished.copy).line == 1, "nothing that is left names it"
    begin(furnished)
    tell(furnished, line=2)
    furnished.people["alice"].resume([])
    assert index(furnished).line == 3


def test_a_store_that_somebody_copied_back_by_hand_is_announced_where_it_stands(furnished):
    furnished.stop()
    for path in furnished.folder.glob("idp.sqlite*"):
        path.unlink()
    (furnished.folder / "idp.sqlite").write_bytes(furnished.copy.read_bytes())
    furnished.start()
    assert put_back(furnished).line == 1
    assert refused(lambda: furnished.agents["planner"].nonce()) == "RESTORING"


def test_a_long_mark_comes_in_parts(furnished):
    put_back(furnished, furnished.copy)
    hops = [("hop", f"{number:032x}") for number in range(5)]
    tell(furnished, "cell-1", *hops[:3], remaining=1)
    assert refused(lambda: furnished.people["alice"].resume([])) == "POINTS_UNHEARD"
    tell(furnished, "cell-1", *hops[3:])
    furnished.people["alice"].resume([])
    assert revoked(furnished) == {("agent", "early"), *hops}


@pytest.mark.xdist_group("postgres")
@pytest.mark.parametrize(("first", "second"), [("sqlite", "postgres"), ("postgres", "sqlite")])
def test_a_provider_moves_from_one_database_to_the_other_by_a_copy(tmp_path, first, second):
    """All of it, to the last column: the copy of the copy is the same."""
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
    with World(tmp_path / "a", database=first) as one, World(tmp_path / "b", database=second) as two:
        planner, mover = one.agent("planner"), one.agent("mover")
        lent = one.people["alice"].issue(planner, one.scope(), purpose="p")
        planner.delegate(lent.token, mover, SLOWER, purpose="p")
        one.people["alice"].revoke("hop", "a" * 32, "r")
        one.people["alice"].suspend_agent("mover", "r")
        one.pep()
        copy = copied(one)
        two.stop()
        two.private, two.idp_keys, two.trust = one.private, one.idp_keys, one.trust
        deployment = StoppedProvider(two.settings, two.idp_keys, load_shipped("paper-default"), two.clock)
        place_of(two.settings.database_url, tmp_path).put(copy_file_of(copy, tmp_path / "staged"), 0)
        again = tmp_path / "again.sqlite"
        backup(two.settings.database_url, again)
        assert rows_of(again) == rows_of(copy)
        done = restore(deployment, copy)
        assert (done.line, done.before) == (1, "whole")
        begin(two)
        two.peps = {"cell-1": two.caller(Operator, "cell-1")}
        tell(two)
        two.people["alice"].resume([])
        assert revoked(two) == {("hop", "a" * 32)}
        assert {row["id"]: row["status"] for row in two.people["alice"].agents()} == {
            "planner": "active", "mover": "suspended"
        }  # fmt: skip


def copy_file_of(copy, destination):
    copy_file(copy, destination)
    return destination


def rows_of(file):
    with closing(sqlite3.connect(file)) as base:
        names = [n for (n,) in base.execute("SELECT name FROM sqlite_master WHERE type = 'table' ORDER BY name")]
        return {n: sorted(base.execute(f"SELECT * FROM {n}"), key=repr) for n in names}


def test_a_copy_of_a_server_has_the_schema_of_a_store(world):
    with closing(sqlite3.connect(copied(world))) as base, closing(sqlite3.connect(":memory:")) as other:
        base.backup(other)
        engine = sa.create_engine("sqlite://", creator=lambda: other, poolclass=sa.StaticPool)
        with engine.connect() as connection:
            assert compare_metadata(MigrationContext.configure(connection), metadata) == []
