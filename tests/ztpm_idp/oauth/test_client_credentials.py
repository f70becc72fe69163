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
from tests.ztpm_idp.world import AUDIENCE, ISSUER, START_S

from capabilities.keys.keys import Algorithm
from ztpm_idp.oauth.client_auth import ASSERTION_TYPE

OTHER = "http://127.0.0.1:8801/mcp"


@pytest.fixture
def viewer(world):
    client = StockClient(world, key=keys.generate(Algorithm.P256))
    assert client.register().status_code == 201
    world.pep()
    return client


def test_a_token_is_rooted_in_the_person_who_signed_the_mandate(world, viewer):
    mandate_id = viewer.mandate(ceiling=3)
    given = viewer.credentials()
    assert given.status_code == 200
    assert given.headers["cache-control"] == "no-store"
    body = given.json()
    assert (body["token_type"], body["expires_in"]) == ("Bearer", 600)
    header = jwt.get_unverified_header(body["access_token"])
    (known,) = world.anonymous().get("/oauth/jwks").json()["keys"]
    assert (header["typ"], header["kid"]) == ("at+jwt", known["kid"])
    key = jwt.PyJWK(known).key
    claims = jwt.decode(
        body["access_token"], key, algorithms=["EdDSA"], audience=AUDIENCE, issuer=ISSUER,
        options={"verify_exp": False, "verify_iat": False},
    )  # fmt: skip
    assert (claims["sub"], claims["client_id"], claims["act"]) == ("alice", "viewer", {"sub": "viewer"})
    assert claims["exp"] - claims["iat"] == 600

    told = looked_at(world, body["access_token"])
    assert told["active"] is True
    chain = chain_of(world, told["ztpm_capability"])
    assert (chain.leaf.hop_id, chain.leaf.agent, chain.sponsor.subject) == (claims["jti"], "viewer", "alice")
    assert chain.mandate_id == mandate_id
    assert chain.leaf.attestation.kind is EvidenceKind.CLIENT
    assert (chain.scope.ceiling, chain.scope.audiences, chain.scope.depth) == (Tier(1), {AUDIENCE}, 0)
    kinds = [entry for entry in world.people["alice"].export_ledger().splitlines() if b"oauth-access-made" in entry]
    assert len(kinds) == 1 and b'"viewer"' in kinds[0] and b'"alice"' in kinds[0]
    assert told["ztpm_capability"].encode() not in world.people["alice"].export_ledger()


def test_without_a_mandate_that_names_the_client_there_is_no_token(world, viewer):
    assert refusal(viewer.credentials()) == (400, "unauthorized_client")
    other = StockClient(world, "other", key=keys.generate())
    other.register()
    other.mandate()
    assert refusal(viewer.credentials()) == (400, "unauthorized_client")
    mandate_id = viewer.mandate()
    assert viewer.credentials().status_code == 200
    world.people["alice"].revoke("mandate", mandate_id, "enough")
    assert refusal(viewer.credentials()) == (400, "unauthorized_client")


def test_a_public_client_has_no_credentials_to_draw_with(world):
    client = StockClient(world)
    client.register()
    client.mandate()
    assert refusal(client.credentials()) == (400, "unauthorized_client")


def test_scopes_narrow_what_the_mandate_holds(world, viewer):
    assert declare(world).status_code == declare(world, "camera.wipe", WIPE).status_code == 200
    viewer.mandate(grants=(Grant("camera", "pan"), *READ))
    given = viewer.credentials(scope="camera.read").json()
    assert given["scope"] == claims_of(given["access_token"])["scope"] == "camera.read"
    chain = chain_of(world, looked_at(world, given["access_token"])["ztpm_capability"])
    assert chain.scope.grants == READ
    assert refusal(viewer.credentials(scope="camera.wipe")) == (400, "invalid_scope")
    assert refusal(viewer.credentials(scope="camera.read camera.wipe")) == (400, "invalid_scope")
    assert refusal(viewer.credentials(scope="no.such")) == (400, "invalid_scope")
    assert refusal(viewer.credentials(scope='"')) == (400, "invalid_scope")


def test_a_token_serves_one_audience(world, viewer):
    viewer.mandate(audiences=frozenset({AUDIENCE, OTHER}))
    assert refusal(viewer.credentials(resource=None)) == (400, "invalid_target")
    assert refusal(viewer.credentials(resource="http://127.0.0.1:9/mcp")) == (400, "unauthorized_client")
    given = viewer.credentials(resource=OTHER).json()
    assert claims_of(given["access_token"])["aud"] == OTHER
    # The enforcement point of another audience learns nothing of it.
    assert looked_at(world, given["access_token"]) == {"active": False}
    twice = world.anonymous().post(
        "/oauth/token",
        content=b"grant_type=client_credentials&resource=a&resource=b",
        headers={"Content-Type": "application/x-www-form-urlencoded"},
    )
    assert refusal(twice) == (400, "invalid_target")


