"""A latch on its way to people, and their clearings on the way back, over the wire."""

import asyncio

import pytest
from capabilities.statements.people.clearing import Clearing
from capabilities.statements.people.latch import LatchCause
from capabilities.statements.people.vote import digest_of
from capabilities.values.caps import DEFAULT as CAPS
from capabilities.values.scope import Tier
from pep.base.errors import PepFault
from pep.people.ask_composer import Asker
from pep.people.latch_file import LatchFile
from pep.people.latches import LatchedStop, Latches
from pep.provider.latch_client import AGAIN_MS, BACK_OFF_MS, LatchClient
from tests.pep.kit import AUDIENCE, ISSUER, PEP, Rig

from capabilities.statements.people import clearing

pytestmark = pytest.mark.clause("LSD-22")


@pytest.fixture
def rig(tmp_path):
    rig = Rig(tmp_path)
    rig.latched = Latches(
        LatchFile(tmp_path / "latch.json"),
        journal=rig.journal,
        clock=rig.clock,
        author=Asker(pep=PEP, audience=AUDIENCE, issuer=ISSUER, key=rig.pep_key),
        robot="ur3e",
        causes=frozenset(LatchCause),
        approvers=rig.registry,
        caps=CAPS,
        new_id=lambda: "1a" * 16,
    )
    rig.client = LatchClient(rig.latched, rig.asking, clock=rig.clock, incident=rig.incidents.append)
    yield rig
    rig.gate.close()
    rig.journal.close()


def fallen(rig):
    rig.latched.stopped(LatchedStop(LatchCause.WATCH, "IMPACT_ROSE", Tier.CONSEQUENTIAL))
    rig.latched.keep()
    rig.latched.propose("UNPROVEN")
    return rig.latched.in_force


def look(rig):
    asyncio.run(rig.client.look())
    return len(rig.issuer.latches)


def test_a_latch_is_posted_once_it_is_signed_and_again_after_a_while(rig):
    assert look(rig) == 0
    rig.latched.stopped(LatchedStop(LatchCause.WATCH, tier=Tier.CONSEQUENTIAL))
    rig.latched.keep()
    assert look(rig) == 0, "its way out is not worked out yet"
    rig.latched.propose("UNPROVEN")
    assert look(rig) == look(rig) == 1
    assert rig.issuer.latches == [rig.latched.in_force.text]
    rig.clock.advance(AGAIN_MS + 1)
    assert look(rig) == 2
    assert rig.incidents == []


@pytest.mark.parametrize(
    ("fault", "code"),
    [
        (lambda rig: setattr(rig.issuer, "latch_status", 409), PepFault.LATCH_NOT_TAKEN),
        (lambda rig: setattr(rig.issuer, "down", True), PepFault.FEED_UNREACHABLE),
    ],
)
def test_a_post_that_fails_is_an_incident_and_is_tried_again(rig, fault, code):
    fallen(rig)
    fault(rig)
    look(rig)
    assert [error.code for error in rig.incidents] == [code]
    look(rig)
    assert len(rig.incidents) == 1, "not at once"
    rig.issuer.down, rig.issuer.latch_status = False, 200
    rig.clock.advance(BACK_OFF_MS + 1)
    before = len(rig.issuer.latches)
    assert look(rig) == before + 1


def test_a_clearing_in_the_providers_word_clears_it_and_one_in_a_forged_word_does_not(rig):
    found = fallen(rig)
    at = int(rig.clock.wall_s())
    stated = Clearing(
        found.latch.latch_id, digest_of(found.text), AUDIENCE, "ur3e", LatchCause.WATCH, "bob", at + 60, at
    )
    rig.issuer.clearings = [clearing.sign(stated, rig.people["bob"].key)]
    rig.asking.heard.append(lambda answers: rig.latched.accept(answers.clearings, stands=True))
    rig.issuer.answers_signer = rig.made["feed"]
    with pytest.raises(Exception, match="FEED_UNTRUSTED"):
        rig.pull()
    assert rig.latched.latch_id is not None
    rig.issuer.answers_signer = rig.made["registry"]
    rig.pull()
    assert rig.latched.latch_id is None
