"""A person lets a client act: page, code, tokens; and every known attack on the way."""

from __future__ import annotations

import hashlib
import re
import secrets
from urllib.parse import parse_qs, urlencode, urlsplit

import pytest
from capabilities.keys import keys
from capabilities.values.chain import EvidenceKind
from capabilities.values.scope import Tier
from tests.ztpm_idp.login.browser import Browser
from tests.ztpm_idp.oauth.speaking import REVOKE, WIPE, StockClient, claims_of, declare, looked_at, refusal
from tests.ztpm_idp.test_lending import chain_of
from tests.ztpm_idp.world import AUDIENCE, ISSUER, World
from ztpm_idp.oauth.client_documents import ClientDocument, DocumentError

from capabilities.keys.keys import Algorithm
from ztpm_idp.oauth.issuing import challenge_of

AUTHORIZE = "/ztpm/oauth/authorize"
BACK = "https://viewer.example/back"
HIDDEN = re.compile(r'name="(\w+)" value="([^"]*)"')


@pytest.fixture(scope="module")
def shared(tmp_path_factory):
    with World(tmp_path_factory.mktemp("world"), settings_changes={"client_documents": True}) as world:
        world.pep()
        StockClient(world).register()
        StockClient(world, "other").register()
        declare(world)
        declare(world, "camera.wipe", WIPE)
        declare(world, "elsewhere.read", audience="http://127.0.0.1:8801/mcp")
        yield world


@pytest.fixture
def alice(shared):
    shared.clock.at_s += 1_000
    browser = Browser(shared)
    browser.log_in(shared.people["alice"])
    return browser


class Flow:
    """One authorization of a client by a person in a browser."""

    def __init__(self, world, browser, client=None, **changes):
        self.world, self.browser, self.client = world, browser, client or StockClient(world)
        self.verifier = secrets.token_urlsafe(32)
        self.asked = {
            "response_type": "code",
            "client_id": self.client.client_id,
            "redirect_uri": BACK,
            "scope": "camera.read",
            "state": "s-1",
            "code_challenge": challenge_of(self.verifier),
            "code_challenge_method": "S256",
            "resource": AUDIENCE,
        } | changes

    def page(self):
        query = urlencode({name: value for name, value in self.asked.items() if value is not None})
        return self.browser.get(f"{AUTHORIZE}?{query}")

    def answer(self, answer="allow", **changes):
        found = dict(HIDDEN.findall(self.page().text))
        fields = {name: found[name].replace("&amp;", "&") for name in ("asked", "shown")}
        return self.browser.post(AUTHORIZE, fields | {"answer": answer} | changes)

    def told(self, response):
        assert response.status_code == 303, response.text
        address, _, query = response.headers["location"].partition("?")
        assert address == self.asked["redirect_uri"]
        told = {name: values[0] for name, values in parse_qs(query).items()}
        assert told["iss"] == ISSUER
        assert told.get("state") == self.asked["state"]
        return told

    def code(self):
        return self.told(self.answer())["code"]

    def redeem(self, spent, **changes):
        form = {
            "grant_type": "authorization_code",
            "code": spent,
            "code_verifier": self.verifier,
            "redirect_uri": self.asked["redirect_uri"],
            "resource": AUDIENCE,
        }
        return self.client.form(**(form | changes))

    def refresh(self, token, **changes):
        return self.client.form(**({"grant_type": "refresh_token", "refresh_token": token} | changes))


