"""An OpenID provider in this process whose every answer a test can bend."""

from __future__ import annotations

import json
from urllib.parse import parse_qs, parse_qsl, urlsplit

import httpx2
from joserfc import jwt
from joserfc.jwk import ECKey, KeySet, OctKey
from joserfc.util import urlsafe_b64encode
from tests.ztpm_idp.world import ISSUER
from ztpm_idp.login.oidc import OpenIdProvider
from ztpm_idp.login_settings import LoginProvider, LoginProviderSettings

OP = "https://login.example/tenant"
KEY = ECKey.generate_key("P-256", {"kid": "one"})
OTHER_KEY = ECKey.generate_key("P-256", {"kid": "two"})
SECRET = "a-secret-of-a-client-1"


def settings(**changes) -> LoginProviderSettings:
    stated = {"name": "works", "title": "Works", "issuer": OP, "client_id": "ztpm"}
    return LoginProviderSettings(**(stated | changes))


class Fake:
    """Discovery, keys and token endpoint; the authorization endpoint is the test itself."""

    def __init__(self, world, *, secret=SECRET, **changes):
        self.world = world
        self.metadata = {
            "issuer": OP,
            "authorization_endpoint": f"{OP}/authorize",
            "token_endpoint": f"{OP}/token",
            "jwks_uri": f"{OP}/keys",
            "code_challenge_methods_supported": ["S256"],
            "authorization_response_iss_parameter_supported": True,
        }
        self.claims = {}
        self.header = {}
        self.signer, self.keys = KEY, [KEY]
        self.answer = None
        self.seen = []
        self.nonce = ""
        self.ours = OpenIdProvider(
            LoginProvider(settings(**changes), secret),
            redirect_uri=f"{ISSUER}/login/providers/works/callback",
            now=world.clock,
            transport=httpx2.MockTransport(self.answered),
        )
        world.app.state.login_providers = {"works": self.ours}

    def answered(self, request):
        path = str(request.url).removeprefix(OP)
        self.seen.append((path, dict(parse_qsl(request.content.decode())), request.headers.get("authorization")))
        if self.answer is not None and path in self.answer:
            return self.answer[path]
        match path:
            case "/.well-known/openid-configuration":
                return httpx2.Response(200, json=self.metadata)
            case "/keys":
                return httpx2.Response(200, json=KeySet(self.keys).as_dict())
            case "/token":
                body = {"access_token": "x", "token_type": "Bearer", "id_token": self.id_token()}
                return httpx2.Response(200, json=body)
        return httpx2.Response(404)

    def id_token(self):
        now = int(self.world.clock())
        claims = {
            "iss": OP,
            "sub": "b-17",
            "aud": "ztpm",
            "exp": now + 300,
            "iat": now,
            "nonce": self.nonce,
            "auth_time": now - 5,
        }
        claims = {name: value for name, value in (claims | self.claims).items() if value is not None}
        header = {"alg": "ES256", "kid": self.signer.kid} | self.header
        if header["alg"] == "none":
            parts = (urlsafe_b64encode(json.dumps(each).encode()).decode() for each in (header, claims))
            return ".".join([*parts, ""])
        key = OctKey.import_key(SECRET * 2) if header["alg"] == "HS256" else self.signer
        return jwt.encode(header, claims, key, algorithms=[header["alg"]])

    def log_in(self, browser, *, fresh_s=None, **changed):
        """Goes through the whole login in this browser; the answer of our callback."""
        browser.get("/ztpm/login" + ("" if fresh_s is None else f"?fresh_s={fresh_s}"))
        shown = browser.post("/ztpm/login/providers/works", {"fresh_s": "" if fresh_s is None else str(fresh_s)})
        assert shown.status_code == 200, shown.text
        self.asked = self.read_leave(shown.text)
        self.nonce = self.asked["nonce"]
        answer = {"code": "c", "state": self.asked["state"], "iss": OP} | changed
        return self.come_back(browser, {name: value for name, value in answer.items() if value is not None})

    @staticmethod
    def read_leave(text):
        url = text.split('content="0; url=', 1)[1].split('"', 1)[0].replace("&amp;", "&")
        return {name: values[0] for name, values in parse_qs(urlsplit(url).query).items()}

    @staticmethod
    def come_back(browser, answer):
        return browser.get("/ztpm/login/providers/works/callback?" + str(httpx2.QueryParams(answer)))
