"""Logging in at an OpenID provider: who gets in, and every way in which an answer is none."""

from __future__ import annotations

import base64
import hashlib
import time
import tomllib
from pathlib import Path

import httpx2
import pytest
from tests.ztpm_idp.login.browser import Browser
from tests.ztpm_idp.login.openid import KEY, OP, OTHER_KEY, SECRET, Fake, settings
from tests.ztpm_idp.login.test_session import as_list, code, rows
from tests.ztpm_idp.world import ISSUER, World
from ztpm_idp.domain.parties import PersonRole
from ztpm_idp.login.oidc import ATTEMPT_S, SKEW_S, OpenIdProvider
from ztpm_idp.login_settings import LoginProvider, LoginProviderSettings, check_login_providers, load_login_providers
from ztpm_idp.routes.openid import ATTEMPT

from ztpm_idp.client import ClientError
from ztpm_idp.keys.key_files import SettingsError
from ztpm_idp.login import session


@pytest.fixture(scope="module")
def shared(tmp_path_factory):
    with World(tmp_path_factory.mktemp("openid")) as world:
        add_login(world, "bob", OP, "b-17")
        yield world


def add_login(world, person, issuer, subject):
    change = world.people["alice"].propose_login(person, issuer, subject)
    assert world.people["dan"].confirm_change(change) == "done"


@pytest.fixture
def browser(shared):
    return Browser(shared)


def test_who_has_the_login_is_logged_in_with_what_the_provider_said(shared, browser):
    fake = Fake(shared)
    fake.claims = {"acr": "urn:strong", "amr": ["pwd", "otp", 7, "x" * 200]}
    assert fake.log_in(browser).status_code == 303
    assert browser.who() == "bob"
    at = int(shared.clock()) - 5
    (row,) = rows(shared, "SELECT method, at_ms, acr, amr, login FROM sessions ORDER BY made_ms DESC LIMIT 1")
    assert (*row[:3], as_list(row[3]), row[4]) == ("oidc", at * 1_000, "urn:strong", ["pwd", "otp"], f"{OP} b-17")
    assert ATTEMPT not in browser.cookies


def test_a_token_for_several_audiences_with_us_as_the_party_is_taken(shared, browser):
    fake = Fake(shared)
    fake.claims = {"aud": ["other", "ztpm"], "azp": "ztpm"}
    assert fake.log_in(browser).status_code == 303


def test_it_asks_with_pkce_state_nonce_and_an_age(shared, browser):
    fake = Fake(shared)
    fake.log_in(browser)
    assert {"response_type": "code", "client_id": "ztpm", "scope": "openid", "code_challenge_method": "S256",
            "redirect_uri": f"{ISSUER}/login/providers/works/callback", "max_age": "43200"}.items() <= fake.asked.items()  # fmt: skip
    assert min(len(fake.asked[name]) for name in ("state", "nonce", "code_challenge")) >= 43
    (_, sent, basic) = next(seen for seen in fake.seen if seen[0] == "/token")
    challenge = base64.urlsafe_b64encode(hashlib.sha256(sent["code_verifier"].encode()).digest()).decode().rstrip("=")
    assert challenge == fake.asked["code_challenge"]
    assert sent["redirect_uri"] == fake.asked["redirect_uri"]
    assert base64.b64decode(basic.removeprefix("Basic ")).decode() == f"ztpm:{SECRET}"


def test_a_person_who_must_log_in_again_does(shared, browser):
    fake = Fake(shared)
    fake.claims = {"auth_time": int(shared.clock()) - SKEW_S - 1}
    assert code(fake.log_in(browser, fresh_s=0)) == "LOGIN_FAILED"
    assert fake.asked["max_age"] == "0" and fake.asked["prompt"] == "login"
    fake.claims = {"auth_time": int(shared.clock()) - 60}
    assert code(fake.log_in(browser, fresh_s=20)) == "LOGIN_FAILED"
    assert fake.log_in(browser, fresh_s=40).status_code == 303


BROKEN = {
    "another nonce": ({"nonce": "other"}, {}),
    "no nonce": ({"nonce": None}, {}),
    "another issuer": ({"iss": "https://evil.example"}, {}),
    "another audience": ({"aud": "other"}, {}),
    "another audience, with us as the party": ({"aud": "other", "azp": "ztpm"}, {}),
    "another authorized party": ({"aud": ["ztpm", "other"], "azp": "other"}, {}),
    "over": ({"exp": 1_700_000_000}, {}),
    "from the future": ({"iat": 1_900_000_000}, {}),
    "no subject": ({"sub": None}, {}),
    "a subject with a blank": ({"sub": "b 17"}, {}),
    "a subject that is a number": ({"sub": 17}, {}),
    "no time of login": ({"auth_time": None}, {}),
    "a login in the future": ({"auth_time": 1_900_000_000}, {}),
    "a login that is no number": ({"auth_time": True}, {}),
    "a wrong digest of the access token": ({"at_hash": "AAAAAAAAAAAAAAAAAAAAAA"}, {}),
    "no signature": ({}, {"alg": "none"}),
    "a signature with our secret": ({}, {"alg": "HS256"}),
}