def test_a_person_lets_a_client_act(shared, alice):
    flow = Flow(shared, alice)
    shown = flow.page()
    assert shown.status_code == 200
    for said in ("viewer", "https://viewer.example", AUDIENCE, "camera.read", "width: 1 to 640", "1 (reversible"):
        assert said in shown.text, said
    policy = shown.headers["content-security-policy"]
    assert "frame-ancestors 'none'" in policy and "form-action 'self' https://viewer.example;" in policy
    assert (shown.headers["x-frame-options"], shown.headers["cache-control"]) == ("DENY", "no-store")
    given = flow.redeem(flow.code())
    assert given.status_code == 200, given.text
    body = given.json()
    assert (body["token_type"], body["expires_in"], body["scope"]) == ("Bearer", 600, "camera.read")
    claims = claims_of(body["access_token"])
    assert (claims["sub"], claims["client_id"], claims["aud"]) == ("alice", "viewer", AUDIENCE)
    chain = chain_of(shared, looked_at(shared, body["access_token"])["ztpm_capability"])
    assert chain.leaf.attestation.kind is EvidenceKind.CLIENT
    assert (chain.scope.ceiling, chain.scope.depth, chain.mandate_id) == (Tier(1), 0, None)
    assert chain.sponsor.authenticated_at == int(shared.clock())
    ledger = shared.people["alice"].export_ledger()
    assert b"oauth-assent-given" in ledger
    assert body["access_token"].encode() not in ledger and body["refresh_token"].encode() not in ledger


def test_a_code_is_good_once_and_the_second_use_ends_all_that_it_led_to(shared, alice):
    flow = Flow(shared, alice)
    code = flow.code()
    first = flow.redeem(code).json()
    assert looked_at(shared, first["access_token"])["active"]
    assert refusal(flow.redeem(code)) == (400, "invalid_grant")
    assert looked_at(shared, first["access_token"]) == {"active": False}
    assert refusal(flow.refresh(first["refresh_token"])) == (400, "invalid_grant")


def test_a_stolen_code_is_good_for_nobody_else(shared, alice):
    """Code injection: another client, redirect, verifier, resource or time; and it stays good for its own client."""
    flow = Flow(shared, alice)
    code = flow.code()
    other = StockClient(shared, "other")
    injected = {"code_verifier": flow.verifier, "redirect_uri": BACK, "grant_type": "authorization_code"}
    assert refusal(other.form(code=code, **injected)) == (400, "invalid_grant")
    for changes in (
        {"code_verifier": secrets.token_urlsafe(32)},
        {"redirect_uri": "http://127.0.0.1/back"},
        {"redirect_uri": f"{BACK}/"},
        {"code": code[:-1] + ("A" if code[-1] != "A" else "B")},
    ):
        assert refusal(flow.redeem(code, **changes)) == (400, "invalid_grant"), changes
    assert refusal(flow.redeem(code, resource="http://127.0.0.1:9/mcp")) == (400, "invalid_target")
    for missing in ("code_verifier", "redirect_uri", "code"):
        assert refusal(flow.redeem(code, **{missing: None})) == (400, "invalid_request")
    assert flow.redeem(code).status_code == 200
    late = flow.code()
    shared.clock.at_s += 61
    assert refusal(flow.redeem(late)) == (400, "invalid_grant")


def test_a_refresh_token_rotates_and_its_second_use_ends_the_family(shared, alice):
    flow = Flow(shared, alice)
    first = flow.redeem(flow.code()).json()
    other = StockClient(shared, "other")
    stolen = other.form(grant_type="refresh_token", refresh_token=first["refresh_token"])
    assert refusal(stolen) == (400, "invalid_grant")
    assert refusal(flow.refresh(first["refresh_token"], scope="camera.wipe")) == (400, "invalid_scope")
    second = flow.refresh(first["refresh_token"]).json()
    assert second["refresh_token"] != first["refresh_token"]
    assert refusal(flow.refresh(first["refresh_token"])) == (400, "invalid_grant")
    for spent in (first, second):
        assert looked_at(shared, spent["access_token"]) == {"active": False}
    assert refusal(flow.refresh(second["refresh_token"])) == (400, "invalid_grant")


