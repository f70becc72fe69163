"""SQLite without a thread for each statement: what waits lets the loop go on, and nothing overtakes it."""

import asyncio
import sqlite3
import threading

import pytest
from ztpm_idp.store import Store, StoreUnavailableError
from ztpm_idp.store.database.sqlite_driver import _waited, connect

TURNS = 20


@pytest.fixture
def path(tmp_path):
    path = tmp_path / "some.sqlite"
    with sqlite3.connect(path) as made:
        made.execute("PRAGMA journal_mode = WAL")
        made.execute("CREATE TABLE rows (n INTEGER UNIQUE)")
    made.close()
    return path


async def turned():
    for _ in range(TURNS):
        await asyncio.sleep(0)


def test_a_writer_waits_for_another_process_while_the_loop_goes_on(path):
    other = sqlite3.connect(path, isolation_level=None)

    async def go():
        mine = await connect(str(path), isolation_level=None)
        cursor = mine.cursor()
        await cursor.execute("PRAGMA busy_timeout = 5000")
        other.execute("BEGIN IMMEDIATE")
        begun = asyncio.create_task(cursor.execute("BEGIN IMMEDIATE"))
        await turned()
        assert not begun.done()
        other.execute("COMMIT")
        await begun
        assert mine._conn.in_transaction
        await cursor.execute("PRAGMA busy_timeout")
        assert await cursor.fetchall() == [(5000,)]
        await mine.close()

    asyncio.run(go())
    other.close()


def test_impatience_is_an_error(path):
    other = sqlite3.connect(path, isolation_level=None)
    other.execute("BEGIN IMMEDIATE")

    async def go():
        mine = await connect(str(path), isolation_level=None, timeout=0)
        with pytest.raises(sqlite3.OperationalError, match="locked"):
            await mine.cursor().execute("BEGIN IMMEDIATE")
        await mine.close()

    asyncio.run(go())
    other.close()


def test_what_is_cancelled_while_it_waits_has_ended_before_anything_follows():
    may_end, ended = threading.Event(), []

    def slow():
        may_end.wait(10)
        ended.append(True)

    async def go():
        call = asyncio.create_task(_waited(slow))
        await turned()
        call.cancel()
        await turned()
        assert not call.done()
        may_end.set()
        with pytest.raises(asyncio.CancelledError):
            await call
        assert ended == [True]

    asyncio.run(go())


def test_statements_run_where_they_are_asked_for_and_a_commit_does_not(path):
    async def go():
        mine = await connect(str(path), isolation_level=None)
        here, seen = threading.get_ident(), []
        mine._conn.create_function("seen", 1, lambda n: seen.append(threading.get_ident()) or n)
        cursor = mine.cursor()
        await cursor.execute("BEGIN")
        await cursor.execute("INSERT INTO rows VALUES (seen(1))")
        await cursor.executemany("INSERT INTO rows VALUES (seen(?))", [(2,), (3,)])
        assert seen == [here] * 3
        await cursor.execute("PRAGMA user_version")
        await cursor.execute("SELECT n FROM rows ORDER BY n")
        assert cursor.description[0][0] == "n"
        assert [await cursor.fetchone(), await cursor.fetchmany(1), await cursor.fetchall()] == [(1,), [(2,)], [(3,)]]
        await mine.rollback()
        await cursor.execute("SELECT count(*) FROM rows")
        assert await cursor.fetchall() == [(0,)]
        await mine.close()
        await mine.close()
        with pytest.raises(ValueError, match="no active connection"):
            mine.cursor()

    asyncio.run(go())


def test_a_store_whose_commit_fails_says_so_and_keeps_nothing(tmp_path, monkeypatch):
    async def go():
        store = await Store.open(f"sqlite+aiosqlite:///{tmp_path}/idp.sqlite")
        use = dict(key=bytes(32), jti="x", expires_ms=1_000, at_ms=1)

        def torn(function):
            raise sqlite3.OperationalError("disk I/O error")

        with monkeypatch.context() as patched:
            patched.setattr("ztpm_idp.store.database.sqlite_driver._waited", torn)
            with pytest.raises(StoreUnavailableError):
                await store.first_use(**use)
        assert await store.first_use(**use)
        assert not await store.first_use(**use)
        await store.close()

    asyncio.run(go())
