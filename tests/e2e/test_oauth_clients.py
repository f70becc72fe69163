"""Stock OAuth clients of the MCP SDK, from 401 to a call of a guarded tool."""

from __future__ import annotations

import asyncio
import json
from urllib.parse import parse_qs, urlsplit

import httpx2
import pytest
from capabilities.keys.keys import Algorithm
from mcp.client.auth import AuthorizationCodeResult, OAuthClientProvider, OAuthTokenError
from mcp.shared.auth import OAuthClientInformationFull, OAuthClientMetadata
from pep.mcp.guard import DECISION_META
from tests.e2e.routed import CALLED, GRANTS, Memory, Plant, by_credentials
from tests.ztpm_idp.login.browser import Browser
from tests.ztpm_idp.oauth.speaking import StockClient, claims_of, declare
from tests.ztpm_idp.oauth.test_code_flow import AUTHORIZE, HIDDEN
from tests.ztpm_idp.world import AUDIENCE, ISSUER

from capabilities.keys import keys
from ztpm_idp.client import DPoPAuth

pytestmark = [pytest.mark.e2e, pytest.mark.clause("OAT-1", "OAT-2", "OAT-3", "OAT-4", "OAT-5")]


@pytest.fixture
def plant(tmp_path, monkeypatch):
    with Plant(tmp_path, monkeypatch) as made:
        yield made


def by_mandate(client, memory):
    return by_credentials(client.client_id, client.key, memory, url=AUDIENCE, issuer=ISSUER)


def decision(answer):
    return answer.meta[DECISION_META]["decision"], answer.meta[DECISION_META]["reason"]


def test_a_program_with_a_mandate_goes_from_401_to_a_call(plant):
    world, memory = plant.world, Memory()
    stock = StockClient(world, key=keys.generate(Algorithm.P256))
    assert stock.register().status_code == 201
    mandate_id = stock.mandate(grants=GRANTS, ceiling=3)

    async def work():
        async with plant.client(by_mandate(stock, memory)) as client:
            first = await client.call_tool("read", {"width": 320})
            assert decision(first) == ("PERMIT", "PERMITTED")
            # Beyond the mandate, and above tier 1 whatever the mandate holds.
            assert decision(await client.call_tool("read", {"width": 641}))[0] == "DENY"
            assert decision(await client.call_tool("wipe", {"width": 1})) == ("DENY", "ABOVE_CEILING")
            asked = [each for each in plant.transport.seen if each[2].endswith("introspect")]
            assert len(asked) == 1
            await asyncio.to_thread(world.people["alice"].revoke, "mandate", mandate_id, "enough")
            # The client is told 401 within the lease, asks for a token, and is told that no mandate names it.
            async with asyncio.timeout(10):
                while True:
                    told = decision(await client.call_tool("read", {"width": 320}))
                    # Denied, not 401, only where the revocation is heard between the door and the gate.
                    assert told in {("PERMIT", "PERMITTED"), ("DENY", "REVOKED")}

    # The SDK's own connection ends with that error.
    with pytest.raises(ExceptionGroup) as ended:
        plant.run(work())
    refused = ended.value.split(OAuthTokenError)
    assert refused[1] is None
    assert "unauthorized_client" in str(refused[0].exceptions)
    assert ("POST", 8800, "/mcp", 401) in plant.transport.seen
    assert ("GET", 8800, "/.well-known/oauth-protected-resource/mcp", 200) in plant.transport.seen
    assert ("GET", 8700, "/.well-known/oauth-authorization-server/ztpm", 200) in plant.transport.seen
    assert ("POST", 8700, "/ztpm/oauth/token", 200) in plant.transport.seen
    assert plant.transport.seen.count(("POST", 8700, "/ztpm/oauth/token", 400)) >= 1
    assert CALLED and set(CALLED) == {320}
    # The point's own record names client and person, and no token.
    text = (plant.folder / "state" / "journal.ndjson").read_text()
    assert memory.tokens.access_token not in text
    decided = [json.loads(line) for line in text.splitlines()]
    (permitted, *_) = [each["body"] for each in decided if each["kind"] == "decision"]
    said = json.dumps(permitted)
    assert '"viewer"' in said and '"alice"' in said


