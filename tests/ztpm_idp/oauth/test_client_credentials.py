"""Access tokens from mandates: rooted in a person, at most tier 1, ten minutes, one audience; and their end."""

from __future__ import annotations

import secrets

import jwt
import pytest
from capabilities.keys import jws, keys
from capabilities.values.chain import EvidenceKind
from capabilities.values.scope import Grant, Tier
from tests.ztpm_idp.oauth.speaking import READ, REVOKE, WIPE, StockClient, claims_of, declare, looked_at, refusal
from tests.ztpm_idp.test_lending import chain_of
from tests.ztpm_idp.world import AUDIENCE, ISSUER, World

from capabilities.keys.keys import Algorithm
from ztpm_idp.client import ClientError
from ztpm_idp.oauth.client_auth import ASSERTION_TYPE

OTHER = "http://127.0.0.1:8801/mcp"


@pytest.fixture(scope="module")
def shared(tmp_path_factory):
    with World(tmp_path_factory.mktemp("world")) as made:
        made.pep()
        yield made


def registered(world, client_id, **keyed):
    client = StockClient(world, client_id, **keyed)
    assert client.register().status_code == 201
    return client


@pytest.fixture
def viewer(shared, request):
    """A client of this test alone; what others drew is over."""
    shared.clock.at_s += 3_600
    return registered(
        shared,
        f"viewer-{len(shared.private)}-{request.node.name[5:35].replace('_', '-').strip('-')}",
        key=keys.generate(Algorithm.P256),
    )


def test_a_token_is_rooted_in_the_person_who_signed_the_mandate(shared, viewer):
    mandate_id = viewer.mandate(ceiling=3)
    given = viewer.credentials()
    assert given.status_code == 200
    assert given.headers["cache-control"] == "no-store"
    body = given.json()
    assert (body["token_type"], body["expires_in"]) == ("Bearer", 600)
    header = jwt.get_unverified_header(body["access_token"])
    (known,) = shared.anonymous().get("/oauth/jwks").json()["keys"]
    assert (header["typ"], header["kid"]) == ("at+jwt", known["kid"])
    key = jwt.PyJWK(known).key
    claims = jwt.decode(
        body["access_token"], key, algorithms=["EdDSA"], audience=AUDIENCE, issuer=ISSUER,
        options={"verify_exp": False, "verify_iat": False},
    )  # fmt: skip
    assert (claims["sub"], claims["client_id"], claims["act"]) == ("alice", viewer.client_id, {"sub": viewer.client_id})
    assert claims["exp"] - claims["iat"] == 600

    told = looked_at(shared, body["access_token"])
    assert told["active"] is True
    chain = chain_of(shared, told["ztpm_capability"])
    assert (chain.leaf.hop_id, chain.leaf.agent, chain.sponsor.subject) == (claims["jti"], viewer.client_id, "alice")
    assert chain.mandate_id == mandate_id
    assert chain.leaf.attestation.kind is EvidenceKind.CLIENT
    assert (chain.scope.ceiling, chain.scope.audiences, chain.scope.depth) == (Tier(1), {AUDIENCE}, 0)
    kinds = [entry for entry in shared.people["alice"].export_ledger().splitlines() if b"oauth-access-made" in entry]
    (kind,) = (each for each in kinds if claims["jti"].encode() in each)
    assert f'"{viewer.client_id}"'.encode() in kind and b'"alice"' in kind
    assert told["ztpm_capability"].encode() not in shared.people["alice"].export_ledger()


def test_without_a_mandate_that_names_the_client_there_is_no_token(shared, viewer):
    assert refusal(viewer.credentials()) == (400, "unauthorized_client")
    other = registered(shared, "other-1", key=keys.generate())
    other.mandate()
    assert refusal(viewer.credentials()) == (400, "unauthorized_client")
    mandate_id = viewer.mandate()
    assert viewer.credentials().status_code == 200
    shared.people["alice"].revoke("mandate", mandate_id, "enough")
    assert refusal(viewer.credentials()) == (400, "unauthorized_client")


def test_a_public_client_has_no_credentials_to_draw_with(shared):
    client = registered(shared, "public")
    client.mandate()
    assert refusal(client.credentials()) == (400, "unauthorized_client")


def test_scopes_narrow_what_the_mandate_holds(shared, viewer):
    assert declare(shared).status_code == declare(shared, "camera.wipe", WIPE).status_code == 200
    viewer.mandate(grants=(Grant("camera", "pan"), *READ))
    given = viewer.credentials(scope="camera.read").json()
    assert given["scope"] == claims_of(given["access_token"])["scope"] == "camera.read"
    chain = chain_of(shared, looked_at(shared, given["access_token"])["ztpm_capability"])
    assert chain.scope.grants == READ
    assert refusal(viewer.credentials(scope="camera.wipe")) == (400, "invalid_scope")
    assert refusal(viewer.credentials(scope="camera.read camera.wipe")) == (400, "invalid_scope")
    assert refusal(viewer.credentials(scope="no.such")) == (400, "invalid_scope")
    assert refusal(viewer.credentials(scope='"')) == (400, "invalid_scope")


