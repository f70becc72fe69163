"""A guarded server for clients in its own process, by the SDK's own `Client(server)`, in both eras of the protocol."""

import asyncio
import json
from dataclasses import dataclass

import pytest
from mcp import Client, MCPError
from mcp.server import MCPServer
from mcp.server.lowlevel.server import Server
from mcp.shared.memory import create_client_server_memory_streams
from mcp_types import CallToolResult, ElicitResult, ListToolsResult, TextContent
from pep.mcp.body_screen import BODY_BYTES
from pep.mcp.guard import DECISION_META, lowlevel
from pep.mcp.http_request import REFUSED_CODE
from tests.pep.kit import AUDIENCE, ISSUER
from tests.pep.point.alive import CALLED, living, open_valve, sdk, valve_scope
from tests.pep.point.test_guarded_server import TABLE, VALVE, written  # noqa: F401 - a fixture

from capabilities.keys import keys
from capabilities.proof.mcp_meta import META, PROOF, TOKEN
from pep import pins
from ztpm_idp.client import Agent
from ztpm_idp.client.signing import MetaAuth
from ztpm_idp.client.tools import signed

pytestmark = [pytest.mark.real_time, pytest.mark.version, pytest.mark.filterwarnings("ignore::DeprecationWarning")]

MODES = ("legacy", "2026-07-28", "auto")
SEEN = []
"""Requests as a low-level tool saw them."""


def low():
    async def listed(ctx, params):
        return ListToolsResult(tools=[VALVE])

    async def called(ctx, params):
        SEEN.append((dict(ctx.params), dict(ctx.meta or {}), params.meta))
        value = open_valve(params.arguments["percent"])
        return CallToolResult(content=[TextContent(type="text", text=json.dumps(value))])

    return Server("plant", on_list_tools=listed, on_call_tool=called)


def fast():
    server = pytest.importorskip("fastmcp.server", reason="the extra `fastmcp` is not installed").FastMCP("plant")
    server.tool(open_valve)
    return server


KINDS = {"sdk": (sdk, ""), "fastmcp": (fast, ""), "lowlevel": (low, TABLE)}


@dataclass
class Here:
    """The guarded server in this process, and a holder of a token."""

    outer: object
    server: object
    mode: str

    @property
    def holder(self):
        return self.outer.holder

    def client(self, **options):
        """The SDK's own client; FastMCP's server is no class of the SDK's, the one behind it is."""
        server = self.server if isinstance(self.server, MCPServer | Server) else lowlevel(self.server)
        return Client(server, mode=self.mode, **options)

    def auth(self, *, key=None, token=None, audience=AUDIENCE):
        return MetaAuth(key or self.holder.key, lambda: token or self.holder.text, audience)

    def meta(self, percent, *, method="tools/call", params=None, **other):
        call = {"name": "open_valve", "arguments": {"percent": percent}}
        return self.auth(**other).signed(method, call if params is None else params)[META]

    async def use(self, percent, meta=None, **options):
        async with self.client(**options) as client:
            return await client.call_tool("open_valve", {"percent": percent}, meta=meta)

    async def refused(self, percent, meta=None):
        async with self.client() as client:
            with pytest.raises(MCPError) as caught:
                await client.call_tool("open_valve", {"percent": percent}, meta=meta)
        assert caught.value.error.code == REFUSED_CODE
        return caught.value.error.message

    def refusals(self):
        return [reason for kind, reason in self.outer.kinds() if kind == "refusal"]


@pytest.fixture(params=[(kind, mode) for kind in KINDS for mode in MODES], ids="-".join)
def run(request, written):  # noqa: F811
    """Runs a scenario against a guarded server of one kind, in one era."""
    kind, mode = request.param
    make, table = KINDS[kind]

    def go(scenario, server=None):
        server, path = server or make(), written(table)
        approved = pins(server, path)
        CALLED.clear()
        SEEN.clear()

        async def inside():
            async with living(path, server, approved, valve_scope(open_valve)) as outer:
                return await scenario(Here(outer, server, mode))

        return asyncio.run(inside())

    go.kind, go.mode = kind, mode
    return go


def told(answer):
    return answer.meta[DECISION_META]


