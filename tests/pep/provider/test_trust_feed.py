"""Following the trust bundle: what may take its place does so at once and over restarts, and nothing else does."""

from __future__ import annotations

import asyncio
from dataclasses import replace
from functools import partial

import pytest
from capabilities.keys.windows import Role
from capabilities.values.caps import DEFAULT as CAPS
from pep.base.errors import ConfigError, FeedError, PepFault
from pep.point.trust_mark import BUNDLE_FILE, check_mark, keep, newest
from pep.provider.feed import ProviderFollower
from pep.provider.feed_mark import FeedMarkFile
from tests.pep.kit import AUDIENCE, ISSUER, FakeIssuer, ManualClock, issuer_keys

from capabilities.keys import keys
from capabilities.rotation import rotation
from capabilities.statements import trust as trust_statement

PEP_KEY = keys.generate()


class Rotating:
    """A provider whose keys are rotated, and one enforcement point that hears it."""

    def __init__(self, tmp):
        self.clock, (self.made, _) = ManualClock(), issuer_keys()
        self.at = int(self.clock.wall_s()) - 1_000
        first = {role: keys.public_raw(self.made[rotation.ID_STEM[role]]) for role in Role}
        self.ring = rotation.begin(ISSUER, first, at=self.at)
        self.issuer = FakeIssuer(self.made, self.clock, pep_key=keys.public_raw(PEP_KEY))
        self.incidents, self.mark = [], tmp / "trust.json"
        self.configured = self.trust
        self.publish(self.made["registry"])
        self.begin()

    @property
    def trust(self):
        return self.ring.bundle(CAPS)

    def begin(self):
        held = newest(self.configured, self.mark)
        check_mark(held, self.mark, at=self.clock.wall_s(), caps=CAPS)
        self.follower = ProviderFollower(
            self.issuer.client(), issuer=ISSUER, key=PEP_KEY, audience=AUDIENCE, trust=held, caps=CAPS, clock=self.clock,
            mark=FeedMarkFile(self.mark.with_name("feed.json")), incident=self.incidents.append,
        )  # fmt: skip
        self.follower.trusts.keep = partial(keep, mark=self.mark)
        self.told = []
        self.follower.trusts.followers.append(self.told.append)

    def step(self, verb, *what):
        self.at += 1
        self.ring = verb(self.ring, *what, at=self.at)
        assert isinstance(self.ring, rotation.KeyRing), self.ring

    def publish(self, *signers, bundle=None):
        self.issuer.bundles = [trust_statement.sign(bundle or self.trust, key) for key in signers]
        self.issuer.trust_hint = str((bundle or self.trust).version)

    def rotate(self, role):
        """A new key signs in the role; the provider publishes each bundle, and the point hears each."""
        stem = rotation.ID_STEM[role]
        fresh = keys.generate()
        before = self.made["registry"]
        self.step(rotation.prepare, role, keys.public_raw(fresh))
        self.publish(self.made["registry"])
        self.pull()
        self.step(rotation.activate, self.ring.records[-1].id)
        self.made[stem] = fresh
        self.issuer.signer = self.made["feed"]
        self.publish(self.made["registry"], *([before] if role is Role.REGISTRY else []))
        self.pull()
        return next(r.id for r in reversed(self.ring.records) if r.role is role and r.retired_at is not None)

    def pull(self):
        asyncio.run(self.follower.trusts.pull())

    def refused(self):
        with pytest.raises(FeedError) as caught:
            self.pull()
        return caught.value.code


@pytest.fixture
def rotating(tmp_path):
    return Rotating(tmp_path)


@pytest.mark.parametrize("role", list(Role))
def test_a_whole_rotation_is_followed(rotating, role):
    asyncio.run(rotating.follower.pull())
    old = rotating.rotate(role)
    asyncio.run(rotating.follower.pull())
    rotating.step(rotation.revoke, old)
    rotating.publish(rotating.made["registry"])
    rotating.pull()
    assert rotating.follower.trusts.held == rotating.trust
    assert [bundle.version for bundle in rotating.told] == [2, 3, 4]
    asyncio.run(rotating.follower.pull())  # feed and registry are signed by the new keys
    # A restart begins with what was kept, not with the file of the first day.
    rotating.begin()
    assert rotating.follower.trusts.held == rotating.trust
    asyncio.run(rotating.follower.pull())


