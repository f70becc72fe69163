"""Hints wake the pull and do nothing else: none is believed, none needed, none makes it spin."""

import asyncio
import contextlib

import httpx2
import pytest
from capabilities.values.caps import DEFAULT as CAPS
from pep.base.clock import SystemClock
from pep.base.errors import PepFault
from pep.provider.feed import MOVING_PERIOD_S, ProviderFollower
from pep.provider.feed_hints import BACKOFF_S
from pep.provider.feed_mark import FeedMarkFile
from tests.pep.kit import AUDIENCE, ISSUER, FakeIssuer, issuer_keys

from capabilities.keys import keys
from capabilities.statements import mark

pytestmark = pytest.mark.real_time

NEVER_S = 3_600.0
"""A period that does not end while a test lasts: what is pulled, a hint has caused."""

PEP_KEY = keys.generate()


class World:
    """A follower on real time, and a provider whose hints a test gives."""

    def __init__(self, tmp):
        self.clock = SystemClock()
        made, self.trust = issuer_keys()
        self.issuer = FakeIssuer(made, self.clock, pep_key=keys.public_raw(PEP_KEY))
        self.incidents = []
        self.waits = []
        self.pulling, self.most_pulling = 0, 0
        self.hold = None
        self.answer = self.faithful
        self.follower = ProviderFollower(
            httpx2.AsyncClient(transport=httpx2.MockTransport(self.handle)), issuer=ISSUER, key=PEP_KEY, audience=AUDIENCE,
            trust=self.trust, caps=CAPS, clock=self.clock, mark=FeedMarkFile(tmp / "feed.json"), incident=self.incidents.append,
        )  # fmt: skip

    async def handle(self, request):
        if request.url.path.endswith("/wait"):
            since = int(request.url.params["since"])
            self.waits.append(asyncio.get_running_loop().time())
            return await self.answer(since)
        self.pulling += 1
        self.most_pulling = max(self.pulling, self.most_pulling)
        try:
            answer = self.issuer.handle(request)
            if self.hold is not None:  # the answer is made, and on its way
                await self.hold.wait()
            return answer
        finally:
            self.pulling -= 1

    async def faithful(self, since):
        while self.issuer.epoch <= since:
            await asyncio.sleep(0.001)
        return httpx2.Response(200, json={"epoch": self.issuer.epoch})

    @property
    def pulls(self):
        return self.issuer.asked.count("/revocations")

    async def until(self, seen):
        async with asyncio.timeout(20):
            while not seen():
                await asyncio.sleep(0.001)

    def sees(self, epoch):
        return lambda: self.follower.view().epoch >= epoch

    def scenario(self, act, *, period_s=NEVER_S):
        async def go():
            task = asyncio.create_task(self.follower.run(period_s=period_s))
            await self.until(lambda: self.follower._known is not None)
            try:
                await act()
            finally:
                task.cancel()
                with contextlib.suppress(asyncio.CancelledError):
                    await task

        asyncio.run(go())


@pytest.fixture
def world(tmp_path):
    return World(tmp_path)


def test_a_hint_brings_the_revocation_without_waiting_for_the_period(world):
    async def act():
        for number in range(1, 6):
            world.issuer.revoke("agent", f"agent-{number}")
            await world.until(world.sees(number))

    world.scenario(act)
    assert len(world.follower.view().revoked) == 5
    assert world.incidents == []


NEWS_NONCE = "0" * 16


def with_news(world, *, after=0, **lies):
    """A provider that brings news with the hint, of what came after another epoch or changed by a test."""

    async def answer(since):
        while world.issuer.epoch <= since + after:
            await asyncio.sleep(0.001)
        world.issuer.lie = lies
        text = world.issuer.index(since=since + after, nonce=NEWS_NONCE)
        world.issuer.lie = {}
        return httpx2.Response(200, json={"epoch": world.issuer.epoch, "news": text})

    return answer