def test_so_many_are_live_at_once_and_no_more(world, viewer):
    viewer.mandate()
    assert [viewer.credentials().status_code for _ in range(9)] == [200] * 8 + [429]
    world.clock.at_s = START_S + 601
    assert viewer.credentials().status_code == 200


BAD_ASSERTIONS = (
    {"iss": "other"},
    {"sub": "other"},
    {"aud": "https://elsewhere.example"},
    {"aud": [ISSUER, "https://elsewhere.example"]},
    {"aud": None},
    {"exp": START_S - 60},
    {"exp": START_S + 3_600},
    {"exp": None},
    {"exp": "soon"},
    {"iat": START_S + 60},
    {"jti": None},
    {"key": keys.generate(Algorithm.P256)},
    {"key": keys.generate()},
)


def test_an_assertion_is_this_clients_for_this_server_and_just_made(viewer):
    viewer.mandate()
    for changes in BAD_ASSERTIONS:
        bad = viewer.assertion(**changes)
        answer = viewer.credentials(client_assertion=bad, client_assertion_type=ASSERTION_TYPE)
        assert refusal(answer) == (401, "invalid_client"), changes


def test_an_assertion_is_used_once(viewer):
    viewer.mandate()
    once = {"client_assertion": viewer.assertion(), "client_assertion_type": ASSERTION_TYPE}
    assert viewer.credentials(**once).status_code == 200
    assert refusal(viewer.credentials(**once)) == (401, "invalid_client")


def test_an_unsigned_assertion_is_none(viewer):
    at = int(START_S)
    claims = dict(iss="viewer", sub="viewer", aud=ISSUER, exp=at + 300, jti="1")
    for bad in (jwt.encode(claims, None, algorithm="none"), jwt.encode(claims, "s" * 64, algorithm="HS256"), "x", "ä"):
        answer = viewer.credentials(client_assertion=bad, client_assertion_type=ASSERTION_TYPE)
        assert refusal(answer) == (401, "invalid_client")
    assert refusal(viewer.credentials(client_secret="s")) == (401, "invalid_client")


def test_a_clients_key_is_nobody_elses(world, viewer):
    raw = keys.public_raw(keys.generate())
    second = StockClient(world, "second", key=keys.generate())
    assert second.register().status_code == 201
    taken = StockClient(world, "third", key=second.key)
    assert taken.register().json()["code"] == "KEY_IN_USE"
    world.private["agent-9"] = second.key
    with pytest.raises(Exception, match="KEY_IN_USE"):
        world.people["alice"].register_agent(
            "agent-9", keys.public_raw(second.key), software_digest=bytes(32).hex(), model="m", role="r", workload=""
        )
    signs = StockClient(world, "fourth", key=world.oauth_keys.signing)
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


def test_an_administrator_registers_clients_with_https_or_loopback_redirects(world):
    for by in ("bob", "carol"):
        assert StockClient(world).register(by=by).json()["code"] == "NOT_PERMITTED"
    for uri in BAD_REDIRECTS:
        assert StockClient(world, redirects=(uri,)).register().json()["code"] == "BODY_MALFORMED", uri


def test_every_revocation_ends_the_access_token(world, viewer):
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


def test_a_suspended_client_has_nothing(world, viewer):
    viewer.mandate()
    text = viewer.credentials().json()["access_token"]
    world.people["alice"].suspend_agent("viewer", "look at it")
    assert looked_at(world, text) == {"active": False}
    assert refusal(viewer.credentials()) == (400, "invalid_grant")


def test_a_client_gives_its_token_back_and_no_other_client_can(world, viewer):
    viewer.mandate()
    text = viewer.credentials().json()["access_token"]
    other = StockClient(world, "other", key=keys.generate())
    other.register()
    assert other.form(REVOKE, token=text).status_code == 200
    assert looked_at(world, text)["active"] is True
    assert viewer.form(REVOKE, token="nonsense").status_code == 200
    assert viewer.form(REVOKE, token=text).status_code == 200
    assert looked_at(world, text) == {"active": False}


