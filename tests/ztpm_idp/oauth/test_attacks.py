"""OAuth's known attacks that no other file of this folder tries, each by its name (RFC 9700, RFC 9207)."""

from __future__ import annotations

import re
from urllib.parse import urlencode, urlsplit

import pytest
from capabilities.keys import keys
from tests.ztpm_idp.login.browser import ORIGIN, Browser
from tests.ztpm_idp.login.test_devices import Terminal, enter
from tests.ztpm_idp.oauth.speaking import (
    INTROSPECT,
    REVOKE,
    TOKEN,
    StockClient,
    claims_of,
    declare,
    looked_at,
    refusal,
)
from tests.ztpm_idp.oauth.test_code_flow import AUTHORIZE, BACK, Flow
from tests.ztpm_idp.world import AUDIENCE, ISSUER, World
from ztpm_idp.oauth.client_auth import ASSERTION_TYPE

FORM = "application/x-www-form-urlencoded"
OTHER = "http://127.0.0.1:8801/mcp"


@pytest.fixture(scope="module")
def shared(tmp_path_factory):
    with World(tmp_path_factory.mktemp("attacks")) as world:
        world.pep()
        StockClient(world).register()
        StockClient(world, "other").register()
        declare(world)
        yield world


@pytest.fixture
def alice(shared):
    shared.clock.at_s += 1_000
    browser = Browser(shared)
    browser.log_in(shared.people["alice"])
    return browser


def send(world, url, content, kind=FORM, **headers):
    typed = {} if kind is None else {"Content-Type": kind}
    return world.anonymous().post(url, content=content, headers=typed | headers)


def lent(world):
    (newest, *_) = world.known("alice").get("/oauth/lent").json()
    return newest


def test_giving_a_token_back_keeps_nobody_from_taking_back_the_rest(shared, alice):
    """A client that revokes its own access token must not so keep its family alive."""
    flow = Flow(shared, alice)
    given = flow.redeem(flow.code()).json()
    for _ in range(2):  # RFC 7009 section 2.2: a token that is revoked already is no error
        assert flow.client.form(REVOKE, token=given["access_token"]).status_code == 200
    path = f"/oauth/lent/{lent(shared)['id']}/end"
    first, again = (shared.known("alice").post(path, json={"reason": "enough"}) for _ in range(2))
    assert (first.status_code, again.json()) == (200, first.json())
    assert lent(shared)["state"] == "ended"
    assert refusal(flow.refresh(given["refresh_token"])) == (400, "invalid_grant")
    assert flow.client.form(REVOKE, token=given["refresh_token"]).status_code == 200


@pytest.mark.parametrize("used", ["code", "refresh_token"])
def test_a_second_use_ends_the_family_also_where_a_token_of_it_was_given_back(shared, alice, used):
    flow = Flow(shared, alice)
    code = flow.code()
    first = flow.redeem(code).json()
    second = flow.refresh(first["refresh_token"]).json()
    flow.client.form(REVOKE, token=first["access_token"])
    again = flow.redeem(code) if used == "code" else flow.refresh(first["refresh_token"])
    assert refusal(again) == (400, "invalid_grant")
    assert looked_at(shared, second["access_token"]) == {"active": False}
    assert refusal(flow.refresh(second["refresh_token"])) == (400, "invalid_grant")


def test_mix_up(shared, alice):
    """Every answer names its issuer, as the metadata says that it does: with a code, a refusal and a defect."""
    told = shared.anonymous().get("/.well-known/oauth-authorization-server").json()
    assert (told["issuer"], told["authorization_response_iss_parameter_supported"]) == (ISSUER, True)
    flow = Flow(shared, alice)
    defect = Flow(shared, alice, code_challenge=None)
    for answer in (flow.answer(), flow.answer("deny"), defect.page()):
        query = urlsplit(answer.headers["location"]).query
        assert query.count("iss=") == 1 and urlencode({"iss": ISSUER}) in query
    forged = Flow(shared, alice, iss="https://evil.example")
    assert forged.told(forged.answer())["iss"] == ISSUER


def test_pkce_downgrade_at_the_token_endpoint(shared, alice):
    """The challenge is no verifier, and no method that a client names there counts."""
    flow = Flow(shared, alice)
    code, challenge = flow.code(), flow.asked["code_challenge"]
    for changes in ({"code_verifier": challenge}, {"code_verifier": challenge, "code_challenge_method": "plain"}):
        assert refusal(flow.redeem(code, **changes)) == (400, "invalid_grant")
    for short in ("", "a" * 42):
        assert flow.redeem(code, code_verifier=short).status_code == 400
    assert flow.redeem(code).status_code == 200


