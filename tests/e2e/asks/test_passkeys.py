"""A passkey from its making to a vote that an enforcement point counts, in headless Chromium on a real listener."""

from __future__ import annotations

import hashlib
import re
import socket
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import httpx2
import pytest
from capabilities.statements.people.vote import digest_of
from capabilities.values.caps import DEFAULT
from capabilities.values.scope import Tier
from msgspec import structs
from pep.people.clearings import count
from pep.people.votes import Count, VerifiedVote, read_vote, tally
from pep.pit.base.errors import SceneError
from pep.pit.picture.shown_form import shown_text
from pep.pit.scene.adult_body import adult_at_distance
from pep.pit.scene.scene import THINGS_LIMIT, Capsule, Thing
from pep.request.authority import PresentedRequest
from policies.evidence.model import Effect
from policies.words.reason_table import Reason
from tests import browsing
from tests.browsing import CHROMIUM, looked_at, picture
from tests.pep import kit
from tests.pep.people.test_approvals import People
from tests.e2e.asks.pictured import FOUND, MOTION, SEEN, SHOWN, answered, asked, checked
from tests.pep.pit.scenes import ROBOT
from tests.ursim.cell import HOME, let_go, until
from tests.ztpm_idp.asks import PEP
from tests.ztpm_idp.routes.test_latches import taken as told_latch
from tests.ztpm_idp.provider.test_ask_page import SENTENCES
from tests.ztpm_idp.world import AUDIENCE
from ursim.ports.launch import SimulatedController

from capabilities.keys import keys
from capabilities.statements import registry
from capabilities.statements.people import ask, latch, passkey_vote
from capabilities.statements.people import picture as wire

pytestmark = [
    pytest.mark.e2e,
    pytest.mark.clause("PSK-6"),
    pytest.mark.skipif(CHROMIUM is None, reason="Chromium is not installed"),
]
SCRIPTS_PORT = 30_002


class Snapshot:
    """Approvers as an enforcement point reads them from the signed registry."""

    def __init__(self, cell):
        text = cell.get(PEP, f"/registry?audience={AUDIENCE}").text
        self.read = registry.open(text, cell.world.trust.registry, DEFAULT)

    def approvers(self):
        return {entry.key: entry.id for entry in self.read.approvers}

    def passkeys(self):
        return {entry.key: entry.id for entry in self.read.passkeys}


ACT = {
    "perception": "none",
    "object": "valve-7",
    "operation": "open_valve",
    "start_urad": (),
    "contributors": (),
    "index_milli": 0,
    "perception_age_ms": None,
}
"""An act without motion."""
FIRST = ask.Contributor("person", "wrist_3", f"{'p' * 240}/torso", 2_640, 133_700, 371_000, "c" * 256)
LONG = {"object": "x" * 256, "operation": "m" * 256, "contributors": (FIRST,)}
"""The longest names that an ask may have, none of which can be broken at a space."""


def opened(cell, text):
    return ask.open(text, {keys.public_raw(cell.world.private[PEP])}, DEFAULT)


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

    ask_id, text = asked(cell)
    page.goto(f"{cell.world.issuer}/approvals/{ask_id}/page")
    checked(page)
    browsing.narrow(page)
    # a person who is not verified signs nothing, and nor does one in another's name
    page.fill("#approver", "carol")
    browsing.verified(page, person=False)
    page.click("#approve")
    answered(page, "Nothing was signed")
    browsing.verified(page, person=True)
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
    checked(page)
    page.fill("#approver", "carol")
    page.click("#approve")
    answered(page, "CLEAR_NOT_SEEN")
    page.click("#deny")
    answered(page, "The ask is denied")
    assert cell.told(ask_id).state == "denied"


