"""DPoP around a provider of the MCP SDK: at the certified `oidc-provider`, and at servers that ask oddly."""

from __future__ import annotations

import asyncio
import re
import shutil
import subprocess
from html import unescape
from pathlib import Path
from urllib.parse import parse_qs, urljoin, urlsplit

import httpx2
import jwt
import pytest
from capabilities.keys.keys import Algorithm
from mcp.client.auth import AuthorizationCodeResult, OAuthClientProvider, OAuthTokenError
from mcp.client.auth.extensions.client_credentials import ClientCredentialsOAuthProvider
from mcp.shared.auth import OAuthClientInformationFull, OAuthClientMetadata, OAuthToken
from starlette.applications import Starlette
from starlette.responses import JSONResponse, RedirectResponse, Response
from starlette.routing import Route
from tests.node_packages import installed, node
from tests.e2e.routed import Memory

from capabilities.keys import keys
from ztpm_idp.client import DPoPAuth
from ztpm_idp.client.dpop_auth import NONCES

OIDC = Path(__file__).parents[1] / "login" / "oidc_provider"
REDIRECT = "http://127.0.0.1/back"
FORM_ACTION = re.compile(r'<form[^>]* action="([^"]+)"')
PROMPT = re.compile(r'name="prompt" value="(\w+)"')


class Browser:
    """A person's browser at the pages of `oidc-provider`: logs in, and allows."""

    pages = 0

    async def open(self, url):
        async with httpx2.AsyncClient() as http:
            shown = await http.get(url)
            while True:
                if shown.is_redirect:
                    url = urljoin(url, shown.headers["location"])
                    if url.startswith(REDIRECT):
                        self.back = url
                        return
                    shown = await http.get(url)
                    continue
                self.pages += 1
                url = urljoin(url, unescape(FORM_ACTION.search(shown.text)[1]))
                fields = {"prompt": PROMPT.search(shown.text)[1], "login": "alice", "password": "any"}
                shown = await http.post(url, data=fields)

    async def come_back(self):
        told = {name: values[0] for name, values in parse_qs(urlsplit(self.back).query).items()}
        return AuthorizationCodeResult(code=told["code"], state=told["state"], iss=told.get("iss"))


@pytest.fixture(scope="module")
def certified():
    """The certified provider's issuer."""
    kept = installed(OIDC)
    shutil.copy(OIDC / "dpop_server.mjs", kept / "dpop_server.mjs")
    with subprocess.Popen(
        [node(), "dpop_server.mjs", REDIRECT], cwd=kept, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True
    ) as running:
        for line in running.stdout:
            if line.startswith("http://127.0.0.1:"):
                yield line.strip()
                break
        running.kill()


@pytest.mark.e2e
@pytest.mark.parametrize("algorithm", Algorithm)
def test_the_certified_provider_takes_proofs_with_its_nonces(certified, algorithm):
    seen = []

    async def note(response):
        seen.append((urlsplit(str(response.request.url)).path, response.status_code))

    key, browser = keys.generate(algorithm), Browser()
    memory = Memory(
        OAuthClientInformationFull(
            client_id="viewer", redirect_uris=[REDIRECT], token_endpoint_auth_method="none", issuer=certified
        )
    )
    memory.tokens = OAuthToken(access_token="of-an-earlier-time")
    metadata = OAuthClientMetadata(redirect_uris=[REDIRECT], token_endpoint_auth_method="none", client_name="viewer")
    provider = OAuthClientProvider(f"{certified}/me", metadata, memory, browser.open, browser.come_back)

    async def work():
        async with httpx2.AsyncClient(auth=DPoPAuth(provider, key), event_hooks={"response": [note]}) as http:
            told = await http.get(f"{certified}/me")
            assert (told.status_code, told.json()) == (200, {"sub": "alice"})
            assert (await http.get(f"{certified}/me")).json() == {"sub": "alice"}
            first, provider.context.token_expiry_time = memory.tokens.access_token, 1.0
            assert (await http.get(f"{certified}/me")).json() == {"sub": "alice"}
            assert memory.tokens.access_token != first
        async with httpx2.AsyncClient() as http:
            stolen = await http.get(
                f"{certified}/me", headers={"Authorization": f"Bearer {memory.tokens.access_token}"}
            )
            assert stolen.status_code == 401

    asyncio.run(work())
    assert browser.pages == 2
    # Refused for want of a nonce once at each of the two; each later nonce came with the answer before.
    assert seen == [
        ("/me", 401), ("/me", 401), ("/.well-known/oauth-protected-resource/me", 200),
        ("/.well-known/oauth-authorization-server", 200), ("/token", 400), ("/token", 200), ("/me", 200), ("/me", 200),
        ("/token", 200), ("/me", 200),
    ]  # fmt: skip


