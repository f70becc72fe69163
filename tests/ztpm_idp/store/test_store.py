"""Store: its migration builds exactly the schema, its commits are durable, and its faults are 503 only."""

from __future__ import annotations

import logging
import sqlite3
from contextlib import closing

import pytest
import sqlalchemy as sa
from alembic import command
from alembic.autogenerate import compare_metadata
from alembic.config import Config
from alembic.migration import MigrationContext
from alembic.operations import Operations
from alembic.script import ScriptDirectory
from capabilities.proof.proof import prove
from tests.ztpm_idp.asks import Cell
from tests.ztpm_idp.journals import Journal
from tests.ztpm_idp.world import AUDIENCE, ISSUER, LATEST_TABLES, SLOWER, World, new_jti, drop_latest_columns
from ztpm_idp.bootstrap import FirstPerson, initialise
from ztpm_idp.provider.problems import Problem
from ztpm_idp.store.database.migrate import MIGRATIONS, NEWEST
from ztpm_idp.store.migrations.versions.from_27 import v0028_pushes as v0028
from ztpm_idp.store.migrations.versions.from_27 import v0031_pushed_latches as v0031
from ztpm_idp.store.schema import metadata
from ztpm_idp.store.transaction import Transaction

from capabilities.keys import keys
from ztpm_idp import ledger_file
from ztpm_idp.client import ClientError
from ztpm_idp.store import Store, StoreUnavailableError

pytestmark = pytest.mark.long


def on_connection(world, ask):
    async def go():
        async with world.provider.store._engine.connect() as connection:
            return await connection.run_sync(ask)

    return world.on_loop(go())


def test_the_migration_builds_the_schema(world):
    assert on_connection(world, lambda c: compare_metadata(MigrationContext.configure(c), metadata)) == []


def test_the_newest_revision_is_the_migrations_own():
    config = Config()
    config.set_main_option("script_location", str(MIGRATIONS))
    config.set_main_option("recursive_version_locations", "true")
    assert ScriptDirectory.from_config(config).get_current_head() == NEWEST


def test_a_newest_schema_is_opened_without_the_library_that_migrates(world, monkeypatch):
    monkeypatch.setattr(command, "upgrade", pytest.fail)
    world.stop()
    world.start()


def test_the_first_schema_is_migrated_with_its_rows(tmp_path):
    """A database of the first release, with people, an agent and a token in it, and nothing of approvals."""
    with World(tmp_path, database="sqlite") as world:
        planner = world.agent("planner")
        world.people["alice"].issue(planner, world.scope(), purpose="p")
        world.stop()
        file = tmp_path / "idp.sqlite"
        with closing(sqlite3.connect(file)) as base, base:
            for table in (
                "refusals",
                "change_words",
                "changes",
                "person_keys",
                "enrolments",
                "envelopes",
                "votes",
                "asks",
                "openings",
                "permits",
                "conduct",
                "edges",
            ):
                base.execute(f"DROP TABLE {table}")
            drop_latest_columns(base)
            base.execute("ALTER TABLE counters DROP COLUMN conduct_version")
            base.execute("ALTER TABLE agents DROP COLUMN workload")
            base.execute("UPDATE alembic_version SET version_num = 'v0001'")
            assert base.execute("SELECT count(*) FROM hops").fetchone() == (1,)
        before = first_rows(file)
        world.start()
        assert on_connection(world, lambda c: compare_metadata(MigrationContext.configure(c), metadata)) == []
        assert {
            n: [row[: len(old[0])] for row in rows] for n, rows in first_rows(file).items() if (old := before.get(n))
        } == {n: rows for n, rows in before.items() if rows}
        cell = Cell(world)
        ask_id, _ = cell.taken()
        assert world.people["carol"].approve(ask_id)["state"] == "granted"
        lines = world.people["carol"].export_ledger().splitlines()
        assert isinstance(ledger_file.verify(lines, world.trust), ledger_file.Verified)


def test_words_on_changes_stay_where_a_change_may_be_about_a_login(tmp_path):
    """SQLite makes a new table for a new constraint, and forgets no row that points at the old one."""
    with World(tmp_path, database="sqlite") as world:
        waits = world.people["dan"].propose_end("carol", "left")
        world.person("erin", "approver")
        world.stop()
        with closing(sqlite3.connect(tmp_path / "idp.sqlite")) as base, base:
            words = base.execute("SELECT * FROM change_words").fetchall()
            drop_latest_columns(base)
            base.execute("UPDATE alembic_version SET version_num = 'v0007'")
        assert len(words) == 1
        world.start()
        with closing(sqlite3.connect(tmp_path / "idp.sqlite")) as base:
            assert base.execute("SELECT * FROM change_words").fetchall() == words
            assert base.execute("PRAGMA foreign_key_check").fetchall() == []
        assert world.people["alice"].confirm_change(waits) == "done"


