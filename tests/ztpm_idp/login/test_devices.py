"""Command lines that log in: confirmed on a page, they sign with a key that does less than an operator's."""

from __future__ import annotations

import re
from pathlib import Path

import pytest
from capabilities.keys import keys
from capabilities.token.static_verification import inspect_token
from capabilities.token.token_text import token_from_text
from capabilities.values.caps import DEFAULT
from capabilities.values.scope import Tier
from tests.house.pages import rows as rows_of
from tests.ztpm_idp.login.browser import Browser
from tests.ztpm_idp.login.openid import OP, Fake
from tests.ztpm_idp.login.test_openid import add_login
from tests.ztpm_idp.login.test_session import code, rows
from tests.ztpm_idp.world import ISSUER, World
from ztpm_idp.domain.login import devices
from ztpm_idp.domain.login.records import (
    DEVICE_INTERVAL_S,
    DEVICE_MS,
    ENROL_FRESH_S,
    SESSION_KEY_MS,
    WRONG_CODES,
)

from ztpm_idp.client import ClientError, Operator
from ztpm_idp.client.device_login import Confirmed, DeviceLogin


@pytest.fixture
def world(tmp_path):
    with World(tmp_path) as world:
        yield world


@pytest.fixture(scope="module")
def shared(tmp_path_factory):
    with World(tmp_path_factory.mktemp("devices")) as world:
        add_login(world, "bob", OP, "b-17")
        world.agent("mover", sponsor="bob")
        yield world


@pytest.fixture(autouse=True)
def nobody_waits(request):
    """Lets what an earlier test left waiting be over."""
    if "shared" in request.fixturenames:
        request.getfixturevalue("shared").clock.at_s += DEVICE_MS / 1_000 + 1


class Terminal:
    """A command line with a fresh key."""

    def __init__(self, world, name="laptop"):
        self.world, self.key = world, keys.generate()
        self.login = DeviceLogin("terminal", self.key, ISSUER, transport=world.transport, now=world.clock)
        self.waiting = self.login.ask(name)

    def poll(self):
        return self.login.poll(self.waiting.device_code)

    def operator(self, name="bob"):
        return Operator(name, self.key, ISSUER, transport=self.world.transport, now=self.world.clock)


def refusal(act):
    with pytest.raises(ClientError) as refused:
        act()
    return refused.value.code


def enter(browser, entered):
    browser.get("/ztpm/login/device")
    return browser.post("/ztpm/login/device", {"code": entered})


def answer(browser, terminal, said="confirm"):
    enter(browser, terminal.waiting.user_code.lower().replace("-", " "))
    return browser.post("/ztpm/login/device/answer", {"code": terminal.waiting.user_code, "answer": said})


def confirmed(world, person="bob", browser=None):
    terminal = Terminal(world)
    if browser is None:
        browser = Browser(world)
        browser.log_in(world.people[person])
    answer(browser, terminal)
    found = terminal.poll()
    assert isinstance(found, Confirmed), found
    return terminal, found


def lent(world, caller, **changes):
    token = caller.issue(world.agents["mover"], world.scope(**changes), purpose="p").token
    return inspect_token(token_from_text(token, DEFAULT), world.trust, DEFAULT)["sponsor"]


def test_a_confirmed_key_lends_and_the_token_says_when_and_how_its_person_logged_in(shared):
    browser = Browser(shared)
    Fake(shared).log_in(browser)
    at = int(shared.clock()) - 5
    terminal, found = confirmed(shared, browser=browser)
    assert (found.person, found.roles, found.method, found.authenticated_at) == ("bob", ("sponsor",), "oidc", at)
    assert found.expires_at == at + SESSION_KEY_MS // 1_000
    shared.clock.at_s += 3_000
    shared.agents["mover"].attest()
    sponsor = lent(shared, terminal.operator())
    assert (sponsor["subject"], sponsor["method"], sponsor["authenticated_at"]) == ("bob", "oidc", at)
    own = lent(shared, shared.people["bob"])
    assert (own["method"], own["authenticated_at"]) == ("operator-key", int(shared.clock()))


def test_it_waits_until_then_and_asks_no_faster_than_it_may(shared):
    terminal = Terminal(shared)
    assert terminal.poll() == 2 * DEVICE_INTERVAL_S
    shared.clock.at_s += 2 * DEVICE_INTERVAL_S
    assert terminal.poll() == 2 * DEVICE_INTERVAL_S
    assert refusal(terminal.operator().persons) == "CALLER_UNKNOWN"


def test_the_page_shows_what_is_confirmed_and_needs_the_code(shared):
    browser = Browser(shared)
    browser.get("/ztpm/login/device")
    assert browser.page.status_code == 303
    browser.log_in(shared.people["bob"])
    terminal = Terminal(shared, "build machine")
    shown = enter(browser, terminal.waiting.user_code).text
    for said in (
        "build machine",
        keys.thumbprint(keys.public_raw(terminal.key)),
        terminal.waiting.user_code,
        "sponsor",
    ):
        assert said in shown
    assert "code" not in terminal.waiting.url.partition("?")[2]