def test_a_secret_of_one_kind_is_none_of_another(shared, alice):
    """Code, refresh token and access token do not stand in for each other, nor for a client's assertion."""
    flow = Flow(shared, alice)
    code = flow.code()
    given = flow.redeem(flow.code()).json()
    for stolen in (given["access_token"], code, given["refresh_token"][:-1]):
        assert refusal(flow.refresh(stolen)) == (400, "invalid_grant")
    for stolen in (given["access_token"], given["refresh_token"]):
        assert refusal(flow.redeem(stolen)) == (400, "invalid_grant")
        asserted = {"client_assertion": stolen, "client_assertion_type": ASSERTION_TYPE}
        assert refusal(flow.client.credentials(**asserted)) == (401, "invalid_client")
    for text in (code, given["refresh_token"]):
        assert looked_at(shared, text) == {"active": False}
    assert flow.redeem(code).status_code == 200


def test_audience_confusion(shared, alice):
    """A code, and what is refreshed, serve the resource that the person saw; no other, and no two."""
    flow = Flow(shared, alice)
    code = flow.code()
    assert refusal(flow.redeem(code, resource=OTHER)) == (400, "invalid_target")
    given = flow.redeem(code, resource=None).json()
    assert claims_of(given["access_token"])["aud"] == AUDIENCE
    assert refusal(flow.refresh(given["refresh_token"], resource=OTHER)) == (400, "invalid_target")
    twice = [("grant_type", "refresh_token"), ("client_id", "viewer"), ("refresh_token", given["refresh_token"])]
    twice += [("resource", AUDIENCE), ("resource", OTHER)]
    assert refusal(send(shared, TOKEN, urlencode(twice))) == (400, "invalid_target")
    assert flow.refresh(given["refresh_token"]).status_code == 200


def test_a_clients_assertion_for_another_endpoint(shared):
    """Its audience is this issuer alone: neither another server's, nor several, nor one of our other endpoints."""
    client = StockClient(shared, "robot", key=keys.generate())
    client.register()
    client.mandate()
    for audience in (INTROSPECT, AUDIENCE, f"{ISSUER}/", [ISSUER, TOKEN], ISSUER.upper(), "", [], 7):
        bad = {"client_assertion": client.assertion(aud=audience), "client_assertion_type": ASSERTION_TYPE}
        assert refusal(client.credentials(**bad)) == (401, "invalid_client"), audience
    assert client.credentials().status_code == 200


def test_parameter_pollution(shared, alice):
    """Each parameter once; one more of any is refused before anything is read, and spends nothing."""
    flow = Flow(shared, alice)
    form = {
        "grant_type": "authorization_code", "client_id": "viewer", "code": flow.code(), "code_verifier": flow.verifier,
        "redirect_uri": BACK, "resource": AUDIENCE,
    }  # fmt: skip
    for name in (*form, "scope", "unknown"):
        for other in ("", "x", form.get(name, "y")):
            content = urlencode([*form.items(), (name, form.get(name, "y")), (name, other)])
            assert refusal(send(shared, TOKEN, content))[0] == 400, name
    assert refusal(send(shared, f"{TOKEN}?client_id=other", urlencode(form))) == (400, "invalid_request")
    assert refusal(send(shared, TOKEN, urlencode(form) + "&x" * 40)) == (400, "invalid_request")
    assert send(shared, TOKEN, urlencode(form)).status_code == 200
    for name in flow.asked:
        shown = alice.get(f"{AUTHORIZE}?{urlencode(flow.asked)}&{urlencode({name: 'https://evil.example'})}")
        assert (shown.status_code, "location" in shown.headers) == (400, False), name


KINDS = (
    None, "", "application/json", "text/plain", "multipart/form-data; boundary=x", "application/xml", f"text/{FORM}", f"{FORM}x",
    f"application/json, {FORM}",
)  # fmt: skip


def test_smuggling_by_content_type(shared, alice):
    """A body is a form where its type says so, once; what it says beside is not heard."""
    flow = Flow(shared, alice)
    form = {"grant_type": "authorization_code", "client_id": "viewer", "code": flow.code(), "redirect_uri": BACK}
    content = urlencode(form | {"code_verifier": flow.verifier})
    for kind in KINDS:
        assert refusal(send(shared, TOKEN, content, kind))[1] == "invalid_request", kind
    twice = [("Content-Type", "application/json"), ("Content-Type", FORM)]
    assert refusal(shared.anonymous().post(TOKEN, content=content, headers=twice))[1] == "invalid_request"
    for broken in (content.encode() + b"&x=\xff", content.encode() + b"&x=%ff", b"\xff\xfe" + content.encode("utf-16")):
        assert refusal(send(shared, TOKEN, broken))[1] == "invalid_request"
    assert send(shared, TOKEN, content, f"{FORM}; charset=UTF-8").status_code == 200


PLACES = (
    "//evil.example", "https://evil.example", "https://viewer.example@evil.example/back", "https:evil.example", "\\\\evil.example",
    "https://viewer.example\\@evil.example/back", "data:text/html,x", f"{BACK}%0d%0aLocation:%20https://evil.example", f" {BACK}", f"{BACK}\t",
    "https://viewer.example/../back", "https://viewer.example/back/../back", "https://xn--viewer.example/back", f"{BACK}%00", f"{BACK};x", "http://[::1]/back",
)  # fmt: skip


