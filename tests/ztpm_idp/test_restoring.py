"""Restoring a database: its revocations are a chain, and a restore begins a new line of it."""

from __future__ import annotations

import sqlite3
from contextlib import closing
from hashlib import sha256

import pytest
from tests.ztpm_idp.test_revoking import index
from tests.ztpm_idp.world import World, drop_latest_columns

from capabilities.statements import revocation

pytestmark = pytest.mark.long


def chained(told, head):
    for entry in told.entries:
        head = revocation.next_head(head, entry.epoch, entry.kind, entry.id)
    return head


@pytest.mark.clause("STM-14")
def test_the_head_is_that_of_everything_that_was_revoked(world):
    alice, heads = world.people["alice"], [revocation.FIRST_HEAD]
    assert (index(world).line, index(world).head) == (0, revocation.FIRST_HEAD)
    for number in range(3):
        world.agent(f"agent-{number}", attested=False)
        alice.revoke("agent", f"agent-{number}", "r")
        told = index(world)
        assert told.head == chained(told, revocation.FIRST_HEAD)
        heads.append(told.head)
    world.agent("eve", sponsor="bob", attested=False)
    alice.revoke("sponsor", "bob", "r")  # and an agent with it
    last = index(world)
    assert last.epoch == 5
    for since, head in enumerate(heads):
        assert chained(index(world, since=since), head) == last.head
    assert len({*heads, last.head}) == 5


@pytest.mark.clause("STM-14")
def test_a_head_is_the_digest_that_the_specification_says():
    first = "{:064x}".format(7)
    assert revocation.first_head(7) == first
    text = f'{{"epoch":1,"head":"{first}","id":"mover","kind":"agent"}}'
    assert revocation.next_head(first, 1, "agent", "mover") == sha256(text.encode()).hexdigest()


def test_revocations_of_an_earlier_release_are_chained(tmp_path):
    with World(tmp_path, database="sqlite") as world:
        for number in range(3):
            world.agent(f"agent-{number}", attested=False)
            world.people["alice"].revoke("agent", f"agent-{number}", "r")
        head = index(world).head
        world.stop()
        with closing(sqlite3.connect(tmp_path / "idp.sqlite")) as base, base:
            drop_latest_columns(base)
            base.execute("UPDATE alembic_version SET version_num = 'v0007'")
        world.start()
        assert (index(world).line, index(world).head) == (0, head)
