"""Provider and guarded tool server in this process, and the way of a stock client's requests to each."""

from __future__ import annotations

import asyncio
import time
from contextlib import asynccontextmanager
from typing import Annotated

import httpx2
from capabilities.values.scope import Range
from cryptography.hazmat.primitives import serialization
from mcp import Client
from mcp.client.auth.extensions.client_credentials import PrivateKeyJWTOAuthProvider, SignedJWTParameters
from mcp.client.streamable_http import streamable_http_client
from mcp.server import MCPServer
from pep.base.declaration import declared
from tests.pep.point.alive import lifespan
from tests.ztpm_idp.test_process import PASSPHRASE
from tests.ztpm_idp.world import AUDIENCE, ISSUER, World

from capabilities.keys import keys
from pep import Within, grant, guard, operation, pins

CALLED = []
"""Numbers with which the camera was asked; the lens, below zero."""


@operation("camera", base_tier=0)
def read(width: Annotated[int, Within(1, 4_096, "count")]) -> int:
    """Read a picture of so many columns."""
    CALLED.append(width)
    return width


@operation("camera", base_tier=2)
def wipe(width: Annotated[int, Within(1, 4_096, "count")]) -> int:
    """Wipe the lens."""
    CALLED.append(-width)
    return width


ROWS = {tool.__name__: declared(tool) for tool in (read, wipe)}
GRANTS = (grant(ROWS["read"], width=Range(1, 640)), grant(ROWS["wipe"]))


class Memory:
    """The SDK's storage of tokens, in memory."""

    def __init__(self, client=None):
        self.tokens, self.client = None, client

    async def get_tokens(self):
        return self.tokens

    async def set_tokens(self, tokens):
        self.tokens = tokens

    async def get_client_info(self):
        return self.client

    async def set_client_info(self, client_info):
        self.client = client_info


def by_credentials(client_id, key, memory, *, url, issuer):
    """The SDK's provider for a client with a P-256 key of its own."""
    pem = key.private_bytes(
        serialization.Encoding.PEM, serialization.PrivateFormat.PKCS8, serialization.NoEncryption()
    ).decode()
    signed = SignedJWTParameters(issuer=client_id, subject=client_id, signing_key=pem, signing_algorithm="ES256")
    return PrivateKeyJWTOAuthProvider(url, memory, client_id, signed.create_assertion_provider(), issuer=issuer)


class Routed(httpx2.AsyncBaseTransport):
    """Requests to the provider's address and to the tool server's, each to its application in this process."""

    def __init__(self, apps):
        self.apps = apps
        self.seen = []

    async def handle_async_request(self, request):
        port = request.url.port
        response = await httpx2.ASGITransport(app=self.apps[port]).handle_async_request(request)
        self.seen.append((request.method, port, request.url.path, response.status_code))
        return response


class Plant:
    """The provider with its people, and a guarded camera in front of a stock MCP server."""

    def __init__(self, folder, monkeypatch):
        self.folder = folder
        self.world = World(folder, clock=time.time)
        self.transport = Routed({})
        monkeypatch.setenv("ZTPM_PASSPHRASE", PASSPHRASE)
        monkeypatch.setattr("pep.point.parts.httpx2.AsyncHTTPTransport", lambda: self.transport)

    def __enter__(self):
        world = self.world.__enter__()
        self.transport.apps[8700] = world.app
        world.pep()
        (self.folder / "trust.json").write_bytes(world.trust.to_json())
        key = self.folder / "pep.key"
        key.write_bytes(keys.to_pem(world.private["cell-1"], PASSPHRASE.encode()))
        key.chmod(0o600)
        path = self.folder / "guard.toml"
        path.write_text(
            f'audience = "{AUDIENCE}"\npep_id = "cell-1"\nissuer = "{ISSUER}"\n'
            'trust_file = "trust.json"\npep_key_file = "pep.key"\nfolder = "state"\n'
        )
        server = MCPServer("camera", log_level="ERROR")
        for tool in (read, wipe):
            server.tool()(tool)
        for pin in pins(server):
            world.people["alice"].register_tool(
                audience=AUDIENCE, name=pin.name, definition_digest=pin.definition_digest, operation=pin.operation,
                base_tier=int(pin.base_tier),
            )  # fmt: skip
        self.guard = guard(server, path)
        self.transport.apps[8800] = self.guard
        CALLED.clear()
        return self

    def __exit__(self, *details):
        self.world.__exit__(*details)

    def run(self, coroutine):
        """The result of a client's work while the guard lives, on the loop of both."""

        async def go():
            async with lifespan(self.guard):
                return await coroutine

        return asyncio.run_coroutine_threadsafe(go(), self.world.loop).result(60)

    @asynccontextmanager
    async def client(self, auth):
        async with (
            httpx2.AsyncClient(transport=self.transport, auth=auth) as http,
            Client(streamable_http_client(AUDIENCE, http_client=http)) as client,
        ):
            yield client