@pytest.mark.clause("PSK-8")
def test_the_page_says_draws_and_counts_down_what_was_signed(cell, page):
    ask_id, text = asked(cell)
    page.emulate_media(reduced_motion="no-preference")
    page.goto(f"{cell.world.issuer}/approvals/{ask_id}/page")
    checked(page)
    first = FOUND.contributions[0]
    person, region = first.object.split("/")
    said = page.text_content("#sentence")
    assert f"passes person {person}'s {region.replace('_', ' ')} at {first.clearance_um // 1000} mm" in said
    assert page.text_content("#reason") == "Agent mover, for alice. Why you: tier 3."
    assert page.text_content("#code") == digest_of(text)[:8]
    assert re.fullmatch(r"\d+:\d\d left\.", page.text_content("#left"))
    before = page.text_content("#left")
    page.wait_for_function("was => document.querySelector('#left').textContent !== was", arg=before, timeout=5_000)
    decides = str(wire.read(SHOWN).places[0].posture)
    page.wait_for_function("at => document.querySelector('#time').value === at", arg=decides, timeout=15_000)
    at = page.input_value("#time")
    page.wait_for_function("was => document.querySelector('#time').value !== was", arg=at, timeout=15_000)
    page.emulate_media(reduced_motion="reduce")
    assert not page.evaluate("document.querySelector('#all').open"), "digests and angles are folded"
    assert page.evaluate("document.querySelector('#view canvas').width > 0")
    cell.world.people["alice"].deny(ask_id)


@pytest.mark.clause("PSK-8")
@pytest.mark.parametrize("what", ["picture", "sentence", "who", "code", "digest", "ask", "text"])
def test_nobody_can_approve_where_the_page_was_tampered_with(cell, page, what):
    ask_id, text = asked(cell)
    other = ask.sign(structs.replace(opened(cell, text), index_milli=1), cell.world.private[PEP])
    spoil = {
        "sentence": lambda html: html.replace(" mm, ", " m, ", 1),
        "who": lambda html: html.replace("for alice. Why", "for bob. Why", 1),
        "code": lambda html: html.replace(f'id="code">{digest_of(text)[:8]}', 'id="code">00000000', 1),
        "digest": lambda html: html.replace(digest_of(text), digest_of(other)),
        "ask": lambda html: html.replace(f'data-ask="{text}"', f'data-ask="{other}"'),
        "text": lambda html: html.replace(f'data-text="{text}"', f'data-text="{other}"'),
    }

    def changed(route):
        found = route.fetch()
        body = found.text()
        spoilt = body.replace('"at_ms":0', '"at_ms":1', 1) if what == "picture" else spoil[what](body)
        assert spoilt != body
        route.fulfill(response=found, body=spoilt)

    pattern = f"**/approvals/{ask_id}/{'picture' if what == 'picture' else 'page'}"
    page.route(pattern, changed)
    page.goto(f"{cell.world.issuer}/approvals/{ask_id}/page")
    page.wait_for_function("() => !document.querySelector('#alert').hidden", timeout=20_000)
    assert "Nothing can be approved here" in page.text_content("#alert")
    assert page.is_disabled("#approve")
    page.unroute(pattern)
    cell.world.people["alice"].deny(ask_id)