def test_an_access_token_is_good_for_its_holder_its_server_and_its_scheme(plant):
    world = plant.world
    stock = StockClient(world, key=keys.generate())
    bound = StockClient(world, "bound", key=keys.generate(), dpop=keys.generate(Algorithm.P256))
    for each in (stock, bound):
        each.register()
        each.mandate(grants=GRANTS)
    bound.nonce = bound.credentials().headers["dpop-nonce"]
    bearer, held = (each.credentials().json()["access_token"] for each in (stock, bound))
    thief = StockClient(world, "bound", dpop=keys.generate())
    body = json.dumps(
        {"jsonrpc": "2.0", "id": 1, "method": "tools/call", "params": {"name": "read", "arguments": {"width": 9}}}
    ).encode()

    async def send(authorization, proof=None):
        headers = {"Authorization": authorization, "Content-Type": "application/json"}
        headers |= {"Accept": "application/json, text/event-stream"} | ({} if proof is None else {"DPoP": proof})
        async with httpx2.AsyncClient(transport=plant.transport) as http:
            answer = await http.post(AUDIENCE, content=body, headers=headers)
        return answer.status_code if answer.status_code == 200 else (answer.status_code, answer.json()["reason"])

    async def work():
        # By then the guard takes proofs that are made now.
        proof = bound.proof(AUDIENCE, token=held)
        while (status := await send(f"DPoP {held}", proof)) == (401, "PROOF_STALE"):
            await asyncio.sleep(0.05)
            proof = bound.proof(AUDIENCE, token=held)
        assert status == 200
        assert await send(f"DPoP {held}", proof) == (401, "REPLAYED")
        assert await send(f"Bearer {bearer}") == 200
        assert await send(f"DPoP {bearer}", bound.proof(AUDIENCE, token=bearer)) == (401, "PROOF_WRONG_KEY")
        assert await send(f"Bearer {held}") == (401, "PROOF_MISSING")
        assert await send(f"DPoP {held}") == (401, "PROOF_MISSING")
        assert await send(f"DPoP {held}", thief.proof(AUDIENCE, token=held)) == (401, "PROOF_WRONG_KEY")
        assert await send(f"DPoP {held}", bound.proof(AUDIENCE, token=bearer)) == (401, "PROOF_NOT_FOR_THIS_REQUEST")
        elsewhere = bound.proof(f"{AUDIENCE}/other", token=held)
        assert await send(f"DPoP {held}", elsewhere) == (401, "PROOF_NOT_FOR_THIS_REQUEST")
        for nonsense in ("a.b.c", bearer[:-4] + "AAAA", "x" * 9_000 + ".y.z"):
            assert await send(f"Bearer {nonsense}") == (401, "TOKEN_MALFORMED")
        assert await send("Bearer none") == (401, "TOKEN_MISSING")
        # The provider that cannot be asked denies.
        plant.guard.access._kept.clear()
        plant.transport.apps[8700] = None
        assert await send(f"Bearer {bearer}") == (401, "TOKEN_MALFORMED")

    plant.run(work())


class Person:
    """A person's browser as the SDK's callbacks see it: it opens the page, and allows what it shows."""

    def __init__(self, plant):
        self.browser = Browser(plant.world)
        self.back = ""

    async def open(self, url):
        # In a thread: the page is answered on this very loop.
        await asyncio.to_thread(self.allow, url)

    def allow(self, url):
        shown = self.browser.get(url)
        assert shown.status_code == 200, shown.text
        found = dict(HIDDEN.findall(shown.text))
        fields = {name: found[name].replace("&amp;", "&") for name in ("asked", "shown")}
        self.back = self.browser.post(AUTHORIZE, fields | {"answer": "allow"}).headers["location"]

    async def come_back(self):
        told = {name: values[0] for name, values in parse_qs(urlsplit(self.back).query).items()}
        return AuthorizationCodeResult(code=told["code"], state=told["state"], iss=told["iss"])


