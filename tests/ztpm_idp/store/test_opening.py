"""A database that cannot be had ends in one line with its cause and place."""

from __future__ import annotations

import asyncio
import errno
import sqlite3
import threading

import pytest
from sqlalchemy.engine import make_url
from sqlalchemy.exc import OperationalError
from ztpm_idp.store.errors import StoreNotOpenedError, StoreUnavailableError

from ztpm_idp.store import engine


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
