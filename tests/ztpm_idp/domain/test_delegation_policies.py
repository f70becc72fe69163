"""Policies on delegation (e2): decided before anything is signed, refused with a reason, on record."""

from __future__ import annotations

import json

import pytest
from capabilities.values.scope import Restriction, Tier
from policies.conduct.trust_changes import CHARGES
from policies.decision.load import load
from policies.words.reason_table import Reason
from tests.ztpm_idp.journals import Journal
from tests.ztpm_idp.test_conduct import held, probed, scores
from tests.ztpm_idp.test_lending import chain_of
from tests.ztpm_idp.world import LOWER, SLOWER, World

from ztpm_idp.client import ClientError
from ztpm_idp.domain.lending import delegation_policy

pytestmark = pytest.mark.long

HEAD = 'name = "test"\nversion = 1\n'
DELEGATION = """
[[policy]]
id = "delegation"
subject = {{ agents = {subject}, sponsors = "any" }}
object = {{ ids = {ids}, operations = ["delegate"] }}
predicate = {predicate}
ep = ["e2"]
effect = "{effect}"
obligation = [{obligation}]
pit_bound = "none"
"""
CHAIN = '{ all = ["AID-1", "AID-2", "AID-3", "AID-4", "AID-5", "CATP-1", "CATP-2", "CATP-3", "CATP-4", "ABG-3"] }'


def policies(*, predicate=CHAIN, effect="PERMIT", obligation='"record"', subject='"any"', ids='"any"', more=""):
    stated = dict(predicate=predicate, effect=effect, obligation=obligation, subject=subject, ids=ids)
    return load(HEAD + DELEGATION.format(**stated) + more)


def world_with(tmp_path, chosen):
    world = World(tmp_path, policies=chosen)
    return world


def delegations(world):
    entries = [json.loads(line) for line in world.people["carol"].export_ledger().splitlines()]
    return [entry["body"] for entry in entries if entry.get("kind") == "delegation-refused"]


def refused(world, planner, lent, mover, restriction=SLOWER):
    with pytest.raises(ClientError) as caught:
        planner.delegate(lent.token, mover, restriction, purpose="p")
    assert caught.value.status == 403
    return caught.value.code


def party(world):
    planner, mover = world.agent("planner", role="planner"), world.agent("mover")
    return planner, mover, world.people["alice"].issue(planner, world.scope(), purpose="p")


ALSO = DELEGATION.replace('id = "delegation"', 'id = "more"')


@pytest.mark.parametrize(
    ("chosen", "code", "effect"),
    [
        (policies(), None, "PERMIT"),
        (policies(ids='["helper"]'), "NO_POLICY", "DENY"),
        (policies(subject='["somebody"]'), "NO_POLICY", "DENY"),
        (policies(predicate="'CII-1'"), "EVIDENCE_MISSING", "DENY"),
        (policies(predicate="'CII-6'"), "EVIDENCE_MISSING", "DENY"),
        (policies(predicate='{ primitive = "AID-5", hops_max_count = 0 }'), None, "PERMIT"),
        (
            policies(more=ALSO.format(predicate='"always"', effect="DENY", obligation='"record"', subject='["planner"]', ids='["mover"]')),
            "PROHIBITED",
            "DENY",
        ),
        (
            policies(more=ALSO.format(predicate='"always"', effect="DEFER", obligation='"record"', subject='"any"', ids='"any"')),
            "APPROVAL_REQUIRED",
            "DEFER",
        ),
    ],
)  # fmt: skip
def test_the_set_decides(tmp_path, chosen, code, effect):
    with world_with(tmp_path, chosen) as world:
        planner, mover, lent = party(world)
        if code is None:
            made = planner.delegate(lent.token, mover, SLOWER, purpose="p")
            assert [hop.agent for hop in chain_of(world, made.token).hops] == ["planner", "mover"]
            assert delegations(world) == []
            return
        assert refused(world, planner, lent, mover) == code
        (kept,) = delegations(world)
        assert kept["code"] == code
        assert (kept["decision"]["effect"], kept["decision"]["reason"]) == (effect, code)
        assert kept["decision"]["policy_digest"] == chosen.digest
        world.people["alice"].revoke("token", lent.token_id, "nothing was made below it")
        assert world.on_loop(hops(world)) == [lent.hop_id]


async def hops(world):
    import sqlalchemy as sa

    from ztpm_idp.store import schema as t

    async with world.provider.store._engine.connect() as connection:
        return list((await connection.execute(sa.select(t.hops.c.hop_id))).scalars())


