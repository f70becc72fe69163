"""Following the identity provider: age runs here, what was accepted only grows, and every lie on the wire is refused."""

import asyncio
import json

import pytest
from capabilities.statements.registry import PartyEntry, SensorEntry, ToolEntry, TrustEntry
from capabilities.values.caps import DEFAULT as CAPS
from capabilities.values.scope import Tier
from pep.base.errors import FeedError, PepFault
from pep.provider.feed import ProviderFollower
from pep.provider.feed_mark import FeedMarkFile
from tests.pep.kit import AUDIENCE, CALIBRATION, ISSUER, FakeIssuer, ManualClock, issuer_keys

from capabilities.keys import keys
from capabilities.statements import revocation

PEP_KEY = keys.generate()


class World:
    def __init__(self, tmp):
        self.clock = ManualClock()
        self.made, self.trust = issuer_keys()
        self.issuer = FakeIssuer(
            self.made,
            self.clock,
            tools=[ToolEntry("stop", "d" * 64, "stop", Tier.NO_EFFECT)],
            pep_key=keys.public_raw(PEP_KEY),
        )
        self.path = tmp / "feed.json"
        self.incidents = []
        self.restart()

    def restart(self):
        self.follower = ProviderFollower(
            self.issuer.client(),
            issuer=ISSUER,
            key=PEP_KEY,
            audience=AUDIENCE,
            trust=self.trust,
            caps=CAPS,
            clock=self.clock,
            mark=FeedMarkFile(self.path),
            incident=self.incidents.append,
        )

    def pull(self):
        asyncio.run(self.follower.pull())

    def refused(self, code):
        before = self.follower._known
        with pytest.raises(FeedError) as raised:
            self.pull()
        assert raised.value.code is code
        assert self.follower._known is before


@pytest.fixture
def world(tmp_path):
    return World(tmp_path)


def test_before_the_first_answer_everything_is_too_old(world):
    assert world.follower.view().age_ms > 10**9
    assert world.follower.tool("stop") is None
    assert world.follower.sensors() == {}


def test_age_runs_from_sending_on_the_monotonic_clock(world):
    answer = world.issuer.handle

    def slow(request):
        world.clock.advance(300)
        return answer(request)

    world.issuer.handle = slow
    world.restart()
    world.pull()
    assert world.follower.view().age_ms == 600  # index and registry, both after the nonce was sent
    world.clock.advance(1_000)
    assert world.follower.view().age_ms == 1_600
    world.clock.wall += 10_000
    assert world.follower.view().age_ms == 1_600


def test_a_suspended_agent_counts_as_revoked_until_it_is_restored(world):
    def told(*agents):
        world.issuer.suspended, world.issuer.registry_version = agents, world.issuer.registry_version + 1
        world.pull()
        return world.follower.view().revoked

    world.issuer.revoke("agent", "gone")
    assert told("mover", "gone") == {("agent", "mover"), ("agent", "gone")}
    # It is current with the view or there is none: without the registry the view grows old, and says so meanwhile.
    world.issuer.registry_version, world.issuer.registry_audience = 4, "http://127.0.0.1:1/mcp"
    world.clock.advance(2_001)
    world.refused(PepFault.REGISTRY_WRONG_AUDIENCE)
    assert world.follower.view().age_ms == 2_001
    world.issuer.registry_audience = None
    assert told() == {("agent", "gone")}
    world.restart()
    world.pull()
    assert world.follower.view().revoked == {("agent", "gone")}


def test_entries_accumulate(world):
    world.issuer.revoke("hop", "a" * 32)
    world.pull()
    world.issuer.revoke("agent", "robotic")
    world.pull()
    world.pull()
    view = world.follower.view()
    assert view.epoch == 2
    assert view.revoked == {("hop", "a" * 32), ("agent", "robotic")}


def test_pages_are_asked_for_until_the_end(world, monkeypatch):
    monkeypatch.setattr(revocation, "ENTRIES", 4)
    for number in range(11):
        world.issuer.revoke("agent", f"agent-{number}")
    world.pull()
    assert len(world.follower.view().revoked) == 11
    assert world.follower.view().epoch == 11


def test_a_page_that_leads_nowhere_is_refused(world):
    world.issuer.revoke("agent", "robotic")
    world.issuer.lie = {"entries": ()}
    world.refused(PepFault.FEED_WRONG_RANGE)


def test_a_silent_provider_leaves_the_view_to_age(world):
    world.pull()
    world.issuer.down = True
    world.clock.advance(2_001)
    world.refused(PepFault.FEED_UNREACHABLE)
    assert world.follower.view().age_ms == 2_001


LIES = {
    "nonce": ({"nonce": "x" * 22}, PepFault.FEED_WRONG_NONCE),
    "issuer": ({"issuer": "http://127.0.0.1:1/other"}, PepFault.FEED_WRONG_ISSUER),
    "since": ({"since": 1, "epoch": 1}, PepFault.FEED_WRONG_RANGE),
}


@pytest.mark.parametrize("name", LIES)
def test_an_answer_to_another_question_is_refused(world, name):
    world.pull()
    world.issuer.lie, code = LIES[name]
    world.refused(code)


