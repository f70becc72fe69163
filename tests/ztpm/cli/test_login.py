"""`ztpm login`: a link for a browser, and a key of one's own that a person confirms there."""

from __future__ import annotations

import json
import re
import time

import pytest
from capabilities.keys import keys
from tests.ztpm_idp.login.browser import Browser
from tests.ztpm_idp.world import ISSUER, FakeClock, World
from typer.testing import CliRunner
from ztpm.base import layout

from ztpm.cli import app
from ztpm.cli.provider import login
from ztpm_idp.client import direct_http


class Ahead(FakeClock):
    """The machine's own time, and as much more as a command has slept: commands look at no other clock."""

    def __call__(self):
        return time.time() + self.at_s


PASSPHRASE = "a long enough passphrase"


@pytest.fixture
def world(tmp_path, monkeypatch):
    with World(tmp_path / "idp", clock=Ahead(0.0)) as world:
        monkeypatch.setenv("ZTPM_PASSPHRASE", PASSPHRASE)
        inner = direct_http.client
        monkeypatch.setattr(direct_http, "client", lambda s, t=None: inner(s, t or world.transport))
        yield world


@pytest.fixture
def tmp_path(tmp_path):
    (tmp_path / "idp").mkdir()
    return tmp_path


def run(*words):
    return CliRunner().invoke(app, list(map(str, words)))


def confirming(world, monkeypatch, answer):
    """Lets the person answer on the page while the command waits for the first time."""
    browser = Browser(world)
    browser.log_in(world.people["bob"])

    def sleep(seconds):
        world.clock.at_s += seconds
        monkeypatch.setattr(login.time, "sleep", lambda s: setattr(world.clock, "at_s", world.clock.at_s + s))
        browser.get("/ztpm/login/device")
        (waiting,) = world.on_loop(open_devices(world))
        browser.post("/ztpm/login/device", {"code": waiting.user_code})
        browser.post("/ztpm/login/device/answer", {"code": waiting.user_code, "answer": answer})

    monkeypatch.setattr(login.time, "sleep", sleep)


async def open_devices(world):
    async with world.provider.store.read() as view:
        return await view.devices.devices()


def test_a_confirmed_key_signs_the_commands_that_follow(world, tmp_path, monkeypatch):
    confirming(world, monkeypatch, "confirm")
    file = tmp_path / "laptop.key"
    done = run("login", "--issuer", ISSUER, "--key", file)
    assert done.exit_code == 0, done.output
    assert re.search(rf"Open   {ISSUER}/login/device\nEnter  [A-Z]{{4}}-[A-Z]{{4}}\nKey    \S{{43}}", done.stderr)
    assert re.match(r"Logged in as bob until 20\d\d-", done.stdout)
    assert file.stat().st_mode & 0o777 == 0o600
    signer = ("--issuer", ISSUER, "--key", file, "--as", "bob", "--json")
    assert json.loads(run("person", "list", *signer).stdout)["ok"] is True
    raw = keys.b64u(keys.public_raw(keys.generate()))
    refused = run("person", "register", "eve", "--public", raw, "--role", "sponsor", *signer)
    assert (refused.exit_code, json.loads(refused.stdout)["code"]) == (3, "SESSION_KEY_TOO_WEAK")


def test_a_declined_key_is_taken_away(world, tmp_path, monkeypatch):
    confirming(world, monkeypatch, "decline")
    done = run("login", "--issuer", ISSUER, "--key", tmp_path / "laptop.key", "--json")
    assert (done.exit_code, json.loads(done.stdout)["code"]) == (3, "LOGIN_DECLINED")
    assert not (tmp_path / "laptop.key").exists()


def test_a_link_logs_a_browser_in(world, tmp_path):
    file = tmp_path / "bob.key"
    layout.write_private(file, keys.to_pem(world.private["bob"], PASSPHRASE.encode()))
    done = run("login", "--browser", "--issuer", ISSUER, "--key", file, "--as", "bob", "--json")
    link = json.loads(done.stdout)["url"]
    browser = Browser(world)
    browser.get(link)
    browser.post(link)
    assert browser.who() == "bob"


def test_a_login_elsewhere_is_proposed_confirmed_and_ended(world, tmp_path):
    for name in ("alice", "dan"):
        layout.write_private(tmp_path / name, keys.to_pem(world.private[name], PASSPHRASE.encode()))
    as_ = {name: ("--issuer", ISSUER, "--key", tmp_path / name, "--as", name, "--json") for name in ("alice", "dan")}
    there = ("--provider", "https://login.example", "--subject", "00u1")
    done = run("person", "login", "bob", *there, *as_["alice"])
    assert done.exit_code == 4
    assert run("person", "confirm", json.loads(done.stdout)["change_id"], *as_["dan"]).exit_code == 0
    listed = json.loads(run("person", "list", *as_["dan"]).stdout)["people"]
    assert next(row for row in listed if row["id"] == "bob")["logins"] == ["https://login.example 00u1"]
    assert run("person", "login-end", *there, *as_["dan"]).exit_code == 0
    assert run("person", "login-end", *there, *as_["dan"]).exit_code == 3


@pytest.mark.parametrize(
    "words",
    [(), ("--issuer", ISSUER), ("--key", "x"), ("--issuer", ISSUER, "--key", "x", "--as", "bob"), ("--browser",),
     ("--browser", "--as", "bob", "--issuer", ISSUER)],
)  # fmt: skip
def test_it_is_told_whose_key_where(words):
    done = run("login", *words, "--json")
    assert (done.exit_code, json.loads(done.stdout)["code"]) == (2, "WHICH_KEY")


def test_a_key_that_exists_is_not_overwritten(world, tmp_path):
    (tmp_path / "laptop.key").write_text("mine")
    done = run("login", "--issuer", ISSUER, "--key", tmp_path / "laptop.key", "--json")
    assert json.loads(done.stdout)["code"] == "EXISTS"
    assert (tmp_path / "laptop.key").read_text() == "mine"