@pytest.mark.parametrize(("claims", "header"), BROKEN.values(), ids=BROKEN)
def test_a_token_that_is_not_for_this_login_logs_nobody_in(shared, browser, claims, header):
    fake = Fake(shared)
    fake.claims, fake.header = claims, header
    assert code(fake.log_in(browser)) == "LOGIN_FAILED"
    assert browser.who() is None and ATTEMPT not in browser.cookies


def test_a_key_that_the_provider_does_not_have_signs_nothing(shared, browser):
    fake = Fake(shared)
    fake.signer = OTHER_KEY
    assert code(fake.log_in(browser)) == "LOGIN_FAILED"


def test_a_new_key_of_the_provider_is_fetched_once_a_minute(shared, browser):
    fake = Fake(shared)
    fake.log_in(Browser(shared))
    fake.signer, fake.keys = OTHER_KEY, [KEY, OTHER_KEY]
    assert code(fake.log_in(browser)) == "LOGIN_FAILED"
    shared.clock.at_s += 60
    assert fake.log_in(browser).status_code == 303
    assert [seen[0] for seen in fake.seen].count("/keys") == 2


MIXED = {
    "of another provider": {"iss": "https://evil.example"},
    "of no provider": {"iss": None},
    "another state": {"state": "A" * 43},
    "no state": {"state": None},
    "refused there": {"error": "access_denied", "code": None},
}


@pytest.mark.parametrize("changed", MIXED.values(), ids=MIXED)
def test_an_answer_that_is_none_to_this_login_logs_nobody_in(shared, browser, changed):
    fake = Fake(shared)
    assert code(fake.log_in(browser, **changed)) == "LOGIN_FAILED"
    assert browser.who() is None
    assert "/token" not in [seen[0] for seen in fake.seen]


def test_a_provider_that_says_nothing_of_its_name_may_leave_it_out(shared, browser):
    fake = Fake(shared)
    del fake.metadata["authorization_response_iss_parameter_supported"]
    assert fake.log_in(browser, iss=None).status_code == 303


def test_an_answer_counts_once_in_its_own_browser_and_in_time(shared, browser):
    fake = Fake(shared)
    fake.log_in(browser)
    answer = {"code": "c", "state": fake.asked["state"], "iss": OP}
    assert code(fake.come_back(browser, answer)) == "LOGIN_OVER"
    other = Browser(shared)
    assert code(fake.come_back(other, answer)) == "LOGIN_OVER"
    other.get("/ztpm/login")
    other.post("/ztpm/login/providers/works", {"fresh_s": ""})
    # Another person's answer in this browser: the code injection that state and verifier are for.
    assert code(fake.come_back(other, answer)) == "LOGIN_FAILED"
    other.get("/ztpm/login")
    asked = fake.read_leave(other.post("/ztpm/login/providers/works", {"fresh_s": ""}).text)
    shared.clock.at_s += ATTEMPT_S + 1
    assert code(fake.come_back(other, answer | {"state": asked["state"]})) == "LOGIN_FAILED"
    assert other.who() is None


def test_an_attempt_that_a_browser_made_up_counts_for_nothing(shared, browser):
    fake = Fake(shared)
    browser.get("/ztpm/login")
    browser.post("/ztpm/login/providers/works", {"fresh_s": ""})
    body, _, said = browser.cookies[ATTEMPT].partition(".")
    forged = session.seal(b"x" * 32, ATTEMPT, session.unb64u(body).decode())
    for held in (forged, f"{body}A.{said}", f"{body}.", body, "é"):
        browser.cookies[ATTEMPT] = held.encode("ascii", "ignore").decode() or "x"
        assert code(fake.come_back(browser, {"code": "c", "state": "s", "iss": OP})) == "LOGIN_OVER"


def test_a_parameter_that_occurs_twice_is_refused(shared, browser):
    Fake(shared)
    answer = browser.get("/ztpm/login/providers/works/callback?code=a&code=b&state=s")
    assert code(answer) == "QUERY_MALFORMED"


LIES = {
    "another issuer": {"issuer": "https://login.example"},
    "an endpoint without TLS": {"token_endpoint": "http://login.example/token"},
    "no key set": {"jwks_uri": None},
    "no S256": {"code_challenge_methods_supported": ["plain"]},
}