def test_pushes_of_questions_are_kept_where_latches_are_pushed_too(world):
    ask_id, _ = Cell(world).taken()
    row = {"tries": 3, "begun_ms": 1_800_000_000_000, "due_ms": 1_800_000_001_000, "code": "PUSH_REFUSED", "done": True}
    key = {"webhook": "cell", "event": "opened"}

    def migrate(connection):
        with Operations.context(MigrationContext.configure(connection)):
            metadata.tables["pushes"].drop(connection)
            v0028.upgrade()
            old = sa.Table("pushes", sa.MetaData(), autoload_with=connection)
            connection.execute(sa.insert(old).values(ask_id=ask_id, **key, **row))
            v0031.upgrade()
        (kept,) = connection.execute(sa.select(metadata.tables["pushes"])).mappings()
        assert dict(kept) == {"matter": "ask", "subject_id": ask_id, **key, **row}
        return compare_metadata(MigrationContext.configure(connection), metadata)

    assert on_connection(world, migrate) == []


def first_rows(file):
    with closing(sqlite3.connect(file)) as base:
        names = [n for (n,) in base.execute("SELECT name FROM sqlite_master WHERE type = 'table'")]
        return {
            n: base.execute(f"SELECT * FROM {n} ORDER BY 1, 2").fetchall()
            for n in names
            if n
            not in {
                *LATEST_TABLES,
                "refusals",
                "change_words",
                "changes",
                "person_keys",
                "enrolments",
                "envelopes",
                "asks",
                "votes",
                "openings",
                "permits",
                "conduct",
                "edges",
                "alembic_version",
                "counters",
            }
        }


def test_commits_are_durable_and_references_enforced(world):
    if world.database == "postgres":  # the server enforces references anyway
        assert world.sql("SELECT current_setting('synchronous_commit')") == [("on",)]
        return

    def pragmas(connection):
        return {
            name: connection.exec_driver_sql(f"PRAGMA {name}").scalar()
            for name in ("journal_mode", "synchronous", "foreign_keys")
        }

    assert on_connection(world, pragmas) == {"journal_mode": "wal", "synchronous": 2, "foreign_keys": 1}


def test_the_first_people_are_registered_once(world, tmp_path):
    def attempt(url, *people):
        with pytest.raises(Problem) as caught:
            world.on_loop(initialise(url, people=people))
        return caught.value.code

    raw, other = keys.public_raw(keys.generate()), keys.public_raw(keys.generate())
    fresh = f"sqlite+aiosqlite:///{tmp_path}/fresh.sqlite"
    admin = FirstPerson("eve", "Eve", raw, ("admin",))
    assert attempt(world.settings.database_url, admin) == "STORE_NOT_EMPTY"
    assert attempt(fresh) == "NO_ADMINISTRATOR"
    assert attempt(fresh, FirstPerson("eve", "Eve", raw, ("sponsor",))) == "NO_ADMINISTRATOR"
    assert attempt(fresh, admin, FirstPerson("eve", "Eve", other, ("admin",))) == "ALREADY_REGISTERED"
    assert attempt(fresh, admin, FirstPerson("mallory", "M", raw, ("admin",))) == "KEY_IN_USE"
    assert attempt(fresh, FirstPerson("Eve", "Eve", raw, ("admin",))) == "BODY_MALFORMED"
    assert attempt(fresh, FirstPerson("eve", "Eve", raw, ("king",))) == "BODY_MALFORMED"
    assert attempt(fresh, FirstPerson("eve", "Eve", bytes(32), ("admin",))) == "BODY_MALFORMED"
    world.on_loop(initialise(fresh, people=[admin]))


def test_a_store_that_cannot_be_opened(world, tmp_path):
    with pytest.raises(StoreUnavailableError):
        world.on_loop(Store.open(f"sqlite+aiosqlite:///{tmp_path}/no/such/folder/x.sqlite"))
    (tmp_path / "garbage.sqlite").write_bytes(b"this is no database at all" * 100)
    with pytest.raises(StoreUnavailableError):
        world.on_loop(Store.open(f"sqlite+aiosqlite:///{tmp_path}/garbage.sqlite"))


FAILURES = (
    sa.exc.OperationalError("statement", {}, Exception("disk I/O error")),
    sa.exc.OperationalError("statement", {}, Exception("database or disk is full")),
    sa.exc.OperationalError("statement", {}, Exception("database is locked")),
    TimeoutError("the server says nothing"),
)
"""Ways in which a call of the store fails, each call in another one than the call before."""


def everything(world):
    """(table -> rows) of what must not change when the store fails."""
    tables = (
        "parties",
        "agents",
        "hops",
        "revocations",
        "ledger",
        "tools",
        "asks",
        "votes",
        "openings",
        "peps",
        "records",
        "permits",
        "conduct",
        "edges",
        "refusals",
    )
    return {t: sorted(map(repr, world.sql(f"SELECT * FROM {t}"))) for t in tables}


