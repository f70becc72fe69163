"""The provider's own keys under a ring, and callers whose keys are P-256."""

from __future__ import annotations

import pytest
from capabilities.keys.trust import TrustBundle
from capabilities.keys.windows import Role
from capabilities.rotation.rotation import KeyRing
from capabilities.rotation.succession import succeed
from capabilities.statements.revocation import RevocationView
from capabilities.token.token_text import token_from_text
from capabilities.token.verify import verify
from capabilities.values.caps import DEFAULT
from capabilities.values.chain import Chain
from tests.ztpm_idp.test_lending import SLOWER, refused, tree
from tests.ztpm_idp.world import AUDIENCE, ISSUER, START_S, World
from ztpm_idp.keys.key_files import IdpKeys

from capabilities.keys import keys
from capabilities.rotation import rotation
from capabilities.statements import registry, workload

P256 = keys.Algorithm.P256
BEGUN = int(START_S) - 1_000
FIRST = {role: keys.generate() for role in Role}
SECOND = {Role.ROOT: keys.generate(), Role.ATTESTER: keys.generate(), Role.REGISTRY: keys.generate(P256)}
BEGINNING = rotation.begin(ISSUER, {role: keys.public_raw(key) for role, key in FIRST.items()}, at=BEGUN)


def rotated() -> KeyRing:
    """Root, attester and registry were rotated once, and the first root is revoked."""
    ring = BEGINNING
    for role, key in SECOND.items():
        ring = rotation.prepare(ring, role, keys.public_raw(key), at=BEGUN + 1)
        ring = rotation.activate(ring, ring.records[-1].id, at=BEGUN + 1)
    return rotation.revoke(ring, "root-1", at=BEGUN + 2)


@pytest.fixture
def later(tmp_path):
    """A provider that signs with the second keys."""
    signing = FIRST | SECOND
    own = IdpKeys(
        signing[Role.ROOT], signing[Role.ATTESTER], signing[Role.FEED], signing[Role.REGISTRY], signing[Role.LEDGER],
        ring=rotated(), former_registry=(FIRST[Role.REGISTRY],),
    )  # fmt: skip
    with World(tmp_path, idp_keys=own, settings_changes={"root_key_id": 2}) as made:
        yield made


def verified(world, text: str, trust: TrustBundle):
    return verify(
        token_from_text(text, DEFAULT), at=world.clock(), audience=AUDIENCE, view=RevocationView(0, 0, frozenset()),
        lease_ms=2_000, trust=trust, caps=DEFAULT,
    )  # fmt: skip


def test_what_is_lent_is_signed_by_the_active_keys(later):
    planner, mover, lent = tree(later)
    narrower = planner.delegate(lent.token, mover, SLOWER, purpose="move the arm")
    chain = verified(later, narrower.token, rotated().bundle(DEFAULT))
    assert isinstance(chain, Chain)
    assert chain.root_key_id == 2
    assert verified(later, narrower.token, BEGINNING.bundle(DEFAULT)).code == "UNKNOWN_ROOT_KEY"


def test_the_bundle_is_published_plain_and_signed(later):
    with later.known() as http:
        plain = TrustBundle.from_json(http.get(ISSUER + "/trust").content)
        statements = http.get(ISSUER + "/trust/signed").json()["statements"]
        snapshot = http.get(ISSUER + "/registry", params={"audience": AUDIENCE}).text
    assert plain == rotated().bundle(DEFAULT)
    assert set(plain.roots) == {2}
    # One that knows the first registry key alone, and one that knows the second alone, both follow.
    first, second = (succeed(held, text, at=later.clock(), caps=DEFAULT) for held, text in (
        (BEGINNING.bundle(DEFAULT), statements[1]), (plain, statements[0]),
    ))  # fmt: skip
    assert first == second == plain
    assert (
        succeed(BEGINNING.bundle(DEFAULT), statements[0], at=later.clock(), caps=DEFAULT).code == "STATEMENT_UNTRUSTED"
    )
    assert registry.open(snapshot, {keys.public_raw(SECOND[Role.REGISTRY])}, DEFAULT).audience == AUDIENCE


def test_nobody_may_have_a_key_that_was_ever_the_providers(later):
    alice = later.people["alice"]
    for private in (*FIRST.values(), *SECOND.values(), later.platform_key):
        error = refused(alice.register_pep, "cell-1", keys.public_raw(private), [AUDIENCE])
        assert error.code == "KEY_IN_USE"


def test_nobody_may_have_a_p256_key_of_the_platform(tmp_path):
    with World(tmp_path, platform_key=keys.generate(P256)) as world:
        raw = keys.public_raw(world.platform_key)
        assert world.platform.all_keys == {raw}
        assert refused(world.people["alice"].register_pep, "cell-1", raw, [AUDIENCE]).code in {
            "KEY_IN_USE",
            "KEY_WRONG_ROLE",
        }
        made = world.agent("planner", vouched=True)
        assert workload.open(
            world.workload_token("planner"), world.platform, audience=ISSUER, at=world.clock(), caps=DEFAULT
        )
        made.attest()


def test_people_sensors_and_peps_may_have_p256_keys(tmp_path):
    with World(tmp_path, private={}) as world:
        alice = world.people["alice"]
        private = {name: keys.generate(P256) for name in ("erin", "cell-1", "camera-1")}
        world.private |= private
        world.person("erin", "sponsor", "approver", "admin")
        erin = world.caller(type(alice), "erin")
        erin.register_pep("cell-1", keys.public_raw(private["cell-1"]), [AUDIENCE])
        erin.register_sensor(
            "camera-1", keys.public_raw(private["camera-1"]), calibration="1" * 64, transit_ms=20, audience=AUDIENCE
        )
        with world.known() as http:
            snapshot = registry.open(
                http.get(ISSUER + "/registry", params={"audience": AUDIENCE}).text, world.trust.registry, DEFAULT
            )
        assert snapshot.sensor("camera-1").key == keys.public_raw(private["camera-1"])
        assert snapshot.approver("erin").key == keys.public_raw(private["erin"])
        assert refused(alice.register_pep, "cell-2", keys.public_raw(private["erin"]), [AUDIENCE]).code in {
            "KEY_IN_USE",
            "KEY_WRONG_ROLE",
        }


def test_an_agent_with_a_p256_key_attests_itself(tmp_path):
    with World(tmp_path) as world:
        private = keys.generate(P256)
        world.private["planner"] = private
        world.people["alice"].register_agent(
            "planner", keys.public_raw(private), software_digest=bytes(range(32)).hex(), model="m", role="planner"
        )
        from ztpm_idp.client import Agent  # noqa: PLC0415

        world.caller(Agent, "planner", bytes(range(32))).attest()
