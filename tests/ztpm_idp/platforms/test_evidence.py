"""Every kind of evidence from a platform or publisher: what it carries, and everything forged refused."""

from __future__ import annotations

import pytest
from capabilities.token.hop_rules import highest
from capabilities.values.caps import DEFAULT
from capabilities.values.chain import EvidenceKind
from capabilities.values.scope import Tier
from tests.ztpm_idp.platforms import forgeries
from tests.ztpm_idp.platforms.forgeries import KINDS, Scene
from tests.ztpm_idp.test_lending import refused
from tests.ztpm_idp.test_workload import chain_of
from ztpm_idp.domain.lending.evidence import VERIFIERS

pytestmark = pytest.mark.long


@pytest.fixture(scope="module")
def scene(tmp_path_factory):
    with Scene(tmp_path_factory.mktemp("scene")) as made:
        yield made


def source(scene, agent):
    """Each proves as its platform lets it, anew for every nonce."""
    kind = agent.id
    agent._svid = None if kind == "key" else lambda nonce: scene.beside(kind, nonce)
    return agent


def test_each_kind_carries_what_its_row_says(scene):
    alice = scene.world.people["alice"]
    for name in KINDS:
        kind = EvidenceKind.BEARER if name == "cluster" else EvidenceKind(name)
        agent = source(scene, scene.world.agents[name])
        agent.attest()
        lent = alice.issue(agent, scene.world.scope(ceiling=highest(kind, DEFAULT)), purpose="p")
        assert chain_of(scene.world, lent.token).leaf.attestation.kind is kind
        error = refused(alice.issue, agent, scene.world.scope(ceiling=Tier(4)), purpose="p")
        assert (error.code, error.status) == ("ABOVE_CEILING", 403)
    assert {kind for kind in EvidenceKind if kind.vouched} == {"jwt", "bearer", "x509"}
    assert len(VERIFIERS) == 4


@pytest.mark.clause("WLD-6", "WLD-7", "WLD-8", "STM-19")
def test_no_forgery_is_accepted(scene):
    found = list(forgeries.tried(scene))
    assert len(found) >= 60
    assert {what: code for what, _, code in found if code != "ATTESTATION_INVALID"} == {}
    for kind in KINDS:  # what refuses them all takes what is genuine
        assert scene.hand_in(kind, scene.evidence(kind)) == ""


def test_a_thief_of_the_key_draws_from_no_mandate_with_a_release(scene):
    """A release is public: it is nobody's word at this moment, and a mandate asks for one after a day."""
    assert not EvidenceKind.RELEASE.vouched
    assert not EvidenceKind.KEY.vouched
