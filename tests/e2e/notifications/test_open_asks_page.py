"""The page of open questions in headless Chromium tells of each new one, and of its own end."""

from __future__ import annotations

import asyncio
import os
import shutil
import socket
import time
from pathlib import Path

import pytest
import uvicorn
from tests.ztpm_idp.asks import AGENT, Cell
from tests.ztpm_idp.world import World
from ztpm_idp.routes.pages import open_asks

CHROMIUM = shutil.which("chromium")
pytestmark = [
    pytest.mark.e2e,
    pytest.mark.clause("PSH-5"),
    pytest.mark.skipif(CHROMIUM is None, reason="Chromium is not installed"),
]
PICTURES = os.environ.get("ZTPM_PICTURES")
"""A folder for screenshots, for people who want to look."""
KEPT = """() => {
  const Real = window.Notification;
  window.told = [];
  window.Notification = class extends Real {
    constructor(title, options) { super(title, options); window.told.push({ title, ...options }); }
  };
}"""
"""Notes what the page hands to the browser, which still gets it."""


@pytest.fixture(scope="module")
def often():
    """The page looks ten times a second: what it does then does not depend on how often."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(open_asks, "EVERY_S", 0.1)
        yield


@pytest.fixture(scope="module")
def cell(tmp_path_factory, often):  # noqa: ARG001
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    changes = {"issuer": f"http://localhost:{port}/ztpm", "port": port}
    with World(tmp_path_factory.mktemp("browser"), clock=time.time, settings_changes=changes) as world:
        config = uvicorn.Config(world.app, host="127.0.0.1", port=port, lifespan="off", log_level="error")
        server = uvicorn.Server(config)
        served = asyncio.run_coroutine_threadsafe(server.serve(), world.loop)
        for _ in range(500):
            if server.started:
                break
            time.sleep(0.01)
        yield Cell(world)
        server.should_exit = True
        served.result(20)


@pytest.fixture(scope="module")
def page(cell):
    playwright = pytest.importorskip("playwright.sync_api")
    with playwright.sync_playwright() as started:
        browser = started.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        context = browser.new_context(viewport={"width": 390, "height": 844})
        context.grant_permissions(["notifications"], origin=cell.world.issuer.removesuffix("/ztpm"))
        context.add_init_script(f"({KEPT})()")
        opened = context.new_page()
        opened.faults = []
        opened.on("pageerror", lambda error: opened.faults.append(str(error)))
        yield opened
        browser.close()


def picture(page, name):
    if PICTURES:
        page.screenshot(path=Path(PICTURES) / f"{name}.png", full_page=True)


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
    page.wait_for_function("() => window.told.length === 1", timeout=20_000)
    (told,) = page.evaluate("window.told")
    assert (told["title"], told["tag"]) == ("A question waits: tier 3", new)
    assert not any(word in str(told) for word in ("alice", "carol", AGENT, "person-7"))
    assert [item.get_attribute("data-ask") for item in page.locator("#open li").all()] == [seen, new]
    for width in (390, 768, 1280):
        page.set_viewport_size({"width": width, "height": 844})
        assert page.evaluate("document.documentElement.scrollWidth") <= width
        picture(page, f"open-asks-{width}")
    # The session ends: the page says so, and tells of nothing more.
    cell.world.end("carol")
    page.wait_for_function("() => document.querySelector('#told').textContent.includes('logged out')", timeout=20_000)
    assert [each["title"] for each in page.evaluate("window.told")] == [
        "A question waits: tier 3",
        "You are logged out",
    ]
    assert page.faults == []
