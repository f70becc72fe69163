"""The MCP SDK's client in the scenarios `auth/*` of the conformance suite, with or without DPoP around its providers.

The suite begins a command for each scenario. As the SDK takes a second to load, the command only passes what it was
given to this process, where the client is, and ends as that did: `python -ISs -c PASS_ON SOCKET URL`.
"""

from __future__ import annotations

import asyncio
import json
import sys
import traceback
from urllib.parse import parse_qs, urlsplit

import httpx2
from capabilities.keys.keys import Algorithm
from mcp import Client
from mcp.client.auth import AuthorizationCodeResult, OAuthClientProvider
from mcp.client.auth.extensions.client_credentials import (
    ClientCredentialsOAuthProvider,
    PrivateKeyJWTOAuthProvider,
    SignedJWTParameters,
)
from mcp.client.auth.extensions.identity_assertion import IdentityAssertionOAuthProvider
from mcp.client.streamable_http import streamable_http_client
from mcp.shared.auth import JWT_BEARER_GRANT_TYPE, OAuthClientInformationFull, OAuthClientMetadata

from tests.e2e.routed import Memory

from capabilities.keys import keys
from ztpm_idp.client import DPoPAuth

PASS_ON = """
import json, os, socket, sys
with socket.socket(socket.AF_UNIX) as there:
    there.connect(sys.argv[1])
    said = {name: text for name, text in os.environ.items() if name.startswith("MCP_CONFORMANCE_")}
    there.sendall(json.dumps(said | {"url": sys.argv[2]}).encode() + b"\\n")
    told = b"".join(iter(lambda: there.recv(65536), b"")).decode()
sys.stderr.write(told)
sys.exit(bool(told))
"""
REDIRECT = "http://localhost:3000/callback"
DOCUMENT = "https://conformance-test.local/client-metadata.json"
"""The address of a client metadata document that the suite knows."""
LONGEST_S = 120.0
"""Time for one scenario; all are played at once, on a machine that may be busy."""


class Person:
    """The person's browser: the suite's page allows at once."""

    async def open(self, url):
        async with httpx2.AsyncClient(timeout=LONGEST_S) as http:
            self.back = (await http.get(url)).headers["location"]

    async def come_back(self):
        told = {name: values[0] for name, values in parse_qs(urlsplit(self.back).query).items()}
        return AuthorizationCodeResult(code=told["code"], state=told.get("state"), iss=told.get("iss"))


class WorkloadProvider(ClientCredentialsOAuthProvider):
    """Public client that shows its platform's word (SEP-1933), for which the SDK has no provider."""

    def __init__(self, url, assertion, **options):
        super().__init__(url, Memory(), client_secret="", token_endpoint_auth_method="client_secret_post", **options)
        self._assertion = assertion

    async def _exchange_token_client_credentials(self):
        form = {
            "grant_type": JWT_BEARER_GRANT_TYPE,
            "assertion": self._assertion,
            "resource": self.context.get_resource_url(),
        }
        headers = {"Content-Type": "application/x-www-form-urlencoded"}
        return httpx2.Request("POST", self._get_token_endpoint(), data=form, headers=headers)


async def provider(scenario, url, given):
    """The SDK's provider for a scenario."""
    match scenario:
        case "auth/client-credentials-jwt":
            signed = SignedJWTParameters(
                issuer=given["client_id"],
                subject=given["client_id"],
                signing_key=given["private_key_pem"],
                signing_algorithm=given["signing_algorithm"],
            )
            return PrivateKeyJWTOAuthProvider(
                url, Memory(), given["client_id"], signed.create_assertion_provider(), issuer=await issuer(url)
            )
        case "auth/client-credentials-basic":
            return ClientCredentialsOAuthProvider(
                url, Memory(), given["client_id"], given["client_secret"], issuer=await issuer(url)
            )
        case "auth/enterprise-managed-authorization":
            return IdentityAssertionOAuthProvider(
                url, Memory(), given["client_id"], given["client_secret"], await issuer(url),
                lambda audience, resource: exchanged(given, audience, resource),
                token_endpoint_auth_method="client_secret_basic",
            )  # fmt: skip
        case "auth/wif-jwt-bearer":
            return WorkloadProvider(url, given["valid_jwt"], client_id=given["client_id"], issuer=await issuer(url))
    person, known = Person(), None
    if "client_id" in given:
        known = OAuthClientInformationFull(
            client_id=given["client_id"], client_secret=given["client_secret"], redirect_uris=[REDIRECT],
            token_endpoint_auth_method="client_secret_basic", issuer=given["issuer"],
        )  # fmt: skip
    metadata = OAuthClientMetadata(
        client_name="ztpm", redirect_uris=[REDIRECT], grant_types=["authorization_code", "refresh_token"]
    )
    return OAuthClientProvider(
        url, metadata, Memory(known), person.open, person.come_back, client_metadata_url=DOCUMENT
    )


