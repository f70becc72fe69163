"""Sessions in browsers: begun by a link, kept by a cookie, over with time, person and key.

Forms count only from pages of ours.
"""

from __future__ import annotations

import json
import re

import pytest
from capabilities.keys import keys
from tests.ztpm_idp.login.browser import ORIGIN, Browser
from tests.ztpm_idp.world import ISSUER, World
from ztpm_idp.domain.login import sessions
from ztpm_idp.domain.login.records import ABSOLUTE_MS, IDLE_MS, OFFER_MS

from ztpm_idp.client import ClientError
from ztpm_idp.login import session


@pytest.fixture(scope="module")
def shared(tmp_path_factory):
    with World(tmp_path_factory.mktemp("login")) as world:
        yield world


@pytest.fixture
def browser(shared):
    return Browser(shared)


def code(answer):
    assert answer.headers["content-type"].startswith("text/html"), answer.text
    return re.search(r"Code <code>([A-Z_]+)</code>", answer.text)[1]


def as_list(column):
    """A column of JSON, of which SQLite gives the text."""
    return json.loads(column) if isinstance(column, str) else column


def rows(world, query):
    return [tuple(row) for row in world.sql(query)]


def test_a_link_of_the_operator_key_begins_a_session(shared, browser):
    assert browser.who() is None
    browser.follow()
    assert browser.log_in(shared.people["bob"]) == "/ztpm/login/account"
    assert browser.who() == "bob"
    (held,) = [value for name, value in browser.cookies.items() if name == session.COOKIE]
    assert (session.digest(held).hex(),) in rows(shared, "SELECT session_id FROM sessions")
    assert held not in str(rows(shared, "SELECT * FROM sessions") + rows(shared, "SELECT line FROM ledger"))


def test_it_goes_back_to_where_a_person_was_needed(shared, browser):
    browser.get("/ztpm/login?back_to=/ztpm/authorize%3Fclient_id%3Dx&fresh_s=60")
    link = shared.people["bob"].login_link()
    browser.get(link)
    browser.post(link)
    assert browser.page.headers["location"] == "/ztpm/authorize?client_id=x"
    assert session.BACK not in browser.cookies


@pytest.mark.parametrize(
    "back_to",
    ["//evil.example/x", "https://evil.example/", "/ztpm//evil", "/ztpm/../x", "/ztpmx/y", "/ztpm/a\\b", "/ztpm/a%0db", "x",
     "/ztpm/login\n", "/ztpm/@evil", "/ztpm/" + "a" * 3_000],
)  # fmt: skip
def test_it_goes_back_to_no_other_place(shared, browser, back_to):
    from urllib.parse import quote

    assert code(browser.get("/ztpm/login?back_to=" + quote(back_to, safe=""))) == "QUERY_MALFORMED"


def test_a_link_is_good_once_and_opening_it_changes_nothing(shared, browser):
    link = shared.people["bob"].login_link()
    for _ in range(2):
        assert browser.get(link).status_code == 200
    browser.post(link)
    assert browser.who() == "bob"
    other = Browser(shared)
    assert code(other.get(link)) == "LOGIN_OVER"
    other.get(shared.people["carol"].login_link())
    assert code(other.post(link)) == "LOGIN_OVER"
    assert other.who() is None


def test_a_newer_link_ends_the_one_before_and_time_ends_both(shared, browser):
    old, new = (shared.people["bob"].login_link() for _ in range(2))
    assert code(browser.get(old)) == "LOGIN_OVER"
    browser.get(new)
    shared.clock.at_s += OFFER_MS / 1_000
    assert code(browser.post(new)) == "LOGIN_OVER"
    assert code(browser.get(new)) == "LOGIN_OVER"


def test_only_people_get_links(shared):
    agent = shared.agent("orderly")
    with pytest.raises(ClientError) as refused:
        agent._post("/login/links", {})
    assert refused.value.code == "NOT_PERMITTED"


def test_the_id_is_new_at_each_login_and_the_former_session_is_over(shared, browser):
    browser.cookies[session.COOKIE] = planted = "A" * 43
    browser.log_in(shared.people["bob"])
    first = browser.cookies[session.COOKIE]
    browser.log_in(shared.people["carol"])
    assert len({planted, first, browser.cookies[session.COOKIE]}) == 3
    assert browser.who() == "carol"
    stolen = Browser(shared)
    for held in (planted, first):
        stolen.cookies[session.COOKIE] = held
        assert stolen.who() is None


def test_two_cookies_of_the_name_are_none(shared, browser):
    browser.log_in(shared.people["bob"])
    held = browser.cookies.pop(session.COOKIE)
    answer = browser.send("GET", "/ztpm/login/account", cookie=f"{session.COOKIE}={held}; {session.COOKIE}={'A' * 43}")
    assert answer.status_code == 303


