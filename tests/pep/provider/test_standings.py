"""The provider's word on conduct: accepted whole, with an age of its own, and every lie on the wire refused."""

import asyncio

import pytest
from capabilities.statements.conduct import AgentEntry, EdgeEntry
from pep.base.errors import FeedError, PepFault
from policies.conduct.report import Edge
from tests.pep.provider.test_feed import World

from capabilities.keys import keys

pytestmark = pytest.mark.clause("STM-8")


@pytest.fixture
def world(tmp_path):
    return World(tmp_path)


def pull(world):
    asyncio.run(world.follower.standings.pull())


def refused(world, code):
    before = world.follower.conduct()
    with pytest.raises(FeedError) as raised:
        pull(world)
    assert raised.value.code is code
    assert world.follower.conduct() == before


def edge(version, score, delegate="robotic"):
    return EdgeEntry(version, "alice", delegate, score)


def agent(version, name="robotic", **changes):
    fields = dict(deviations=(), deviated_at=None, contracted=True, samples=3, restored_at=None)
    return AgentEntry(version=version, agent=name, **(fields | changes))


def test_before_the_first_word_its_age_is_endless(world):
    word = world.follower.conduct()
    assert word.age_ms > 10**9
    assert (dict(word.edges), dict(word.agents)) == ({}, {})


def test_the_age_runs_from_sending_and_is_no_others(world):
    world.pull()
    assert world.follower.conduct().age_ms > 10**9
    pull(world)
    world.clock.advance(700)
    assert world.follower.conduct().age_ms == 700
    world.pull()
    assert (world.follower.view().age_ms, world.follower.conduct().age_ms) == (0, 700)


def test_what_is_newer_takes_the_place_of_what_was_said(world):
    world.issuer.edges, world.issuer.agents, world.issuer.conduct_version = (edge(1, 600),), (agent(2),), 2
    pull(world)
    world.issuer.edges, world.issuer.agents, world.issuer.conduct_version = (edge(3, 700), edge(4, 1, "x")), (), 4
    pull(world)
    word = world.follower.conduct()
    assert dict(word.edges) == {Edge("alice", "robotic"): 700, Edge("alice", "x"): 1}
    assert word.agents["robotic"].contracted is True


def test_a_word_that_is_cut_is_followed_to_its_end_or_not_believed(world):
    told = {number: (edge(number, 100 * number, f"a{number}"),) for number in (1, 2, 3)}
    world.issuer.conduct_version = 3
    answer = world.issuer.conduct

    def page(*, since, nonce):
        at = int(since) + 1
        world.issuer.edges, world.issuer.conduct_lie = told[at], {"through": at}
        world.clock.advance(100)
        return answer(since=since, nonce=nonce)

    world.issuer.conduct = page
    pull(world)
    assert len(world.follower.conduct().edges) == 3
    assert world.follower.conduct().age_ms == 300, "from the first nonce"
    world.restart()
    told[3] = (edge(3, 2_000),)
    with pytest.raises(FeedError):
        pull(world)
    assert not world.follower.conduct().edges, "whole or not at all"


def test_a_page_that_leads_nowhere(world):
    world.issuer.conduct_version, world.issuer.conduct_lie = 3, {"through": 0}
    refused(world, PepFault.FEED_WRONG_RANGE)


LIES = {
    "nonce": ({"nonce": "x" * 22}, PepFault.FEED_WRONG_NONCE),
    "issuer": ({"issuer": "http://127.0.0.1:1/other"}, PepFault.FEED_WRONG_ISSUER),
    "since": ({"since": 1, "version": 1, "through": 1}, PepFault.FEED_WRONG_RANGE),
    "range": ({"edges": (edge(9, 1),)}, PepFault.FEED_UNTRUSTED),
}


@pytest.mark.parametrize("name", LIES)
def test_an_answer_to_another_question(world, name):
    pull(world)
    world.issuer.conduct_lie, code = LIES[name]
    refused(world, code)


@pytest.mark.parametrize("signer", ["registry", "nobody"])
def test_another_signer(world, signer):
    world.issuer.signer = world.made.get(signer) or keys.generate()
    refused(world, PepFault.FEED_UNTRUSTED)


def test_a_recorded_answer(world):
    answer, recorded = world.issuer.conduct, []

    def once(**query):
        recorded.append(answer(**query))
        return recorded[0]

    world.issuer.conduct = once
    pull(world)
    refused(world, PepFault.FEED_WRONG_NONCE)


def test_a_silent_provider_leaves_it_to_age(world):
    pull(world)
    world.issuer.down = True
    world.clock.advance(5_001)
    refused(world, PepFault.FEED_UNREACHABLE)
    assert world.follower.conduct().age_ms == 5_001


def test_what_is_revoked_is_known_without_it_and_it_without_what_is_revoked(world):
    world.issuer.conduct_lie = {"nonce": "x" * 22}
    world.pull()
    assert world.follower.view().age_ms == 0
    world.issuer.conduct_lie, world.issuer.lie = {}, {"nonce": "x" * 22}
    pull(world)
    assert world.follower.conduct().age_ms == 0


def test_following_pulls_both(world):
    async def follow():
        running = asyncio.create_task(world.follower.run(period_s=0.01))
        async with asyncio.timeout(10):
            while world.follower.conduct().age_ms > 0 or world.follower.view().age_ms > 0:
                await asyncio.sleep(0)
        running.cancel()
        await asyncio.gather(running, return_exceptions=True)

    asyncio.run(follow())
