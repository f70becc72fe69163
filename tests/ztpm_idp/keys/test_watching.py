"""A ring that changes takes effect while the provider serves; one that does not hold together changes nothing."""

from __future__ import annotations

import asyncio
from dataclasses import replace

import pytest
from capabilities.keys.trust import TrustBundle
from capabilities.keys.windows import Role
from capabilities.rotation.rotation_json import ring_to_json
from capabilities.token.token_text import token_from_text
from capabilities.values.caps import DEFAULT
from capabilities.values.chain import Chain
from tests.ztpm_idp.keys.test_keys import verified
from tests.ztpm_idp.test_lending import SLOWER, refused, tree
from tests.ztpm_idp.world import AUDIENCE, ISSUER, START_S, World
from ztpm_idp.keys import key_ring
from ztpm_idp.keys.watched_file import WatchedFile

from capabilities.keys import keys
from capabilities.rotation import rotation
from capabilities.statements import registry

BEGUN = int(START_S) - 1_000


class Ring:
    """A ring on disk with its private keys, and the watch of one provider over it."""

    def __init__(self, folder):
        self.folder, self.path, self.at = folder, folder / "keys.json", BEGUN
        self.ring = rotation.begin(ISSUER, {role: self.new(f"{rotation.ID_STEM[role]}-1") for role in Role}, at=BEGUN)
        self.write()

    def new(self, name):
        key, path = keys.generate(), self.folder / f"{name}.key"
        path.touch(0o600)
        path.write_bytes(keys.to_pem(key, b"secret"))
        return keys.public_raw(key)

    def write(self, raw=None):
        beside = self.path.with_suffix(".new")
        beside.touch(0o600)
        beside.write_bytes(ring_to_json(self.ring) if raw is None else raw)
        beside.replace(self.path)

    def load(self):
        return key_ring.load("keys.json", self.folder, ISSUER, "secret")

    def step(self, verb, *what, write=True):
        self.at += 1
        self.ring = verb(self.ring, *what, at=self.at)
        if write:
            self.write()

    def prepare(self, role):
        name = f"{rotation.ID_STEM[role]}-{1 + max(r.number for r in self.ring.records if r.role is role)}"
        self.step(rotation.prepare, role, self.new(name))
        return name


@pytest.fixture
def ring(tmp_path):
    (tmp_path / "ring").mkdir(mode=0o700)
    return Ring(tmp_path / "ring")


@pytest.fixture
def world(tmp_path, ring):
    with World(tmp_path, idp_keys=ring.load()) as made:
        made.watch = watch_of(made, ring)
        yield made


def watch_of(world, ring):
    provider = world.provider
    return WatchedFile(key_ring.SETTING, ring.path, read=ring.load, take=provider.adopt, faults=provider.faults)


def look(world):
    world.on_loop(world.watch.look())


def served(world):
    with world.anonymous() as http:
        return TrustBundle.from_json(http.get(ISSUER + "/trust").content), http.get(ISSUER + "/readyz").json()


def rotate(world, ring, role):
    name = ring.prepare(role)
    look(world)
    ring.step(rotation.activate, name)
    look(world)
    return f"{rotation.ID_STEM[role]}-{int(name.rpartition('-')[2]) - 1}"


