"""A whole login in a real browser: the certified `oidc-provider`, Chromium, our pages, and a command line confirmed."""

from __future__ import annotations

import asyncio
import shutil
import socket
import subprocess
import time
from pathlib import Path

import pytest
from capabilities.keys import keys
from tests.node_packages import installed, node
from tests.progress import telling
from tests.ztpm_idp.login.openid import SECRET, settings
from tests.ztpm_idp.world import FakeClock, World
from ztpm_idp.login.oidc import OpenIdProvider
from ztpm_idp.login_settings import LoginProvider

from ztpm_idp.client import Operator
from ztpm_idp.client.device_login import Confirmed, DeviceLogin

pytestmark = [pytest.mark.e2e, pytest.mark.campaign]
HERE = Path(__file__).parent / "oidc_provider"
CHROMIUM = shutil.which("chromium")
WIDTHS = (390, 1280)
"""Widths of a telephone and of a screen, in pixels."""


class MachineTime(FakeClock):
    """The machine's own time: another process and a browser keep it too."""

    def __call__(self):
        return time.time()


@pytest.fixture(scope="module", autouse=True)
def word():
    with telling(lambda: "provider, OpenID provider and browser are at work"):
        yield


@pytest.fixture(scope="module")
def issuer():
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        return f"http://localhost:{free.getsockname()[1]}/ztpm"


@pytest.fixture(scope="module")
def provider(issuer):
    """The certified provider's issuer."""
    kept = installed(HERE)
    shutil.copy(HERE / "server.mjs", kept / "server.mjs")
    command = [node(), "server.mjs", f"{issuer}/login/providers/works/callback", SECRET]
    with subprocess.Popen(
        command, cwd=kept, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
    ) as running:  # fmt: skip
        for line in running.stdout:
            if line.startswith("http://127.0.0.1:"):
                yield line.strip()
                break
        running.kill()


@pytest.fixture(scope="module")
def world(tmp_path_factory, issuer, provider):
    import uvicorn

    port = int(issuer.rsplit(":", 1)[1].partition("/")[0])
    folder = tmp_path_factory.mktemp("browser")
    with World(folder, clock=MachineTime(), settings_changes={"issuer": issuer, "port": port}) as world:
        ours = OpenIdProvider(
            LoginProvider(settings(issuer=provider, title="Works"), SECRET),
            redirect_uri=f"{issuer}/login/providers/works/callback",
            now=world.clock,
        )
        world.app.state.login_providers = {"works": ours}
        world.people = {
            name: Operator(name, world.private[name], issuer, transport=world.transport) for name in world.ROLES
        }
        server = uvicorn.Server(
            uvicorn.Config(world.app, host="127.0.0.1", port=port, lifespan="off", log_level="error")
        )
        serving = asyncio.run_coroutine_threadsafe(server.serve(), world.loop)
        change = world.people["alice"].propose_login("bob", provider, "b-17")
        world.people["dan"].confirm_change(change)
        yield world
        server.should_exit = True
        serving.result(10)


@pytest.fixture(scope="module")
def chromium():
    if CHROMIUM is None:
        pytest.skip("chromium is not on the path: no login in a browser")
    from playwright.sync_api import sync_playwright

    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        yield browser
        browser.close()


def seen(page, name, folder):
    """Keeps a picture of the page at both widths, and holds that nothing is cut off."""
    for width in WIDTHS:
        page.set_viewport_size({"width": width, "height": 900})
        assert page.evaluate("document.documentElement.scrollWidth") <= width, (name, width)
        page.screenshot(path=folder / f"{name}-{width}.png", full_page=True)