class Odd:
    """Authorization server and resource of one origin or many, which answer as a test says.

    Attributes:
        token, resource: answer to a request with these claims of its proof, or None without one.
        seen: path, scheme of the authorization, and claims of the proof of each such request.
    """

    def __init__(self):
        self.seen = []
        self.kind, self.access_token = "DPoP", "opaque"
        self.resource = lambda claims: Response(status_code=200 if claims else 401)
        self.token = lambda claims: JSONResponse({"access_token": self.access_token, "token_type": self.kind})
        paths = {
            "/.well-known/oauth-protected-resource/mcp": self.protected,
            "/.well-known/oauth-authorization-server": self.described,
            "/token": self.asked,
            "/moved": self.asked,
            "/mcp": self.used,
        }
        self.app = Starlette(routes=[Route(path, end, methods=["GET", "POST"]) for path, end in paths.items()])

    def origin(self, request):
        assert "dpop" not in request.headers, "proofs are for tokens"
        return f"{request.url.scheme}://{request.url.netloc}"

    async def protected(self, request):
        origin = self.origin(request)
        return JSONResponse({"resource": f"{origin}/mcp", "authorization_servers": [origin]})

    async def described(self, request):
        origin = self.origin(request)
        return JSONResponse(
            {"issuer": origin, "token_endpoint": f"{origin}/token", "authorization_endpoint": f"{origin}/authorize"}
            | {"response_types_supported": ["code"], "grant_types_supported": ["client_credentials"]}
        )

    def claims(self, request):
        proof = request.headers.get("dpop")
        claims = None if proof is None else jwt.decode(proof, options={"verify_signature": False})
        scheme = request.headers.get("authorization", "").partition(" ")[0]
        self.seen.append((request.url.path, scheme, claims and claims.get("nonce")))
        return claims

    async def asked(self, request):
        return self.token(self.claims(request))

    async def used(self, request):
        return self.resource(self.claims(request))

    def auth(self, origin="http://odd.test", **options):
        inner = ClientCredentialsOAuthProvider(f"{origin}/mcp", Memory(), "viewer", "secret", issuer=origin)
        return DPoPAuth(inner, keys.generate(), **options)

    def get(self, auth, *urls):
        """Status of each request in turn."""

        async def work():
            async with httpx2.AsyncClient(transport=httpx2.ASGITransport(app=self.app), auth=auth) as http:
                return [(await http.get(url)).status_code for url in urls]

        return asyncio.run(work())


def wants(nonce, *, status, how):
    """Refusal that asks for a nonce."""
    told = {"DPoP-Nonce": nonce, "WWW-Authenticate": f'DPoP error="{how}"'}
    return JSONResponse({"error": how}, status_code=status, headers=told)


def test_a_request_is_sent_again_once_however_often_a_nonce_is_asked_for():
    odd, given = Odd(), iter(range(100))
    odd.token = lambda claims: wants(f"n{next(given)}", status=400, how="use_dpop_nonce")
    with pytest.raises(OAuthTokenError):
        odd.get(odd.auth(), "http://odd.test/mcp")
    assert [each for each in odd.seen if each[0] == "/token"] == [("/token", "Basic", None), ("/token", "Basic", "n0")]
    odd, given = Odd(), iter(range(100))
    odd.resource = lambda claims: wants(f"n{next(given)}", status=401, how="use_dpop_nonce")
    assert odd.get(odd.auth(), "http://odd.test/mcp") == [401]
    # Without a token, with one, and again with the nonce that was asked for.
    used = [each for each in odd.seen if each[0] == "/mcp"]
    assert used == [("/mcp", "", None), ("/mcp", "DPoP", "n0"), ("/mcp", "DPoP", "n1")]


def test_a_nonce_that_was_sent_and_is_asked_for_again_is_sent_no_more():
    odd = Odd()
    odd.resource = lambda claims: wants("n", status=401, how="use_dpop_nonce")
    odd.token = lambda claims: JSONResponse({"access_token": "opaque", "token_type": "DPoP"})
    assert odd.get(odd.auth(), "http://odd.test/mcp") == [401]
    assert [each for each in odd.seen if each[0] == "/mcp"] == [("/mcp", "", None), ("/mcp", "DPoP", "n")]


@pytest.mark.parametrize("nonce", ['a"b', "a b", "", "x" * 257, "a\\b", "\u00e9"])
def test_a_nonce_of_another_form_is_none(nonce):
    odd = Odd()
    odd.token = lambda claims: wants(nonce, status=400, how="use_dpop_nonce")
    with pytest.raises(OAuthTokenError):
        odd.get(odd.auth(), "http://odd.test/mcp")
    assert [each for each in odd.seen if each[0] == "/token"] == [("/token", "Basic", None)]


def test_another_refusal_is_not_answered_with_its_nonce_at_once():
    odd = Odd()
    odd.token = lambda claims: wants("n", status=400, how="invalid_grant")
    with pytest.raises(OAuthTokenError):
        odd.get(odd.auth(), "http://odd.test/mcp")
    odd.token = Odd().token
    given = iter(range(100))
    odd.resource = lambda claims: wants(f"n{next(given)}", status=401, how="invalid_token")
    assert odd.get(odd.auth(), "http://odd.test/mcp") == [401]
    assert [each[0] for each in odd.seen] == ["/mcp", "/token", "/mcp", "/token", "/mcp"]


