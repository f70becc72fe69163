"""Page of an ask at its edges: a keyboard alone, a failing network or clock, a second person."""

from __future__ import annotations

import re

import pytest
from tests import browsing
from tests.browsing import CHROMIUM
from tests.e2e.asks.pictured import answered, asked, checked

pytestmark = [
    pytest.mark.e2e,
    pytest.mark.clause("PSK-6", "PSK-8"),
    pytest.mark.skipif(CHROMIUM is None, reason="Chromium is not installed"),
]


@pytest.fixture(scope="module")
def page(cell, page):
    """Browser in which carol has made her passkey."""
    browsing.enrolled(page, cell.world.people["carol"], cell.world.people["dan"])
    return page


def test_a_connection_that_is_lost_and_an_ask_that_ends_are_told(cell, page):
    ask_id, _ = asked(cell)
    page.goto(f"{cell.world.issuer}/approvals/{ask_id}/page")
    checked(page)
    page.route("**/state", lambda route: route.abort())
    page.wait_for_function("() => !document.querySelector('#alert').hidden", timeout=15_000)
    assert "No connection" in page.text_content("#alert")
    page.unroute("**/state")
    cell.world.people["alice"].deny(ask_id)
    page.wait_for_selector("text=State: denied", timeout=15_000)
    assert page.query_selector("#approve") is None


def shown(cell, page, ask_id):
    page.goto(f"{cell.world.issuer}/approvals/{ask_id}/page")
    checked(page)
    page.fill("#approver", "carol")


def test_a_telephone_without_a_network_says_that_no_answer_came_and_answers_when_it_is_back(cell, page):
    ask_id, _ = asked(cell)
    shown(cell, page, ask_id)
    page.context.set_offline(True)
    try:
        page.click("#approve")
        answered(page, "No answer came")
        assert cell.told(ask_id).votes == ()
    finally:
        page.context.set_offline(False)
    page.click("#approve")
    answered(page, "The ask is granted")
    assert len(cell.told(ask_id).votes) == 1


def test_who_answers_second_is_told_that_it_does_not_count(cell, page):
    ask_id, _ = asked(cell)
    page.route("**/state", lambda route: route.abort())  # the page does not hear of the first answer
    shown(cell, page, ask_id)
    cell.world.people["alice"].deny(ask_id)
    page.click("#approve")
    answered(page, "Nothing counts")
    page.unroute("**/state")
    assert "ASK_ANSWERED" in page.text_content("#told")
    assert (cell.told(ask_id).state, len(cell.told(ask_id).votes)) == ("denied", 1)


PAST_MS = 700_000
"""Longer than an ask waits."""


@pytest.mark.parametrize("wrong_h", [-72, 72])
def test_a_telephone_with_a_wrong_clock_counts_down_right_and_signs_nothing_for_an_ask_that_is_over(
    cell, page, wrong_h
):
    ask_id, _ = asked(cell)
    other = page.context.new_page()
    other.add_init_script(f"const now = Date.now.bind(Date); Date.now = () => now() + {wrong_h * 3_600_000};")
    other.add_init_script(
        "window.past_ms = 0; const past = performance.now.bind(performance); performance.now = () => past() + past_ms;"
    )
    other.add_init_script(
        "navigator.credentials.get = () => { window.signed = true; return Promise.reject(new Error()); };"
    )
    other.route("**/state", lambda route: route.abort())
    shown(cell, other, ask_id)
    assert re.fullmatch(r"(10:00|9:\d\d) left\.", other.text_content("#left"))
    other.evaluate("ms => { window.past_ms = ms; }", PAST_MS)
    other.wait_for_function("() => document.querySelector('#left').textContent === 'Over.'", timeout=15_000)
    assert other.is_disabled("#approve")
    other.click("#deny")
    answered(other, "this ask is over")
    assert other.evaluate("window.signed") is None
    other.close()
    assert cell.told(ask_id).votes == ()
    cell.world.people["alice"].deny(ask_id)


HERE = """() => {
  const at = document.activeElement, box = at.getBoundingClientRect(), drawn = getComputedStyle(at);
  const seen = document.elementFromPoint(box.left + box.width / 2, box.top + box.height / 2);
  const framed = at.matches(":focus-visible") && parseFloat(drawn.outlineWidth) >= 2 && drawn.outlineStyle === "solid";
  return [at.id || at.dataset.view || ("play" in at.dataset ? "play" : at.tagName), framed && at.contains(seen)];
}"""
"""Name of what has the focus, and whether that is seen: framed, inside the window, under nothing else."""
NAMES = "() => [...document.querySelectorAll('#view span')].map((each) => each.style.transform).join()"
"""Places of the names over the picture, which move as it is turned."""
COUNTED = """() => {
  const get = navigator.credentials.get.bind(navigator.credentials);
  window.wanted = 0;
  navigator.credentials.get = (options) => { window.wanted += 1; return get(options); };
}"""
"""Counts how often the page asks the authenticator for a signature."""


def tabbed(page, name, *, back=False, limit=12):
    """Goes on by Tab until this has the focus, which is seen at every stop."""
    for _ in range(limit):
        page.keyboard.press("Shift+Tab" if back else "Tab")
        at, seen = page.evaluate(HERE)
        assert seen or at == "BODY", at
        if at == name:
            return
    raise AssertionError(f"{name} is not reached")


def moved(page, script, key):
    """Presses this, and waits until what the script gives is another."""
    before = page.evaluate(script)
    page.keyboard.press(key)
    page.wait_for_function(f"before => ({script})() !== before", arg=before, timeout=10_000)


