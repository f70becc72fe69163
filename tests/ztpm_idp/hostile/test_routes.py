"""Each route of the application has a row in `routes.toml`, and answers as its row says."""

from __future__ import annotations

from itertools import takewhile

import pytest
from capabilities.keys import keys
from tests.ztpm_idp.hostile import faults, matrix
from tests.ztpm_idp.hostile.scene import PAGES, REQUESTS, Scene
from tests.ztpm_idp.login.test_devices import Terminal
from tests.ztpm_idp.world import World
from ztpm_idp import ledger_file

from ztpm_idp.client import ClientError, Operator

pytestmark = pytest.mark.long
ALWAYS = {"nobody", "role", "another's", "right", "replayed"}
"""Columns of each row here; of the others each row has every third, and `make routes` all."""


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    with World(tmp_path_factory.mktemp("routes")) as world:
        yield Scene(world)


def test_every_route_has_a_row(scene):
    assert matrix.routes(scene.world.app) == {*matrix.rows(), *matrix.pages()}
    assert set(matrix.rows()) == set(REQUESTS)
    assert set(matrix.pages()) == set(PAGES)


def test_every_route_answers_every_caller_as_its_row_says(scene):
    """Nothing changes without a proof, and nothing that stands in the ledger is changed at all."""
    before, wrong = ledger(scene.world), []
    for number, row in enumerate(matrix.rows().values()):
        columns = tuple(c for n, c in enumerate(matrix.COLUMNS) if c in ALWAYS or (n + number) % 3 == 0)
        found = matrix.tried(scene, row, columns)
        wrong += [(row["at"], name, cell) for name, cell in found.items() if cell != row.get(name)]
    for row in matrix.pages().values():
        found = matrix.page_tried(scene, row)
        wrong += [(row["at"], name, cell) for name, cell in found.items() if cell != row.get(name)]
    assert wrong == []
    after = ledger(scene.world)
    assert after[: len(before)] == before
    exported = scene.world.people["alice"].export_ledger().splitlines()
    assert isinstance(ledger_file.verify(exported, scene.world.trust), ledger_file.Verified)


def ledger(world):
    return sorted((row["seq"], bytes(row["line"])) for row in world.rows("ledger"))


def test_strangers_who_fill_all_that_they_may_keep_nobody_from_recovering(scene):
    """Command lines of strangers wait in places of their own: the root key and people need none of them."""
    world = scene.world
    with pytest.raises(ClientError) as full:
        for _ in range(10_000):
            Terminal(world)
    assert full.value.code == "TOO_MANY_LOGINS"
    root = Operator("root", world.idp_keys.root, world.issuer, transport=world.transport, now=world.clock)
    change = root.recover("rescue", "Rescue", keys.public_raw(keys.generate()))
    assert [row["kind"] for row in world.people["alice"].changes() if row["change_id"] == change] == ["recovery"]
    assert world.people["alice"].revoke("agent", "other", "odd") > 0


def test_a_store_that_fails_once_leaves_nothing_half_done(tmp_path):
    """Each third command with one call of the store failing, in one way each; `make store-errors` tries every call."""
    found = faults.Found()
    with World(tmp_path) as world, faults.failing(world.provider.store._engine.sync_engine):
        scene = Scene(world)  # of its own: others leave as many waiting command lines there as may be
        for number, at in enumerate(faults.commands()[::3]):
            kind = faults.KINDS[number % len(faults.KINDS)]
            place = 0 if kind == faults.AFTER else number % 4
            assert faults.strike(scene, at, kind, place, found), at
        assert found.wrong == []
        assert set(found.struck) == set(faults.KINDS)
        assert faults.whole(world) == []


def test_a_clearing_that_counts_is_read_by_nothing_that_may_fail(scene):
    found, at = faults.Found(), "POST /latches/{latch_id}/clearings"
    with faults.failing(scene.world.provider.store._engine.sync_engine):
        struck = list(takewhile(lambda place: faults.strike(scene, at, "full or locked", place, found), range(100)))
    assert found.wrong == []
    assert 10 < len(struck) < 100


def test_a_commit_whose_word_was_lost_is_no_replay(scene):
    """The command's own commit uses the proof up: its loss is told as one of the store."""
    found = faults.Found()
    with faults.failing(scene.world.provider.store._engine.sync_engine):
        assert faults.strike(scene, "POST /revocations", faults.AFTER, 0, found)
    assert (found.wrong, dict(found.again)) == ([], {"200": 1})


def test_a_browser_that_logs_in_anew_does_so_in_one_commit(scene):
    """The link is spent, the new session begins and the former one ends together: no second commit could fail."""
    found, at = faults.Found(), "POST /login/links/{secret}"
    with faults.failing(scene.world.provider.store._engine.sync_engine):
        assert faults.strike(scene, at, faults.AFTER, 0, found)
        assert not faults.strike(scene, at, faults.AFTER, 1, found)
    assert (found.wrong, dict(found.again)) == ([], {"409 LOGIN_OVER": 1})
