"""`GET /revocations/wait`: answers at the commit, not before; bounded in time and number; holds up no shutdown."""

from __future__ import annotations

import asyncio
import threading
import time

import pytest
from capabilities.statements import revocation
from capabilities.values.caps import DEFAULT as CAPS
from tests.ztpm_idp.world import ISSUER
from ztpm_idp.provider.epoch_wait import EpochWait
from ztpm_idp.provider.news import NONCE
from ztpm_idp.provider.problems import Problem

from ztpm_idp.store import StoreUnavailableError


def ask(world, since, **more):
    with world.anonymous() as http:
        return http.get(ISSUER + "/revocations/wait", params={"since": str(since)} | more)


def test_an_epoch_that_has_passed_is_answered_at_once(world):
    assert world.people["alice"].revoke("hop", "a" * 32, "test") == 1
    answer = ask(world, 0)
    assert (answer.status_code, answer.json()) == (200, {"epoch": 1})


def test_a_waiter_is_answered_by_the_revocation(world):
    got = []
    waiter = threading.Thread(target=lambda: got.append(ask(world, 0)), daemon=True)
    waiter.start()
    deadline = time.monotonic() + 20
    while world.provider.epochs._waiting == 0:
        assert time.monotonic() < deadline
        time.sleep(0.001)
    world.agent("mover")  # other commits wake nobody
    assert got == []
    world.people["alice"].revoke("agent", "mover", "test")
    waiter.join(20)
    assert got[0].json() == {"epoch": 1}
    assert world.provider.epochs._waiting == 0


@pytest.mark.parametrize("since", ["", "-1", "x", "01", "1" * 20, "1.0"])
def test_what_is_no_epoch(world, since):
    answer = ask(world, since)
    assert (answer.status_code, answer.json()["code"]) == (400, "QUERY_MALFORMED")
    assert ask(world, 0, nonce="n" * 32).status_code == 400
    assert ask(world, 0, news=since or "0").json()["code"] == "QUERY_MALFORMED"


@pytest.mark.clause("STM-20")
def test_news_is_signed_once_for_all_who_wait(world, monkeypatch):
    signed = []
    sign = revocation.sign

    def counted(index, key):
        signed.append(index.nonce)
        return sign(index, key)

    monkeypatch.setattr("ztpm_idp.provider.feed.revocation.sign", counted)
    got, many = [], 8
    waiters = [threading.Thread(target=lambda: got.append(ask(world, 0, news="1")), daemon=True) for _ in range(many)]
    for waiter in waiters:
        waiter.start()
    deadline = time.monotonic() + 20
    while world.provider.epochs._waiting < many:
        assert time.monotonic() < deadline
        time.sleep(0.001)
    signed.clear()
    world.people["alice"].revoke("hop", "a" * 32, "test")
    for waiter in waiters:
        waiter.join(20)
    (text,) = {answer.json()["news"] for answer in got}
    index = revocation.open(text, world.trust.feed, CAPS)
    assert [(entry.kind, entry.id) for entry in index.entries] == [("hop", "a" * 32)]
    assert (index.since, index.epoch, index.nonce) == (0, 1, NONCE)
    assert len(signed) == 2, "once to be read back before the commit, and once for everybody"
    world.people["alice"].revoke("hop", "b" * 32, "test")
    later = revocation.open(ask(world, 0, news="1").json()["news"], world.trust.feed, CAPS)
    assert (later.epoch, len(later.entries)) == (2, 2), "what was made before is not told for new"
    assert ask(world, 0).json() == {"epoch": 2}


@pytest.mark.clause("STM-20")
def test_a_store_that_is_being_restored_tells_no_news(world):
    world.people["alice"].revoke("hop", "a" * 32, "test")
    world.sql("UPDATE counters SET restoring = :yes", yes=True)
    answer = ask(world, 0, news="1")
    assert (answer.status_code, answer.json()["code"]) == (503, "RESTORING")


class Scene:
    """An `EpochWait` over a store that a test holds in its hand."""

    def __init__(self, **how):
        self.epoch, self.reads = 0, 0
        self.wait = EpochWait(self.read, **({"longest_s": 30.0} | how))

    async def read(self):
        self.reads += 1
        return self.epoch

    def commit(self):
        self.epoch += 1
        self.wait.told(self.epoch)


async def forever():
    await asyncio.Event().wait()


def test_it_ends_by_time_with_the_stores_epoch():
    """An epoch that another process has committed is found then."""

    async def go():
        scene = Scene(longest_s=0.05)
        scene.epoch = 3
        assert await scene.wait.above(3, gone=forever) == 3
        task = asyncio.create_task(scene.wait.above(3, gone=forever))
        while scene.wait._waiting == 0:
            await asyncio.sleep(0)
        scene.epoch = 4  # nobody told
        assert await task == 4

    asyncio.run(go())


def test_a_commit_between_reading_and_waiting_is_not_missed():
    async def go():
        scene = Scene()
        reading = asyncio.Event()

        async def slow():
            known = scene.epoch
            reading.set()
            await asyncio.sleep(0.01)
            return known

        scene.wait._epoch = slow
        task = asyncio.create_task(scene.wait.above(0, gone=forever))
        await reading.wait()
        scene.commit()
        async with asyncio.timeout(5):
            assert await task == 1

    asyncio.run(go())


