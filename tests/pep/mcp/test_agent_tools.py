"""An agent's own client of tools: a result, or an error that says what would be permitted."""

import asyncio
import socket

import httpx2
import pytest
from pep.people.deferral import AskState
from tests.pep.kit import AUDIENCE, MOVE, reading
from tests.pep.mcp.test_mcp_defer import approve, cell, with_cell  # noqa: F401 - a fixture

from ztpm_idp.client import ClientError, Deferred, Denied, ProofAuth, raise_refused
from ztpm_idp.client.tools import Tools

pytestmark = pytest.mark.real_time


def tools(cell, **options):
    return Tools(AUDIENCE, auth(cell), **options)


def auth(cell):
    return ProofAuth(cell.holder.key, cell.holder.text, now=cell.clock.wall_s)


def test_a_permitted_call_gives_its_result(cell):
    cell.physics.answer = reading(1, 500)

    async def scenario():
        async with tools(cell) as opened:
            names = {tool.name for tool in await opened.list()}
            return names, await opened.call("move_joint", MOVE)

    names, result = with_cell(cell, scenario)
    assert {"move_joint", "stop"} <= names
    assert not result.is_error
    assert result.structured_content["outcome"] == "reached"


def test_a_call_outside_of_a_limit_says_what_would_be_permitted_and_who_set_it(cell):
    async def scenario():
        async with tools(cell) as opened:
            await opened.call("move_joint", {**MOVE, "speed_rad_s": 3.0})

    with pytest.raises(Denied) as caught:
        with_cell(cell, scenario)
    denied = caught.value
    assert (denied.reason, denied.primitive, denied.parameter) == ("LIMIT_EXCEEDED_BY_REQUEST", "TEA-2", "speed")
    assert denied.value > denied.nearest_permitted
    assert {"hop", "agent", "sponsor"} <= set(denied.set_by)
    assert denied.remedy


def test_an_argument_that_is_no_value_is_named_with_its_place(cell):
    async def scenario():
        async with tools(cell) as opened:
            await opened.call("move_joint", {**MOVE, "q_rad": [0.1, "1", 0.1, 0.1, 0.1, 0.1]})

    with pytest.raises(Denied) as caught:
        with_cell(cell, scenario)
    assert (caught.value.reason, caught.value.parameter) == ("NOT_A_NUMBER", "q_rad[1]")


def test_a_revoked_token_is_called_revoked_at_the_next_call(cell):
    cell.physics.answer = reading(1, 500)

    async def scenario():
        async with tools(cell) as opened:
            await opened.call("move_joint", MOVE)
            cell.feed.revoke("agent", "robotic")
            await opened.call("move_joint", MOVE)

    with pytest.raises(Denied) as caught:
        with_cell(cell, scenario)
    assert caught.value.reason == "REVOKED"


def test_a_revoked_token_is_called_revoked_at_the_door(cell):
    async def scenario():
        cell.feed.revoke("agent", "robotic")
        async with tools(cell):
            pass

    with pytest.raises(Denied) as caught:
        with_cell(cell, scenario)
    assert caught.value.reason == "REVOKED"


def test_any_http_client_hears_the_reason_as_an_error(cell):
    async def scenario():
        cell.feed.revoke("agent", "robotic")
        async with httpx2.AsyncClient(auth=auth(cell), event_hooks={"response": [raise_refused]}) as http:
            await http.post(AUDIENCE, json={"jsonrpc": "2.0", "id": 1, "method": "ping"})

    with pytest.raises(Denied) as caught:
        with_cell(cell, scenario)
    assert caught.value.reason == "REVOKED"


def test_a_deferred_call_tells_the_page_and_the_end(cell):
    async def scenario():
        async with tools(cell) as opened:
            await opened.call("move_joint", MOVE)

    with pytest.raises(Deferred) as caught:
        with_cell(cell, scenario)
    deferred = caught.value
    assert deferred.page.endswith(f"/approvals/{deferred.ask_id}/page")
    assert deferred.until > cell.clock.wall_s()


def test_a_patient_call_waits_for_people_and_happens_once(cell):
    shown = []

    async def scenario():
        async with tools(cell, patience_s=30.0, asked=shown.append) as opened:
            waiting = asyncio.create_task(opened.call("move_joint", MOVE))
            async with asyncio.timeout(10):
                while not shown:
                    await asyncio.sleep(0.02)
            await approve(cell, shown[0].split("/")[-2])
            return await waiting

    result = with_cell(cell, scenario)
    assert not result.is_error
    assert len(shown) == len(cell.arm.moves) == 1
    assert cell.asks.state_of(shown[0].split("/")[-2]) is not AskState.OPEN


def test_a_server_that_is_not_there_is_unreachable(cell):
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        url = f"http://127.0.0.1:{free.getsockname()[1]}/mcp"

    async def scenario():
        async with Tools(url, auth(cell)):
            pass

    with pytest.raises(ClientError) as caught:
        asyncio.run(scenario())
    assert caught.value.code == "UNREACHABLE"
