"""The page of open questions is for people who are logged in, and its list never prolongs their session."""

from __future__ import annotations

import pytest
from tests.ztpm_idp.asks import AGENT, Cell
from tests.ztpm_idp.login.browser import Browser
from tests.ztpm_idp.routes.test_latches import clear
from tests.ztpm_idp.routes.test_latches import taken as fallen
from tests.ztpm_idp.world import ISSUER
from ztpm_idp.login import session
from ztpm_idp.provider import ask_page

pytestmark = pytest.mark.clause("PSH-5")
PAGE, LIST = "/ztpm/approvals/page", "/ztpm/approvals/page/open"


@pytest.fixture
def cell(world):
    return Cell(world)


@pytest.fixture
def browser(cell):
    made = Browser(cell.world)
    made.log_in(cell.world.people["carol"])
    return made


def test_open_questions_are_shown_oldest_first_and_gone_when_answered(cell, browser):
    assert browser.get(LIST).json()["open"] == []
    first, _ = cell.taken()
    cell.world.clock.at_s += 1
    second, _ = cell.taken()
    rows = browser.get(LIST).json()["open"]
    assert [row["ask_id"] for row in rows] == [first, second]
    assert rows[0]["url"] == f"{ISSUER}/approvals/{first}/page"
    assert rows[0]["tier"] == 3
    assert AGENT in rows[0]["words"]
    page = browser.get(PAGE)
    assert page.status_code == 200
    assert page.text.index(first) < page.text.index(second)
    cell.world.people["carol"].deny(first)
    assert [row["ask_id"] for row in browser.get(LIST).json()["open"]] == [second]
    assert first not in browser.get(PAGE).text


@pytest.mark.clause("PSH-6")
def test_stopped_robots_are_shown_until_they_are_cleared(cell, browser):
    assert browser.get(LIST).json()["latched"] == []
    latch_id, text = fallen(cell)
    (row,) = browser.get(LIST).json()["latched"]
    assert (row["latch_id"], row["url"]) == (latch_id, f"{ISSUER}/latches/{latch_id}/page")
    assert row["words"].startswith("ur3e at cell-1 has stopped, since ")
    assert latch_id in browser.get(PAGE).text
    assert clear(cell, latch_id, text).json()["state"] == "released"
    assert browser.get(LIST).json()["latched"] == []
    assert latch_id not in browser.get(PAGE).text


def test_who_is_not_logged_in_sees_nothing_of_them(cell):
    ask_id, _ = cell.taken()
    stranger = Browser(cell.world)
    page = stranger.get(PAGE)
    assert page.status_code == 303
    assert page.headers["location"].startswith("/ztpm/login?back_to=%2Fztpm%2Fapprovals%2Fpage&")
    assert stranger.follow().status_code == 200
    told = stranger.get(LIST)
    assert (told.status_code, told.json()["code"]) == (403, "NOT_LOGGED_IN")
    assert ask_id not in page.text + told.text
    # The session of somebody who has left shows nothing either.
    left = Browser(cell.world)
    left.log_in(cell.world.people["carol"])
    assert left.get(LIST).status_code == 200
    cell.world.end("carol")
    assert left.get(LIST).status_code == 403


def test_the_list_does_not_prolong_a_session_and_the_page_does(cell, browser):
    silent_s = session.SEEN_MS / 1_000 + 1
    for _ in range(3):
        cell.world.clock.at_s += 14 * 60
        status = browser.get(LIST).status_code
    assert status == 403
    browser.log_in(cell.world.people["carol"])
    for _ in range(3):
        cell.world.clock.at_s += 14 * 60 + silent_s
        assert browser.get(PAGE).status_code == 200


def test_the_page_has_one_script_of_its_own_file_and_nothing_from_elsewhere(browser):
    page = browser.get(PAGE)
    policy = page.headers["content-security-policy"]
    assert "default-src 'none'" in policy
    assert "unsafe" not in policy
    assert f"script-src {ISSUER}/approvals/assets/open_asks.js;" in policy
    assert page.text.count("<script") == 1
    script = browser.get("/ztpm/approvals/assets/open_asks.js")
    assert (script.status_code, script.text) == (200, ask_page.LIST_SCRIPT)
    assert page.text.count(ISSUER) == 2  # the script, and the look that all pages have
    assert policy.count("http") == 1
    assert page.headers["cache-control"] == browser.get(LIST).headers["cache-control"] == "no-store"