def by_person(plant, memory, *, redirect="http://127.0.0.1:41234/callback"):
    """A registered public client of the SDK, and the person who is asked by it."""
    stock = StockClient(plant.world, redirects=("http://127.0.0.1/callback",))
    assert stock.register().status_code == 201
    declare(plant.world, "camera.use", GRANTS)
    person = Person(plant)
    person.browser.log_in(plant.world.people["alice"])
    memory.client = OAuthClientInformationFull(
        client_id="viewer", redirect_uris=[redirect], token_endpoint_auth_method="none", issuer=ISSUER
    )
    metadata = OAuthClientMetadata(
        redirect_uris=[redirect], token_endpoint_auth_method="none", client_name="The viewer"
    )
    return OAuthClientProvider(AUDIENCE, metadata, memory, person.open, person.come_back)


def test_a_person_lets_a_stock_client_call(plant):
    memory = Memory()
    auth = by_person(plant, memory)

    async def work():
        async with plant.client(auth) as client:
            assert decision(await client.call_tool("read", {"width": 320})) == ("PERMIT", "PERMITTED")
            assert decision(await client.call_tool("wipe", {"width": 1})) == ("DENY", "ABOVE_CEILING")

    plant.run(work())
    assert memory.tokens.scope == "camera.use" and memory.tokens.refresh_token
    assert CALLED == [320]


def bound_to(key, memory):
    return claims_of(memory.tokens.access_token)["cnf"]["jkt"] == keys.thumbprint(keys.public_raw(key))


def tokens_asked(plant):
    """Status of each request for a token, in order."""
    return [status for _, _, path, status in plant.transport.seen if path.endswith("/oauth/token")]


@pytest.mark.parametrize("algorithm", Algorithm)
def test_a_program_with_a_mandate_has_its_tokens_bound(plant, algorithm):
    memory, key = Memory(), keys.generate(algorithm)
    stock = StockClient(plant.world, key=keys.generate(Algorithm.P256))
    stock.register()
    stock.mandate(grants=GRANTS)

    async def work():
        async with plant.client(DPoPAuth(by_mandate(stock, memory), key)) as client:
            assert decision(await client.call_tool("read", {"width": 320})) == ("PERMIT", "PERMITTED")
            assert decision(await client.call_tool("read", {"width": 641}))[0] == "DENY"
        # The stored token is found by the next connection, which knows it by the key that it names.
        async with plant.client(DPoPAuth(by_mandate(stock, memory), key)) as client:
            assert decision(await client.call_tool("read", {"width": 321})) == ("PERMIT", "PERMITTED")
        assert tokens_asked(plant) == [400, 200]
        async with httpx2.AsyncClient(transport=plant.transport) as http:
            body = {"jsonrpc": "2.0", "id": 1, "method": "tools/list", "params": {}}
            stolen = await http.post(
                AUDIENCE, json=body, headers={"Authorization": f"Bearer {memory.tokens.access_token}"}
            )
        assert (stolen.status_code, stolen.json()["reason"]) == (401, "PROOF_MISSING")

    plant.run(work())
    assert bound_to(key, memory)
    assert CALLED == [320, 321]


def test_a_person_lets_a_client_call_whose_tokens_are_bound_and_renewed(plant):
    memory, key = Memory(), keys.generate()
    provider = by_person(plant, memory)
    auth = DPoPAuth(provider, key)

    async def work():
        async with plant.client(auth) as client:
            assert decision(await client.call_tool("read", {"width": 320})) == ("PERMIT", "PERMITTED")
            first = memory.tokens
            provider.context.token_expiry_time = 1.0
            assert decision(await client.call_tool("read", {"width": 321})) == ("PERMIT", "PERMITTED")
            assert bound_to(key, memory) and memory.tokens.access_token != first.access_token
            # The nonce was kept from one token request to the next; the browser's page was opened once.
            assert tokens_asked(plant) == [400, 200, 200]
        # Whoever has the refresh token has not the key: the thief is refused, and asks a person, who is not there.
        stolen = OAuthClientProvider(AUDIENCE, provider.context.client_metadata, memory)
        stolen.context.token_expiry_time = 1.0
        stolen.context.oauth_metadata = provider.context.oauth_metadata
        async with plant.client(DPoPAuth(stolen, keys.generate())) as client:
            await client.call_tool("read", {"width": 322})

    with pytest.raises(ExceptionGroup):
        plant.run(work())
    assert tokens_asked(plant)[3:] == [400, 400]  # for want of a nonce, and with it
    assert CALLED == [320, 321]
