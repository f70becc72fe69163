"""A provider as a process pushes each question by its configuration, and says no address anywhere."""

from __future__ import annotations

import json
import signal
import time
from types import SimpleNamespace

import httpx2
import pytest
from tests.ztpm_idp.asks import Cell
from tests.ztpm_idp.login.browser import Browser
from tests.ztpm_idp.push.push_service import PushService
from tests.ztpm_idp.push.receiver import Receiver
from tests.ztpm_idp.test_process import Process
from tests.ztpm_idp.world import AUDIENCE, MEASUREMENT

from capabilities.keys import keys
from ztpm_idp.client import Agent, ProofAuth

pytestmark = [pytest.mark.e2e, pytest.mark.clause("PSH-2", "PSH-3", "PSH-7")]
QUESTIONS = 3
"""Ours; one agent has at most a third of those that may wait."""


@pytest.fixture
def receiver():
    made = Receiver((500, {}))
    yield made
    made.close()


@pytest.fixture
def service(tmp_path):
    made = PushService(tmp_path)
    yield made
    made.close()


def ask(process, cell):
    """Id of a question that a process took."""
    body = json.dumps({"ask": cell.text(issuer=process.issuer)}).encode()
    auth = ProofAuth(cell.world.private["cell-1"])
    with httpx2.Client() as http:
        taken = http.post(f"{process.issuer}/approvals", content=body, auth=auth)
    assert taken.status_code == 201, taken.text
    return taken.json()["ask_id"]


@pytest.mark.timeout(120)
def test_a_process_pushes_each_question_and_says_the_address_nowhere(tmp_path, receiver, service, monkeypatch):
    monkeypatch.setenv("A_WEBHOOK", receiver.url())
    process = Process(tmp_path)
    table = '\n[[webhooks]]\nname = "cell"\nform = "json"\nurl_variable = "A_WEBHOOK"\n'
    table += "[web_push]\n" + "".join(f"{name} = {json.dumps(value)}\n" for name, value in service.stated.items())
    process.config.write_text(process.config.read_text() + table)
    process.start()
    try:
        private = {name: keys.generate() for name in ("mover", "cell-1")}
        public = {name: keys.public_raw(key) for name, key in private.items()}
        with process.operator() as alice:
            alice.register_agent("mover", public["mover"], software_digest=MEASUREMENT.hex(), model="m", role="r")
            alice.register_pep("cell-1", public["cell-1"], [AUDIENCE])
            with httpx2.Client() as http:
                browser = Browser(None, origin=process.issuer.removesuffix("/ztpm"), http=http)
                browser.log_in(alice)
                browser.get("/ztpm/approvals/page")
                device = service.device("s3cret")
                assert browser.post("/ztpm/approvals/page/devices", device.form).status_code == 201
        with Agent("mover", private["mover"], process.issuer, MEASUREMENT) as mover:
            mover.attest()
        cell = Cell(SimpleNamespace(private=private, clock=time.time), furnished=True)
        asked = [ask(process, cell) for _ in range(QUESTIONS)]
        # One of them comes twice: its first message was not taken.
        found = [receiver.posts.get(timeout=30).body["ask_id"] for _ in range(QUESTIONS + 1)]
        noticed = [device.told(service.posts.get(timeout=30))["tag"] for _ in range(QUESTIONS)]
    finally:
        ended = process.end(signal.SIGTERM)
    assert (set(found), ended) == (set(asked), 0)
    assert set(noticed) == set(asked)
    assert receiver.all() == service.all() == []
    assert b"s3cret" not in process.output
    assert b"PUSH_NOT_TAKEN" in process.output