def test_a_lower_epoch_wakes_nobody():
    async def go():
        scene = Scene()
        scene.commit()
        scene.commit()
        task = asyncio.create_task(scene.wait.above(2, gone=forever))
        while scene.reads == 0:
            await asyncio.sleep(0)
        scene.wait.told(1)
        scene.wait.told(2)
        for _ in range(10):
            await asyncio.sleep(0)
        assert not task.done()
        scene.commit()
        assert await task == 3

    asyncio.run(go())


def test_the_first_revocation_is_told_at_once_and_those_that_follow_share_a_hint():
    async def go():
        scene = Scene(apart_s=0.2)
        first = asyncio.create_task(scene.wait.above(0, gone=forever))
        while scene.reads == 0:
            await asyncio.sleep(0)
        scene.commit()
        async with asyncio.timeout(0.1):
            assert await first == 1
        scene.commit()
        # Who has the first one waits for the rest of the moment; who has not even that does not.
        second = asyncio.create_task(scene.wait.above(1, gone=forever))
        assert await scene.wait.above(0, gone=forever) == 2
        scene.commit()
        for _ in range(10):
            await asyncio.sleep(0)
        assert not second.done()
        async with asyncio.timeout(5):
            assert await second == 3
        scene.wait.close()

    asyncio.run(go())


def test_a_revocation_of_another_process_whose_hint_is_lost_is_told_after_the_moment():
    async def go():
        scene = Scene(apart_s=0.05)
        scene.commit()
        scene.epoch = 2  # nobody tells
        async with asyncio.timeout(5):
            assert await scene.wait.above(1, gone=forever) == 2
        scene.wait.close()

    asyncio.run(go())


def test_waiters_are_bounded_and_leave_when_they_hang_up():
    async def go():
        scene = Scene(most=2)
        hung_up = asyncio.Event()
        tasks = [asyncio.create_task(scene.wait.above(0, gone=hung_up.wait)) for _ in range(2)]
        while scene.wait._waiting < 2:
            await asyncio.sleep(0)
        with pytest.raises(Problem) as caught:
            await scene.wait.above(0, gone=forever)
        assert caught.value.code == "TOO_MANY_WAITERS"
        hung_up.set()
        async with asyncio.timeout(10):  # the longest wait is 30 s
            assert await asyncio.gather(*tasks) == [0, 0]
        assert scene.wait._waiting == 0
        cancelled = asyncio.create_task(scene.wait.above(0, gone=forever))
        while scene.wait._waiting == 0:
            await asyncio.sleep(0)
        cancelled.cancel()
        with pytest.raises(asyncio.CancelledError):
            await cancelled
        assert scene.wait._waiting == 0

    asyncio.run(go())


def test_a_store_that_cannot_be_read_leaves_no_waiter_behind():
    async def go():
        scene = Scene()

        async def broken():
            raise StoreUnavailableError

        scene.wait._epoch = broken
        with pytest.raises(StoreUnavailableError):
            await scene.wait.above(0, gone=forever)
        assert scene.wait._waiting == 0

    asyncio.run(go())


def test_nobody_waits_for_a_service_that_ends():
    async def go():
        scene = Scene()
        task = asyncio.create_task(scene.wait.above(0, gone=forever))
        while scene.reads == 0:
            await asyncio.sleep(0)
        scene.wait.close()
        async with asyncio.timeout(5):
            assert await task == 0
            assert await scene.wait.above(0, gone=forever) == 0

    asyncio.run(go())


def test_a_revocation_that_is_not_committed_is_not_told(world, monkeypatch):
    told = []
    monkeypatch.setattr(world.provider.epochs, "told", told.append)
    from ztpm_idp.store.transaction import Transaction

    before = Transaction.append_each

    async def fails(self, *args, **more):
        await before(self, *args, **more)
        raise OSError("disk full")

    monkeypatch.setattr(Transaction, "append_each", fails)
    from ztpm_idp.client import ClientError

    with pytest.raises(ClientError) as caught:
        world.people["alice"].revoke("hop", "a" * 32, "test")
    assert caught.value.code == "STORE_UNAVAILABLE"
    assert not any(told), "PostgreSQL's listener tells what was committed when it began: epoch 0"


# --- server-sent events ----------------------------------------------------------------------------------------------


def test_events_tell_each_new_epoch_and_end_with_the_service():
    async def go():
        scene = Scene()
        scene.epoch = 2
        events = scene.wait.growing(1, longest_s=30.0)
        assert await anext(events) == 2, "what was before is told at once"
        coming = asyncio.ensure_future(anext(events))
        while scene.wait._waiting == 0:
            await asyncio.sleep(0)
        scene.commit()
        assert await coming == 3
        scene.wait.close()
        assert [epoch async for epoch in events] == []
        assert scene.wait._waiting == 0

    asyncio.run(go())


def test_events_are_bounded_in_time_and_number():
    async def go():
        scene = Scene(most=1)
        assert [epoch async for epoch in scene.wait.growing(0, longest_s=0.01)] == []
        holder = asyncio.create_task(scene.wait.above(0, gone=forever))
        while scene.wait._waiting == 0:
            await asyncio.sleep(0)
        with pytest.raises(Problem):
            scene.wait.check_place()
        assert [epoch async for epoch in scene.wait.growing(0, longest_s=30.0)] == []
        holder.cancel()

    asyncio.run(go())


@pytest.mark.parametrize("query", ["", "?since=x", "?since=1&since=2", "?since=1&more=1"])
def test_events_of_nothing(world, query):
    with world.anonymous() as http:
        assert http.get(ISSUER + f"/revocations/events{query}").json()["code"] == "QUERY_MALFORMED"