def test_a_call_with_token_and_proof_happens_once_and_after_its_record(run):
    async def scenario(here):
        return await here.use(45.04, here.meta(45.04)), here.outer.kinds()

    opened, kinds = run(scenario)
    assert (told(opened)["decision"], told(opened)["rounded"]) == ("PERMIT", {"percent": 45.0})
    assert CALLED == [45.0]
    kinds = [kind for kind, _ in kinds]
    assert kinds.index("decision") < kinds.index("outcome")
    assert "refusal" not in kinds


def test_an_agent_signs_the_meta_of_one_call(run):
    async def scenario(here):
        with Agent("robotic", here.holder.key, ISSUER, bytes(32)) as agent:
            meta = agent.meta("open_valve", {"percent": 5}, here.holder.text, audience=AUDIENCE)
        return await here.use(5, meta)

    assert told(run(scenario))["decision"] == "PERMIT"


def test_the_tool_sees_neither_token_nor_proof(run):
    if run.kind != "lowlevel":
        pytest.skip("its tools have no raw request")

    async def scenario(here):
        meta = here.meta(5, params={"name": "open_valve", "arguments": {"percent": 5}, META: {"mine": 1}})
        return await here.use(5, meta)

    assert told(run(scenario))["decision"] == "PERMIT"
    ((params, meta, typed),) = SEEN
    assert params[META]["mine"] == meta["mine"] == typed["mine"] == 1
    assert "dev.ztpm/" not in json.dumps([params, meta, typed], default=str)


def test_a_call_without_meta_is_refused_and_on_record(run):
    async def scenario(here):
        return await here.refused(5), here.refusals()

    assert run(scenario) == ("TOKEN_MISSING", ["TOKEN_MISSING"])
    assert CALLED == []


def test_a_proof_counts_once(run):
    async def scenario(here):
        meta = here.meta(5)
        return (await here.use(5, meta), await here.refused(5, meta), here.refusals())

    opened, *rest = run(scenario)
    assert rest == ["REPLAYED", ["REPLAYED"]]
    assert CALLED == [5.0]


SPOILT = [
    (lambda here: here.meta(6), "PROOF_NOT_FOR_THIS_REQUEST"),
    (lambda here: here.meta(5, method="tools/list"), "PROOF_NOT_FOR_THIS_REQUEST"),
    (lambda here: here.meta(5, audience="http://127.0.0.1:1/mcp"), "PROOF_NOT_FOR_THIS_REQUEST"),
    (lambda here: here.meta(5, key=keys.generate()), "PROOF_WRONG_KEY"),
    (lambda here: here.meta(5) | {"mine": 1}, "PROOF_NOT_FOR_THIS_REQUEST"),
    (lambda here: {TOKEN: here.holder.text}, "PROOF_MISSING"),
    (lambda here: {PROOF: here.meta(5)[PROOF]}, "TOKEN_MISSING"),
    (lambda here: here.meta(5) | {TOKEN: 7}, "TOKEN_MALFORMED"),
    (lambda here: here.meta(5) | {TOKEN: "x" * 1_000_000}, "TOKEN_TOO_LARGE"),
    (lambda here: here.meta(5) | {TOKEN: "ü\x00"}, "TOKEN_MALFORMED"),
    (lambda here: here.meta(5) | {PROOF: [here.meta(5)[PROOF]]}, "PROOF_MALFORMED"),
    (lambda here: here.meta(5) | {PROOF: "x" * 1_000_000}, "PROOF_MALFORMED"),
    (lambda here: here.meta(5) | {"mine": "x" * BODY_BYTES}, "BODY_TOO_LARGE"),
    (lambda here: here.meta(5) | {"mine": 2**53}, "PROOF_MALFORMED"),
]
"""Spoilt credentials of a call with 5 percent, and the reason that is told."""


def test_forged_swapped_stolen_and_foreign_credentials_are_refused_and_on_record(run):
    async def scenario(here):
        return [await here.refused(5, spoil(here)) for spoil, _ in SPOILT], here.refusals()

    said, refusals = run(scenario)
    assert said == refusals == [reason for _, reason in SPOILT]
    assert CALLED == []


def test_a_revoked_token_is_refused(run):
    async def scenario(here):
        opened = await here.use(5, here.meta(5))
        view = here.outer.feed.view()
        revoked = view.revoked | {("agent", "robotic")}
        here.outer.app.authority._feed = type("Feed", (), {"view": lambda _: type(view)(view.epoch, 0, revoked)})()
        return opened, await here.refused(5, here.meta(5))

    opened, said = run(scenario)
    assert (told(opened)["decision"], said) == ("PERMIT", "REVOKED")
    assert CALLED == [5.0]