@pytest.mark.parametrize("size", [browsing.TELEPHONE, browsing.SCREEN], ids=["telephone", "screen"])
def test_picture_and_answer_are_reached_seen_and_pressed_by_keyboard_alone(cell, page, size):
    ask_id, _ = asked(cell)
    page.set_viewport_size(size)
    page.goto(f"{cell.world.issuer}/approvals/{ask_id}/page")
    checked(page)
    page.evaluate(COUNTED)
    tabbed(page, "view")
    assert page.is_visible("#view .keys"), "keys are told to those who have no mouse"
    for key in ("ArrowLeft", "ArrowDown", "+", "-"):
        moved(page, NAMES, key)
    place = "() => document.querySelector('#time').value"
    tabbed(page, "play")
    moved(page, place, "Enter")
    assert page.evaluate("document.activeElement.textContent") == "Pause"
    page.keyboard.press("Space")
    assert page.evaluate("document.activeElement.textContent") == "Play"
    tabbed(page, "time")
    page.keyboard.press("Home")
    moved(page, place, "End")
    if size == browsing.SCREEN:
        for name in ("above", "side", "corner"):
            tabbed(page, name)
            moved(page, NAMES, "Enter")
    # keys that answer elsewhere answer nothing here
    tabbed(page, "approver")
    page.keyboard.type("carol")
    for key in ("Enter", "Escape"):
        page.keyboard.press(key)
    for name in ("approve", "deny"):
        tabbed(page, name)
        page.keyboard.press("Escape")
    assert page.evaluate("window.wanted") == 0
    tabbed(page, "approve", back=True)
    browsing.verified(page, person=False)
    page.keyboard.press("Enter")
    answered(page, "Nothing was signed")
    browsing.verified(page, person=True)
    tabbed(page, "deny")
    page.keyboard.press("Space")
    answered(page, "The ask is denied")
    assert page.evaluate(HERE) == ["deny", True]
    assert page.text_content("#state") == "State: denied."
    assert cell.told(ask_id).state == "denied"
    for key in ("Enter", "Space"):
        page.keyboard.press(key)
    assert page.evaluate("window.wanted") == 2, "an answer that counts is asked for no more"
    page.set_viewport_size(browsing.TELEPHONE)


def test_a_refused_answer_leaves_the_keyboard_where_it_was(cell, page):
    ask_id, _ = cell.taken(perception="stale")
    shown(cell, page, ask_id)
    page.route("**/passkey-votes", lambda route: (page.wait_for_timeout(200), route.continue_()))
    tabbed(page, "sees-clear")
    tabbed(page, "approve")
    page.keyboard.press("Enter")
    answered(page, "CLEAR_NOT_SEEN")
    page.unroute("**/passkey-votes")
    assert page.evaluate(HERE) == ["approve", True]
    tabbed(page, "sees-clear", back=True)
    page.keyboard.press("Space")
    tabbed(page, "approve")
    page.keyboard.press("Enter")
    answered(page, "The ask is granted")


@pytest.mark.parametrize("arrives", [True, False])
def test_an_answer_whose_receipt_is_lost_is_told_as_unknown_until_the_page_knows(cell, page, arrives):
    ask_id, _ = asked(cell)
    shown(cell, page, ask_id)
    lose = lambda route: (route.fetch(), route.abort()) if arrives else route.fulfill(status=502, body="<html>")
    page.route("**/passkey-votes", lose)
    page.click("#approve")
    answered(page, "No answer came")
    page.unroute("**/passkey-votes")
    if not arrives:
        page.click("#approve")
        answered(page, "The ask is granted")
    page.evaluate("() => { watch(); }")
    page.wait_for_selector("text=State: granted", timeout=15_000)
    assert len(cell.told(ask_id).votes) == 1


def test_the_first_of_two_people_is_told_of_the_second(cell, page):
    ask_id, _ = asked(cell, approvers=2)
    shown(cell, page, ask_id)
    page.click("#approve")
    answered(page, "Your answer counts. The ask is open.")
    page.evaluate("watch()")
    assert "Your answer counts" in page.text_content("#told"), "its own answer is no news"
    cell.world.people["alice"].approve(ask_id)
    page.evaluate("() => { watch(); }")
    page.wait_for_selector("text=State: granted", timeout=15_000)


def test_two_people_who_answer_at_one_instant_are_both_told_the_one_outcome(cell, page):
    context = page.context.browser.new_context(reduced_motion="reduce")
    other = browsing.authenticator(context.new_page())
    browsing.enrolled(other, cell.world.people["alice"], cell.world.people["dan"])
    ask_id, _ = asked(cell)
    for each, person in ((page, "carol"), (other, "alice")):
        shown(cell, each, ask_id)
        each.fill("#approver", person)
    page.evaluate("document.querySelector('#approve').click()")
    other.evaluate("document.querySelector('#deny').click()")
    for each in (page, other):
        each.wait_for_function("() => document.querySelector('#state').textContent.includes('State: denied')")
    context.close()
    assert cell.told(ask_id).state == "denied"


def test_a_page_that_is_being_left_does_not_call_the_person_back(cell, page):
    ask_id, _ = asked(cell)
    page.goto(f"{cell.world.issuer}/approvals/{ask_id}/page")
    checked(page)
    loads = []
    loaded = lambda _: loads.append(page.url)
    page.on("domcontentloaded", loaded)
    cell.world.people["alice"].deny(ask_id)
    page.evaluate("""async () => {
      dispatchEvent(new Event("beforeunload"));
      for (let looked = 0; looked < 3; looked += 1) await watch();
    }""")
    assert loads == []
    # whoever stayed after all is told
    page.wait_for_selector("text=State: denied", timeout=15_000)
    assert len(loads) == 1
    page.remove_listener("domcontentloaded", loaded)