@pytest.mark.clause("PSK-8", "STM-25")
def test_a_scene_of_500_things_is_refused_and_the_most_crowded_one_is_drawn_and_answered(cell, page):
    there = lambda k: (2.0 + k % 25 / 10, 2.0 + k // 25 / 10, 0.5)
    things = tuple(
        Thing(f"thing-{k}-{'x' * 200}", "rigid", Capsule(there(k), (*there(k)[:2], 0.8), 0.03), 0.01)
        for k in range(500)
    )
    people = tuple(
        replace(adult_at_distance(1.0 + k / 10, bearing_rad=k / 5), id=f"person-{k}-{'y' * 200}") for k in range(32)
    )
    held = lambda count: replace(SEEN, scene=replace(SEEN.scene, objects=things[:count], people=people))
    with pytest.raises(SceneError) as caught:
        shown_text(ROBOT, held(500), MOTION, FOUND)
    assert caught.value.reason == "PERCEPTION_INVALID"
    crowded = shown_text(ROBOT, held(THINGS_LIMIT), MOTION, FOUND)
    drawn = wire.read(crowded)
    assert len(crowded) <= wire.PICTURE_BYTES
    assert drawn.omitted + len(drawn.bodies) == THINGS_LIMIT + sum(len(each.regions) for each in people)
    ask_id, _ = asked(cell, shown=crowded, picture_digest=wire.digest_of(crowded))
    page.goto(f"{cell.world.issuer}/approvals/{ask_id}/page")
    checked(page)
    assert ("bodies are not drawn." in page.text_content("#margin")) is (drawn.omitted > 0)
    browsing.narrow(page)
    cell.world.people["alice"].deny(ask_id)


@pytest.mark.clause("PSK-8")
@pytest.mark.parametrize("name", ["motion", "long", "act"])
def test_nothing_is_wider_than_the_screen_and_everybody_can_read_it(cell, page, axe, name):
    changes = {"motion": {}, "long": LONG, "act": ACT}[name]
    ask_id, _ = cell.taken(**changes) if name == "act" else asked(cell, **changes)
    page.goto(f"{cell.world.issuer}/approvals/{ask_id}/page")
    checked(page)
    for whole in (False, True):
        page.evaluate("whole => { document.querySelector('#all').open = whole; }", whole)
        looked_at(page, f"ask-{name}{'-all' if whole else ''}", axe)
    cell.world.people["alice"].deny(ask_id)


@pytest.mark.clause("PSK-8")
def test_without_javascript_the_text_and_the_command_remain(cell, page):
    ask_id, text = asked(cell)
    context = page.context.browser.new_context(java_script_enabled=False, viewport={"width": 390, "height": 844})
    bare = context.new_page()
    bare.goto(f"{cell.world.issuer}/approvals/{ask_id}/page")
    seen = bare.inner_text("main")
    assert "passes person" in seen
    assert f"ztpm approvals approve {ask_id}" in seen
    assert digest_of(text)[:8] in seen
    assert not bare.is_visible("#approve")
    assert not bare.is_visible("#deny")
    picture(bare, "ask-no-script")
    context.close()
    cell.world.people["alice"].deny(ask_id)


class Answered(People):
    """Point that asks the provider about a motion near a person, and whose effect moves a simulated arm."""

    away = False

    def __init__(self, tmp, cell, robot):
        self.cell, self.robot, self.pictures = cell, robot, Drawn()
        self.beside = ThreadPoolExecutor(1)  # playwright has a loop of its own on this thread
        super().__init__(tmp)

    def build(self, journal=None):
        self.pep_key = self.cell.world.private[PEP]
        self.issuer.client = self.client
        super().build(journal)
        self.asking.renew(self.cell.world.trust)
        return self

    def client(self):
        """Client of the provider, which is away when a test says so."""
        away = httpx2.MockTransport(lambda _: httpx2.Response(503)) if self.away else None
        # each call has a loop of its own, which no connection outlives
        return httpx2.AsyncClient(transport=away, limits=httpx2.Limits(max_keepalive_connections=0))

    def credentials(self, holder, *, lease_ms=30_000):
        at = self.clock.wall_s()
        presented = PresentedRequest(holder.text, holder.proof(b"{}", at=at, url=AUDIENCE), "POST", AUDIENCE, b"{}")
        return self.authority.check(presented, lease_ms=lease_ms)

    def go(self):
        return self.beside.submit(super().go).result(20)

    def approved_by_page(self, page, url):
        page.goto(url)
        checked(page)
        page.fill("#approver", "carol")
        page.click("#approve")
        answered(page, "The ask is granted")
        self.clock.wall = time.time()
        self.beside.submit(self.pull).result(20)

    async def effect(self, permit):
        program = f"def moved():\n  movej({list(kit.MOVE['q_rad'])}, a=3.0, v=1.5)\nend\n"
        with socket.create_connection((self.robot.host, SCRIPTS_PORT), timeout=5) as port:
            port.sendall(program.encode())
        return await super().effect(permit)


class Drawn:
    """The picture of the motion, for any request."""

    def shown(self, request_id):
        return SHOWN


def asking(cell, tmp_path, monkeypatch, robot=None):
    """Point at which a person is near the arm, and mover as its caller."""
    for name, value in {"ISSUER": cell.world.issuer, "AUDIENCE": AUDIENCE, "PEP": PEP}.items():
        monkeypatch.setattr(kit, name, value)
    point, people = Answered(tmp_path, cell, robot), Snapshot(cell)
    point.registry.people, point.registry.held = people.approvers(), people.passkeys()
    point.physics.answer = kit.reading(3, 2_500, contributions=FOUND.contributions)
    scope = kit.full_scope(time.time(), audience=AUDIENCE, ceiling=Tier(3))
    key = cell.world.private["mover"]
    point.holder = kit.agent(point.made, time.time(), name="mover", key=key, scope=scope, caps=point.caps)
    return point


@pytest.mark.clause("STM-25")
def test_a_point_that_ended_before_the_provider_had_its_question_puts_it_anew(cell, page, tmp_path, monkeypatch):
    monkeypatch.setattr(Answered, "away", True)
    point = asking(cell, tmp_path, monkeypatch)
    lost = point.go()
    assert lost.decision.effect is Effect.DEFER
    monkeypatch.setattr(Answered, "away", False)
    point.beside.submit(point.restart).result(20)
    told = point.go()
    assert (told.decision.effect, told.decision.reason) == (Effect.DEFER, Reason.TIER_NEEDS_APPROVAL)
    page.goto(told.ask.url)
    checked(page)
    assert cell.told(lost.ask.ask_id) is None
    assert [(each["body"]["ask_id"], each["body"]["reason"]) for each in point.records("ask-refused")] == [
        (lost.ask.ask_id, "ASK_PICTURE_DIFFERS")
    ]
    cell.world.people["alice"].deny(told.ask.ask_id)


@pytest.mark.clause("PSK-6", "PSK-8")
def test_a_question_answered_on_its_page_moves_the_arm_once(cell, page, tmp_path, monkeypatch):
    """After the first test, in which carol has made her passkey."""
    eyes_of = pytest.importorskip("rtde_receive", reason="ur_rtde is not installed").RTDEReceiveInterface
    with SimulatedController.start(joints=HOME) as robot:
        point, eyes = asking(cell, tmp_path, monkeypatch, robot), eyes_of(robot.host)
        at = lambda q: max(abs(a - b) for a, b in zip(eyes.getActualQ(), q, strict=True)) < 1e-3
        asked_first = point.go()
        assert asked_first.decision.effect is Effect.DEFER, asked_first.decision.reason
        assert (at(HOME), point.sent) == (True, [])
        point.approved_by_page(page, asked_first.ask.url)
        assert at(HOME), "an answer moves nothing by itself"
        assert point.go().decision.effect is Effect.PERMIT
        until(lambda: at(kit.MOVE["q_rad"]))
        # the answer is used: the same again is another question
        assert point.go().decision.effect is Effect.DEFER
        assert len(point.sent) == 1
        assert at(kit.MOVE["q_rad"])
        let_go(eyes)


@pytest.mark.clause("PSK-7", "STM-22")
def test_a_latch_is_cleared_by_passkey(cell, page):
    """After the first test, in which carol has made her passkey."""
    latch_id, text = told_latch(cell, at=int(time.time()), person="bob")
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


@pytest.mark.clause("PSK-8")
def test_the_script_says_of_every_contributor_what_the_provider_says(cell, page):
    ask_id, _ = asked(cell)
    page.goto(f"{cell.world.issuer}/approvals/{ask_id}/page")
    checked(page)
    for sentence, first in SENTENCES.items():
        shown_ask = ask.claims(cell.ask(contributors=(ask.Contributor(*first[:3], 2_640, *first[3:], "camera-1"),)))
        assert page.evaluate("ask => sentenceOf(ask)", shown_ask) == sentence
    cell.world.people["alice"].deny(ask_id)