def test_a_dpop_key_is_kept_through_the_whole_flow(shared, alice):
    client = StockClient(shared, dpop=keys.generate(Algorithm.P256))
    client.nonce = client.form(grant_type="refresh_token", refresh_token="x").headers["dpop-nonce"]
    jkt = keys.thumbprint(keys.public_raw(client.dpop))
    flow = Flow(shared, alice, client, dpop_jkt=jkt)
    assert "bound to the client" in flow.page().text
    code, bare = flow.code(), Flow(shared, alice)
    bare.verifier = flow.verifier
    assert refusal(bare.redeem(code)) == (400, "invalid_grant")
    thief = Flow(shared, alice, StockClient(shared, dpop=keys.generate(), nonce=client.nonce))
    thief.verifier = flow.verifier
    assert refusal(thief.redeem(code)) == (400, "invalid_grant")
    first = flow.redeem(code).json()
    assert (first["token_type"], claims_of(first["access_token"])["cnf"]) == ("DPoP", {"jkt": jkt})
    for wrong in (bare, thief):
        assert refusal(wrong.refresh(first["refresh_token"])) == (400, "invalid_grant")
    assert flow.refresh(first["refresh_token"]).json()["token_type"] == "DPoP"


PREFIXES = (
    f"{BACK}/more", f"{BACK}?next=x", f"{BACK}#part", "https://viewer.example.evil.example/back", "https://viewer.example/",
    "https://VIEWER.example/back", "http://viewer.example/back", "https://viewer.example:8443/back", "https://a@viewer.example/back",
    "http://127.0.0.2/back", "http://127.0.0.1:99999/back", "http://127.0.0.1/other", "http://localhost/back", "javascript:alert(1)", None,
)  # fmt: skip


def test_a_redirect_uri_is_compared_whole_and_nothing_is_sent_to_another(shared, alice):
    for redirect in PREFIXES:
        shown = Flow(shared, alice, redirect_uri=redirect).page()
        assert (shown.status_code, "location" in shown.headers) == (400, False), redirect
    assert Flow(shared, alice, client_id="nobody").page().status_code == 404
    flow = Flow(shared, alice, redirect_uri="http://127.0.0.1:54321/back")
    assert flow.redeem(flow.code()).status_code == 200


def test_a_defect_is_told_to_the_client_with_the_issuer(shared, alice):
    """PKCE left out or weakened, unknown scopes, several resources; each answer names its issuer (RFC 9207)."""
    for changes, error in (
        ({"code_challenge": None}, "invalid_request"),
        ({"code_challenge_method": "plain"}, "invalid_request"),
        ({"code_challenge_method": None}, "invalid_request"),
        ({"response_type": "token"}, "unsupported_response_type"),
        ({"response_mode": "fragment"}, "invalid_request"),
        ({"request": "x"}, "invalid_request"),
        ({"dpop_jkt": "x"}, "invalid_request"),
        ({"scope": "no.such"}, "invalid_scope"),
        ({"scope": "elsewhere.read"}, "invalid_scope"),
        ({"scope": "camera.read elsewhere.read", "resource": None}, "invalid_target"),
        ({"resource": "not a url"}, "invalid_target"),
    ):
        flow = Flow(shared, alice, **changes)
        assert flow.told(flow.page())["error"] == error, changes
    twice = Flow(shared, alice)
    shown = alice.get(f"{AUTHORIZE}?{urlencode(twice.asked)}&redirect_uri=https%3A%2F%2Fevil.example")
    assert shown.status_code == 400


def test_scopes_of_other_resources_are_left_out(shared, alice):
    flow = Flow(shared, alice, scope="camera.read camera.wipe elsewhere.read")
    assert flow.redeem(flow.code()).json()["scope"] == "camera.read camera.wipe"
    every = Flow(shared, alice, scope=None)
    assert every.redeem(every.code()).json()["scope"] == "camera.read camera.wipe"


def test_nobody_else_answers_for_the_person(shared, alice):
    flow = Flow(shared, alice)
    assert flow.told(flow.answer("deny"))["error"] == "access_denied"
    assert flow.answer("perhaps").status_code == 400
    for changes in ({"shown": "A" * 43}, {"shown": "-"}, {"asked": urlencode(flow.asked | {"scope": "camera.wipe"})}):
        assert flow.answer(**changes).status_code == 403
    # The page of one person is no page of another, and a form without our token, or of another site, is none.
    dora = Browser(shared)
    dora.log_in(shared.people["bob"])
    flow.page()
    found = dict(HIDDEN.findall(alice.page.text))
    fields = {name: found[name].replace("&amp;", "&") for name in ("asked", "shown")} | {"answer": "allow"}
    Flow(shared, dora).page()
    assert dora.post(AUTHORIZE, fields).status_code == 403
    flow.page()
    assert alice.post(AUTHORIZE, fields | {"form_token": "x"}).status_code == 403
    flow.page()
    assert alice.post(AUTHORIZE, fields, origin="https://evil.example").status_code == 403
    # What was shown is what is lent: a scope that changed meanwhile is shown again.
    flow.page()
    declare(shared, "camera.read", WIPE)
    try:
        assert alice.post(AUTHORIZE, fields).status_code == 403
    finally:
        declare(shared)