def test_introspection_is_for_the_enforcement_points_of_the_audience(world, viewer):
    viewer.mandate()
    text = viewer.credentials().json()["access_token"]
    assert looked_at(world, text, "alice") == {"active": False}
    assert world.anonymous().post("/oauth/introspect", content=b"token=x").status_code == 401
    header, payload, signature = text.split(".")
    for forged in (
        f"{header}.{payload}.{signature[:-4]}AAAA",
        jwt.encode(claims_of(text), keys.generate(), algorithm="EdDSA", headers=jwt.get_unverified_header(text)),
        "x" * 10_000,
        "ä",
    ):
        assert looked_at(world, forged) == {"active": False}
    world.clock.at_s = START_S + 601
    assert looked_at(world, text) == {"active": False}


@pytest.mark.clause("PRF-11")
def test_a_proof_binds_the_token_to_its_key(world):
    client = StockClient(world, key=keys.generate(), dpop=keys.generate(Algorithm.P256))
    client.register()
    world.pep()
    client.mandate()
    first = client.credentials()
    assert refusal(first) == (400, "use_dpop_nonce")
    client.nonce = first.headers["dpop-nonce"]
    given = client.credentials()
    assert given.json()["token_type"] == "DPoP"
    jkt = keys.thumbprint(keys.public_raw(client.dpop))
    told = looked_at(world, given.json()["access_token"])
    assert told["cnf"] == claims_of(given.json()["access_token"])["cnf"] == {"jkt": jkt}
    assert told["token_type"] == "DPoP"
    for changes in (
        {"htm": "GET"},
        {"htu": "http://127.0.0.1:8700/ztpm/oauth/revoke"},
        {"iat": int(START_S) - 60},
        {"jti": None},
        {"ath": "x"},
    ):
        assert refusal(client.credentials(proof=client.proof(**changes))) == (400, "invalid_dpop_proof")
    once = client.proof()
    assert client.credentials(proof=once).status_code == 200
    assert refusal(client.credentials(proof=once)) == (400, "invalid_dpop_proof")
    world.clock.at_s = START_S + 301
    assert refusal(client.credentials()) == (400, "use_dpop_nonce")
    client.nonce = f"{int(START_S) + 301}.{secrets.token_urlsafe(32)}"
    assert refusal(client.credentials()) == (400, "use_dpop_nonce")


@pytest.mark.clause("PRF-11")
def test_a_private_key_in_a_proof_is_refused(world):
    client = StockClient(world, key=keys.generate(), dpop=keys.generate())
    client.register()
    leaky = jws.jwk(keys.public_raw(client.dpop)) | {"d": "AAAA"}
    claims = dict(htm="POST", htu=f"{ISSUER}/oauth/token", iat=int(START_S), jti="1")
    proof = jwt.encode(claims, client.dpop, algorithm="EdDSA", headers={"typ": "dpop+jwt", "jwk": leaky})
    assert refusal(client.credentials(proof=proof)) == (400, "invalid_dpop_proof")


def test_metadata_is_where_clients_look(world):
    for path in (
        "http://127.0.0.1:8700/.well-known/oauth-authorization-server/ztpm",
        f"{ISSUER}/.well-known/oauth-authorization-server",
    ):
        answer = world.anonymous().get(path)
        assert answer.headers["access-control-allow-origin"] == "*"
        told = answer.json()
        assert told["issuer"] == ISSUER
        assert told["code_challenge_methods_supported"] == ["S256"]
        assert told["authorization_response_iss_parameter_supported"] is True
    assert (
        world.anonymous().get("http://127.0.0.1:8700/.well-known/oauth-authorization-server/other").status_code == 404
    )
    resource = world.anonymous().get("http://127.0.0.1:8700/.well-known/oauth-protected-resource/ztpm").json()
    assert resource["authorization_servers"] == [ISSUER]


def test_without_a_key_there_is_no_authorization_server(world):
    world.stop()
    world.oauth_keys = None
    world.start()
    for path in ("/.well-known/oauth-authorization-server", "/oauth/jwks"):
        assert world.anonymous().get(path).json()["code"] == "PATH_UNKNOWN"
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


def test_bad_forms_are_told_in_the_words_of_oauth(world):
    headers = {"Content-Type": "application/x-www-form-urlencoded"}
    for form, error in BAD_FORMS:
        answer = world.anonymous().post("/oauth/token", content=form, headers=headers)
        assert refusal(answer)[1] == error, form[:60]
        assert answer.status_code in {400, 401}
    assert refusal(world.anonymous().post("/oauth/token", json={}))[1] == "invalid_request"