def test_whatever_else_has_authority_needs_it_too_and_a_bare_list_shows_nothing(run):
    async def scenario(here):
        async with here.client(cache=None) as client:
            shown = [
                (await client.list_tools(meta=meta)).tools
                for meta in (None, here.meta(0, method="tools/list", params={}))
            ]
            with pytest.raises(MCPError) as spoilt:
                await client.list_tools(meta={TOKEN: "x"})
            with pytest.raises(MCPError) as read:
                await client.read_resource("file:///etc/passwd")
            with pytest.raises(MCPError) as got:
                await client.get_prompt("any")
        return shown, [each.value.error.message for each in (spoilt, read, got)], here.refusals()

    shown, said, refusals = run(scenario)
    assert [[tool.name for tool in tools] for tools in shown] == [[], ["open_valve"]]
    assert said[1:] == refusals[1:] == ["TOKEN_MISSING", "TOKEN_MISSING"]
    assert said[0] == refusals[0]
    assert said[0].startswith("TOKEN_")


def test_a_deferred_call_says_where_people_answer(run):
    if run.kind == "lowlevel":
        pytest.skip("its declaration has no row that needs a person")

    async def scenario(here):
        return await here.use(85, here.meta(85))

    asked = run(scenario)
    assert (told(asked)["decision"], asked.is_error, bool(told(asked)["url"])) == ("DEFER", True, True)
    assert CALLED == []


def test_a_retry_of_the_clients_own_with_an_old_proof_is_refused_and_one_over_a_signing_transport_is_not(run):
    """The trap of a client that retries with the same `_meta`."""
    if run.kind == "lowlevel" or run.mode == "legacy":
        pytest.skip("no elicitation in a call")
    pages = []

    async def show(ctx, asked):
        pages.append(asked.url)
        return ElicitResult(action="decline")

    async def scenario(here):
        async with here.client(elicitation_callback=show) as client:
            with pytest.raises(MCPError) as caught:
                await client.call_tool("open_valve", {"percent": 85}, meta=here.meta(85))
        behind = lowlevel(here.server)
        async with create_client_server_memory_streams() as (ours, theirs):
            serving = asyncio.create_task(behind.run(*theirs, behind.create_initialization_options()))

            class Wire:
                async def __aenter__(self):
                    return ours

                async def __aexit__(self, *error):
                    await ours[1].aclose()

            async with Client(signed(Wire(), here.auth()), mode=run.mode, elicitation_callback=show) as client:
                answer = await client.call_tool("open_valve", {"percent": 85})
            await serving
        return caught.value.error.message, answer

    said, answer = run(scenario)
    assert said == "PROOF_NOT_FOR_THIS_REQUEST"
    assert (told(answer)["decision"], told(answer)["url"]) == ("DEFER", pages[-1])
    assert len(pages) == 2
    assert CALLED == []


def test_stopping_needs_nobodys_leave(run, monkeypatch):
    """A tool that stops is called for strangers too, and their credentials go no further."""
    monkeypatch.setattr("pep.mcp.message_edge.stops", lambda tools, name: True)
    monkeypatch.setattr("pep.mcp.guard.stops", lambda tools, name: True)

    async def scenario(here):
        return await here.use(5, {TOKEN: 7})

    assert told(run(scenario))["decision"] == "PERMIT"
    assert CALLED == [5.0]
    assert not any(TOKEN in params[META] for params, _, _ in SEEN)


def test_http_is_as_it_was(run):
    """Over HTTP the header counts, and the edge of messages is passed."""

    async def scenario(here):
        return await here.outer.call_tool("open_valve", {"percent": 5})

    assert told(run(scenario))["decision"] == "PERMIT"


def test_a_break_of_a_verification_is_a_refusal(run, monkeypatch):
    async def scenario(here):
        def broken(*_, **__):
            raise RuntimeError("broken")

        monkeypatch.setattr(here.outer.app.authority, "check", broken)
        return await here.refused(5, here.meta(5))

    assert run(scenario) == "TOKEN_MALFORMED"
    assert CALLED == []
