"""A passkey from its making to a vote that an enforcement point counts, in headless Chromium on a real listener."""

from __future__ import annotations

import asyncio
import hashlib
import os
import shutil
import socket
import time
from pathlib import Path

import pytest
import uvicorn
from capabilities.statements.people.vote import digest_of
from capabilities.values.caps import DEFAULT
from pep.people.clearings import count
from pep.people.votes import Count, VerifiedVote, read_vote, tally
from tests.ztpm_idp.asks import PEP, Cell
from tests.ztpm_idp.routes.test_latches import taken as told_latch
from tests.ztpm_idp.world import AUDIENCE, World

from capabilities.keys import keys
from capabilities.statements import registry
from capabilities.statements.people import ask, latch, passkey_vote

CHROMIUM = shutil.which("chromium")
pytestmark = [
    pytest.mark.e2e,
    pytest.mark.clause("PSK-6"),
    pytest.mark.skipif(CHROMIUM is None, reason="Chromium is not installed"),
]
PICTURES = os.environ.get("ZTPM_PICTURES")
"""A folder for screenshots, for people who want to look."""


@pytest.fixture(scope="module")
def cell(tmp_path_factory):
    """A provider on a listener of its own, at a name: passkeys belong to no address."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    changes = {"issuer": f"http://localhost:{port}/ztpm", "port": port}
    with World(tmp_path_factory.mktemp("browser"), clock=time.time, settings_changes=changes) as world:
        server = uvicorn.Server(
            uvicorn.Config(world.app, host="127.0.0.1", port=port, lifespan="off", log_level="error")
        )
        served = asyncio.run_coroutine_threadsafe(server.serve(), world.loop)
        for _ in range(500):
            if server.started:
                break
            time.sleep(0.01)
        yield Cell(world)
        server.should_exit = True
        served.result(20)


@pytest.fixture(scope="module")
def page():
    playwright = pytest.importorskip("playwright.sync_api")
    with playwright.sync_playwright() as started:
        browser = started.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        opened = browser.new_context(viewport={"width": 390, "height": 844}).new_page()
        opened.authenticator = opened.context.new_cdp_session(opened)
        opened.authenticator.send("WebAuthn.enable")
        opened.id = opened.authenticator.send(
            "WebAuthn.addVirtualAuthenticator",
            {
                "options": {
                    "protocol": "ctap2",
                    "transport": "internal",
                    "hasResidentKey": True,
                    "hasUserVerification": True,
                    "isUserVerified": True,
                    "automaticPresenceSimulation": True,
                }
            },
        )["authenticatorId"]
        opened.faults = []
        opened.on("pageerror", lambda error: opened.faults.append(str(error)))
        opened.on("console", lambda said: opened.faults.append(said.text) if said.type == "error" else None)
        yield opened
        browser.close()


class Snapshot:
    """Approvers as an enforcement point reads them from the signed registry."""

    def __init__(self, cell):
        text = cell.get(PEP, f"/registry?audience={AUDIENCE}").text
        self.read = registry.open(text, cell.world.trust.registry, DEFAULT)

    def approvers(self):
        return {entry.key: entry.id for entry in self.read.approvers}

    def passkeys(self):
        return {entry.key: entry.id for entry in self.read.passkeys}


def picture(page, name):
    if PICTURES:
        page.screenshot(path=str(Path(PICTURES) / f"{name}.png"), full_page=True)


def answered(page, told):
    page.wait_for_function(
        "text => document.querySelector('#told').textContent.includes(text)", arg=told, timeout=15_000
    )


def test_a_passkey_is_made_and_answers_an_ask(cell, page):
    carol, dan = cell.world.people["carol"], cell.world.people["dan"]
    begun = carol.begin_passkey()
    page.goto(begun["url"])
    picture(page, "enrol")
    page.click("#enrol")
    answered(page, "Made. Its code is")
    key = carol.enrolled_passkey(begun["enrolment_id"])
    assert hashlib.sha256(keys.unb64u(key)).hexdigest()[:8] in page.text_content("#told")
    assert dan.confirm_change(carol.propose_passkey(begun["enrolment_id"], key)) == "done"

    ask_id, text = cell.taken()
    page.goto(f"{cell.world.issuer}/approvals/{ask_id}/page")
    assert page.evaluate("document.documentElement.scrollWidth <= window.innerWidth")
    # a person who is not verified signs nothing, and nor does one in another's name
    page.fill("#approver", "carol")
    page.authenticator.send("WebAuthn.setUserVerified", {"authenticatorId": page.id, "isUserVerified": False})
    page.click("#approve")
    answered(page, "Nothing was signed")
    page.authenticator.send("WebAuthn.setUserVerified", {"authenticatorId": page.id, "isUserVerified": True})
    page.fill("#approver", "alice")
    page.click("#approve")
    answered(page, "That passkey is carol's")
    assert cell.told(ask_id).votes == ()
    page.fill("#approver", "carol")
    picture(page, "ask")
    page.click("#approve")
    answered(page, "The ask is granted")
    picture(page, "answered")
    assert [fault for fault in page.faults if "Content Security Policy" in fault] == []

    # the enforcement point opens it by itself, with the key of its snapshot, and counts it
    (carried,) = cell.told(ask_id).votes
    shown = ask.open(text, {keys.public_raw(cell.world.private[PEP])}, DEFAULT)
    people = Snapshot(cell)
    ballot = read_vote(carried, shown, text, people, at=time.time(), caps=DEFAULT)
    assert isinstance(ballot, VerifiedVote)
    assert (ballot.vote.approver, ballot.vote.ask_digest) == ("carol", digest_of(text))
    assert passkey_vote.is_one(carried)
    assert tally([ballot], shown, people.passkeys()).count is Count.GRANTED


def test_a_denial_by_passkey_ends_the_ask(cell, page):
    ask_id, _ = cell.taken(perception="stale")
    page.goto(f"{cell.world.issuer}/approvals/{ask_id}/page")
    page.fill("#approver", "carol")
    page.click("#approve")
    answered(page, "CLEAR_NOT_SEEN")
    page.click("#deny")
    answered(page, "The ask is denied")
    assert cell.told(ask_id).state == "denied"


@pytest.mark.clause("PSK-7", "STM-22")
def test_a_latch_is_cleared_by_passkey(cell, page):
    """After the first test, in which carol has made her passkey."""
    latch_id, text = told_latch(cell, at=int(time.time()))
    page.goto(f"{cell.world.issuer}/latches/{latch_id}/page")
    assert page.evaluate("document.documentElement.scrollWidth <= window.innerWidth")
    picture(page, "latch")
    page.fill("#approver", "alice")
    page.click("#clear")
    answered(page, "That passkey is carol's")
    page.fill("#approver", "carol")
    page.click("#clear")
    answered(page, "Cleared.")
    assert [fault for fault in page.faults if "Content Security Policy" in fault] == []

    # the enforcement point opens it by itself, with the key of its snapshot, and counts it
    (carried,) = cell.answers().clearings
    shown = latch.open(text, {keys.public_raw(cell.world.private[PEP])}, DEFAULT)
    counted = count([carried], shown, text, Snapshot(cell), at=time.time(), caps=DEFAULT)
    assert (counted.approvers, counted.rejected) == (("carol",), {})
