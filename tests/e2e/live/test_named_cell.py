"""A whole cell with its provider at a name: people answer for the arm by passkey, and take it back."""

import json
import time
from pathlib import Path

import pytest
from capabilities.statements.people import picture
from tests import browsing
from tests.browsing import CHROMIUM
from tests.e2e.live.test_live_page import CALLS, call_of
from tests.e2e.test_up import PASSPHRASE, Running, until
from ztpm.stage.stage import LEFT, RIGHT
from ztpm_idp.client import ClientError, Operator

from ztpm.base.layout import Layout, read_key

pytestmark = [
    pytest.mark.e2e,
    pytest.mark.timeout(300),
    pytest.mark.skipif(CHROMIUM is None, reason="Chromium is not installed"),
]
SLOWLY_RAD_S = 0.35
"""Speed at which an approved motion near a person hurts nobody."""
CONFIRMED_S = 10.0
"""A cell confirms within a second; a busy machine within this."""


@pytest.fixture(scope="module")
def cell(tmp_path_factory):
    running = Running(tmp_path_factory.mktemp("named") / "cell", "--localhost")
    yield running
    running.end()


@pytest.fixture(scope="module")
def page(cell, caller):
    """A browser with a passkey of alice."""
    layout = Layout(Path(cell.told["data"]))
    bob = Operator("bob", read_key(layout.operator_key("bob"), PASSPHRASE.encode()), cell.told["issuer"])
    with browsing.browser_page() as opened:
        browsing.authenticator(opened)
        browsing.enrolled(opened, caller.alice, bob)
        yield opened


def place(cell):
    """Angle of the arm's base joint, rad."""
    return cell.status()["robot"]["q_rad"][0]


def stands(cell):
    status = cell.status()
    return status and not status["robot"]["moving"] and status


def seen(cell, *people):
    scene = Path(cell.told["data"]) / "cell" / "scene.json"
    scene.write_text(json.dumps({"people": list(people)}))
    until(lambda: cell.status()["perception"]["people"] == len(people), "the sensor sees them")


@pytest.mark.clause("PSK-6", "PSK-8", "LIV-6")
def test_a_question_of_a_whole_cell_answered_on_its_page_moves_the_arm_once(cell, caller, page):
    seen(cell, {"id": "p1", "x_m": -0.62, "y_m": -0.3})
    begun = place(cell)
    to = RIGHT
    asked = call_of(caller, to, "DEFER", speed=SLOWLY_RAD_S).result(60)
    assert abs(place(cell) - begun) < 1e-3
    page.goto(f"{cell.told['issuer']}/approvals/{asked.content['approval_id']}/page")
    page.wait_for_function("() => !document.querySelector('#approve').disabled", timeout=20_000)
    page.fill("#approver", "alice")
    page.focus("#approve")
    page.keyboard.press("Enter")
    page.wait_for_function("() => document.querySelector('#told').textContent.includes('The ask is granted')")
    assert abs(place(cell) - begun) < 1e-3, "an answer moves nothing by itself"
    assert call_of(caller, to, "PERMIT", speed=SLOWLY_RAD_S).result(60).content["outcome"] == "reached"
    assert abs(place(cell) - to[0]) < 2e-3
    # the answer is used: another motion there is another question
    assert call_of(caller, LEFT, "PERMIT", "DEFER", speed=SLOWLY_RAD_S).result(60).decision == "DEFER"
    assert page.faults == []


def drawn_from_its_record(cell, caller, page):
    """The last permitted motion, about which nobody was asked, is drawn on the page of its request, with its end."""

    def told():
        records = [
            json.loads(line)["body"]["record"]
            for line in caller.alice.export_ledger().splitlines()
            if b'"record"' in line
        ]
        *_, moved = (each["body"] for each in records if each["kind"] == "decision" and permitted(each["body"]))
        named = [each["body"] for each in records if each["kind"] == "picture"]
        return next((each for each in named if each["request_id"] == moved["request"]["id"]), None)

    record = until(told, "its picture is named on record", 90)
    assert "digest" in record, record

    def brought():
        try:
            return caller.alice.motion_picture(record["digest"])
        except ClientError as error:
            assert error.code == "PICTURE_AWAITED"
            return None

    shown = picture.read(until(brought, "it has come", 30))
    assert shown.margin_um >= 0 and len(shown.postures) > 8 and shown.bodies
    page.goto(f"{cell.told['issuer']}/console/trail/requests/{record['request_id']}")
    page.wait_for_function("() => document.querySelector('.pictured').dataset.result", timeout=60_000)
    assert page.inner_text(".pictured .verdict").startswith("Checked in this browser before it was drawn")
    assert page.locator(".pictured canvas").count() == page.locator(".pictured").count() == 1
    assert "authority_lost" in page.text_content("main"), "its end is told beside it"
    browsing.picture(page, "console-motion-on-record")


def permitted(body):
    return body["decision"]["effect"] == "PERMIT" and body["request"]["operation"] == "move_joint"


@pytest.mark.clause("CON-4", "CON-9", "LIV-6")
def test_a_token_taken_back_in_the_tree_stops_the_moving_arm_and_is_in_the_trail(cell, caller, page):
    seen(cell)
    issuer, token = cell.told["issuer"], caller.lent.token_id
    page.goto(f"{issuer}/console")
    page.get_by_role("button", name="Log in with a passkey").click()
    page.wait_for_url(f"{issuer}/console")
    page.goto(f"{issuer}/console/tree")
    page.get_by_role("link", name=f"Revoke Token {token}").focus()
    page.keyboard.press("Enter")
    page.get_by_label("Reason").focus()
    page.keyboard.type("it has moved enough")
    begun = place(cell)
    to = RIGHT if begun < 0 else LEFT
    asked = call_of(caller, to, "PERMIT", speed=SLOWLY_RAD_S)
    until(lambda: abs(place(cell) - begun) > 0.05, "it moves")
    word_s = time.monotonic()
    page.keyboard.press("Enter")
    page.wait_for_url("**/console/revocations/*")
    seen_s = time.monotonic() - word_s
    stood = until(lambda: stands(cell), "it stands", 5)
    stood_s = time.monotonic() - word_s
    assert abs(stood["robot"]["q_rad"][0] - to[0]) > 0.1, "stopped, not arrived"
    assert "mover" in page.inner_text(".dead-hops")
    page.wait_for_function(
        "() => document.querySelectorAll('.point.confirmed').length === 2", timeout=CONFIRMED_S * 1e3
    )
    confirmed_s = time.monotonic() - word_s
    told = page.locator(".point.confirmed").all_inner_texts()
    said = asked.result(20)
    assert said.content["outcome"] == "authority_lost", said
    assert CALLS.submit(caller.move, to).result(20).reason == "REVOKED"

    page.get_by_role("link", name="Trail", exact=True).first.click()
    page.get_by_label("Kind").fill("revoked")
    page.get_by_role("button", name="Find").click()
    row = page.locator("tbody tr").first.inner_text()
    assert "it has moved enough" in row
    assert token in row
    assert page.faults == []

    drawn_from_its_record(cell, caller, page)
    print(
        f"the page told {seen_s:.2f} s after the word what died, the arm stood {stood_s:.2f} s after it, "
        f"and points had confirmed {confirmed_s:.2f} s after it: {'; '.join(told)}"
    )
