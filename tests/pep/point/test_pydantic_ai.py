"""Recipes of docs/guard.md for pydantic-ai, with the real package: a model reads denials in words and goes on."""

import asyncio
from functools import partial
from pathlib import Path
from types import SimpleNamespace

import httpx2
import pytest
from capabilities.statements.revocation import RevocationView
from tests.house.pages import BLOCK
from tests.pep.kit import AUDIENCE
from tests.pep.point.alive import CALLED, living, open_valve, sdk, valve_scope
from tests.pep.point.test_guarded_functions import living as program_living
from tests.pep.point.test_guarded_functions import open_valve as valve_function
from tests.pep.point.test_guarded_server import written  # noqa: F401 - a fixture

from pep import acting, pins
from ztpm_idp.client import refusal_in

pytest.importorskip("pydantic_ai.mcp", reason="the extra `pydantic-ai` is not installed")
from pydantic_ai import Agent
from pydantic_ai.messages import ModelResponse, TextPart, ToolCallPart
from pydantic_ai.models.function import FunctionModel

pytestmark = [pytest.mark.real_time, pytest.mark.version, pytest.mark.filterwarnings("ignore::DeprecationWarning")]
PAGE = (Path(__file__).parents[3] / "docs" / "guard.md").read_text("utf-8")
RECIPE = next(text for _, text in BLOCK.findall(PAGE) if "MCPToolset" in text)


def model(*percents):
    """A model that calls the valve with each of the numbers, and then says all that it was told."""

    def answer(messages, info):
        told = [part.model_response_str() for message in messages for part in message.parts if part.part_kind == "tool-return"]  # fmt: skip  # noqa: E501
        if len(told) < len(percents):
            return ModelResponse(parts=[ToolCallPart("open_valve", {"percent": percents[len(told)]})])
        return ModelResponse(parts=[TextPart("\n".join(told))])

    return FunctionModel(answer)


def recipe(client):
    names = {"__name__": "recipe"}
    exec(compile(RECIPE, "docs/guard.md", "exec"), names)  # noqa: S102 - the page itself
    served = partial(httpx2.AsyncClient, transport=httpx2.ASGITransport(app=client.app))
    names["httpx2"] = SimpleNamespace(AsyncClient=served)
    return names["toolset"](AUDIENCE, client.auth)


def alive(path, scenario):
    server = sdk()
    approved = pins(server)
    CALLED.clear()

    async def go():
        async with living(path, server, approved, valve_scope(open_valve)) as client:
            return await scenario(client)

    return asyncio.run(go())


def test_a_model_reads_in_words_what_is_permitted_and_goes_on(written):  # noqa: F811
    async def scenario(client):
        return (await Agent(model(95, 85, 40), toolsets=[recipe(client)]).run("open the valve")).output

    denied, deferred, opened = alive(written(), scenario).splitlines()
    for each in ("LIMIT_EXCEEDED_BY_REQUEST", "0 to 900 permille", "robotic for alice", "nearest permitted is 900"):
        assert each in denied
    assert "TIER_NEEDS_APPROVAL" in deferred and "/page" in deferred
    assert "40.0" in opened
    assert CALLED == [40.0]


@pytest.mark.parametrize("connected", [True, False])
def test_a_revoked_token_is_called_revoked(written, connected):  # noqa: F811
    async def scenario(client):
        tools = recipe(client)
        agent = Agent(model(1), toolsets=[tools])
        revoked = RevocationView(9, 0, frozenset({("agent", client.holder.name)}))
        if not connected:
            client.feed.view = lambda: revoked
        try:
            async with agent:
                await tools.list_tools()
                client.feed.view = lambda: revoked
                return (await agent.run("open the valve")).output
        except Exception as error:  # noqa: BLE001 - the framework's own kinds are what is tried
            return refusal_in(error).words

    assert "REVOKED" in alive(written(), scenario)
    assert CALLED == []


def test_a_function_of_the_agents_own_program(written):  # noqa: F811
    async def go():
        async with program_living(written()) as program:
            carried = program.point.carried(valve_function, refused=lambda error: refusal_in(error).words)
            agent = Agent(model(95, 45.04), tools=[carried])
            with acting(program.holder.text, program.holder.key):
                return (await agent.run("open the valve")).output

    denied, opened = asyncio.run(go()).splitlines()
    assert denied.startswith("Denied: LIMIT_EXCEEDED_BY_REQUEST")
    assert "45.0" in opened
