"""Enforcement points confirm how far they follow the feed: by their key, freshly, and never backwards."""

from __future__ import annotations

import json

import pytest
from tests.ztpm_idp.world import ISSUER, World

from capabilities.keys import keys
from capabilities.statements import mark
from ztpm_idp.client import ClientError

pytestmark = pytest.mark.clause("STM-17")


@pytest.fixture(scope="module")
def furnished(tmp_path_factory):
    with World(tmp_path_factory.mktemp("points")) as world:
        world.pep("cell-1"), world.pep("cell-2")
        world.agent("planner", attested=False)
        for number in range(3):
            world.people["alice"].revoke("hop", f"{number:032x}", "r")
        yield world


def signed(world, key="cell-1", **changes):
    stated = dict(issuer=ISSUER, line=0, epoch=2, head="a" * 64, entries=(), remaining=0, at=int(world.clock()))
    return mark.sign(mark.Mark(**(stated | changes)), world.private[key] if isinstance(key, str) else key)


def post(world, text):
    with world.anonymous() as http:
        return http.post(ISSUER + "/revocations/marks", content=json.dumps({"mark": text}).encode())


def told(world, name="cell-1", by="bob"):
    return next(point for point in world.people[by].points()["points"] if point["pep"] == name)


def test_the_highest_mark_counts_with_the_time_at_which_it_came(furnished):
    world = furnished
    assert told(world, "cell-2") == {
        "pep": "cell-2", "audiences": ["http://127.0.0.1:8800/mcp"], "line": -1, "epoch": -1, "confirmed_ms": 0, "heard_ms": 0, "connected": False,
    }  # fmt: skip
    for epoch, confirmed, heard in ((1, 0, 0), (2, 1, 1), (2, 1, 2), (0, 1, 3), (3, 4, 4)):
        began = int(world.clock() * 1_000)
        assert post(world, signed(world, epoch=epoch)).json() == {"taken": True}
        seen = told(world)
        assert (seen["epoch"], seen["heard_ms"], seen["connected"]) == (max(epoch, seen["epoch"]), began, True)
        assert (seen["confirmed_ms"] == began) is (confirmed == heard)
        world.clock.at_s += 1
    world.clock.at_s += 31
    assert told(world)["connected"] is False
    assert told(world)["epoch"] == 3
    assert world.people["bob"].points()["epoch"] == 3


@pytest.mark.parametrize("changes", [
    {"issuer": ISSUER + "x"}, {"line": 1}, {"epoch": 4}, {"remaining": 1}, {"entries": (mark.MarkEntry("agent", "mover"),)},
    {"at": 1_799_999_000}, {"at": 1_900_000_000}, {"key": "alice"}, {"key": "planner"}, {"key": keys.generate()},
])  # fmt: skip
def test_other_marks_change_nothing(furnished, changes):
    before = told(furnished)
    answer = post(furnished, signed(furnished, **changes))
    assert (answer.status_code, answer.json()["code"]) == (403, "STATEMENT_UNTRUSTED")
    assert told(furnished) == before


@pytest.mark.parametrize("text", ["", "x", "a.b.c", "e30.e30.AA", "x" * 5_000, 5, None])
def test_no_marks(furnished, text):
    answer = post(furnished, text)
    assert answer.json()["code"] in {"STATEMENT_MALFORMED", "BODY_MALFORMED", "BODY_TOO_LARGE", "TEXT_REFUSED"}


def test_people_alone_are_shown_the_points(furnished):
    with pytest.raises(ClientError) as caught:
        furnished.peps["cell-1"].points()
    assert caught.value.code == "NOT_PERMITTED"


def test_many_at_once_are_written_together(furnished, monkeypatch):
    import asyncio

    from ztpm_idp.provider.confirmations import Confirmations

    world = furnished
    written = []
    store = world.provider.store
    inner = store.beside
    monkeypatch.setattr(store, "beside", lambda: written.append(1) or inner())

    async def go():
        taking = Confirmations(store)
        at_ms = world.provider.now_ms()
        await asyncio.gather(
            *(taking.take(pep, line=0, epoch=3, at_ms=at_ms + n) for n in range(20) for pep in ("cell-1", "cell-2"))
        )

    world.on_loop(go())
    assert len(written) <= 3
    assert told(world, "cell-2")["epoch"] == 3