def test_a_token_serves_one_audience(shared, viewer):
    viewer.mandate(audiences=frozenset({AUDIENCE, OTHER}))
    assert refusal(viewer.credentials(resource=None)) == (400, "invalid_target")
    assert refusal(viewer.credentials(resource="http://127.0.0.1:9/mcp")) == (400, "unauthorized_client")
    given = viewer.credentials(resource=OTHER).json()
    assert claims_of(given["access_token"])["aud"] == OTHER
    # The enforcement point of another audience learns nothing of it.
    assert looked_at(shared, given["access_token"]) == {"active": False}
    twice = shared.anonymous().post(
        "/oauth/token",
        content=b"grant_type=client_credentials&resource=a&resource=b",
        headers={"Content-Type": "application/x-www-form-urlencoded"},
    )
    assert refusal(twice) == (400, "invalid_target")


def test_so_many_are_live_at_once_and_no_more(shared, viewer):
    viewer.mandate()
    assert [viewer.credentials().status_code for _ in range(9)] == [200] * 8 + [429]
    shared.clock.at_s += 601
    assert viewer.credentials().status_code == 200


def bad_assertions(at):
    return (
        {"iss": "other"},
        {"sub": "other"},
        {"aud": "https://elsewhere.example"},
        {"aud": [ISSUER, "https://elsewhere.example"]},
        {"aud": None},
        {"exp": at - 60},
        {"exp": at + 3_600},
        {"exp": None},
        {"exp": "soon"},
        {"iat": at + 60},
        {"jti": None},
        {"key": keys.generate(Algorithm.P256)},
        {"key": keys.generate()},
    )


def test_an_assertion_is_this_clients_for_this_server_and_just_made(viewer):
    viewer.mandate()
    for changes in bad_assertions(int(viewer.world.clock())):
        bad = viewer.assertion(**changes)
        answer = viewer.credentials(client_assertion=bad, client_assertion_type=ASSERTION_TYPE)
        assert refusal(answer) == (401, "invalid_client"), changes


def test_an_assertion_is_used_once(viewer):
    viewer.mandate()
    once = {"client_assertion": viewer.assertion(), "client_assertion_type": ASSERTION_TYPE}
    assert viewer.credentials(**once).status_code == 200
    assert refusal(viewer.credentials(**once)) == (401, "invalid_client")


def test_an_unsigned_assertion_is_none(viewer):
    at = int(viewer.world.clock())
    claims = dict(iss=viewer.client_id, sub=viewer.client_id, aud=ISSUER, exp=at + 300, jti="1")
    for bad in (jwt.encode(claims, None, algorithm="none"), jwt.encode(claims, "s" * 64, algorithm="HS256"), "x", "ä"):
        answer = viewer.credentials(client_assertion=bad, client_assertion_type=ASSERTION_TYPE)
        assert refusal(answer) == (401, "invalid_client")
    assert refusal(viewer.credentials(client_secret="s")) == (401, "invalid_client")


def test_a_clients_key_is_nobody_elses(shared, viewer):
    raw = keys.public_raw(keys.generate())
    second = StockClient(shared, "second", key=keys.generate())
    assert second.register().status_code == 201
    taken = StockClient(shared, "third", key=second.key)
    assert taken.register().json()["code"] == "KEY_IN_USE"
    shared.private["agent-9"] = second.key
    with pytest.raises(Exception, match="KEY_IN_USE"):
        shared.people["alice"].register_agent(
            "agent-9", keys.public_raw(second.key), software_digest=bytes(32).hex(), model="m", role="r", workload=""
        )
    signs = StockClient(shared, "fourth", key=shared.oauth_keys.signing)
    assert signs.register().json()["code"] == "KEY_IN_USE"
    assert raw


BAD_REDIRECTS = (
    "http://viewer.example/back",
    "https://viewer.example/back#part",
    "https://user@viewer.example/back",
    "custom:/back",
    "https://viewer.example/b ack",
    "http://localhost.evil.example/",
    "http://127.0.0.1:80evil/",
    "https:///path",
    "javascript:alert(1)",
)


def test_an_administrator_registers_clients_with_https_or_loopback_redirects(shared):
    for by in ("bob", "carol"):
        assert StockClient(shared, "by-others").register(by=by).json()["code"] == "NOT_PERMITTED"
    for uri in BAD_REDIRECTS:
        assert StockClient(shared, redirects=(uri,)).register().json()["code"] == "BODY_MALFORMED", uri


