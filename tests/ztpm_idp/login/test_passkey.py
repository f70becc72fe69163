"""Logging in by passkey: the challenge of one browser's page, asserted once by a person's passkey."""

from __future__ import annotations

import re

import pytest
from capabilities.keys import keys
from tests.authenticators import PRESENT
from tests.ztpm_idp.asks import Cell
from tests.ztpm_idp.hostile.faults import commits
from tests.ztpm_idp.login.browser import Browser
from tests.ztpm_idp.login.test_session import as_list, code, rows
from tests.ztpm_idp.test_passkeys import NAMED, passkey
from tests.ztpm_idp.world import World
from ztpm_idp.login.passkey import PASSKEY, PASSKEY_S

CHALLENGE = re.compile(r'data-challenge="([A-Za-z0-9_-]{43})" data-rp="localhost"')
ORIGIN = "http://localhost:8700"


@pytest.fixture(scope="module")
def named(tmp_path_factory):
    with World(tmp_path_factory.mktemp("passkey-login"), settings_changes={"issuer": NAMED}) as world:
        yield Cell(world)


@pytest.fixture(scope="module")
def held(named):
    return passkey(named, "carol")


@pytest.fixture
def browser(named):
    return Browser(named.world)


def challenge(browser):
    return keys.unb64u(CHALLENGE.search(browser.get("/ztpm/login").text)[1])


def use(browser, held, asked, **changes):
    return browser.post("/ztpm/login/passkey", held.body(asked, **changes), origin=ORIGIN)


def test_a_passkey_begins_a_session_that_says_so(named, browser, held):
    asked = challenge(browser)
    assert "script-src 'sha256-" in browser.page.headers["content-security-policy"]
    assert use(browser, held, asked).status_code == 303
    assert browser.who() == "carol" and PASSKEY not in browser.cookies
    (row,) = rows(named.world, "SELECT method, amr, key_shown FROM sessions ORDER BY made_ms DESC LIMIT 1")
    assert (row[0], as_list(row[1]), row[2]) == ("passkey", ["pop", "user"], keys.thumbprint(held.key))


def test_it_counts_once_in_its_own_browser_and_in_time(named, browser, held):
    asked = challenge(browser)
    sealed, page = browser.cookies[PASSKEY], browser.page
    other = Browser(named.world)
    challenge(other)
    assert code(use(other, held, asked)) == "STATEMENT_UNTRUSTED"
    again = Browser(named.world)
    again.cookies |= browser.cookies
    use(browser, held, asked)
    again.page = page
    assert again.cookies[PASSKEY] == sealed
    assert code(use(again, held, asked)) == "LOGIN_OVER"
    late = Browser(named.world)
    asked = challenge(late)
    named.world.clock.at_s += PASSKEY_S + 1
    assert code(use(late, held, asked)) == "LOGIN_OVER"
    late.cookies[PASSKEY] = "x.y"
    assert code(use(late, held, asked)) == "FORM_FORGED"  # the page that refuses has no form


def test_an_assertion_is_used_in_the_commit_that_begins_its_session(named, browser, held):
    """A commit that fails leaves no use of the passkey behind."""
    asked = challenge(browser)
    assert commits(named.world, lambda: use(browser, held, asked)) == 1
    assert browser.who() == "carol"


@pytest.mark.parametrize(
    ("changes", "wanted"),
    [
        ({"flags": PRESENT}, "STATEMENT_UNTRUSTED"),
        ({"origin": "http://localhost:8701"}, "STATEMENT_UNTRUSTED"),
        ({"crossOrigin": True}, "STATEMENT_UNTRUSTED"),
    ],
)
def test_an_assertion_that_is_none_logs_nobody_in(named, browser, held, changes, wanted):
    asked = challenge(browser)
    assert code(use(browser, held, asked, **changes)) == wanted
    assert browser.who() is None


def test_an_unknown_or_broken_one_is_told_so(named, browser, held):
    body = held.body(challenge(browser))
    sent = browser.post("/ztpm/login/passkey", body | {"credential": "A" * 22}, origin=ORIGIN)
    assert code(sent) == "PASSKEY_UNKNOWN"
    challenge(browser)
    assert code(browser.post("/ztpm/login/passkey", body | {"client": "!"}, origin=ORIGIN)) == "FORM_MALFORMED"


def test_a_passkey_that_ends_takes_its_sessions_with_it(named, browser):
    own = passkey(named, "dan", "alice")
    use(browser, own, challenge(browser))
    assert browser.who() == "dan"
    named.world.people["dan"].revoke("key", keys.thumbprint(own.key), "lost")
    assert browser.who() is None