@pytest.mark.parametrize("changed", LIES.values(), ids=LIES)
def test_a_provider_that_is_not_the_configured_one_is_told_so(shared, browser, changed):
    fake = Fake(shared)
    fake.metadata |= changed
    browser.get("/ztpm/login")
    assert code(browser.post("/ztpm/login/providers/works", {"fresh_s": ""})) == "LOGIN_PROVIDER_SILENT"


@pytest.mark.parametrize(
    ("path", "answer", "wanted"),
    [
        ("/token", httpx2.Response(500, text="no"), "LOGIN_PROVIDER_SILENT"),
        ("/token", httpx2.Response(200, text="[]"), "LOGIN_PROVIDER_SILENT"),
        ("/token", httpx2.Response(200, json={"access_token": "x"}), "LOGIN_PROVIDER_SILENT"),
        ("/token", httpx2.Response(400, json={"error": "invalid_grant"}), "LOGIN_FAILED"),
        ("/token", httpx2.Response(302, headers={"location": "https://evil.example"}), "LOGIN_PROVIDER_SILENT"),
        ("/keys", httpx2.Response(200, json={"keys": [{"kty": "oct", "k": "AAAA"}]}), "LOGIN_PROVIDER_SILENT"),
        ("/keys", httpx2.Response(200, json={"keys": 7}), "LOGIN_PROVIDER_SILENT"),
        ("/keys", httpx2.Response(200, text="{"), "LOGIN_PROVIDER_SILENT"),
        ("/keys", httpx2.Response(404), "LOGIN_PROVIDER_SILENT"),
    ],
)
def test_a_provider_that_answers_nonsense_logs_nobody_in(shared, browser, path, answer, wanted):
    fake = Fake(shared)
    fake.answer = {path: answer}
    assert code(fake.log_in(browser)) == wanted
    assert browser.who() is None


def test_a_login_that_nobody_has_is_told_with_its_name(shared, browser):
    fake = Fake(shared)
    fake.claims = {"sub": "stranger", "email": "bob@example.com"}
    answer = fake.log_in(browser)
    assert code(answer) == "LOGIN_UNKNOWN" and f"{OP} stranger" in answer.text


def test_a_login_needs_two_people_and_ends_with_one(shared, browser):
    alice, dan, carol = (shared.people[name] for name in ("alice", "dan", "carol"))
    change = carol.propose_login("carol", OP, "c-1")
    for refused, who in (("CHANGE_YOURS", carol), ("NOT_PERMITTED", shared.people["bob"])):
        with pytest.raises(ClientError) as error:
            who.confirm_change(change)
        assert error.value.code == ("NOT_PERMITTED" if who is carol else refused)
    with pytest.raises(ClientError) as error:
        shared.people["bob"].propose_login("carol", OP, "c-2")
    assert error.value.code == "NOT_PERMITTED"
    assert alice.confirm_change(change) == "done"
    with pytest.raises(ClientError) as error:
        alice.propose_login("dan", OP, "c-1")
    assert error.value.code == "LOGIN_IN_USE"
    fake = Fake(shared)
    fake.claims = {"sub": "c-1"}
    fake.log_in(browser)
    assert browser.who() == "carol"
    assert next(row for row in dan.persons() if row["id"] == "carol")["logins"] == [f"{OP} c-1"]
    with pytest.raises(ClientError) as error:
        shared.people["bob"].end_login(OP, "c-1")
    assert error.value.code == "NOT_PERMITTED"
    dan.end_login(OP, "c-1")
    assert browser.who() is None
    assert code(fake.log_in(browser)) == "LOGIN_UNKNOWN"


GROUPS = {"groups_claim": "groups", "groups": {"ops": ["sponsor", "admin"]}}


@pytest.mark.parametrize(
    ("named", "roles"), [(["ops", "x"], "sponsor"), (["x"], "none"), (None, "none"), ("ops", "none"), ([7], "none")]
)
def test_groups_limit_the_roles_of_a_session_and_give_none(shared, browser, named, roles):
    """The registry makes bob a sponsor alone: that his group may administer gives him nothing."""
    fake = Fake(shared, **GROUPS)
    fake.claims = {"groups": named}
    fake.log_in(browser)
    assert f"<td>{roles}</td>" in browser.get("/ztpm/login/account").text


def test_a_class_that_was_asked_for_is_insisted_on(shared, browser):
    fake = Fake(shared, acr_values=["urn:strong"])
    assert code(fake.log_in(browser)) == "LOGIN_FAILED"
    assert fake.asked["acr_values"] == "urn:strong"
    fake.claims = {"acr": "urn:strong"}
    assert fake.log_in(browser).status_code == 303


