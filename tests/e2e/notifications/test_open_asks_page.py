"""The page of open questions in headless Chromium tells of each new one, of its age and its end."""

from __future__ import annotations

import pytest
from tests.browsing import CHROMIUM, TELEPHONE, browser_page, looked_at, rules, served
from tests.ztpm_idp.asks import AGENT, Cell
from tests.ztpm_idp.routes.test_latches import taken as fallen
from ztpm_idp.routes.pages import open_asks

pytestmark = [
    pytest.mark.e2e,
    pytest.mark.clause("PSH-5"),
    pytest.mark.skipif(CHROMIUM is None, reason="Chromium is not installed"),
]
KEPT = """() => {
  const Real = window.Notification;
  window.told = [];
  window.Notification = class extends Real {
    constructor(title, options) { super(title, options); window.told.push({ title, ...options }); }
  };
}"""
"""Notes what the page hands to the browser, which still gets it."""
WAIT_MS = 20_000


@pytest.fixture(scope="module")
def often():
    """The page looks ten times a second: what it does then does not depend on how often."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(open_asks, "EVERY_S", 0.1)
        patch.setattr(open_asks, "OLD_S", 2)
        yield


@pytest.fixture(scope="module")
def cell(tmp_path_factory, often):  # noqa: ARG001
    with served(tmp_path_factory.mktemp("browser")) as world:
        yield Cell(world)


@pytest.fixture(scope="module")
def page(cell):
    with browser_page(viewport=TELEPHONE) as opened:
        opened.context.grant_permissions(["notifications"], origin=cell.world.issuer.removesuffix("/ztpm"))
        opened.context.add_init_script(f"({KEPT})()")
        yield opened


def grey(page):
    """Colour of the ink and of the first link, which are otherwise told apart."""
    style = "each => getComputedStyle(each).color"
    return page.locator("#told").evaluate(style) == page.locator("#open a").first.evaluate(style)


def test_a_person_who_is_logged_in_is_told_of_each_new_question_once_and_of_no_name(cell, page):
    seen, _ = cell.taken()
    page.goto(f"{cell.world.issuer}/approvals/page")
    assert "/login" in page.url  # nobody is logged in
    page.goto(cell.world.people["carol"].login_link())
    page.get_by_role("button").first.click()
    page.wait_for_url("**/approvals/page")
    assert page.locator("#open li").count() == 1
    button = page.get_by_role("button", name="Tell me of new questions")
    button.focus()
    page.keyboard.press("Enter")
    page.wait_for_function("() => document.querySelector('#notify').getAttribute('aria-pressed') === 'true'")
    assert page.evaluate("window.told") == []  # what is there already is on the page
    new, _ = cell.taken()
    page.wait_for_function("() => window.told.length === 1", timeout=WAIT_MS)
    (told,) = page.evaluate("window.told")
    assert (told["title"], told["tag"]) == ("A question waits: tier 3", new)
    assert not any(word in str(told) for word in ("alice", "carol", AGENT, "person-7"))
    assert [item.get_attribute("data-ask") for item in page.locator("#open li").all()] == [seen, new]
    assert [tier.inner_text() for tier in page.locator("#open .tier").all()] == ["Tier 3", "Tier 3"]
    # So is a robot that has stopped.
    latch_id, _ = fallen(cell)
    page.wait_for_function("() => window.told.length === 2", timeout=WAIT_MS)
    assert page.evaluate("[window.told[1].title, window.told[1].tag]") == ["A robot has stopped", latch_id]
    assert page.locator("#latched a").inner_text().startswith("ur3e at cell-1 has stopped")
    looked_at(page, "open-asks", rules())
    # Without a word of the provider the page says so with the time of the last one, and is grey until the next.
    assert page.locator("#alert").is_hidden()
    assert not grey(page)
    page.context.set_offline(True)
    page.wait_for_selector("#alert", timeout=WAIT_MS)
    last = page.locator("#told").inner_text().removeprefix("As of ").removesuffix(".")
    assert f"since {last}" in page.locator("#alert").inner_text()
    assert grey(page)
    looked_at(page, "open-asks-old", rules())
    page.context.set_offline(False)
    page.wait_for_selector("#alert", state="hidden", timeout=WAIT_MS)
    assert not grey(page)
    assert page.locator("#told").inner_text() != f"As of {last}."
    # The session ends: the page says so, and tells of nothing more.
    assert [each for each in page.faults if "ERR_INTERNET_DISCONNECTED" not in each] == []
    cell.world.end("carol")
    page.wait_for_function("() => document.querySelector('#alert').textContent.includes('logged out')", timeout=WAIT_MS)
    assert grey(page)
    assert [each["title"] for each in page.evaluate("window.told")] == [
        "A question waits: tier 3",
        "A robot has stopped",
        "You are logged out",
    ]
