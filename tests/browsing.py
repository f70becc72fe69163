"""Browsers of tests, the provider at a name that they visit, and the rules for every page."""

from __future__ import annotations

import asyncio
import os
import shutil
import socket
import time
from contextlib import contextmanager
from functools import cache
from pathlib import Path

import pytest
import uvicorn
from tests.node_packages import installed
from tests.ztpm_idp.world import World

CHROMIUM = shutil.which("chromium")
PICTURES = os.environ.get("ZTPM_PICTURES")
"""A folder for screenshots, for people who want to look."""
WIDTHS = (390, 768, 1280)
"""Widths of a telephone, a tablet and a screen, in pixels."""
HEIGHT, TELEPHONE = 900, {"width": 390, "height": 844}
SCREEN = {"width": 1280, "height": HEIGHT}
WIDER = """() => [...document.querySelectorAll("body *")].filter((each) => {
  const box = each.getBoundingClientRect();
  return box.width > 0 && box.right > document.documentElement.clientWidth + 1
    && !each.closest(".unseen, .skip, pre, table.wide, .scrolls");
}).map((each) => `${each.tagName} ${each.className} ${each.textContent.slice(0, 40)}`)"""
"""Elements that reach past the screen; those that are unseen, or scroll by themselves, do not."""
SERIOUS = {"serious", "critical"}
FRAMES_S = 5.0
"""A picture follows its place within some frames, which a busy machine draws late."""


@contextmanager
def served(tmp, **changes):
    """A provider on a listener of its own, at a name: passkeys belong to no address.

    Args:
        tmp: its folder.
        changes: of its settings.
    """
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    settings = {"issuer": f"http://localhost:{port}/ztpm", "port": port} | changes
    with World(tmp, clock=time.time, settings_changes=settings) as world:
        server = uvicorn.Server(
            uvicorn.Config(world.app, host="127.0.0.1", port=port, lifespan="off", log_level="error")
        )
        running = asyncio.run_coroutine_threadsafe(server.serve(), world.loop)
        for _ in range(500):
            if server.started:
                break
            time.sleep(0.01)
        yield world
        server.should_exit = True
        running.result(20)


@contextmanager
def browser_page(*, args=(), **context):
    """A page of headless Chromium, which keeps its script's faults and errors in `faults`.

    Args:
        args: further ones of the command line.
        context: of the browser's context.
    """
    playwright = pytest.importorskip("playwright.sync_api")
    with playwright.sync_playwright() as started:
        browser = started.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox", *args])
        opened = browser.new_context(**{"viewport": SCREEN} | context).new_page()
        opened.faults = []
        opened.on("pageerror", lambda error: opened.faults.append(str(error)))
        opened.on("console", lambda said: opened.faults.append(said.text) if said.type == "error" else None)
        yield opened
        browser.close()


def authenticator(page):
    """Gives the page an authenticator for passkeys, whose person is there and verified; its id is `page.id`."""
    page.authenticator = page.context.new_cdp_session(page)
    page.authenticator.send("WebAuthn.enable")
    options = {
        "protocol": "ctap2",
        "transport": "internal",
        "hasResidentKey": True,
        "hasUserVerification": True,
        "isUserVerified": True,
        "automaticPresenceSimulation": True,
    }
    page.id = page.authenticator.send("WebAuthn.addVirtualAuthenticator", {"options": options})["authenticatorId"]
    return page


def verified(page, *, person):
    """Has the authenticator verify its person from now on, or not."""
    page.authenticator.send("WebAuthn.setUserVerified", {"authenticatorId": page.id, "isUserVerified": person})


def enrolled(page, person, another):
    """Makes a passkey of this person in the page's authenticator, which another person confirms."""
    begun = person.begin_passkey()
    page.goto(begun["url"])
    page.click("#enrol")
    page.wait_for_function("() => document.querySelector('#told').textContent.includes('Made.')", timeout=15_000)
    key = person.enrolled_passkey(begun["enrolment_id"])
    assert another.confirm_change(person.propose_passkey(begun["enrolment_id"], key)) == "done"


@cache
def rules():
    """The accessibility rules, as text of a script; "" where npm cannot bring them."""
    try:
        kept = installed(Path(__file__).parent / "ztpm_idp" / "console" / "axe")
    except pytest.skip.Exception:
        return ""
    return (kept / "node_modules" / "axe-core" / "axe.min.js").read_text("utf-8")


def picture(page, name, *, whole=True):
    """Keeps a picture of the page, for people who want to look."""
    if PICTURES:
        page.screenshot(path=str(Path(PICTURES) / f"{name}.png"), full_page=whole)


def narrow(page, *told):
    """Holds that nothing is wider than the screen, some frames later at most."""
    ends_s = time.monotonic() + FRAMES_S
    while (found := page.evaluate(WIDER)) and time.monotonic() < ends_s:
        page.wait_for_timeout(50)
    assert found == [], (told, found)
    assert page.evaluate("document.documentElement.scrollWidth <= innerWidth"), told


def accessible(page, axe, *told, only=None):
    """Holds that no rule of accessibility is broken in earnest.

    Args:
        page: as it is now.
        axe: text of the rules' script; "" tries nothing.
        told: of the page, for who reads that it failed.
        only: rules that are tried; None tries all.
    """
    if not axe:
        return
    if page.evaluate("typeof axe") == "undefined":
        page.evaluate(axe)
    found = page.evaluate("only => axe.run(only ? {runOnly: only} : {})", only)["violations"]
    serious = [
        (each["id"], [(node["html"], node["failureSummary"]) for node in each["nodes"]][:3])
        for each in found
        if each["impact"] in SERIOUS
    ]
    assert serious == [], told


def looked_at(page, name, axe):
    """Holds that nothing is wider than the screen, and that no rule of accessibility is broken; keeps pictures."""
    back_to = page.viewport_size
    for scheme in ("light", "dark"):
        page.emulate_media(color_scheme=scheme)
        for width in WIDTHS:
            page.set_viewport_size({"width": width, "height": TELEPHONE["height"] if width < 700 else HEIGHT})
            narrow(page, name, width, scheme)
            picture(page, f"{name}-{width}-{scheme}")
        # in the dark nothing but colours differs
        accessible(page, axe, name, scheme, only=None if scheme == "light" else ["color-contrast"])
    page.emulate_media(color_scheme="light")
    page.set_viewport_size(back_to)
