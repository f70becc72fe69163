"""Tokens of a mandate, one after another, on a clock that moves when told to."""

from __future__ import annotations

import asyncio
import threading

import httpx2
import pytest
from capabilities.proof.proof import check_proof
from capabilities.values.caps import DEFAULT
from tests.ztpm_idp.world import AUDIENCE, World

from capabilities.keys import keys
from ztpm_idp.client import ClientError, Denied, Issued, Renewal

pytestmark = pytest.mark.long


class Drawer:
    """An agent that draws without a provider: each token is named by its number, and may fail to come."""

    def __init__(self, clock):
        self.key, self.clock, self.drawn, self.failure = keys.generate(), clock, 0, None

    def draw(self, mandate_id, *, lifetime_s):
        if self.failure is not None:
            raise ClientError(self.failure, 403)
        self.drawn += 1
        return Issued(f"token-{self.drawn}", "T" * 22, "0a" * 16, int(self.clock()) + lifetime_s)


class Clock:
    at_s = 1_800_000_000.0

    def __call__(self):
        return self.at_s


@pytest.fixture
def made():
    clock = Clock()
    drawer = Drawer(clock)
    return clock, drawer, Renewal(drawer, "0b" * 16, lifetime_s=100, now=clock)


def test_the_next_is_drawn_when_a_quarter_of_the_life_is_left(made):
    clock, _, renewal = made
    for passed, expected in ((0, "token-1"), (74.9, "token-1"), (0.2, "token-2"), (74, "token-2"), (1.1, "token-3")):
        clock.at_s += passed
        assert renewal.token() == expected


@pytest.mark.parametrize("failure", ["UNREACHABLE", "MANDATE_REVOKED", "MANDATE_TOKENS_LIVE"])
def test_a_token_is_used_to_its_end_and_tried_for_again_after_a_pause(made, failure):
    clock, drawer, renewal = made
    renewal.token()
    clock.at_s += 80
    drawer.failure = failure
    assert renewal.token() == "token-1"
    drawer.failure = None
    clock.at_s += 4.9
    assert renewal.token() == "token-1"
    clock.at_s += 0.2
    assert renewal.token() == "token-2"


def test_the_end_is_told_as_what_it_is(made):
    clock, drawer, renewal = made
    drawer.failure = "MANDATE_REVOKED"
    with pytest.raises(Denied) as denied:
        renewal.token()
    assert denied.value.reason == "MANDATE_REVOKED"
    drawer.failure = None
    renewal.token()
    clock.at_s += 100
    drawer.failure = "UNREACHABLE"
    with pytest.raises(ClientError) as unreachable:
        renewal.token()
    assert unreachable.value.code == "UNREACHABLE"


def test_threads_draw_one_token(made):
    _, drawer, renewal = made
    found = []
    threads = [threading.Thread(target=lambda: found.append(renewal.token())) for _ in range(8)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(10)
    assert (found, drawer.drawn) == (["token-1"] * 8, 1)


def seen_by(renewal, drawer, clock):
    """A server that notes the token of each request whose proof holds."""
    seen = []

    def answer(request):
        token = request.headers["Authorization"].removeprefix("DPoP ")
        proof = check_proof(
            request.headers["DPoP"], key=keys.public_raw(drawer.key), method="POST", url=AUDIENCE, body=request.content,
            token=token, at=clock(), caps=DEFAULT,
        )  # fmt: skip
        seen.append((token, type(proof).__name__))
        return httpx2.Response(200)

    return seen, httpx2.MockTransport(answer), renewal.auth()


def test_each_request_presents_a_token_that_lives(made):
    clock, drawer, renewal = made
    seen, transport, auth = seen_by(renewal, drawer, clock)
    with httpx2.Client(transport=transport, auth=auth) as http:
        http.post(AUDIENCE, content=b"{}")
        clock.at_s += 90
        http.post(AUDIENCE, content=b"{}")

    async def go():
        async with httpx2.AsyncClient(transport=transport, auth=auth) as client:
            await client.post(AUDIENCE, content=b"{}")
            clock.at_s += 90
            await client.post(AUDIENCE, content=b"{}")

    asyncio.run(go())
    assert seen == [(token, "Proof") for token in ("token-1", "token-2", "token-2", "token-3")]


def test_the_provider_never_sees_more_than_two_live(tmp_path):
    with World(tmp_path) as world:
        planner = world.agent("planner", vouched=True)
        week = world.scope(not_after=int(world.clock()) + 604_800)
        renewal = planner.renewal(world.people["alice"].sign_mandate("planner", week, purpose="p"))
        tokens = set()
        for _ in range(20):
            tokens.add(renewal.token())
            world.clock.at_s += 900.5
        assert 6 <= len(tokens) <= 8
