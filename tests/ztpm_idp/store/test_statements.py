"""Statements of the commands that come most often, as PostgreSQL takes them: by index, and by one text each."""

import asyncio
import json

import asyncpg
import pytest
import sqlalchemy as sa
from capabilities.keys import keys
from sqlalchemy.dialects import postgresql
from tests.ztpm_idp import postgres as databases
from ztpm_idp.bootstrap import FirstPerson, initialise
from ztpm_idp.store import AgainError, ConflictError, Store, StoreUnavailableError, prepared
from ztpm_idp.store import schema as t
from ztpm_idp.store.database.postgres_trips import fetch

pytestmark = pytest.mark.xdist_group("postgres")


def values(ids):
    """Each statement with these ids, or as many keys."""
    yield prepared.PARTIES_OF_KEYS, {"keys": [id_.encode() for id_ in ids]}
    yield from ((statement, {"ids": ids}) for statement in (prepared.STANDING, prepared.EDGES))
    yield prepared.PEERS, {"agent_": "a"}
    yield prepared.PEERS_OF_EACH, {"ids": ids}
    lists = {name: ids for part in prepared.JOINT.parts for name in part.lists}
    for part in prepared.JOINT.parts:
        if part.lists:  # the others read one row that is there
            yield part.select, lists | {"young_ms": 1, "since_s": 1}


def compiled(statement):
    return statement.compile(dialect=postgresql.asyncpg.dialect())


async def walked(url):
    """Scans that no condition on an index bounds, with what was asked."""
    connection, found = await asyncpg.connect(**databases.arguments(url)), []
    try:
        # Of tables without rows all plans cost the same; with these, a walk is the plan of what no index answers.
        await connection.execute("SET enable_seqscan = off; SET enable_hashjoin = off; SET enable_mergejoin = off")
        for statement, given in values(["a", "b"]):
            made = compiled(statement)
            known = made.params | given
            plan = await connection.fetchval(
                f"EXPLAIN (FORMAT JSON) {made.string}", *(known[name] for name in made.positiontup)
            )
            found += [(made.string[:60], node) for node in unbounded(json.loads(plan)[0]["Plan"])]
    finally:
        await connection.close()
    return found


def unbounded(node):
    """Names of the tables, or indexes, that a plan reads from one end to the other."""
    scans = {"Seq Scan", "Index Scan", "Index Only Scan", "Bitmap Index Scan"}
    if node["Node Type"] in scans and "Index Cond" not in node:
        yield node.get("Relation Name") or node["Index Name"]
    for below in node.get("Plans", ()):
        yield from unbounded(below)


def test_no_table_is_walked_through():
    assert asyncio.run(walked(databases.new_database())) == []


FAULTS = {
    "INSERT INTO heartbeat SELECT * FROM heartbeat": ConflictError,
    "DO $$ BEGIN RAISE SQLSTATE '40001'; END $$": AgainError,
    "SELECT 1 / 0": StoreUnavailableError,
}


@pytest.mark.parametrize("text", FAULTS)
def test_an_error_of_the_driver_is_one_of_the_store_and_nothing_holds(text):
    async def beats(store):
        async with store.glance() as view:
            return await view._scalar(sa.select(t.heartbeat.c.beats))

    async def go(url):
        store = await Store.open(url)
        try:
            before = await beats(store)
            with pytest.raises(FAULTS[text]) as caught:
                async with store.write() as transaction:
                    await fetch(transaction._connection, "UPDATE heartbeat SET beats = beats + 1")
                    await fetch(transaction._connection, text)
            assert await beats(store) == before
            await store.beat()  # the connection is good for the next one
            assert await beats(store) == before + 1
            return type(caught.value)
        finally:
            await store.close()

    assert asyncio.run(go(databases.new_database())) is FAULTS[text]


def test_joined_rows_are_those_of_each_select():
    async def go(url):
        await initialise(
            url, people=[FirstPerson("ann", "Ann", keys.public_raw(keys.generate()), ("sponsor", "admin"))]
        )
        store = await Store.open(url)
        try:
            every = {name: ["ann", "b"] for part in prepared.JOINT.parts for name in part.lists}
            given = every | {"young_ms": 1, "since_s": 1}
            async with store.read() as view:
                connection = view._connection
                apart = [(await connection.execute(part.select, given)).all() for part in prepared.JOINT.parts]
                joined = await prepared.JOINT.read(connection, given)
            return [[row._asdict() for row in rows] for rows in apart], [[r._asdict() for r in rows] for rows in joined]
        finally:
            await store.close()

    apart, joined = asyncio.run(go(databases.new_database()))
    assert joined == apart
    assert joined[0][0]["roles"] == ["admin", "sponsor"]


def test_a_longer_list_is_the_same_text():
    for statement, _ in values([]):
        text = compiled(statement).string
        assert "POSTCOMPILE" not in text  # which is written out anew for each length
        assert "VARCHAR(" not in text  # a cast that cuts what is longer