def log_in_by_passkey(world, issuer, context, page, folder):
    """Carol's passkey, made in a virtual authenticator, logs her in in place of bob."""
    authenticator = context.new_cdp_session(page)
    authenticator.send("WebAuthn.enable")
    options = {"protocol": "ctap2", "transport": "internal", "hasResidentKey": True, "hasUserVerification": True,
               "isUserVerified": True, "automaticPresenceSimulation": True}  # fmt: skip
    made = authenticator.send("WebAuthn.addVirtualAuthenticator", {"options": options})["authenticatorId"]
    carol = world.people["carol"]
    begun = carol.begin_passkey()
    page.goto(begun["url"])
    page.click("#enrol")
    page.wait_for_function("() => document.querySelector('#told').textContent.includes('Made.')", timeout=15_000)
    key = carol.enrolled_passkey(begun["enrolment_id"])
    world.people["dan"].confirm_change(carol.propose_passkey(begun["enrolment_id"], key))
    page.goto(f"{issuer}/login?back_to=/ztpm/login/account&fresh_s=0")
    seen(page, "passkey", folder)
    authenticator.send("WebAuthn.setUserVerified", {"authenticatorId": made, "isUserVerified": False})
    page.get_by_role("button", name="Log in with a passkey").click()
    page.wait_for_function("() => document.querySelector('#told').textContent.includes('No passkey was used')")
    authenticator.send("WebAuthn.setUserVerified", {"authenticatorId": made, "isUserVerified": True})
    page.get_by_role("button", name="Log in with a passkey").click()
    page.wait_for_url(f"{issuer}/login/account")
    assert "Logged in as carol" in page.inner_text("h1") and "by passkey" in page.inner_text("main")


def test_a_person_logs_in_there_and_confirms_a_command_line_here(world, issuer, provider, chromium, tmp_path):
    context = chromium.new_context()
    page = context.new_page()
    told = []
    page.on("console", lambda message: told.append(message.text))
    page.goto(f"{issuer}/login/account")
    seen(page, "login", tmp_path)
    page.get_by_role("button", name="Log in with Works").click()
    # The certified provider's own pages.
    page.wait_for_url(f"{provider}/interaction/*")
    page.fill("input[name=login]", "b-17")
    page.fill("input[name=password]", "any")
    page.click("button[type=submit]")
    page.wait_for_load_state()
    page.click("button[type=submit]")
    page.wait_for_url(f"{issuer}/login/account")
    assert "Logged in as bob" in page.inner_text("h1")
    assert f"{provider} b-17" in page.inner_text("main")
    cookies = {cookie["name"]: cookie for cookie in context.cookies(issuer)}
    held = cookies["__Host-ztpm-session"]
    assert (held["secure"], held["httpOnly"], held["sameSite"], held["path"]) == (True, True, "Lax", "/")
    assert "__Host-ztpm-attempt" not in cookies
    assert page.evaluate("document.cookie") == ""

    key = keys.generate()
    with DeviceLogin("", key, issuer) as terminal:
        waiting = terminal.ask("ztpm on laptop")
        page.get_by_role("link", name="Enter the code").click()
        page.get_by_label("Code").fill("bbbb bbbb")
        page.get_by_role("button", name="Look at it").click()
        assert "No command line waits under this code" in page.inner_text("main")
        seen(page, "device", tmp_path)
        page.get_by_label("Code").fill(waiting.user_code.lower())
        page.get_by_role("button", name="Look at it").click()
        assert keys.thumbprint(keys.public_raw(key)) in page.inner_text("main")
        seen(page, "confirm", tmp_path)
        page.get_by_role("button", name="Yes, it is mine").click()
        assert page.inner_text("h1") == "Confirmed"
        found = terminal.poll(waiting.device_code)
    assert isinstance(found, Confirmed)
    assert (found.person, found.roles, found.method) == ("bob", ("sponsor",), "oidc")
    assert abs(found.authenticated_at - time.time()) < 60
    page.get_by_role("link", name="Your session and keys").click()
    seen(page, "account", tmp_path)
    page.get_by_role("button", name="Log out").click()
    page.goto(f"{issuer}/login/account")
    assert "Log in to" in page.inner_text("h1")
    page.goto(world.people["bob"].login_link())
    seen(page, "link", tmp_path)
    page.get_by_role("button", name="Log in as bob").click()
    assert "Logged in as bob" in page.inner_text("h1")
    # Nothing of ours broke our own content policy.
    assert [text for text in told if "Content Security Policy" in text and provider not in text] == []
    log_in_by_passkey(world, issuer, context, page, tmp_path)
    context.close()
    print(f"logged in through {provider}; pictures in {tmp_path}")