@pytest.mark.clause("STM-20")
def test_news_is_in_force_without_a_pull_and_makes_no_view_young(world):
    world.answer = with_news(world)
    gone = [("agent", f"agent-{number}") for number in range(1, 4)]

    async def act():
        pulls, known = world.pulls, world.follower._known
        for name in gone:
            world.issuer.revoke(*name)
            await world.until(lambda: name in world.follower.view().revoked)  # noqa: B023 - it is over within this turn
        assert (world.pulls, world.follower._known) == (pulls, known)
        assert world.follower.view().epoch == 0
        world.follower._wake.set()  # as the end of a period would
        await world.until(world.sees(3))
        assert world.follower._kept.synced

    world.scenario(act)
    assert world.follower.view().revoked == set(gone)
    assert world.incidents == []


NEWS_LIES = {
    "of another issuer": {"issuer": "https://elsewhere.example/ztpm"},
    "of another question": {"after": 1},
    "cut": {"epoch": 9},
}


@pytest.mark.clause("STM-20")
@pytest.mark.parametrize("name", [*NEWS_LIES, "signed by a stranger", "no statement"])
def test_what_is_no_news_is_a_hint_and_the_pull_finds_out(world, name):
    stranger, honest = keys.generate(), with_news(world, **NEWS_LIES.get(name, {}))

    async def answer(since):
        signer = world.issuer.signer
        if since == 0 and name == "signed by a stranger":
            world.issuer.signer = stranger
        told = (await honest(since)).json()
        world.issuer.signer = signer
        return httpx2.Response(200, json=told | ({"news": "no statement"} if name == "no statement" else {}))

    world.answer = answer
    heard = []
    hear = world.follower._kept.hear

    def listen(index, text, **more):
        heard.append(index.nonce)
        hear(index, text, **more)

    world.follower._kept.hear = listen

    async def act():
        await world.until(lambda: world.waits)
        world.issuer.revoke("agent", "robotic")
        world.issuer.revoke("agent", "mover")
        await world.until(world.sees(2))

    world.scenario(act)
    assert NEWS_NONCE not in heard
    assert world.incidents == []


@pytest.mark.clause("STM-17")
def test_each_view_that_is_in_force_is_confirmed_by_this_points_key(world):
    def newest():
        return [mark.open(text, {keys.public_raw(PEP_KEY)}, CAPS) for text in world.issuer.confirmed]

    async def act():
        await world.until(lambda: len(newest()) == 1)
        world.issuer.revoke("agent", "agent-1")
        await world.until(lambda: len(newest()) == 2)

    world.scenario(act)
    before, after = newest()
    assert (before.epoch, after.epoch, after.entries, after.remaining) == (0, 1, (), 0)
    assert after.head == world.follower._mark.head
    assert world.incidents == []


@pytest.mark.clause("STM-17")
def test_a_provider_that_takes_no_confirmation_is_followed_all_the_same(world):
    world.issuer.mark_status = 404

    async def act():
        world.issuer.revoke("agent", "agent-1")
        await world.until(world.sees(1))

    world.scenario(act)
    assert world.incidents == []


def test_a_hint_that_comes_while_a_pull_is_under_way_is_not_lost(world):
    """The index that this pull brings was made before the revocation: another pull must follow at once."""

    async def act():
        await world.until(lambda: len(world.waits) == 1)
        world.hold = asyncio.Event()
        world.follower._wake.set()  # as the end of a period would
        await world.until(lambda: world.pulling == 1)
        world.issuer.revoke("agent", "robotic")
        await world.until(world.follower._wake.is_set)
        world.hold.set()
        await world.until(world.sees(1))

    world.scenario(act)


def test_pulls_never_overlap(world):
    async def eager(since):
        await asyncio.sleep(0)
        world.issuer.revoke("agent", f"agent-{world.issuer.epoch}")
        return httpx2.Response(200, json={"epoch": since + 1})

    async def act():
        await world.until(world.sees(60))

    world.answer = eager
    world.scenario(act, period_s=0.002)
    assert world.most_pulling == 1