def test_every_revocation_ends_the_access_token(world):
    world.pep()
    viewer = registered(world, "viewer", key=keys.generate())
    viewer.mandate()
    for what, id_of in (
        ("token", lambda chain: chain.token_id),
        ("hop", lambda chain: chain.leaf.hop_id),
        ("audience", lambda chain: AUDIENCE),
    ):
        text = viewer.credentials().json()["access_token"]
        told = looked_at(world, text)
        world.people["alice"].revoke(what, id_of(chain_of(world, told["ztpm_capability"])), "enough")
        assert looked_at(world, text) == {"active": False}, what


def test_nobody_holds_the_key_of_a_clients_agent(shared, viewer):
    """With one it could lend on, and show the capability itself."""
    with pytest.raises(ClientError) as refused:
        shared.people["alice"].replace_key("agent", viewer.client_id, keys.public_raw(keys.generate()), reason="x")
    assert refused.value.code == "NOT_PERMITTED"


def test_a_suspended_client_has_nothing(shared, viewer):
    viewer.mandate()
    text = viewer.credentials().json()["access_token"]
    shared.people["alice"].suspend_agent(viewer.client_id, "look at it")
    assert looked_at(shared, text) == {"active": False}
    assert refusal(viewer.credentials()) == (400, "invalid_grant")


def test_a_client_gives_its_token_back_and_no_other_client_can(shared, viewer):
    viewer.mandate()
    text = viewer.credentials().json()["access_token"]
    other = registered(shared, "other-2", key=keys.generate())
    assert other.form(REVOKE, token=text).status_code == 200
    assert looked_at(shared, text)["active"] is True
    assert viewer.form(REVOKE, token="nonsense").status_code == 200
    assert viewer.form(REVOKE, token=text).status_code == 200
    assert looked_at(shared, text) == {"active": False}


def test_introspection_is_for_the_enforcement_points_of_the_audience(shared, viewer):
    viewer.mandate()
    text = viewer.credentials().json()["access_token"]
    assert looked_at(shared, text, "alice") == {"active": False}
    assert shared.anonymous().post("/oauth/introspect", content=b"token=x").status_code == 401
    header, payload, signature = text.split(".")
    for forged in (
        f"{header}.{payload}.{signature[:-4]}AAAA",
        jwt.encode(claims_of(text), keys.generate(), algorithm="EdDSA", headers=jwt.get_unverified_header(text)),
        "x" * 10_000,
        "ä",
    ):
        assert looked_at(shared, forged) == {"active": False}
    shared.clock.at_s += 601
    assert looked_at(shared, text) == {"active": False}


@pytest.mark.clause("PRF-11")
def test_a_proof_binds_the_token_to_its_key(shared):
    client = registered(shared, "bound", key=keys.generate(), dpop=keys.generate(Algorithm.P256))
    client.mandate()
    first = client.credentials()
    assert refusal(first) == (400, "use_dpop_nonce")
    client.nonce = first.headers["dpop-nonce"]
    given = client.credentials()
    assert given.json()["token_type"] == "DPoP"
    jkt = keys.thumbprint(keys.public_raw(client.dpop))
    told = looked_at(shared, given.json()["access_token"])
    assert told["cnf"] == claims_of(given.json()["access_token"])["cnf"] == {"jkt": jkt}
    assert told["token_type"] == "DPoP"
    for changes in (
        {"htm": "GET"},
        {"htu": "http://127.0.0.1:8700/ztpm/oauth/revoke"},
        {"iat": int(shared.clock()) - 60},
        {"jti": None},
        {"ath": "x"},
    ):
        assert refusal(client.credentials(proof=client.proof(**changes))) == (400, "invalid_dpop_proof")
    once = client.proof()
    assert client.credentials(proof=once).status_code == 200
    assert refusal(client.credentials(proof=once)) == (400, "invalid_dpop_proof")
    shared.clock.at_s += 301
    assert refusal(client.credentials()) == (400, "use_dpop_nonce")
    client.nonce = f"{int(shared.clock())}.{secrets.token_urlsafe(32)}"
    assert refusal(client.credentials()) == (400, "use_dpop_nonce")


@pytest.mark.clause("PRF-11")
def test_a_private_key_in_a_proof_is_refused(shared):
    client = registered(shared, "leaky", key=keys.generate(), dpop=keys.generate())
    leaky = jws.jwk(keys.public_raw(client.dpop)) | {"d": "AAAA"}
    claims = dict(htm="POST", htu=f"{ISSUER}/oauth/token", iat=int(shared.clock()), jti="1")
    proof = jwt.encode(claims, client.dpop, algorithm="EdDSA", headers={"typ": "dpop+jwt", "jwk": leaky})
    assert refusal(client.credentials(proof=proof)) == (400, "invalid_dpop_proof")


