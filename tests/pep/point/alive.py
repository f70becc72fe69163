"""A guarded tool server in this process, with its provider on the wire and a client of MCP."""

import asyncio
import math
from contextlib import asynccontextmanager
from dataclasses import replace
from typing import Annotated

import httpx2
from capabilities.statements.registry import ToolEntry
from capabilities.values.scope import Grant, Limit, Range
from mcp import Client
from mcp.server import MCPServer
from mcp.client.streamable_http import streamable_http_client
from pep.base.clock import SystemClock
from pep.base.declaration import declared
from pep.point.guard_config import GuardConfig
from pep.point.tool_server import GuardedServer
from tests.pep.kit import AUDIENCE, FakeIssuer, agent, full_scope, issuer_keys
from tests.pep.mcp.test_mcp import Signed
from tests.pep.point.test_guarded_server import PASSPHRASE

from capabilities.keys import keys
from pep import Within, operation


CALLED = []
"""Numbers with which the valve was opened."""


@operation("valve-7", base_tier=1)
def open_valve(percent: Annotated[float, Within(0, 1_000, "permille", scale=10, above={800: 3})]) -> float:
    """Open the valve."""
    CALLED.append(percent)
    if percent == 13:
        raise OSError("stuck")
    return percent


def sdk():
    server = MCPServer("plant", log_level="ERROR")
    server.tool()(open_valve)
    return server


def valve_scope(function):
    """Scope of the one function, up to nine tenths, at a time."""
    grant = Grant("valve-7", "open_valve", (Limit(declared(function).parameters[0], Range(0, 900)),))
    return lambda at: replace(full_scope(at), grants=(grant,))


def at_once(point):
    """The new point, which accepts proofs of this second: its journal is new, too, so no earlier process had any."""
    point.started_s = point.authority._started_s = math.floor(point.started_s - 1)
    return point


@asynccontextmanager
async def lifespan(app):
    """The app's life, begun and ended."""
    heard, said = asyncio.Queue(), asyncio.Queue()
    life = asyncio.create_task(app({"type": "lifespan", "asgi": {"version": "3.0"}, "state": {}}, heard.get, said.put))
    await heard.put({"type": "lifespan.startup"})
    started = await said.get()
    assert started["type"] == "lifespan.startup.complete", started
    try:
        yield
    finally:
        await heard.put({"type": "lifespan.shutdown"})
        await life


@asynccontextmanager
async def living(path, server, approved, scope, provider=None, guarded=None):
    """The guarded server, alive, with its provider on the wire, and a client that holds a token.

    Args:
        path: of `guard.toml`.
        server: to be guarded.
        approved: pins of its tools.
        scope: gives that of the token, at a time.
        provider: keys and trust bundle of the provider, where they are made already.
        guarded: the app, where it is made already.
    """
    config = GuardConfig.read(path)
    made, trust = provider or issuer_keys()
    (path.parent / "trust.json").write_bytes(trust.to_json())
    entries = [ToolEntry(p.name, p.definition_digest, p.operation, p.base_tier) for p in approved]
    pep_key, clock = keys.from_pem(config.pep_key_file.read_bytes(), PASSPHRASE.encode()), SystemClock()
    issuer = FakeIssuer(made, clock, tools=entries, pep_key=keys.public_raw(pep_key))
    guarded = at_once(guarded or GuardedServer(server, config))
    for part in (guarded.follower, guarded.shipper, guarded._asking):
        part._http = issuer.client()
    holder = agent(made, clock.wall_s(), scope=scope(clock.wall_s()))
    http = httpx2.AsyncClient(transport=httpx2.ASGITransport(app=guarded), auth=Signed(holder, clock))
    async with lifespan(guarded), http, Client(streamable_http_client(AUDIENCE, http_client=http)) as client:
        client.kinds = lambda: [
            (r["kind"], r["body"].get("outcome") or r["body"].get("reason")) for r in guarded.journal.records()
        ]
        client.app, client.auth, client.feed = guarded, Signed(holder, clock), guarded.follower
        client.holder, client.http = holder, http
        yield client