def test_another_signer_is_refused(world):
    world.issuer.signer = keys.generate()
    world.refused(PepFault.FEED_UNTRUSTED)
    world.issuer.signer = world.made["registry"]
    world.refused(PepFault.FEED_UNTRUSTED)


def test_a_recorded_answer_is_refused(world):
    recorded = []
    answer = world.issuer.index

    def once(**query):
        recorded.append(answer(**query))
        return recorded[0]

    world.issuer.index = once
    world.pull()
    world.refused(PepFault.FEED_WRONG_NONCE)


def test_an_epoch_never_goes_back_not_even_over_a_restart(world):
    world.issuer.revoke("agent", "robotic")
    world.issuer.revoke("agent", "vision")
    world.pull()
    world.issuer.epoch, world.issuer.entries = 1, world.issuer.entries[:1]
    world.restart()
    world.refused(PepFault.FEED_ROLLED_BACK)
    assert world.follower.view().age_ms > 10**9


def test_a_mark_that_cannot_be_read_is_not_taken_for_none(world):
    world.path.write_bytes(b'{"epoch": 1')
    with pytest.raises(FeedError) as raised:
        world.restart()
    assert raised.value.code is PepFault.STATE_UNREADABLE


def test_the_mark_is_of_one_issuer(world):
    world.path.write_text(json.dumps({"issuer": "http://127.0.0.1:1/x", "epoch": 9, "registry_version": 9}))
    world.restart()
    world.pull()
    assert world.follower.view().epoch == 0


def test_the_registry_is_fetched_when_its_version_changes_and_only_then(world):
    world.pull()
    world.pull()
    assert world.issuer.asked.count("/registry") == 1
    world.issuer.trust = (TrustEntry("robotic", 650),)
    world.issuer.sensors = (SensorEntry("camera-1", keys.public_raw(keys.generate()), CALIBRATION, 20),)
    door = keys.public_raw(keys.generate())
    world.issuer.peps = (PartyEntry("door-1", door),)
    world.issuer.registry_version += 1
    assert world.follower.peps() == {}
    world.pull()
    assert world.issuer.asked.count("/registry") == 2
    assert world.follower.peps() == {"door-1": door}
    assert world.follower.trust_permille("robotic") == 650
    assert world.follower.trust_permille("vision") is None
    assert world.follower.sensors()["camera-1"].transit_ms == 20
    assert world.follower.tool("stop").definition_digest == "d" * 64


def test_a_view_is_not_renewed_without_the_registry_that_it_names(world):
    world.pull()
    world.clock.advance(500)
    answer = world.issuer.snapshot
    world.issuer.registry_version += 1

    def older(*, audience):
        world.issuer.registry_version -= 1
        text = answer(audience=audience)
        world.issuer.registry_version += 1
        return text

    world.issuer.snapshot = older
    world.refused(PepFault.REGISTRY_ROLLED_BACK)
    assert world.follower.view().age_ms == 500


def test_the_registry_of_another_audience_is_refused(world):
    world.issuer.registry_audience = "http://127.0.0.1:1/mcp"
    world.refused(PepFault.REGISTRY_WRONG_AUDIENCE)


def test_a_registry_signed_by_the_feed_key_is_refused(world):
    world.issuer.made = {**world.made, "registry": world.made["feed"]}
    world.refused(PepFault.FEED_UNTRUSTED)


def full(_):
    raise OSError("disk full")


def test_a_mark_that_cannot_be_written_keeps_the_view_old(world, monkeypatch):
    monkeypatch.setattr(world.follower._mark_file, "write", full)
    world.refused(PepFault.STATE_UNREADABLE)


@pytest.mark.parametrize("missing", ["mark", "registry"])
def test_what_is_revoked_waits_for_nothing_else(world, monkeypatch, missing):
    world.pull()
    world.issuer.revoke("agent", "robotic")
    world.clock.advance(300)
    if missing == "mark":
        monkeypatch.setattr(world.follower._mark_file, "write", full)
    else:
        world.issuer.registry_audience = "http://127.0.0.1:1/mcp"
        world.issuer.registry_version += 1
    with pytest.raises(FeedError):
        world.pull()
    view = world.follower.view()
    assert (view.epoch, view.age_ms, view.revoked) == (0, 300, {("agent", "robotic")}), "revoked, and no younger"
    monkeypatch.undo()
    world.issuer.registry_audience = AUDIENCE
    world.pull()
    view = world.follower.view()
    assert (view.epoch, view.age_ms, view.revoked) == (1, 0, {("agent", "robotic")})


def test_following_goes_on_after_a_refusal(world):
    world.issuer.down = True

    async def scenario():
        task = asyncio.create_task(world.follower.run(period_s=0.01))
        async with asyncio.timeout(10):
            while not world.incidents:
                await asyncio.sleep(0.005)
            world.issuer.down = False
            while world.follower.view().age_ms > 10**9:
                await asyncio.sleep(0.005)
        task.cancel()

    asyncio.run(scenario())
    assert {error.code for error in world.incidents} == {PepFault.FEED_UNREACHABLE}