def test_open_redirect_on_errors(shared, alice):
    """A browser is sent to a registered URI alone, with any other defect beside."""
    for defect in (
        {},
        {"response_type": "token"},
        {"scope": "no.such"},
        {"code_challenge": None},
        {"client_id": "nobody"},
    ):
        for place in PLACES:
            shown = Flow(shared, alice, redirect_uri=place, **defect).page()
            assert (shown.status_code in {400, 404}, "location" in shown.headers) == (True, False), place
            assert "evil.example" not in "".join(re.findall(r'(?:href|action|content)="([^"]*)"', shown.text))


def test_an_answer_is_not_split_by_its_state(shared, alice):
    state = "a\r\nSet-Cookie: x=1\r\n\r\n&code=stolen&iss=https://evil.example"
    flow = Flow(shared, alice, state=state)
    answer = flow.answer()
    assert flow.told(answer)["state"] == state
    assert "\n" not in answer.headers["location"] and "set-cookie" not in answer.headers


SITES = (
    {"sec-fetch-site": "cross-site", "origin": "https://evil.example"}, {"sec-fetch-site": "same-site", "origin": "http://127.0.0.1:9"},
    {"origin": "null", "sec-fetch-site": None}, {"origin": None, "sec-fetch-site": None}, {"origin": "https://evil.example"},
)  # fmt: skip


def test_forged_requests_let_no_client_act_and_confirm_no_command_line(shared, alice):
    """Another site's page, one that says nothing of itself, and one without this browser's token."""
    flow, terminal = Flow(shared, alice), Terminal(shared)
    found = dict(re.findall(r'name="(\w+)" value="([^"]*)"', flow.page().text))
    assent = {name: found[name].replace("&amp;", "&") for name in ("asked", "shown")} | {"answer": "allow"}
    confirm = {"code": terminal.waiting.user_code, "answer": "confirm"}
    families = len(shared.rows("oauth_codes"))
    for path, fields, shown in (
        (AUTHORIZE, assent, flow.page),
        ("/ztpm/login/device/answer", confirm, lambda: enter(alice, terminal.waiting.user_code)),
    ):
        for headers in SITES:
            shown()
            assert alice.post(path, fields, **headers).status_code == 403, (path, headers)
        for token in ("", "0" * 64):
            shown()
            assert alice.post(path, fields | {"form_token": token}).status_code == 403
        assert alice.get(f"{path}?{urlencode(fields)}").status_code in {404, 405}
    assert len(shared.rows("oauth_codes")) == families
    assert not hasattr(terminal.poll(), "person")
    enter(alice, terminal.waiting.user_code)
    assert alice.post("/ztpm/login/device/answer", confirm).status_code == 200


def test_no_page_is_framed_kept_or_told_onwards(shared, alice):
    """Pages with a button, and their refusals."""
    pages = [
        Flow(shared, alice).page(), Flow(shared, alice, redirect_uri="https://evil.example").page(), alice.get("/ztpm/login"),
        alice.get("/ztpm/login/device"), alice.get("/ztpm/login/account"), alice.get("/ztpm/login/links/unknown"),
        alice.post("/ztpm/login/device", origin="https://evil.example"), Flow(shared, Browser(shared)).page(),
    ]  # fmt: skip
    assert {page.status_code for page in pages} == {200, 303, 400, 403, 409}
    for page in pages:
        assert page.headers["cache-control"] == "no-store"
        if page.status_code == 303:
            continue
        assert page.headers["referrer-policy"] in {"no-referrer", "same-origin"}
        assert page.headers["x-frame-options"] == "DENY"
        assert page.headers["x-content-type-options"] == "nosniff"
        policy = page.headers["content-security-policy"]
        assert "frame-ancestors 'none'" in policy and "default-src 'none'" in policy and "base-uri 'none'" in policy


def test_nothing_secret_is_kept_or_shared_with_other_origins(shared, alice):
    """Tokens, introspection and refusals; what a page of another origin may read has no cookie behind it."""
    flow = Flow(shared, alice)
    given = flow.redeem(flow.code())
    asked = shared.known("cell-1").post(
        INTROSPECT, content=urlencode({"token": given.json()["access_token"]}), headers={"Content-Type": FORM}
    )  # fmt: skip
    for answer in (given, asked, flow.redeem("x"), flow.client.form(REVOKE, token="x")):
        assert answer.headers["cache-control"] == "no-store"
        assert answer.headers.get("access-control-allow-credentials") is None
    shown = alice.send("GET", f"{AUTHORIZE}?{urlencode(flow.asked)}", origin="https://evil.example")
    assert "access-control-allow-origin" not in shown.headers
    session = alice.send(
        "POST", TOKEN, urlencode({"grant_type": "client_credentials"}), **{"content-type": FORM, "origin": ORIGIN}
    )
    assert refusal(session) == (401, "invalid_client"), "a person's session is no client"
