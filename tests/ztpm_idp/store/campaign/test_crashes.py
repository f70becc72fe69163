"""kill -9 in the midst, on both databases: a slice of `make store-faults`."""

from __future__ import annotations

import json

import pytest
from tests.ztpm_idp.store.campaign.__main__ import Book
from tests.ztpm_idp.store.campaign.crashes import Found, at_every_point, at_random_instants
from tests.ztpm_idp.store.campaign.scene import Scene

pytestmark = [pytest.mark.xdist_group("postgres"), pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning")]


@pytest.mark.campaign
@pytest.mark.parametrize("database", ["sqlite", "postgres"])
def test_nothing_acknowledged_is_lost_and_nothing_is_half_done(tmp_path, database):
    scene, found = Scene(tmp_path, database, many=1), Found()
    try:
        at_every_point(scene, found, step=17, names=frozenset({"delegate"}))
        at_random_instants(scene, found, number=1, seed=1)
    finally:
        scene.close()
    assert found.points >= 2 and found.clean, found


def test_a_run_goes_on_by_its_ledger_and_takes_no_figures_of_other_sources(tmp_path):
    book = Book(tmp_path / "ledger")
    found, rounds = book.of("sqlite")
    found.places["revoke"], found.points = 7, 7
    rounds.played["vote"] += 3
    book.keep()
    assert Book(tmp_path / "ledger").of("sqlite") == (found, rounds)
    kept = json.loads((tmp_path / "ledger").read_bytes())
    (tmp_path / "ledger").write_text(json.dumps(kept | {"sources": "others"}))
    assert Book(tmp_path / "ledger").of("sqlite")[0].points == 0