def test_a_recovery_ends_sessions_and_logins(tmp_path):
    with World(tmp_path) as world:
        world.people["alice"].confirm_change(world.people["dan"].propose_login("dan", OP, "b-17"))
        by_login, by_key = Browser(world), Browser(world)
        from capabilities.keys import keys

        world.private["root"] = world.idp_keys.root
        new = keys.generate()
        world.caller(type(world.people["dan"]), "root").recover("dan", "Dan", keys.public_raw(new))
        world.clock.at_s += 86_400
        Fake(world).log_in(by_login)
        by_key.log_in(world.people["dan"])
        assert (by_login.who(), by_key.who()) == ("dan", "dan")
        world.private["dan"] = new
        assert world.caller(type(world.people["dan"]), "dan").persons()
        assert (by_login.who(), by_key.who()) == (None, None)
        assert code(Fake(world).log_in(by_login)) == "LOGIN_UNKNOWN"


REFUSED = {
    "plain HTTP": {"issuer": "http://login.example"},
    "a query": {"issuer": "https://login.example?x=1"},
    "a shared secret signs": {"algorithms": ["HS256"]},
    "nothing signs": {"algorithms": ["none"]},
    "no algorithm": {"algorithms": []},
    "groups without a claim": {"groups": {"ops": ["sponsor"]}},
    "a role that is none": {"groups_claim": "g", "groups": {"ops": ["king"]}},
    "a name that is no part of a path": {"name": "a/b"},
    "something unknown": {"trust_email": True},
}


@pytest.mark.parametrize("changed", REFUSED.values(), ids=REFUSED)
def test_an_insecure_setting_is_refused(changed):
    with pytest.raises(ValueError):
        settings(**changed)


def test_the_pages_example_is_taken():
    text = (Path(__file__).parents[3] / "docs" / "login.md").read_text("utf-8")
    (stated,) = tomllib.loads(text.split("```toml\n", 1)[1].split("```", 1)[0])["login_providers"]
    taken = LoginProviderSettings(**stated)
    assert LoginProvider(taken).roles(["auditors", "others"]) == {PersonRole.AUDITOR}


def test_two_providers_of_one_name_or_issuer_are_refused():
    assert check_login_providers([settings(), settings(name="two")]) == "two have one issuer"
    assert check_login_providers([settings(), settings(issuer="https://other.example")]) == "two have one name"
    assert check_login_providers([settings(), settings(name="two", issuer="https://other.example")]) is None


def test_the_secret_lies_in_a_file_of_its_own(tmp_path):
    stated = settings(client_secret_file="secret")
    for text, mode in (("short", 0o600), (SECRET, 0o644), (None, 0)):
        file = tmp_path / "secret"
        file.unlink(missing_ok=True)
        if text is not None:
            file.write_text(text)
            file.chmod(mode)
        with pytest.raises(SettingsError):
            load_login_providers([stated], tmp_path)
    file.write_text(SECRET + "\n")
    file.chmod(0o600)
    (loaded,) = load_login_providers([stated], tmp_path)
    assert loaded.secret == SECRET and SECRET not in repr(loaded)


@pytest.mark.version
@pytest.mark.filterwarnings("ignore")  # it uses parts that its own library will drop
def test_another_implementation_logs_a_person_in(shared, browser):
    """oidc-provider-mock on a port of its own; it says when a person logged in only where the claims do."""
    import oidc_provider_mock

    before = shared.clock.at_s
    shared.clock.at_s = time.time()
    claims = {"auth_time": int(time.time())}
    user = oidc_provider_mock.User(sub="b-18", claims=claims)
    try:
        with oidc_provider_mock.run_server_in_thread(user_claims=[user]) as server:
            issuer = f"http://localhost:{server.server_port}"
            add_login(shared, "bob", issuer, "b-18")
            configured = LoginProvider(settings(issuer=issuer, client_id="ztpm"), SECRET)
            ours = OpenIdProvider(
                configured, redirect_uri=f"{ISSUER}/login/providers/works/callback", now=shared.clock
            )  # fmt: skip
            shared.app.state.login_providers = {"works": ours}
            browser.get("/ztpm/login")
            shown = browser.post("/ztpm/login/providers/works", {"fresh_s": ""}).text
            url = shown.split('content="0; url=', 1)[1].split('"', 1)[0].replace("&amp;", "&")
            answer = httpx2.post(url, data={"sub": "b-18"}, follow_redirects=False)
            browser.get(answer.headers["location"])
            assert browser.page.status_code == 303, browser.page.text
            assert browser.who() == "bob"
    finally:
        shared.clock.at_s = before