def test_nonces_of_both_sides_of_one_origin_are_kept_apart():
    odd = Odd()
    odd.token = lambda claims: (
        JSONResponse({"access_token": "opaque", "token_type": "DPoP", "expires_in": 1}, headers={"DPoP-Nonce": "t2"})
        if "nonce" in claims
        else wants("t1", status=400, how="use_dpop_nonce")
    )
    odd.resource = lambda claims: (
        Response(headers={"DPoP-Nonce": "r2"}) if claims and "nonce" in claims
        else wants("r1", status=401, how="use_dpop_nonce")
    )  # fmt: skip
    auth = odd.auth()
    assert odd.get(auth, "http://odd.test/mcp", "http://odd.test/mcp") == [200, 200]
    assert odd.seen == [
        ("/mcp", "", None), ("/token", "Basic", None), ("/token", "Basic", "t1"), ("/mcp", "DPoP", "r1"),
        ("/mcp", "DPoP", "r2"),
    ]  # fmt: skip


def test_a_token_that_is_given_as_bearer_stays_one():
    odd = Odd()
    odd.kind = "bearer"
    odd.resource = lambda claims: Response(status_code=200 if odd.seen[-1][1] else 401)
    assert odd.get(odd.auth(), "http://odd.test/mcp", "http://odd.test/mcp") == [200, 200]
    assert [each for each in odd.seen if each[0] == "/mcp"] == [
        ("/mcp", "", None), ("/mcp", "Bearer", None), ("/mcp", "Bearer", None),
    ]  # fmt: skip


def test_a_bearer_token_in_place_of_a_bound_one_has_no_proof_beside_it():
    odd, kinds, answers = Odd(), iter(["DPoP", "Bearer"]), iter([200, 401, 200])
    proofs = []
    odd.token = lambda claims: JSONResponse({"access_token": f"t{len(odd.seen)}", "token_type": next(kinds)})
    odd.resource = lambda claims: (
        proofs.append(claims is not None) or Response(status_code=401 if len(proofs) == 1 else next(answers))
    )
    assert odd.get(odd.auth(), "http://odd.test/mcp", "http://odd.test/mcp") == [200, 200]
    assert [each[1] for each in odd.seen if each[0] == "/mcp"] == ["", "DPoP", "DPoP", "Bearer"]
    assert proofs == [False, True, True, False]


@pytest.mark.parametrize(("named", "scheme"), [("own", "DPoP"), ("another", "Bearer"), (None, "Bearer")])
def test_a_stored_token_is_taken_for_what_it_says(named, scheme):
    odd, auth = Odd(), Odd().auth()
    jkt = {"own": keys.thumbprint(keys.public_raw(auth._key)), "another": "x"}.get(named)
    claims = {} if jkt is None else {"cnf": {"jkt": jkt}}
    stored = jwt.encode(claims, keys.generate(), algorithm="EdDSA")
    auth._inner.context.storage.tokens = OAuthToken(access_token=stored)
    odd.resource = lambda claims: Response()
    assert odd.get(auth, "http://odd.test/mcp") == [200]
    assert [each[1] for each in odd.seen] == [scheme]


def test_the_proof_names_the_address_alone_also_after_a_redirect():
    odd, proofs = Odd(), []

    def noted(answer):
        return lambda claims: proofs.append(claims and claims["htu"]) or answer(claims)

    moved, told = [RedirectResponse("http://odd.test/moved", 307)], odd.token
    odd.token, odd.resource = noted(lambda claims: moved.pop() if moved else told(claims)), noted(odd.resource)
    assert odd.get(odd.auth(), "http://user:word@odd.test/mcp?tool=stop#part") == [200]
    assert proofs == [None, "http://odd.test/token", "http://odd.test/moved", "http://odd.test/mcp"]


def test_the_nonces_of_so_many_origins_are_kept():
    odd = Odd()
    odd.resource = lambda claims: Response(headers={"DPoP-Nonce": "n"})
    inner = ClientCredentialsOAuthProvider("http://a0.test/mcp", Memory(), "viewer", "secret", issuer="http://a0.test")
    inner.context.storage.tokens = OAuthToken(access_token="opaque")
    auth = DPoPAuth(inner, keys.generate())
    urls = [f"http://a{each}.test/mcp" for each in range(NONCES + 1)]
    odd.get(auth, *urls[:-1], urls[0], urls[-1], urls[0], urls[1])
    # Of the first there was word lately; the second is forgotten.
    assert [each[2] for each in odd.seen] == [None] * NONCES + ["n", None, "n", None]


def test_a_client_that_blocks_sends_nothing():
    odd = Odd()
    with httpx2.Client(auth=odd.auth()) as http, pytest.raises(RuntimeError):
        http.get("http://odd.test/mcp")