def test_every_role_is_rotated_while_it_serves(world, ring):
    planner, mover, before = tree(world)
    with world.known() as http:
        first = http.get(ISSUER + "/registry", params={"audience": AUDIENCE}).text
    old = [rotate(world, ring, role) for role in Role]
    bundle = ring.ring.bundle(DEFAULT)
    assert served(world) == (bundle, {"ready": True})
    # What was lent before goes on, and what is lent now is signed by the new keys.
    lent = planner.delegate(before.token, mover, SLOWER, purpose="p")
    assert isinstance(verified(world, lent.token, bundle), Chain)
    fresh = world.people["alice"].issue(planner, world.scope(), purpose="p")
    assert verified(world, fresh.token, bundle).root_key_id == 2
    with world.known() as http:
        text = http.get(ISSUER + "/registry", params={"audience": AUDIENCE}).text
        hint = http.get(ISSUER + "/revocations", params={"since": "0", "nonce": "n" * 16}).headers["ztpm-trust"]
        statements = http.get(ISSUER + "/trust/signed").json()["statements"]
    assert text != first, "the kept snapshot was signed by the old key"
    registry.open(text, {ring.ring.active(Role.REGISTRY).key}, DEFAULT)
    assert (hint, len(statements)) == (str(bundle.version), 2)
    # Withdrawn, nothing under the old keys counts here either.
    for name in old:
        ring.step(rotation.revoke, name)
    look(world)
    error = refused(planner.delegate, before.token, mover, SLOWER, purpose="p")
    assert (error.code, error.status) == ("UNKNOWN_ROOT_KEY", 401)
    assert isinstance(verified(world, fresh.token, ring.ring.bundle(DEFAULT)), Chain)
    assert token_from_text(fresh.token, DEFAULT)


def broken(ring, how):
    """The ring after a mistake or an attack."""
    match how:
        case "half a file":
            ring.write(ring_to_json(ring.ring)[:-40])
        case "gone":
            ring.path.unlink()
        case "a key that is not there":
            ring.step(rotation.prepare, Role.LEDGER, keys.public_raw(keys.generate()), write=False)
            ring.step(rotation.activate, "ledger-2")
        case "another issuer":
            ring.write(ring_to_json(ring.ring).replace(b"/ztpm", b"/other"))
        case "an older ring":
            ring.write(ring_to_json(replace(ring.ring, version=1)))
        case "a key that is forgotten":
            ring.write(ring_to_json(rotation.KeyRing(ISSUER, 9, ring.at, ring.ring.records[:5])))
        case "a step undone":
            records = tuple(replace(r, prepared_at=r.prepared_at - 1) for r in ring.ring.records)
            ring.write(ring_to_json(rotation.KeyRing(ISSUER, 9, ring.at, records)))
        case "writable by others":
            ring.step(rotation.renew)
            ring.path.chmod(0o622)
        case "of the future":
            ring.at = int(START_S) + 60
            ring.step(rotation.renew)


BROKEN = (
    "half a file", "gone", "a key that is not there", "another issuer", "an older ring", "a key that is forgotten",
    "a step undone", "writable by others", "of the future",
)  # fmt: skip


def test_a_ring_that_does_not_hold_together_keeps_the_old_one_and_is_reported(world, ring):
    ring.prepare(Role.FEED)
    look(world)
    good = ring.ring
    for how in BROKEN:
        before = world.provider.keys
        broken(ring, how)
        look(world)
        look(world)
        assert world.provider.keys is before, how
        bundle, ready = served(world)
        assert bundle == good.bundle(DEFAULT), how
        assert (ready["ready"], list(ready["faults"])) == (True, ["key_ring_file"]), how
        ring.ring, ring.at = good, good.issued_at
        ring.step(rotation.renew)
        good = ring.ring
        look(world)
        assert served(world) == (good.bundle(DEFAULT), {"ready": True}), how


def test_a_request_is_signed_whole_by_one_ring(world, ring):
    """Rotations between the requests of a crowd: no answer mixes two rings."""
    planner = world.agent("planner")
    bundles = []

    def lend():
        return world.people["alice"].issue(planner, world.scope(), purpose="p").token

    async def crowd():
        calls = [asyncio.to_thread(lend) for _ in range(6)]
        running = [asyncio.create_task(call) for call in calls]
        return await asyncio.gather(*running)

    tokens = []
    for _ in range(2):
        name = ring.prepare(Role.ROOT)
        look(world)
        tokens += asyncio.run(crowd())
        ring.step(rotation.activate, name)
        look(world)
        bundles.append(ring.ring.bundle(DEFAULT))
    assert {type(verified(world, text, bundles[-1])) for text in tokens} == {Chain}
