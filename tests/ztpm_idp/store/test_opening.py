"""A database that cannot be had ends in one line with its cause and place."""

from __future__ import annotations

import asyncio
import errno
import sqlite3
import ssl
import threading

import pytest
from sqlalchemy.engine import make_url
from sqlalchemy.exc import OperationalError
from tests.ztpm_idp import postgres
from ztpm_idp.store.errors import StoreNotOpenedError, StoreUnavailableError
from ztpm_idp.store.database.migrate import NEWEST

from ztpm_idp.store import engine
from ztpm_idp.store.database import postgres as servers


async def opened(path):
    """The store, or its fault, once aiosqlite's thread has answered this loop, which ends then."""
    before = set(threading.enumerate())
    try:
        return await engine.Store.open(f"sqlite+aiosqlite:///{path}")
    finally:
        for thread in set(threading.enumerate()) - before:
            while "_connection_worker_thread" in thread.name and thread.is_alive():  # noqa: ASYNC110 - a thread sets no event
                await asyncio.sleep(0.001)


def code_of(path):
    with pytest.raises(StoreNotOpenedError) as caught:
        asyncio.run(opened(path))
    assert str(path) in caught.value.sentence and "\n" not in str(caught.value)
    return caught.value.code


@pytest.fixture
def database(tmp_path):
    path = tmp_path / "idp.sqlite"

    async def made():
        await (await engine.Store.open(f"sqlite+aiosqlite:///{path}")).close()

    asyncio.run(made())
    return path


def test_of_a_newer_release(database):
    connection = sqlite3.connect(database)
    connection.execute("update alembic_version set version_num = 'f00dfeedf00d'")
    connection.commit()
    connection.close()
    assert code_of(database) == "DATABASE_NEWER"


def test_that_is_none(tmp_path):
    path = tmp_path / "idp.sqlite"
    path.write_bytes(b"no database " * 1_000)
    path.chmod(0o600)
    assert code_of(path) == "DATABASE_UNUSABLE"


def test_in_no_folder(tmp_path):
    assert code_of(tmp_path / "missing" / "idp.sqlite") == "DATABASE_UNUSABLE"


def test_that_is_a_folder(tmp_path):
    assert code_of(tmp_path) == "DATABASE_UNUSABLE"


def test_on_a_full_disk(tmp_path, monkeypatch):
    def full(_):
        raise OSError(errno.ENOSPC, "No space left on device")

    monkeypatch.setattr(engine, "_make_private", full)
    assert code_of(tmp_path / "idp.sqlite") == "DISK_FULL"


def test_that_fills_its_disk():
    error = StoreUnavailableError()
    error.__cause__ = OperationalError("insert", {}, sqlite3.OperationalError("database or disk is full"))
    assert engine._not_opened(error, make_url("sqlite+aiosqlite:////idp.sqlite")).code == "DISK_FULL"


def server_code(url):
    with pytest.raises(StoreNotOpenedError) as caught:
        asyncio.run(engine.Store.open(url))
    assert "\n" not in str(caught.value)
    return caught.value.code


async def opened_by(number, url):
    """As many stores as processes that begin together."""
    stores = await asyncio.gather(*(engine.Store.open(url) for _ in range(number)))
    for store in stores:
        await store.close()
    return sorted((store.before for store in stores), key=str)


@pytest.mark.xdist_group("postgres")
def test_a_server_is_migrated_once_and_refused_where_it_is_newer_or_forgets():
    url = postgres.new_database("template0")
    try:
        assert asyncio.run(opened_by(3, url)) == [None, NEWEST, NEWEST]
        name = postgres.name_of(url)
        asyncio.run(postgres.execute("UPDATE alembic_version SET version_num = 'f00dfeedf00d'", name))
        assert server_code(url) == "DATABASE_NEWER"
        asyncio.run(postgres.execute(f"UPDATE alembic_version SET version_num = '{NEWEST}'", name))
        asyncio.run(postgres.execute(f"ALTER DATABASE {name} SET synchronous_commit = off"))
        assert server_code(url) == "DATABASE_UNSAFE"
    finally:
        postgres.drop(url)
    assert server_code(url) == "DATABASE_UNUSABLE"


@pytest.mark.parametrize(("host", "verified"), [("db.example", True), ("127.0.0.1", False), ("localhost", False)])
def test_a_server_beyond_this_machine_is_reached_by_verified_tls(host, verified, monkeypatch):
    monkeypatch.delenv("PGSSLROOTCERT", raising=False)
    context = servers._tls(make_url(f"postgresql+asyncpg://idp@{host}/ztpm"))
    if verified:
        assert (context.check_hostname, context.verify_mode) == (True, ssl.CERT_REQUIRED)
    else:
        assert context is False
    assert servers._tls(make_url("postgresql+asyncpg://idp@/ztpm?host=/run/postgresql")) is False


def test_an_authority_that_cannot_be_read(monkeypatch):
    monkeypatch.setenv("PGSSLROOTCERT", "/no/such/authority.pem")
    assert server_code("postgresql+asyncpg://idp@db.example/ztpm") == "DATABASE_UNSAFE"


def test_databases_that_several_threads_make_at_once_are_all_made(tmp_path):
    """Alembic keeps its database in a module: of two at once, one broke and one waited for ever."""
    places = [tmp_path / f"{n}.sqlite" for n in range(4)]

    async def made(path):
        await (await engine.Store.open(f"sqlite+aiosqlite:///{path}")).close()

    threads = [threading.Thread(target=lambda path=path: asyncio.run(made(path)), daemon=True) for path in places]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(60)
    assert not any(thread.is_alive() for thread in threads)
    for path in places:
        connection = sqlite3.connect(path)
        assert connection.execute("select version_num from alembic_version").fetchall() == [(NEWEST,)]
        connection.close()