def test_what_a_withdrawn_registry_key_signed_counts_no_longer(rotating):
    asyncio.run(rotating.follower.pull())
    old_key = rotating.made["registry"]
    old = rotating.rotate(Role.REGISTRY)
    rotating.step(rotation.revoke, old)
    rotating.publish(rotating.made["registry"])
    rotating.pull()
    new_key, rotating.made["registry"] = rotating.made["registry"], old_key
    with pytest.raises(FeedError) as caught:
        asyncio.run(rotating.follower.pull())
    assert caught.value.code is PepFault.FEED_UNTRUSTED
    rotating.made["registry"] = new_key
    asyncio.run(rotating.follower.pull())


def test_nothing_else_takes_its_place(rotating):
    mallory, held = keys.generate(), rotating.trust
    later = replace(held, version=9, issued_at=held.issued_at + 1)
    signer = rotating.made["registry"]
    swapped = {1: keys.public_raw(mallory)}
    for bundle, by in [
        (later, mallory),
        (later, rotating.made["feed"]),
        (replace(later, issuer="http://127.0.0.1:1/other"), signer),
        (replace(later, valid_until=int(rotating.clock.wall_s()) - 1), signer),
        (replace(later, roots=swapped), signer),
        (replace(later, issued_at=int(rotating.clock.wall_s()) + 60), signer),
    ]:
        rotating.publish(by, bundle=bundle)
        assert rotating.refused() is PepFault.FEED_UNTRUSTED
    for older in (held, replace(held, version=0)):  # no news, and no lie
        rotating.publish(signer, bundle=older)
        rotating.pull()
    for answer in ({}, {"statements": "x"}, {"statements": [1]}):
        rotating.issuer.bundles = answer.get("statements", 3)
        assert rotating.refused() is PepFault.FEED_UNREACHABLE
    rotating.issuer.bundles = ["a.b.c"]
    assert rotating.refused() is PepFault.FEED_UNTRUSTED
    assert (rotating.follower.trusts.held, rotating.told) == (held, [])
    assert not rotating.mark.with_name(BUNDLE_FILE).exists()


def test_what_cannot_be_kept_is_not_acted_on(rotating):
    def full(_):
        raise OSError(28, "full")

    rotating.follower.trusts.keep = full
    rotating.step(rotation.renew)
    rotating.publish(rotating.made["registry"])
    assert rotating.refused() is PepFault.STATE_UNREADABLE
    assert rotating.told == []


def test_a_hint_causes_a_question_and_no_more(rotating):
    trusts = rotating.follower.trusts
    for none in (None, "", "1", "0", "-2", "2.5", "²", "9" * 11, "x"):
        trusts.hint(none)
        assert not trusts._wake.is_set(), none
    asyncio.run(rotating.follower.pull())
    assert not trusts._wake.is_set()
    rotating.step(rotation.renew)
    rotating.publish(rotating.made["registry"])
    asyncio.run(rotating.follower.pull())  # the answer to another question names the version
    assert trusts._wake.is_set()
    assert rotating.told == []

    async def woken():
        running = asyncio.create_task(trusts.run())
        await asyncio.sleep(0)
        trusts.doubt()
        while not rotating.told:
            await asyncio.sleep(0.001)
        running.cancel()

    asyncio.run(asyncio.wait_for(woken(), 20))
    assert trusts.held.version == 2


def test_a_kept_bundle_that_cannot_be_read_lets_nothing_begin(rotating):
    rotating.step(rotation.renew)
    rotating.publish(rotating.made["registry"])
    rotating.pull()
    rotating.mark.with_name(BUNDLE_FILE).write_text("{}")
    with pytest.raises(ConfigError) as caught:
        rotating.begin()
    assert caught.value.code is PepFault.STATE_UNREADABLE
    rotating.mark.with_name(BUNDLE_FILE).unlink()
    with pytest.raises(ConfigError) as caught:  # the mark remembers that there was a newer one
        rotating.begin()
    assert caught.value.code is PepFault.CONFIG_INVALID