def test_a_session_is_over_after_half_an_hour_of_silence_and_after_twelve_hours(shared, browser):
    browser.log_in(shared.people["bob"])
    shared.clock.at_s += IDLE_MS / 1_000
    assert browser.who() is None
    browser.log_in(shared.people["bob"])
    for _ in range(ABSOLUTE_MS // IDLE_MS):
        shared.clock.at_s += (IDLE_MS - 1_000) / 1_000
        assert browser.who() == "bob"
    shared.clock.at_s += ABSOLUTE_MS // IDLE_MS
    assert browser.who() is None


def test_the_oldest_of_too_many_sessions_ends(shared, monkeypatch):
    monkeypatch.setattr(sessions, "SESSIONS_OF_ONE", 2)
    browsers = [Browser(shared) for _ in range(3)]
    for each in browsers:
        shared.clock.at_s += 1
        each.log_in(shared.people["bob"])
    assert [each.who() for each in browsers[:2]] == [None, "bob"]


def test_logging_out_ends_the_session_for_every_copy_of_the_cookie(shared, browser):
    browser.log_in(shared.people["bob"])
    copy = Browser(shared)
    copy.cookies |= browser.cookies
    browser.get("/ztpm/login/account")
    browser.post("/ztpm/login/end")
    assert (browser.who(), copy.who()) == (None, None)


def test_a_person_who_ends_is_logged_out(shared, browser):
    shared.person("leaver", "sponsor")
    shared.people["leaver"] = shared.caller(type(shared.people["bob"]), "leaver")
    browser.log_in(shared.people["leaver"])
    assert browser.who() == "leaver"
    shared.people["alice"].disable_person("leaver", "left")
    assert browser.who() is None


def test_a_key_that_ends_takes_its_sessions_and_links_with_it(shared, browser):
    shared.private["second"] = second = keys.generate()
    shared.people["alice"].confirm_change(shared.people["bob"].propose_key(keys.public_raw(second)))
    by_second = shared.caller(type(shared.people["bob"]), "second")
    browser.log_in(by_second)
    link = by_second.login_link()
    shared.people["bob"].revoke("key", keys.thumbprint(keys.public_raw(second)), "lost")
    assert browser.who() is None
    assert code(browser.get(link)) == "LOGIN_OVER"


FORGED = {
    "another site": {"sec-fetch-site": "cross-site", "origin": "https://evil.example"},
    "another site on this host": {"sec-fetch-site": "same-site", "origin": "http://127.0.0.1:9999"},
    "an origin that hides": {"origin": "null", "sec-fetch-site": None},
    "nobody says": {"origin": None, "sec-fetch-site": None},
    "a page of this site, with another's origin": {"origin": "https://evil.example"},
}


@pytest.mark.parametrize("headers", FORGED.values(), ids=FORGED)
def test_a_form_of_another_site_changes_nothing(shared, browser, headers):
    link = shared.people["bob"].login_link()
    browser.get(link)
    assert code(browser.post(link, **headers)) == "FORM_FORGED"
    assert browser.who() is None


def test_a_form_without_this_browsers_token_changes_nothing(shared, browser):
    link = shared.people["bob"].login_link()
    other = Browser(shared)
    for each in (browser, other):
        each.get(link)
    browser.page = other.page
    assert code(browser.post(link)) == "FORM_FORGED"
    browser.cookies.clear()
    browser.get(link)
    browser.cookies.clear()
    assert code(browser.post(link)) == "FORM_FORGED"
    assert browser.who() is None


@pytest.mark.parametrize(
    ("content", "kind", "wanted"),
    [
        (b"{}", "application/json", "FORM_MALFORMED"),
        (b"form_token", "application/x-www-form-urlencoded", "FORM_MALFORMED"),
        (b"form_token=%ff", "application/x-www-form-urlencoded", "FORM_MALFORMED"),
        ("form_token=é".encode(), "application/x-www-form-urlencoded", "FORM_MALFORMED"),
        (b"&".join([b"a=b"] * 40), "application/x-www-form-urlencoded", "FORM_MALFORMED"),
        (b"a" * 9_000, "application/x-www-form-urlencoded", "BODY_TOO_LARGE"),
        (b"", "application/x-www-form-urlencoded", "FORM_FORGED"),
    ],
)
def test_a_broken_form_is_told_so(shared, browser, content, kind, wanted):
    browser.get("/ztpm/login")
    answer = browser.send("POST", "/ztpm/login/end", content, origin=ORIGIN, **{"content-type": kind})
    assert code(answer) == wanted


def test_a_further_field_is_refused(shared, browser):
    browser.log_in(shared.people["bob"])
    browser.get("/ztpm/login/account")
    assert code(browser.post("/ztpm/login/end", {"more": "x"})) == "FORM_MALFORMED"
    assert browser.who() == "bob"


def test_no_page_can_be_framed_stored_or_scripted(shared, browser):
    for path in ("/ztpm/login", shared.people["bob"].login_link(), "/ztpm/login/links/x"):
        headers = browser.get(path).headers
        assert headers["cache-control"] == "no-store"
        assert {"default-src 'none'", "frame-ancestors 'none'", "form-action 'self'"} <= set(
            headers["content-security-policy"].split("; ")
        )
        assert "script" not in headers["content-security-policy"]


def test_a_recent_login_goes_on_at_once_and_an_old_one_does_not(shared, browser):
    browser.log_in(shared.people["bob"])
    shared.clock.at_s += 100
    assert browser.get("/ztpm/login?fresh_s=100").status_code == 303
    assert browser.get("/ztpm/login?fresh_s=99").status_code == 200
    assert code(browser.get("/ztpm/login?fresh_s=-1")) == "QUERY_MALFORMED"


def test_the_ledger_says_who_logged_in_and_how(shared, browser):
    browser.log_in(shared.people["bob"])
    (line,) = rows(shared, "SELECT line FROM ledger ORDER BY seq DESC LIMIT 1")[0]
    thumb = keys.thumbprint(keys.public_raw(shared.private["bob"]))
    for said in ('"kind":"session-begun"', '"method":"operator-key"', '"amr":["swk"]', f'"key":"{thumb}"'):
        assert said in bytes(line).decode()


def test_sessions_are_the_stores_and_not_a_workers(shared, browser):
    browser.log_in(shared.people["bob"])
    shared.stop()
    shared.start()
    again = Browser(shared)
    again.cookies |= browser.cookies
    assert again.who() == "bob"
    for person in shared.people.values():
        person._http = type(person)(person.id, person._key, ISSUER, transport=shared.transport, now=shared.clock)._http