LIES = {
    "an epoch that is not there": {"json": {"epoch": 10**9}},
    "nothing new, at once": {"json": {"epoch": 0}},
    "no number": {"json": {"epoch": "9"}},
    "true": {"json": {"epoch": True}},
    "no member": {"json": {}},
    "no object": {"json": [9]},
    "no JSON": {"text": "{"},
    "far too large": {"text": '{"epoch":' + " " * 300 + "9}"},
    "refused": {"status_code": 503, "json": {"epoch": 9}},
}


@pytest.mark.parametrize("name", LIES)
def test_no_lie_makes_the_pep_spin_or_stops_the_ordinary_period(world, name):
    lie = {"status_code": 200} | LIES[name]

    async def liar(_):
        return httpx2.Response(**lie)

    async def act():
        await world.until(lambda: len(world.waits) >= 3)
        told.extend(world.waits)
        world.issuer.revoke("agent", "robotic")
        await world.until(world.sees(1))

    told = []
    world.answer = liar
    world.scenario(act, period_s=0.05)
    pauses = [later - earlier for earlier, later in zip(told, told[1:], strict=False)]
    assert min(pauses) >= BACKOFF_S * 0.9, pauses
    assert world.incidents == []


def test_failures_back_off_further_each_time(world):
    async def broken(_):
        raise httpx2.ConnectError("down")

    async def act():
        await world.until(lambda: len(world.waits) >= 4)

    world.answer = broken
    world.scenario(act)
    pauses = [later - earlier for earlier, later in zip(world.waits, world.waits[1:], strict=False)]
    assert pauses[0] >= BACKOFF_S * 0.9
    assert pauses[1] >= pauses[0] * 1.5
    assert pauses[2] >= pauses[1] * 1.5


def test_a_false_hint_ages_the_view_as_before(world):
    """A hint brings no freshness: with the index refused, the view grows old under any number of hints."""

    lying = asyncio.Event()

    async def liar(since):
        await lying.wait()
        return httpx2.Response(200, json={"epoch": since + 1})

    async def act():
        await world.until(lambda: world.waits)
        world.issuer.signer = keys.generate()
        before = world.follower._known.read_ms
        lying.set()
        await world.until(lambda: len(world.incidents) >= 2)
        assert world.follower._known.read_ms == before

    world.answer = liar
    world.scenario(act)
    assert {error.code for error in world.incidents} == {PepFault.FEED_UNTRUSTED}


def test_while_something_moves_the_period_is_short(world):
    async def silent(_):
        await asyncio.Event().wait()

    async def act():
        before = world.pulls
        await asyncio.to_thread(world.follower.hurry, moving=True)  # the watch lives in a thread
        loop = asyncio.get_running_loop()
        began = loop.time()
        await world.until(lambda: world.pulls >= before + 6)
        # The first comes at once, the others a short period apart each.
        assert loop.time() - began >= 5 * MOVING_PERIOD_S * 0.8
        world.follower.hurry(moving=False)
        await world.until(lambda: world.pulling == 0)
        at_rest = world.pulls
        world.issuer.revoke("agent", "robotic")
        async with asyncio.timeout(5):
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(4 * MOVING_PERIOD_S):
                    await asyncio.Event().wait()
        assert world.pulls <= at_rest + 1

    world.answer = silent
    world.scenario(act)


def test_hurrying_before_and_after_the_run_is_no_error(world):
    world.follower.hurry(moving=True)
    world.scenario(lambda: world.until(lambda: world.pulls >= 3))
    world.follower.hurry(moving=False)
    world.follower.hurry(moving=True)


def test_the_hint_is_left_alone_when_the_run_ends(world):
    async def act():
        await world.until(lambda: len(world.waits) == 1)

    world.scenario(act)  # `run` has waited for its second task; nothing is left over to be destroyed
    assert world.follower.view().epoch == 0
