"""Statements of the commands that come most often, as PostgreSQL takes them: by index, and by one text each."""

import asyncio
import json

import asyncpg
import pytest
from sqlalchemy.dialects import postgresql
from tests.ztpm_idp import postgres as databases
from ztpm_idp.domain.events import RevocationKind
from ztpm_idp.store import prepared

pytestmark = pytest.mark.xdist_group("postgres")

BY_IDS = (
    prepared.PARTIES, prepared.SUSPENDED, prepared.CONDUCT, prepared.STANDING, prepared.EDGES, prepared.REFUSALS,
)  # fmt: skip


def values(ids):
    """Each statement with these ids, or as many keys."""
    yield prepared.PARTIES_OF_KEYS, {"keys": [id_.encode() for id_ in ids]}
    yield from ((statement, {"ids": ids}) for statement in BY_IDS)
    yield prepared.NONCES, {"ids": ids, "young_ms": 1}
    yield prepared.MANDATES_OF, {"ids": ids, "since_s": 1}
    yield prepared.PEERS, {"agent_": "a"}
    yield prepared.AMONG, {kind.value: ids for kind in RevocationKind}


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


def test_a_longer_list_is_the_same_text():
    for statement, _ in values([]):
        text = compiled(statement).string
        assert "POSTCOMPILE" not in text  # which is written out anew for each length
        assert "VARCHAR(" not in text  # a cast that cuts what is longer
