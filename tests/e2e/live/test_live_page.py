"""The page of a running cell in a real browser: its arm, its stop, and what is old."""

import json
import os
import signal
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import httpx2
import pytest
from tests import browsing
from tests.browsing import CHROMIUM, looked_at
from tests.e2e.test_up import Running, until
from ztpm.stage.stage import LEFT, RIGHT

from ztpm.base.layout import Layout

pytestmark = [
    pytest.mark.e2e,
    pytest.mark.timeout(300),
    pytest.mark.skipif(CHROMIUM is None, reason="Chromium is not installed"),
]
DRAWS = ("--use-angle=swiftshader", "--enable-unsafe-swiftshader")
"""A browser that draws in three dimensions without hardware for it."""


@pytest.fixture(scope="module")
def cell(tmp_path_factory):
    running = Running(tmp_path_factory.mktemp("live") / "cell")
    yield running
    running.end()


@pytest.fixture(scope="module")
def page(cell):
    with browsing.browser_page(args=DRAWS) as opened:
        opened.goto(cell.told["status"])
        yield opened


@pytest.fixture(scope="module")
def axe():
    return browsing.rules()


def says(page, selector, text, limit_ms=20_000):
    page.wait_for_function(
        "([s, t]) => (document.querySelector(s)?.textContent ?? '').includes(t)",
        arg=[selector, text],
        timeout=limit_ms,
        polling=50,
    )


def drawn(page, name):
    """A picture of the page, once its arm is drawn."""
    if browsing.PICTURES:
        page.evaluate("() => new Promise((drawn) => requestAnimationFrame(() => requestAnimationFrame(drawn)))")
        browsing.picture(page, name)


def across(cell):
    """Place of the arm's base joint, and the far end of the sweep."""
    at = cell.status()["robot"]["q_rad"][0]
    return at, RIGHT if abs(at - LEFT[0]) < abs(at - RIGHT[0]) else LEFT


def moved(cell, since):
    status = cell.status()
    return status and abs(status["robot"]["q_rad"][0] - since) > 0.05 and status


CALLS = ThreadPoolExecutor(1)
"""A browser has this thread's event loop; calls have their own."""


def call_of(caller, to, *decisions, **how):
    """Answer with one of these decisions to a move, asked for until it comes: a loaded machine refuses some."""

    def ask():
        deadline = time.monotonic() + 60
        while (answer := caller.move(to, **how)).decision not in decisions:
            assert time.monotonic() < deadline, answer
        return answer

    return CALLS.submit(ask)


@pytest.mark.clause("LIV-1", "LIV-3")
def test_the_page_shows_the_arm_as_it_is_and_who_is_seen(cell, page):
    says(page, "#told", "The arm stands still.")
    scene = Path(cell.told["data"]) / "cell" / "scene.json"
    scene.write_text(json.dumps({"people": [{"id": "p1", "x_m": -1.2, "y_m": -1.0}]}))
    says(page, "#view", "p1")
    says(page, "#part-dots", "gateway")
    assert page.locator("#part-dots li.good").count() == 5
    assert page.faults == []


@pytest.mark.clause("LIV-2")
def test_its_stop_stops_a_moving_arm_and_is_in_the_ledger(cell, page, caller):
    begun, other = across(cell)
    asked = call_of(caller, other, "PERMIT")
    until(lambda: moved(cell, begun), "it moves")
    page.click("#stop", force=True)  # at once: a browser that draws in software is long in proving that nothing moves
    says(page, "#stopped", "The arm is being stopped.")
    status = until(lambda: (s := cell.status()) and not s["robot"]["moving"] and s, "it stands", 5)
    assert abs(status["robot"]["q_rad"][0] - other[0]) > 0.1, "stopped, not arrived"
    assert asked.result(20).content["outcome"] == "stopped"
    assert not status["robot"]["latch"]["latched"], "nobody says who has stopped it, and the policies latch nothing"
    says(page, "#told", "The arm stands still.")
    says(page, "#part-decisions", "somebody: stop")

    def recorded():
        for line in caller.alice.export_ledger().splitlines():
            entry = json.loads(line)
            if entry.get("kind") == "pep-record" and '"asked":"page"' in json.dumps(entry, separators=(",", ":")):
                return entry
        return None

    assert until(recorded, "the ledger tells of it")
    begun, other = across(cell)
    asked = call_of(caller, other, "PERMIT")
    says(page, "#told", "The arm moves.")
    drawn(page, "live-moving")
    assert asked.result(60).content["outcome"] == "reached"


@pytest.mark.clause("LIV-2")
def test_no_other_page_stops_it(cell, page):
    """A page of another origin stops nothing by what it can send without asking first."""
    url = cell.told["status"]
    stops = lambda: sum(decided["operation"] == "stop" for decided in cell.status()["decisions"])
    before = stops()
    for headers, status in (
        ({"Content-Type": "application/json"}, 403),
        ({"Content-Type": "application/json", "Origin": "http://evil.example"}, 403),
        ({"Content-Type": "text/plain", "Origin": url.rstrip("/")}, 400),
        ({"Content-Type": "application/json", "Origin": url.rstrip("/"), "Host": "evil.example"}, 421),
    ):
        assert httpx2.post(url + "stop", content='{"stop":true}', headers=headers).status_code == status
    other = page.context.new_page()
    other.goto("about:blank")
    tried = other.evaluate(
        "url => fetch(url, {method: 'POST', headers: {'Content-Type': 'application/json'}, body: '{\"stop\":true}'})"
        ".then(() => 'sent', () => 'refused')",
        url + "stop",
    )
    other.close()
    assert tried == "refused"
    assert stops() == before


@pytest.mark.clause("LIV-3")
def test_nothing_is_wider_than_the_screen_and_everybody_can_read_it(cell, page, caller, axe):
    scene = Path(cell.told["data"]) / "cell" / "scene.json"
    scene.write_text(json.dumps({"people": [{"id": "p1", "x_m": -0.62, "y_m": -0.3}]}))
    call_of(caller, across(cell)[1], "DEFER").result(60)
    says(page, "#part-asks", "Silence denies in")
    looked_at(page, "live", axe)
    assert page.faults == []


@pytest.mark.clause("LIV-3")
def test_without_a_script_the_page_says_the_same_in_words(cell, page):
    plain = page.context.browser.new_context(java_script_enabled=False).new_page()
    plain.goto(cell.told["status"])
    words = plain.inner_text("body")
    for said in ("stands still", "camera-1", "move_joint", "gateway", f"nc {cell.told['robot']} 29999"):
        assert said in words
    assert not plain.locator("#stop").is_visible()
    plain.context.close()


@pytest.mark.clause("LIV-4")
def test_a_gateway_that_stands_still_is_told_and_its_picture_is_grey_and_a_stop_passes_it_by(cell, page):
    assert not page.locator("#view.stale").count()
    pid = next(part["pid"] for part in cell.status()["parts"] if part["name"] == "gateway")
    os.kill(pid, signal.SIGSTOP)
    try:
        says(page, "#alarm", "says nothing")
        assert page.locator("#view.stale").count() == 1
        drawn(page, "live-stale")
        page.focus("#stop")
        page.keyboard.press("Enter")
        says(page, "#stopped", "the controller was told to stop")
    finally:
        os.kill(pid, signal.SIGCONT)
    log = [json.loads(line) for line in Layout(Path(cell.told["data"])).log.read_text().splitlines()]
    assert "arm-stopped" in {event["event"] for event in log}
