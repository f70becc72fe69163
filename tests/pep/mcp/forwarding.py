"""Tool server without a robot before a guarded gateway, over real sockets; and doubles of the gateway."""

import asyncio
import contextlib
import secrets
from contextlib import asynccontextmanager

import httpx2
from capabilities.token.verify import Verifier
from capabilities.values.caps import DEFAULT as CAPS
from pep.journal.file_journal import FileJournal
from pep.journal.replay_cache import ReplayCache
from pep.mcp.dpop import DPoPLayer
from pep.mcp.forward import Forward, client
from pep.mcp.mapping import ARM_TOOLS
from pep.mcp.ticket_layer import TICKET, TicketLayer
from pep.request.authority import Authority
from pep.request.edge import Edge
from tests.pep.kit import AUDIENCE, HOST, ISSUER, PORT
from tests.pep.mcp.test_mcp import Cell
from ztpm.edge.server import EdgeServer

from capabilities.keys import keys
from capabilities.statements import ticket

GATEWAY_PORT = PORT - 3
URL = f"http://{HOST}:{GATEWAY_PORT}/calls"
DOOR = "door-1"


@asynccontextmanager
async def listening(app, port):
    """The app is served as enforcement points serve theirs."""
    server = EdgeServer(app, host=HOST, port=port, log_level="critical", interface="asgi3", timeout_graceful_shutdown=1)
    server.capture_signals = contextlib.nullcontext
    task = asyncio.create_task(server.serve())
    async with asyncio.timeout(10):
        while not server.started:
            await asyncio.sleep(0.01)
    try:
        yield
    finally:
        server.should_exit = True
        await task


class Shifted:
    """A clock that is wrong by so much."""

    def __init__(self, clock, by_s=0.0):
        self.clock, self.by_s = clock, by_s

    def wall_s(self):
        return self.clock.wall_s() + self.by_s

    def monotonic_ms(self):
        return self.clock.monotonic_ms() + round(self.by_s * 1_000)


class Seen:
    """An ASGI app before another one that remembers what came: method, path, headers as they came, and body."""

    def __init__(self, app):
        self.app, self.came, self.before = app, [], None
        self.lives = app  # whatever stands in for it

    async def __call__(self, scope, receive, send):
        if scope["type"] != "http":
            await self.lives(scope, receive, send)
            return
        got = {"method": scope["method"], "path": scope["path"], "headers": list(scope["headers"]), "body": b""}
        self.came.append(got)
        if self.before is not None:
            self.before()

        async def heard():
            message = await receive()
            got["body"] += message.get("body", b"")
            return message

        await self.app(scope, heard, send)

    @property
    def last(self):
        """The newest request, its headers as text."""
        newest = self.came[-1]
        return newest | {"headers": [(n.decode(), v.decode()) for n, v in newest["headers"]]}


class House(Cell):
    """The guarded gateway and the tool server before it; what they share is the world and the identity provider."""

    def start(self):
        super().start()
        self.door_key = keys.generate()
        self.peps = {DOOR: keys.public_raw(self.door_key), "door-2": keys.public_raw(keys.generate())}
        self.tickets = ReplayCache(self.clock)
        self.layer = TicketLayer(
            self.app,
            edge=self.gate,
            tools=ARM_TOOLS,
            peps=lambda: self.peps,
            feed=self.feed,
            replay=self.tickets,
            audience=AUDIENCE,
            url=URL,
            clock=self.clock,
            caps=CAPS,
        )
        self.gateway = Seen(self.layer)
        self.door_clock = Shifted(self.clock)
        self.door_journal = FileJournal.open(self.tmp / "door.ndjson", pep_id=DOOR, clock=self.clock)
        self.edge = Edge(policies=self.policies, journal=self.door_journal)
        self.door_authority = Authority(
            verifier=Verifier(self.trust, CAPS),
            feed=self.feed,
            replay=ReplayCache(self.clock),
            clock=self.clock,
            caps=CAPS,
            audience=AUDIENCE,
            started_s=self.clock.wall_s() - 100,
        )
        return self

    def forward(self, http):
        return Forward(
            http,
            edge=self.edge,
            tools=ARM_TOOLS,
            audience=AUDIENCE,
            url=URL,
            pep_id=DOOR,
            key=self.door_key,
            clock=self.door_clock,
        )

    @asynccontextmanager
    async def serving(self, gateway=None):
        """Both listen; another app stands in for the gateway where one is given, and nothing does for False."""
        async with contextlib.AsyncExitStack() as stack:
            if gateway is not False:
                self.gateway.app = self.layer if gateway is None else gateway
                await stack.enter_async_context(listening(self.gateway, GATEWAY_PORT))
            http = await stack.enter_async_context(client())
            door = DPoPLayer(
                self.forward(http),
                authority=self.door_authority,
                edge=self.edge,
                tools=ARM_TOOLS,
                audience=AUDIENCE,
                issuer=ISSUER,
                clock=self.clock,
            )
            await stack.enter_async_context(listening(door, PORT))
            yield self

    def run(self, scenario, gateway=None):
        """The scenario's answer, while both listen."""

        async def inside():
            async with self.serving(gateway):
                return await scenario()

        return asyncio.run(inside())

    def run_behind(self, scenario):
        """The scenario's answer, while the gateway alone listens."""

        async def inside():
            async with listening(self.layer, GATEWAY_PORT):
                return await scenario()

        return asyncio.run(inside())

    def ticket(self, carried, **changes):
        """A ticket as the tool server would issue it now; a test may spoil any part of it."""
        said = {"id": secrets.token_hex(16), "pep": DOOR, "audience": AUDIENCE, "url": URL, "key": self.door_key}
        return ticket.issue(carried, **{**said, "at": self.clock.wall_s(), **changes})

    async def knock(self, body, headers, *, ticket=None, url=URL, method="POST"):
        """A request at the gateway's own endpoint, from wherever."""
        sent = [*headers.items(), *([] if ticket is None else [(TICKET, ticket)])]
        async with httpx2.AsyncClient(timeout=30) as http:
            return await http.request(method, url, content=body, headers=[("host", f"{HOST}:{PORT}"), *sent])

    def door_records(self, kind):
        return [r["body"] for r in self.door_journal.records() if r["kind"] == kind]

    def close(self):
        for part in (self.gate, self.journal, self.edge, self.door_journal):
            part.close()