def test_the_shipped_set_lets_an_agent_lend_that_is_well(world):
    planner, mover, lent = party(world)
    planner.delegate(lent.token, mover, SLOWER, purpose="p")


def test_an_agent_that_deviated_lends_nothing_before_it_is_lent_to_anew(world):
    """The deviation came after the attestation for its hop: a holder that delegates is verified anew first."""
    planner, mover, lent = party(world)
    world.journal, world.second = Journal(world), lent.token
    world.clock.at_s += 2
    probed(world)
    assert refused(world, planner, lent, mover) == "REATTESTATION_NEEDED"
    world.clock.at_s += 2
    anew = world.people["alice"].issue(planner, world.scope(), purpose="p")
    planner.delegate(anew.token, mover, SLOWER, purpose="p")


def test_a_holder_that_is_not_trusted_still_lends_what_moves_nothing_yet(world):
    """Lending is of tier 0; where it is used, every edge of the chain is asked for its trust."""
    planner, mover, lent = party(world)
    world.people["alice"].set_trust("planner", 0)
    planner.delegate(lent.token, mover, SLOWER, purpose="p")


def test_trust_below_what_a_set_wants_is_a_question_and_nobody_is_asked(tmp_path, monkeypatch):
    monkeypatch.setattr(delegation_policy, "Tier", type("T", (), {"NO_EFFECT": Tier.HIGH_CONSEQUENCE}))
    with world_with(tmp_path, policies()) as world:
        planner, mover, lent = party(world)
        planner.delegate(lent.token, mover, SLOWER, purpose="p")
        world.people["alice"].set_trust("planner", 699)
        assert refused(world, planner, lent, mover, LOWER) == "TRUST_TOO_LOW"
        (kept,) = delegations(world)
        assert kept["decision"]["effect"] == "DEFER"


def test_a_policy_that_asks_for_what_is_not_done_here_permits_nothing(tmp_path):
    with world_with(tmp_path, policies(obligation='"record", "watch"')) as world:
        planner, mover, lent = party(world)
        assert refused(world, planner, lent, mover) == "OBLIGATION_UNMET"


def test_what_was_not_loaded_is_not_well(world, monkeypatch):
    """Should the holders of a chain ever not be looked up, nothing is lent on the strength of it."""
    import ztpm_idp.routes.tokens as routes

    planner, mover, lent = party(world)
    mid = planner.delegate(lent.token, mover, SLOWER, purpose="p")
    helper = world.agent("helper")
    monkeypatch.setattr(routes, "named", lambda *_: frozenset())
    with pytest.raises(ClientError) as caught:
        mover.delegate(mid.token, helper, Restriction(ceiling=Tier(1)), purpose="p")
    assert caught.value.code == "EVIDENCE_MISSING"
    found = delegations(world)[-1]["decision"]["findings"]
    assert {"CATP-1", "ABG-3"} <= {one["primitive"] for one in found if one["reason"] == "EVIDENCE_MISSING"}


# --- the provider is a reporter, too ---------------------------------------------------------------------------------


def test_an_attempt_to_lend_more_costs_trust_and_asking_for_nothing_less_little(world):
    planner, mover, lent = party(world)
    assert refused(world, planner, lent, mover, Restriction()) == "NOT_NARROWER"
    slip, attempt = (CHARGES[reason].milli / 1_000 for reason in (Reason.PARAMETERS_WRONG, Reason.NOT_NARROWER))
    assert scores(world) == {("alice", "planner"): round(800 * 20 / (20 + slip))}
    assert refused(world, planner, lent, mover, Restriction(ceiling=Tier(4))) == "NOT_NARROWER"
    assert scores(world) == {("alice", "planner"): round(800 * 20 / (20 + slip + attempt))}
    planner.delegate(lent.token, mover, SLOWER, purpose="p")
    trusted, behaves = held(world, "planner")
    assert set(next(iter(trusted.accounts.values()))) == {world.settings.issuer}
    assert behaves.careers["planner"].acts == 3


def test_whose_possession_is_not_proven_is_not_charged(world):
    planner, mover, lent = party(world)
    with pytest.raises(ClientError) as caught:
        mover.delegate(lent.token, planner, Restriction(ceiling=Tier(4)), purpose="p")
    assert caught.value.code == "PROOF_WRONG_KEY"
    assert scores(world) == {}
