"""A stock client's side of OAuth: forms, assertions, plain DPoP proofs, in few words."""

from __future__ import annotations

import base64
import hashlib
import json
import secrets
from dataclasses import dataclass, field
from urllib.parse import urlencode

import httpx2
import jwt
from capabilities.keys import jws, keys
from capabilities.values.scope import Grant, Limit, Range, Tier
from capabilities.values.scope_json import restriction_to_json, Restriction
from capabilities.values.units import Parameter, Unit
from tests.ztpm_idp.world import AUDIENCE, ISSUER
from ztpm_idp.oauth.client_auth import ASSERTION_TYPE

TOKEN, REVOKE, INTROSPECT = (f"{ISSUER}/oauth/{each}" for each in ("token", "revoke", "introspect"))
WEEK_S = 7 * 86_400
READ = (Grant("camera", "read", (Limit(Parameter("width", Unit.COUNT), Range(1, 640)),)),)
WIPE = (Grant("camera", "wipe"),)


def limits(grants=READ, ceiling=1) -> dict:
    return restriction_to_json(Restriction(grants=grants, ceiling=Tier(ceiling)))


def declare(world, name="camera.read", grants=READ, *, ceiling=1, audience=AUDIENCE, by="alice"):
    body = {"words": f"use {name}", "audience": audience, **limits(grants, ceiling)}
    return world.known(by).post(f"/oauth/scopes/{name}", json=body)


@dataclass
class StockClient:
    """Client that is registered, with the key of `private_key_jwt` or without one, and perhaps a DPoP key."""

    world: object
    client_id: str = "viewer"
    key: object = None
    dpop: object = None
    nonce: str | None = None
    redirects: tuple = ("https://viewer.example/back", "http://127.0.0.1/back")
    proofs: dict = field(default_factory=dict)

    def register(self, by="alice", sponsor="alice"):
        body = {
            "client_id": self.client_id,
            "name": "The viewer",
            "sponsor": sponsor,
            "redirect_uris": list(self.redirects),
        }
        if self.key is not None:
            body["key"] = keys.b64u(keys.public_raw(self.key))
        return self.world.known(by).post("/oauth/clients", json=body)

    def mandate(self, grants=READ, *, by="alice", ceiling=1, audiences=frozenset({AUDIENCE})) -> str:
        until = int(self.world.clock()) + WEEK_S
        scope = self.world.scope(
            grants=grants, ceiling=Tier(ceiling), audiences=audiences, delegates=frozenset(), depth=0, not_after=until
        )
        return self.world.people[by].sign_mandate(self.client_id, scope, purpose="look after the hall")

    def assertion(self, *, key=None, **changes) -> str:
        at, key = int(self.world.clock()), key or self.key
        claims = dict(
            iss=self.client_id, sub=self.client_id, aud=ISSUER, exp=at + 300, iat=at, jti=secrets.token_hex(8)
        )
        algorithm = jws.algorithm_name(keys.public_raw(key))
        return jwt.encode({k: v for k, v in (claims | changes).items() if v is not None}, key, algorithm=algorithm)

    def proof(self, url=TOKEN, method="POST", *, token=None, **changes) -> str:
        raw = keys.public_raw(self.dpop)
        claims = dict(htm=method, htu=url, iat=int(self.world.clock()), jti=secrets.token_hex(8))
        if self.nonce is not None:
            claims["nonce"] = self.nonce
        if token is not None:
            claims["ath"] = keys.b64u(hashlib.sha256(token.encode()).digest())
        headers = {"typ": "dpop+jwt", "jwk": jws.jwk(raw)}
        return jwt.encode(claims | changes, self.dpop, algorithm=jws.algorithm_name(raw), headers=headers)

    def form(self, url=TOKEN, *, proof=None, **form) -> httpx2.Response:
        if self.key is not None and "client_assertion" not in form:
            form |= {"client_assertion": self.assertion(), "client_assertion_type": ASSERTION_TYPE}
        elif self.key is None:
            form.setdefault("client_id", self.client_id)
        headers = {"Content-Type": "application/x-www-form-urlencoded"}
        if proof is not None or (self.dpop is not None and url == TOKEN):
            headers["DPoP"] = proof or self.proof(url)
        content = urlencode({name: value for name, value in form.items() if value is not None}).encode()
        return self.world.anonymous().post(url, content=content, headers=headers)

    def credentials(self, **form) -> httpx2.Response:
        return self.form(**({"grant_type": "client_credentials", "resource": AUDIENCE} | form))


def claims_of(text: str) -> dict:
    return json.loads(base64.urlsafe_b64decode(text.split(".")[1] + "=="))


def looked_at(world, token, pep="cell-1") -> dict:
    """The answer of introspection to an enforcement point."""
    headers = {"Content-Type": "application/x-www-form-urlencoded"}
    answer = world.known(pep).post("/oauth/introspect", content=urlencode({"token": token}).encode(), headers=headers)
    assert answer.status_code == 200, answer.text
    return answer.json()


def refusal(answer: httpx2.Response) -> tuple[int, str]:
    assert answer.headers["cache-control"] == "no-store"
    return answer.status_code, answer.json()["error"]