def test_what_was_declined_or_is_too_late_gets_nothing(shared):
    browser = Browser(shared)
    browser.log_in(shared.people["bob"])
    terminal = Terminal(shared)
    answer(browser, terminal, "decline")
    assert refusal(terminal.poll) == "LOGIN_DECLINED"
    assert enter(browser, terminal.waiting.user_code).status_code == 400
    late = Terminal(shared)
    shared.clock.at_s += DEVICE_MS / 1_000
    browser.log_in(shared.people["bob"])
    assert enter(browser, late.waiting.user_code).status_code == 400
    assert refusal(late.poll) == "LOGIN_OVER"


def test_a_code_is_good_once_and_its_device_code_for_its_key_alone(shared):
    browser = Browser(shared)
    browser.log_in(shared.people["bob"])
    terminal, _ = confirmed(shared, browser=browser)
    assert enter(browser, terminal.waiting.user_code).status_code == 400
    thief = Terminal(shared)
    assert refusal(lambda: thief.login.poll(terminal.waiting.device_code)) == "LOGIN_OVER"


def test_guessing_codes_ends_the_session(shared):
    browser = Browser(shared)
    browser.log_in(shared.people["bob"])
    for _ in range(WRONG_CODES):
        assert browser.who() == "bob"
        enter(browser, "BBBB-BBBB")
    assert browser.who() is None


def test_an_old_login_confirms_nothing(shared):
    browser = Browser(shared)
    browser.log_in(shared.people["bob"])
    terminal = Terminal(shared)
    enter(browser, terminal.waiting.user_code)
    shared.clock.at_s += ENROL_FRESH_S - 1
    fields = {"code": terminal.waiting.user_code, "answer": "confirm"}
    shared.clock.at_s += 2
    sent = browser.post("/ztpm/login/device/answer", fields)
    assert sent.headers["location"].startswith("/ztpm/login?back_to=%2Fztpm%2Flogin%2Fdevice")
    assert refusal(terminal.poll) == "LOGIN_OVER"


def test_too_many_that_wait_are_refused_and_others_of_a_person_end(shared, monkeypatch):
    monkeypatch.setattr(devices, "DEVICES_OF_ONE", 2)
    monkeypatch.setattr(devices, "KEYS_OF_ONE", 1)
    for _ in range(2):
        Terminal(shared)
    assert refusal(lambda: Terminal(shared)) == "TOO_MANY_LOGINS"
    shared.clock.at_s += DEVICE_MS / 1_000
    browser = Browser(shared)
    browser.log_in(shared.people["bob"])
    terminals = []
    for _ in range(2):
        shared.clock.at_s += 1
        terminals.append(confirmed(shared, browser=browser)[0])
    assert refusal(terminals[0].operator().persons) == "CALLER_UNKNOWN"
    assert terminals[-1].operator().persons()


def test_one_key_has_one_role(shared):
    for key in (shared.private["alice"], shared.private["mover"], shared.idp_keys.root):
        login = DeviceLogin("terminal", key, ISSUER, transport=shared.transport, now=shared.clock)
        assert refusal(lambda login=login: login.ask("x")) == "KEY_IN_USE"
    terminal, _ = confirmed(shared)
    assert refusal(lambda: terminal.login.ask("again")) == "KEY_IN_USE"
    raw = keys.public_raw(terminal.key)
    assert refusal(lambda: shared.people["alice"].register_person("eve", "Eve", raw, ["sponsor"])) == "KEY_IN_USE"


def test_it_signs_for_nobody_after_its_time_or_its_persons_or_its_logins(world):
    add_login(world, "bob", OP, "b-17")
    browser = Browser(world)
    Fake(world).log_in(browser)
    by_login, _ = confirmed(world, browser=browser)
    by_key, found = confirmed(world)
    ended, _ = confirmed(world)
    browser.get("/ztpm/login/account")
    browser.post("/ztpm/login/keys/end", {"thumbprint": keys.thumbprint(keys.public_raw(ended.key))})
    assert refusal(ended.operator().persons) == "CALLER_UNKNOWN"
    assert by_login.operator().persons()
    world.people["dan"].end_login(OP, "b-17")
    assert refusal(by_login.operator().persons) == "CALLER_UNKNOWN"
    world.clock.at_s = found.expires_at - 1
    assert by_key.operator().persons()
    world.clock.at_s += 1
    assert refusal(by_key.operator().persons) == "CALLER_UNKNOWN"
    last, _ = confirmed(world)
    world.people["alice"].disable_person("bob", "left")
    assert refusal(last.operator().persons) == "CALLER_UNKNOWN"