@pytest.mark.parametrize("step", [4, pytest.param(1, marks=pytest.mark.campaign)])
def test_each_statement_of_each_change_fails_in_turn(world, step):
    """A fault at the n-th statement of the change, or at its commit: 503, nothing half done, and full recovery."""
    alice, planner, mover = world.people["alice"], world.agent("planner"), world.agent("mover")
    lent = alice.issue(planner, world.scope(), purpose="p")
    changes = {
        "register": lambda: alice.register_pep(
            f"cell-{new_jti().lower().strip('-_')}", keys.public_raw(keys.generate()), [ISSUER]
        ),
        "delegate": lambda: planner.delegate(lent.token, mover, SLOWER, purpose="p"),
        "revoke": lambda: alice.revoke("hop", keys.generate().private_bytes_raw()[:16].hex(), "r"),
    }
    cell = Cell(world, furnished=True)
    world.pep()
    ask_id, _ = cell.taken(agent="mover")
    journal = Journal(world, registered=True)
    own = alice.issue(mover, world.scope(), purpose="p").token
    for _ in range(20):  # so many that shipping them contracts the agent, which `restore` undoes
        journal.refused(own)
    journal.acted(own, None)
    journal.acted(own)
    changes |= {
        "ask": lambda: world.peps["cell-1"]._post("/approvals", {"ask": cell.text(agent="mover")}),
        "vote": lambda: alice.approve(ask_id),
        "ship": journal.ship,
        "restore": lambda: alice.restore_agent("mover", "r"),
        "open": lambda: alice.open_tier_4(audience=AUDIENCE, agent="mover", object="ur3e", operation="move_joint"),
    }
    engine = world.provider.store._engine.sync_engine
    for name, change in changes.items():
        failed, countdown = 0, [10**9]

        def fail(*_):
            countdown[0] -= 1
            if countdown[0] < 0:
                raise FAILURES[place % len(FAILURES)]

        sa.event.listen(engine, "before_cursor_execute", fail)
        sa.event.listen(engine, "commit", fail)
        try:
            before = everything(world)
            for place in range(0, 200, step):
                countdown[0] = place
                try:
                    change()
                except ClientError as error:
                    assert (error.code, error.status) == ("STORE_UNAVAILABLE", 503), name
                    countdown[0] = 10**9
                    assert everything(world) == before, (name, place)
                    failed += 1
                else:
                    countdown[0] = 10**9
                    assert everything(world) != before
                    break
            else:
                raise AssertionError("never succeeded")
        finally:
            sa.event.remove(engine, "before_cursor_execute", fail)
            sa.event.remove(engine, "commit", fail)
        assert failed >= 5 / step, name


def test_a_proof_store_that_cannot_answer_denies(world, monkeypatch):
    async def broken(self, **_):
        raise StoreUnavailableError

    monkeypatch.setattr(Store, "first_use", broken)
    with pytest.raises(ClientError) as caught:
        world.people["alice"].agents()
    assert caught.value.status == 503


def test_an_error_of_ours_is_a_500_without_its_message(world, monkeypatch, caplog):
    async def broken(self, wanted, **_):
        raise RuntimeError("canary-in-the-message")

    told = []
    # At its own logger: the handlers of all loggers belong to all that runs in this process.
    monkeypatch.setattr(logging.getLogger("ztpm_idp.app"), "error", lambda form, *args: told.append(form % args))
    monkeypatch.setattr(Transaction, "load_each", broken)
    with pytest.raises(ClientError) as caught:
        world.people["alice"].revoke("hop", "a" * 32, "canary-in-the-body")
    assert (caught.value.code, caught.value.status) == ("INTERNAL", 500)
    assert "canary" not in caplog.text + caught.value.detail + str(told)
    assert len(told) == 1 and "RuntimeError" in told[0]


def test_old_proofs_and_nonces_are_forgotten_but_not_too_soon(world):
    def count(table):
        return on_connection(world, lambda c: c.exec_driver_sql(f"SELECT count(*) FROM {table}").scalar())

    mover = world.agent("mover", attested=False)
    proofs = count("proofs")
    world.clock.at_s += 630
    mover.nonce()
    assert count("proofs") >= proofs
    assert count("nonces") == 1
    world.clock.at_s += 700
    mover.nonce()
    assert (count("proofs"), count("nonces")) == (1, 1)


def test_a_clock_set_back_brings_no_proof_to_life(world):
    once = prove(
        world.private["alice"],
        method="GET",
        url=ISSUER + "/agents",
        body=b"",
        token=None,
        at=int(world.clock()),
        jti=new_jti(),
    )
    with world.anonymous() as http:
        ask = lambda: http.get(ISSUER + "/agents", headers={"DPoP": once})
        assert ask().status_code == 200
        world.clock.at_s += 500
        assert ask().json()["code"] == "PROOF_STALE"
        world.people["alice"].agents()
        world.clock.at_s -= 500
        assert ask().json()["code"] == "REPLAYED"