async def issuer(url):
    """The server's word on its authorization server, which a client with credentials would be told beforehand."""
    parts = urlsplit(url)
    async with httpx2.AsyncClient(timeout=LONGEST_S) as http:
        for path in (f"/.well-known/oauth-protected-resource{parts.path}", "/.well-known/oauth-protected-resource"):
            answer = await http.get(f"{parts.scheme}://{parts.netloc}{path}")
            if answer.status_code == 200:
                return answer.json()["authorization_servers"][0]
    raise AssertionError("no metadata")


async def exchanged(given, audience, resource):
    """The enterprise's word for its person, for the person's identity token (SEP-990, first leg)."""
    form = {
        "grant_type": "urn:ietf:params:oauth:grant-type:token-exchange",
        "requested_token_type": "urn:ietf:params:oauth:token-type:id-jag",
        "subject_token": given["idp_id_token"],
        "subject_token_type": "urn:ietf:params:oauth:token-type:id_token",
        "client_id": given["idp_client_id"],
        "audience": audience,
        "resource": resource,
    }
    async with httpx2.AsyncClient(timeout=LONGEST_S) as http:
        return (await http.post(given["idp_token_endpoint"], data=form)).json()["access_token"]


async def played(said, *, bound):
    """Plays one scenario: connects, lists, calls."""
    scenario, url = said["MCP_CONFORMANCE_SCENARIO"], said["url"]
    auth = await provider(scenario, url, json.loads(said.get("MCP_CONFORMANCE_CONTEXT", "{}")))
    if bound:
        auth = DPoPAuth(auth, keys.generate(Algorithm.P256))
    version = said["MCP_CONFORMANCE_PROTOCOL_VERSION"]
    async with (
        httpx2.AsyncClient(auth=auth, timeout=LONGEST_S) as http,
        Client(
            streamable_http_client(url, http_client=http), mode="auto" if version > "2025-11-25" else "legacy"
        ) as client,
    ):
        tools = (await client.list_tools()).tools
        if tools:
            await client.call_tool(tools[0].name, {})


class Stage:
    """Listens for scenarios, and plays them.

    Attributes:
        ended: error that each scenario ended with, or "".
    """

    def __init__(self, socket, *, bound):
        self.socket, self.bound, self.ended = socket, bound, {}

    @property
    def command(self):
        """Command for the suite, which splits it at spaces and gives it to a shell."""
        script = self.socket.with_suffix(".py")
        script.write_text(PASS_ON)
        return f"{sys.executable} -ISs {script} {self.socket}"

    async def __aenter__(self):
        self._server = await asyncio.start_unix_server(self._plays, self.socket)
        return self

    async def __aexit__(self, *details):
        self._server.close()
        await self._server.wait_closed()

    async def _plays(self, reader, writer):
        said, ended = json.loads(await reader.readline()), ""
        if said["MCP_CONFORMANCE_SCENARIO"].startswith("auth/"):
            try:
                async with asyncio.timeout(LONGEST_S):
                    await played(said, bound=self.bound)
            except Exception:
                ended = traceback.format_exc()
            self.ended[said["MCP_CONFORMANCE_SCENARIO"]] = ended
        writer.write(ended.encode())
        writer.close()
        await writer.wait_closed()