def test_metadata_is_where_clients_look(shared):
    for path in (
        "http://127.0.0.1:8700/.well-known/oauth-authorization-server/ztpm",
        f"{ISSUER}/.well-known/oauth-authorization-server",
        "http://127.0.0.1:8700/.well-known/openid-configuration/ztpm",
        f"{ISSUER}/.well-known/openid-configuration",
    ):
        answer = shared.anonymous().get(path)
        assert answer.headers["access-control-allow-origin"] == "*"
        told = answer.json()
        assert told["issuer"] == ISSUER
        assert told["code_challenge_methods_supported"] == ["S256"]
        assert told["authorization_response_iss_parameter_supported"] is True
    for name in ("oauth-authorization-server", "openid-configuration"):
        for path in ("other", "ztpm/x"):
            assert shared.anonymous().get(f"http://127.0.0.1:8700/.well-known/{name}/{path}").status_code == 404
    resource = shared.anonymous().get("http://127.0.0.1:8700/.well-known/oauth-protected-resource/ztpm").json()
    assert resource["authorization_servers"] == [ISSUER]


PLACES = (
    "/.well-known/oauth-authorization-server/ztpm",
    "/ztpm/.well-known/oauth-authorization-server",
    "/.well-known/openid-configuration/ztpm",
    "/ztpm/.well-known/openid-configuration",
    "/.well-known/oauth-protected-resource/ztpm",
    "/ztpm/.well-known/oauth-protected-resource",
    "/ztpm/oauth/jwks",
)


@pytest.mark.parametrize("path", PLACES)
def test_metadata_is_told_however_clients_ask(shared, path):
    http, url = shared.anonymous(), f"http://127.0.0.1:8700{path}"
    told, slash, head = http.get(url), http.get(f"{url}/"), http.head(url)
    assert told.status_code == slash.status_code == head.status_code == 200
    assert (told.content, slash.content, head.content) == (told.content, told.content, b"") and told.json()
    for name in told.headers.keys() - {"ztpm-request-id"}:
        assert head.headers[name] == told.headers[name]
    # What the browser asks first for a page that sends a header of MCP, as its SDK does.
    asked = {"Origin": "http://localhost:6274", "Access-Control-Request-Method": "GET"}
    before = http.options(url, headers=asked | {"Access-Control-Request-Headers": "mcp-protocol-version"})
    assert (before.status_code, before.content) == (204, b"")
    assert before.headers["access-control-allow-origin"] == before.headers["access-control-allow-headers"] == "*"
    assert before.headers["access-control-allow-methods"] == "GET, HEAD"
    assert http.post(url).status_code == http.delete(url).status_code == 405
    for nowhere in (f"{url}//", f"{url}/x", f"{url}x"):
        assert [http.request(method, nowhere).status_code for method in ("GET", "HEAD", "OPTIONS")] == [404] * 3


def test_without_a_key_there_is_no_authorization_server(world):
    world.stop()
    world.oauth_keys = None
    world.start()
    for path in ("/.well-known/oauth-authorization-server", "/oauth/jwks"):
        assert world.anonymous().get(path).json()["code"] == "PATH_UNKNOWN"
        assert world.anonymous().head(path).status_code == world.anonymous().options(path).status_code == 404
    assert world.anonymous().post("/oauth/token").json()["code"] == "PATH_UNKNOWN"


BAD_FORMS = (
    (b"grant_type=password", "unsupported_grant_type"),
    (b"", "invalid_request"),
    (b"grant_type=client_credentials&grant_type=client_credentials", "invalid_request"),
    (b"grant_type=%FF", "invalid_request"),
    ("grant_type=ä".encode(), "invalid_request"),
    (b"grant_type=client_credentials", "invalid_client"),
    (b"grant_type=client_credentials&client_id=nobody", "invalid_client"),
    (b"grant_type=client_credentials&client_id=https://viewer.example/client", "invalid_client"),
    (b"a=1&" * 40, "invalid_request"),
    (b"grant_type=" + b"x" * 70_000, "invalid_request"),
)


def test_bad_forms_are_told_in_the_words_of_oauth(shared):
    headers = {"Content-Type": "application/x-www-form-urlencoded"}
    for form, error in BAD_FORMS:
        answer = shared.anonymous().post("/oauth/token", content=form, headers=headers)
        assert refusal(answer)[1] == error, form[:60]
        assert answer.status_code in {400, 401}
    assert refusal(shared.anonymous().post("/oauth/token", json={}))[1] == "invalid_request"