def test_only_a_sponsor_who_logged_in_just_now_lets_a_client_act(shared, alice):
    stranger = Flow(shared, Browser(shared)).page()
    assert stranger.status_code == 303 and urlsplit(stranger.headers["location"]).path == "/ztpm/login"
    carol = Browser(shared)
    carol.log_in(shared.people["carol"])
    assert Flow(shared, carol).page().status_code == 403
    shared.clock.at_s += 301
    old = Flow(shared, alice).page()
    assert old.status_code == 303 and "fresh_s=300" in old.headers["location"]


def test_a_person_takes_back_what_it_lent(shared, alice):
    flow = Flow(shared, alice)
    given = flow.redeem(flow.code()).json()
    (newest, *_) = shared.known("alice").get("/oauth/lent").json()
    assert (newest["client_id"], newest["state"], newest["scope"]) == ("viewer", "in force", "camera.read")
    path = f"/oauth/lent/{newest['id']}/end"
    assert shared.known("bob").post(path, json={"reason": "mine"}).json()["code"] == "FAMILY_UNKNOWN"
    assert shared.known("alice").post(path, json={"reason": "enough"}).status_code == 200
    assert looked_at(shared, given["access_token"]) == {"active": False}
    assert refusal(flow.refresh(given["refresh_token"])) == (400, "invalid_grant")
    again = flow.redeem(flow.code()).json()
    assert flow.client.form(REVOKE, token=again["refresh_token"]).status_code == 200
    assert looked_at(shared, again["access_token"]) == {"active": False}


def test_a_family_lasts_seven_days(shared, alice):
    flow = Flow(shared, alice)
    given, began = flow.redeem(flow.code()).json(), shared.clock.at_s
    shared.clock.at_s = began + 7 * 86_400 - 100
    last = flow.refresh(given["refresh_token"]).json()
    assert last["expires_in"] <= 100
    shared.clock.at_s = began + 7 * 86_400
    assert refusal(flow.refresh(last["refresh_token"])) == (400, "invalid_grant")


DOCUMENT = "https://app.example/client.json"


def test_an_unregistered_client_is_looked_up_for_a_person_alone(shared, alice):
    asked = []

    async def fetch(url):
        asked.append(url)
        return ClientDocument(url, "app.example", "Trusted bank", (BACK,), hashlib.sha256(b"1").digest())

    shared.app.state.fetch_document = fetch
    client = StockClient(shared, DOCUMENT)
    assert Flow(shared, Browser(shared), client).page().status_code == 303
    assert asked == []
    flow = Flow(shared, alice, client)
    shown = flow.page().text
    assert "app.example" in shown and "Nobody registered this client" in shown
    given = flow.redeem(flow.code()).json()
    claims = claims_of(given["access_token"])
    assert claims["client_id"] == DOCUMENT and claims["act"]["sub"].startswith("oauth-")
    assert looked_at(shared, given["access_token"])["active"]
    assert flow.redeem(flow.code()).status_code == 200
    # Its agent is this person's own: it ends with one word, and with nobody else's.
    shared.people["alice"].revoke("agent", claims["act"]["sub"], "enough")
    assert looked_at(shared, given["access_token"]) == {"active": False}
    assert flow.told(flow.answer())["error"] == "access_denied"

    async def silent(url):
        raise DocumentError("the client's document cannot be fetched")

    shared.app.state.fetch_document = silent
    assert flow.page().status_code == 404
