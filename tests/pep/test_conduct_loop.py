"""From an enforcement point's gate to the identity provider's ledger and back: what one saw, another one knows."""

import asyncio
import secrets

import httpx2
import pytest
from capabilities.proof.proof import prove
from capabilities.token.token_text import token_from_text
from capabilities.token.verify import Verifier
from capabilities.values.caps import DEFAULT as CAPS
from capabilities.values.chain import Chain
from capabilities.values.scope import Grant, Tier
from pep.journal.file_journal import FileJournal
from pep.mcp.mapping import ARM_TOOLS, to_request
from pep.provider.feed import ProviderFollower
from pep.provider.feed_mark import FeedMarkFile
from pep.provider.journal_shipper import JournalShipper
from pep.request.authority import PresentedRequest
from pep.request.call import Call
from policies.conduct.report import Edge
from policies.evidence.evidence import ToolReading
from policies.evidence.model import Effect
from tests.pep.kit import ManualClock, Rig
from tests.ztpm_idp.world import AUDIENCE, ISSUER, World

READ = ARM_TOOLS["read_state"]


class AsyncBridge(httpx2.AsyncBaseTransport):
    """To the provider on the loop of its world."""

    def __init__(self, world):
        self.inner, self.loop = httpx2.ASGITransport(app=world.app), world.loop

    async def handle_async_request(self, request):
        async def go():
            response = await self.inner.handle_async_request(request)
            return response.status_code, response.headers, await response.aread()

        status, headers, content = await asyncio.wrap_future(asyncio.run_coroutine_threadsafe(go(), self.loop))
        return httpx2.Response(status, headers=headers, content=content)


class Site:
    """An enforcement point of the world's, with a gate, a journal, a shipper and a follower of its own."""

    def __init__(self, world, tmp, name):
        self.world, self.clock = world, ManualClock(world.clock())
        world.pep(name)
        tmp.mkdir()
        self.rig = Rig(tmp, clock=self.clock)
        self.rig.journal.close()
        self.rig.path.unlink()
        self.rig.journal = FileJournal.open(self.rig.path, pep_id=name, clock=self.clock)
        http = httpx2.AsyncClient(transport=AsyncBridge(world))
        self.incidents = []
        self.follower = ProviderFollower(
            http, issuer=ISSUER, key=world.private[name], audience=AUDIENCE, trust=world.trust, caps=CAPS, clock=self.clock,
            mark=FeedMarkFile(tmp / "feed.json"), incident=self.incidents.append,
        )  # fmt: skip
        self.shipper = JournalShipper(
            self.rig.journal, http, issuer=ISSUER, key=world.private[name], clock=self.clock,
            incident=self.incidents.append,
        )  # fmt: skip
        self.rig.registry = self.follower
        self.rig.build()
        self.rig.gate._authority.verifier = Verifier(world.trust, CAPS)
        self.rig.gate._authority._audience = AUDIENCE
        self.conduct = self.rig.gate.conduct

    def ask(self, agent, token):
        """The agent asks for the state of the arm, which it may read, or may not."""
        presented = self.presented(agent, token)
        request = to_request(READ, {}, request_id=self.fresh(), audience=AUDIENCE, at=self.clock.wall_s())
        tool = ToolReading(READ.name, "d" * 64, "d" * 64, READ.base_tier)
        call = Call(request, READ, tool, presented, self.clock.monotonic_ms(), self.rig.readiness)
        return asyncio.run(self.rig.gate.run(call, self.rig.effect))

    def presented(self, agent, token):
        text = prove(
            self.world.private[agent], method="POST", url=AUDIENCE, body=b"{}", token=token,
            at=int(self.clock.wall_s()), jti=self.fresh(),
        )  # fmt: skip
        return self.rig.gate._authority.check(PresentedRequest(token, text, "POST", AUDIENCE, b"{}"), lease_ms=30_000)

    @staticmethod
    def fresh():
        return secrets.token_hex(16)

    def ship(self):
        async def all_of_it():
            while await self.shipper.ship():
                pass

        asyncio.run(all_of_it())

    def learn(self):
        asyncio.run(self.follower.standings.pull())

    def chain(self, token):
        found = Verifier(self.world.trust, CAPS).verify(
            token_from_text(token, CAPS),
            at=self.clock.wall_s(),
            audience=AUDIENCE,
            view=self.rig.feed.view(),
            lease_ms=30_000,
        )
        assert isinstance(found, Chain), found
        return found

    def trust(self, token):
        return self.conduct.trust(self.chain(token), at=self.clock.wall_s()).score_permille

    def behaviour(self, agent):
        return self.conduct.behaviour(agent, at=self.clock.wall_s())


@pytest.fixture
def world(tmp_path):
    (tmp_path / "idp").mkdir()
    with World(tmp_path / "idp") as made:
        yield made


def test_what_one_saw_another_one_knows_until_a_person_restores_the_agent(world, tmp_path):
    mover = world.agent("mover")
    grants = (Grant("ur3e", "stop"),)  # it may not read the state
    token = world.people["alice"].issue(mover, world.scope(grants=grants, ceiling=Tier(1)), purpose="p").token
    here, there = Site(world, tmp_path / "here", "cell-1"), Site(world, tmp_path / "there", "cell-2")
    for site in (here, there):
        site.learn()
        assert (site.trust(token), site.behaviour("mover").contracted) == (800, False)
    # One of them is probed: it knows at once, the other one does not.
    for _ in range(60):
        answer = here.ask("mover", token)
        assert (answer.decision.effect, str(answer.decision.reason)) == (Effect.DENY, "NOT_GRANTED")
    assert here.behaviour("mover").contracted
    assert here.trust(token) < 700
    there.learn()
    assert (there.trust(token), there.behaviour("mover").contracted) == (800, False)
    # Its records are shipped; the other one learns of both.
    here.ship()
    for site in (here, there):
        site.learn()
    assert there.behaviour("mover").contracted
    assert there.behaviour("mover").age_ms == 0
    assert there.trust(token) == here.trust(token) < 700
    assert there.follower.conduct().edges == {Edge("alice", "mover"): there.trust(token)}
    # Shipping all of it again changes nothing.
    version = there.follower.standings._version
    here.shipper.accepted_through = 0
    here.ship()
    there.learn()
    assert there.follower.standings._version == version
    # A person restores it; both hear of it. Trust comes back with time alone.
    for clock in (here.clock, there.clock):
        clock.advance(3_000)
    world.clock.at_s = here.clock.wall_s()
    world.people["alice"].restore_agent("mover", "a test that went astray")
    for site in (here, there):
        site.learn()
        assert not site.behaviour("mover").contracted
        assert site.trust(token) < 700
    assert here.incidents == there.incidents == []