def test_a_key_of_a_mighty_person_votes_administers_and_vouches_for_nothing(world):
    """alice is sponsor, approver and administrator; her session-bound key is a sponsor's."""
    terminal, found = confirmed(world, "alice")
    assert found.roles == ("sponsor",)
    weak = terminal.operator("alice")
    world.agent("mover", sponsor="alice", vouched=True)
    raw = keys.public_raw(keys.generate())
    ask_id = "a" * 32
    for act in (
        lambda: weak.register_person("eve", "Eve", raw, ["sponsor"]),
        lambda: weak.propose_person("eve", "Eve", raw, ["admin"]),
        lambda: weak.propose_key(raw),
        lambda: weak.propose_login("alice", OP, "a"),
        lambda: weak.register_pep("p", raw, ["http://x.example/mcp"]),
        lambda: weak.disable_person("bob", "r"),
        lambda: weak.login_link(),
        lambda: weak._post(f"/approvals/{ask_id}/votes", {"vote": "a.b.c"}),
        lambda: weak._post("/mandates", {"mandate": "a.b.c"}),
        lambda: weak.restore_agent("mover", "r"),
        lambda: weak.revoke("sponsor", "alice", "r"),
        lambda: weak.revoke("key", keys.thumbprint(raw), "r"),
        lambda: weak.revoke("audience", "http://x.example/mcp", "r"),
    ):
        assert refusal(act) == "SESSION_KEY_TOO_WEAK"
    world.agent("bobs", sponsor="bob")
    # Her administrator's role is not in the key: of another's agents it takes back nothing.
    assert refusal(lambda: weak.revoke("agent", "bobs", "r")) == "NOT_PERMITTED"
    assert refusal(weak.export_ledger) == "NOT_PERMITTED"
    # The agent's evidence carries tier 4, and her own key lends it.
    assert lent(world, world.people["alice"], ceiling=Tier(4))["subject"] == "alice"
    assert refusal(lambda: lent(world, weak, ceiling=Tier(4))) == "ABOVE_CEILING"
    assert weak.revoke("agent", "mover", "r")


def test_who_is_no_sponsor_and_no_auditor_has_nothing_to_carry(shared):
    browser = Browser(shared)
    browser.log_in(shared.people["carol"])
    terminal = Terminal(shared)
    assert code(answer(browser, terminal)) == "NOT_PERMITTED"


def test_an_auditor_reads_and_changes_nothing(world):
    world.private["vera"] = keys.generate()
    world.people["alice"].register_person("vera", "Vera", keys.public_raw(world.private["vera"]), ["auditor"])
    vera = world.caller(Operator, "vera")
    agent = world.agent("mover")
    world.pep()
    assert vera.export_ledger() and vera.persons() and vera.agents() and vera.changes() == []
    assert vera.mandates() == [] and vera.openings() == [] and vera.approvals("open") == []
    raw = keys.public_raw(keys.generate())
    for act in (
        lambda: vera.register_person("eve", "Eve", raw, ["sponsor"]),
        lambda: vera.propose_end("bob", "r"),
        lambda: vera.register_agent("x", raw, software_digest="0" * 64, model="m", role="r"),
        lambda: vera.suspend_agent("mover", "r"),
        lambda: vera.revoke("agent", "mover", "r"),
        lambda: vera.issue(agent, world.scope(), purpose="p"),
        lambda: vera.set_trust("mover", 1),
    ):
        assert refusal(act) == "NOT_PERMITTED"
    world.people["vera"] = vera
    terminal, found = confirmed(world, "vera")
    assert found.roles == ("auditor",) and terminal.operator("vera").export_ledger()


SECONDS = {"min": 60, "h": 3_600, "d": 86_400}


def test_the_pages_ages_by_tier_are_those_of_the_sets():
    top = Path(__file__).parents[3]
    for names, *ages in rows_of(
        (top / "docs" / "login.md").read_text("utf-8"), "set", *(f"tier {n}" for n in range(5))
    ):
        stated = [int(number) * SECONDS[unit] for number, unit in (age.split() for age in ages)]
        for name in names.replace("`", "").split(", "):
            text = (top / "policies" / "sets" / f"{name}.toml").read_text("utf-8")
            found = [int(re.search(rf"sponsor_age_tier_{n}_s = ([0-9_]+)", text)[1]) for n in range(5)]
            assert found == stated, name


def test_the_ledger_names_the_key_and_the_login_behind_it(shared):
    terminal, _ = confirmed(shared)
    lines = b"".join(
        bytes(line) for (line,) in rows(shared, "SELECT line FROM ledger ORDER BY seq DESC LIMIT 2")
    ).decode()
    thumb = keys.thumbprint(keys.public_raw(terminal.key))
    for said in ('"kind":"device-confirmed"', '"kind":"session-key-added"', thumb, '"method":"operator-key"'):
        assert said in lines
    assert terminal.waiting.device_code not in lines
