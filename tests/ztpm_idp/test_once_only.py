"""An act that may happen once does, over many tries at once, in one process or several."""

from __future__ import annotations

import asyncio
from concurrent.futures import ThreadPoolExecutor

import pytest
from capabilities.proof.proof import prove
from tests.ztpm_idp.world import ISSUER, LOWER, MEASUREMENT, SLOWER, new_jti
from ztpm_idp.domain.events import NonceConsumed, NonceGiven

from ztpm_idp.client import ClientError, delegate_request
from ztpm_idp.store import OnceOnlyError, Store

pytestmark = pytest.mark.long

TOGETHER = 64


def attempts(action):
    """The results of 64 calls at the same time: a value, or the code of the refusal."""

    def attempt(_):
        try:
            return "made", action()
        except ClientError as error:
            return error.code, None

    with ThreadPoolExecutor(TOGETHER) as pool:
        return [code for code, _ in pool.map(attempt, range(TOGETHER))]


def test_one_nonce_makes_one_hop(world):
    planner, mover = world.agent("planner"), world.agent("mover")
    lent = world.people["alice"].issue(planner, world.scope(), purpose="p")
    evidence = mover.evidence("planner", delegate_request("mover", SLOWER, purpose="p"))
    codes = attempts(lambda: planner.delegate_with(lent.token, "mover", SLOWER, purpose="p", evidence=evidence))
    assert codes.count("made") == 1
    assert codes.count("ATTESTATION_INVALID") == TOGETHER - 1
    exported = world.people["alice"].export_ledger()
    assert exported.count(b'"kind":"token-delegated"') == 1


def test_one_nonce_makes_one_attestation(world):
    mover = world.agent("mover", attested=False)
    evidence = mover._evidence("", bytes(32))
    codes = attempts(lambda: mover._post("/agents/mover/attestations", {"evidence": evidence}))
    assert codes.count("made") == 1


def test_one_proof_makes_one_call(world):
    once = prove(
        world.private["alice"],
        method="GET",
        url=ISSUER + "/agents",
        body=b"",
        token=None,
        at=int(world.clock()),
        jti=new_jti(),
    )
    with ThreadPoolExecutor(TOGETHER) as pool, world.anonymous() as http:
        codes = list(
            pool.map(lambda _: http.get(ISSUER + "/agents", headers={"DPoP": once}).status_code, range(TOGETHER))
        )
    assert sorted(codes) == [200] + [401] * (TOGETHER - 1)


def test_one_id_is_registered_once(world):
    from capabilities.keys import keys

    alice = world.people["alice"]
    codes = attempts(lambda: alice.register_pep("cell-9", keys.public_raw(keys.generate()), ["http://127.0.0.1:1/mcp"]))
    assert codes.count("made") == 1


def test_one_revocation_takes_one_epoch(world):
    world.agent("mover")
    alice = world.people["alice"]
    with ThreadPoolExecutor(TOGETHER) as pool:
        epochs = list(pool.map(lambda _: alice.retire_agent("mover", "r"), range(TOGETHER)))
    assert epochs == [1] * TOGETHER


def test_different_revocations_take_different_epochs(world):
    dan = world.people["dan"]
    with ThreadPoolExecutor(TOGETHER) as pool:
        epochs = list(pool.map(lambda n: dan.revoke("hop", f"{n:032x}", "r"), range(TOGETHER)))
    assert sorted(epochs) == list(range(1, TOGETHER + 1))


def test_the_database_itself_keeps_once_only_things_once(world):
    """Four stores on one file, as four processes would have: no lock of ours is between them."""
    url, key = world.settings.database_url, bytes(32)

    async def go():
        stores = [await Store.open(url) for _ in range(4)]
        try:
            uses = [stores[n % 4].first_use(key=key, jti="j" * 20, expires_ms=2, at_ms=1) for n in range(TOGETHER)]
            return await asyncio.gather(*uses)
        finally:
            for store in stores:
                await store.close()

    assert sum(world.on_loop(go())) == 1


def test_a_nonce_that_another_transaction_spent_rolls_everything_back(world):
    """The domain decided on an older view: the row's own condition refuses, and nothing of the transaction holds."""
    world.agent("mover")
    store = world.provider.store

    async def spend(purpose):
        async with store.write() as transaction:
            await transaction.append((NonceConsumed("n" * 32, purpose),), actor="mover", at_ms=1)

    async def go():
        async with store.write() as transaction:
            await transaction.append((NonceGiven("n" * 32, "mover", 1),), actor="mover", at_ms=1)
        await spend("one")
        with pytest.raises(OnceOnlyError):
            await spend("two")

    world.on_loop(go())


def test_many_hops_at_once_leave_one_unbroken_ledger(world):
    from ztpm_idp import ledger_file

    planner = world.agent("planner")
    movers = [world.agent(f"mover-{n}") for n in range(8)]
    lent = world.people["alice"].issue(planner, world.scope(), purpose="p")
    with ThreadPoolExecutor(8) as pool:
        made = list(pool.map(lambda mover: planner.delegate(lent.token, mover, LOWER, purpose="p"), movers))
    assert len({m.hop_id for m in made}) == 8
    assert isinstance(
        ledger_file.verify(world.people["alice"].export_ledger().splitlines(), world.trust), ledger_file.Verified
    )
    assert MEASUREMENT
