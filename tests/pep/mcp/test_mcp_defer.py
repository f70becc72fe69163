"""A deferral over MCP, with the SDK's own clients: one that can show people a page, and one that cannot."""

import asyncio

import httpx2
import pytest
from mcp import Client, MCPError, UrlElicitationRequiredError
from mcp.client.streamable_http import streamable_http_client
from mcp_types import ElicitResult
from pep.base.clock import SystemClock
from pep.mcp.decision_result import DECISION_META
from pep.people.deferral import AskState
from tests.pep.kit import AUDIENCE, ISSUER, MOVE, reading
from tests.pep.mcp.test_mcp import Cell, Signed, call_body

from pep.mcp import deferred_result
from pep.mcp.guard import DECISION_META

pytestmark = pytest.mark.real_time


@pytest.fixture
def cell(tmp_path):
    cell = Cell(tmp_path, clock=SystemClock()).start()
    cell.physics.answer = reading(3, 2_500)
    cell.shown = []
    cell.holder = cell.agent()
    yield cell
    cell.gate.close()
    cell.journal.close()


def with_cell(cell, scenario):
    """The scenario, while the cell serves and follows what people answer."""

    async def inside():
        async with cell.serving():
            following = asyncio.create_task(cell.asking.run())
            try:
                return await scenario()
            finally:
                following.cancel()

    return asyncio.run(inside())


async def approve(cell, ask_id):
    vote = cell.people["bob"].vote(cell.issuer.asks[ask_id], at=cell.clock.wall_s())
    cell.issuer.cast(ask_id, vote)
    async with asyncio.timeout(10):
        while cell.asks.state_of(ask_id) is not AskState.GRANTED:
            await asyncio.sleep(0.02)


async def use(cell, callback=None, mode="auto"):
    async with httpx2.AsyncClient(auth=Signed(cell.holder, cell.clock), timeout=60) as http:
        transport = streamable_http_client(AUDIENCE, http_client=http)
        async with Client(transport, mode=mode, elicitation_callback=callback) as client:
            return await client.call_tool("move_joint", MOVE)


def page(ask_id):
    return f"{ISSUER}/approvals/{ask_id}/page"


@pytest.mark.parametrize("mode", ["auto", "legacy"])
def test_a_client_without_elicitation_is_told_where_and_its_identical_retry_succeeds_once(cell, mode):
    async def scenario():
        first = await use(cell, mode=mode)
        await approve(cell, first.meta[DECISION_META]["approval_id"])
        return first, await use(cell, mode=mode), await use(cell, mode=mode)

    first, retry, third = with_cell(cell, scenario)
    told = first.meta[DECISION_META]
    assert first.is_error
    assert (told["decision"], told["reason"]) == ("DEFER", "TIER_NEEDS_APPROVAL")
    assert told["approval_id"] == told["ask_id"]
    assert told["url"] == page(told["approval_id"])
    assert told["retry_after_s"] == 1
    assert told["expires_at"] > cell.clock.wall_s()
    assert not retry.is_error
    assert third.meta[DECISION_META]["reason"] == "APPROVAL_USED"
    assert len(cell.arm.moves) == 1


def test_a_client_with_elicitation_shows_the_page_and_moves_in_one_call(cell):
    async def show(_, params):
        cell.shown.append((params.mode, params.url))
        (ask_id,) = cell.issuer.asks

        cell.voting = asyncio.create_task(approve(cell, ask_id))
        return ElicitResult(action="accept")

    result = with_cell(cell, lambda: use(cell, show))
    (ask_id,) = cell.issuer.asks
    assert not result.is_error
    assert cell.shown == [("url", page(ask_id))]
    assert len(cell.arm.moves) == 1
    effects = [r["body"]["decision"]["effect"] for r in cell.records("decision")]
    assert effects[0] == "DEFER"
    assert set(effects[1:]) == {"PERMIT"}  # more than one where a record outlasted its verdict


@pytest.mark.parametrize("content", [None, {"approved": True}])
def test_what_the_client_answers_is_no_approval(cell, content, monkeypatch):
    monkeypatch.setattr(deferred_result, "WAIT_S", 0.3)

    async def lie(_, params):
        cell.shown.append(params.url)
        return ElicitResult(action="accept", content=content)

    result = with_cell(cell, lambda: use(cell, lie))
    assert (result.meta[DECISION_META]["decision"], result.meta[DECISION_META]["reason"]) == (
        "DEFER",
        "TIER_NEEDS_APPROVAL",
    )
    assert cell.arm.moves == []
    assert len(cell.shown) == 1
    assert len(cell.issuer.asks) == 1


@pytest.mark.parametrize("action", ["decline", "cancel"])
def test_a_page_that_was_not_shown_is_not_waited_for(cell, action, monkeypatch):
    monkeypatch.setattr(deferred_result, "WAIT_S", 3_600.0)

    async def no(_, params):
        return ElicitResult(action=action)

    result = with_cell(cell, lambda: use(cell, no))
    assert result.meta[DECISION_META]["decision"] == "DEFER"
    assert cell.arm.moves == []


def test_a_client_of_the_older_protocol_has_the_page_in_an_error_and_its_retry_succeeds_once(cell):
    async def never(_, params):
        raise AssertionError("no question comes back on the call's own connection")

    async def required():
        async with httpx2.AsyncClient(auth=Signed(cell.holder, cell.clock), timeout=60) as http:
            transport = streamable_http_client(AUDIENCE, http_client=http)
            async with Client(transport, mode="legacy", elicitation_callback=never) as client:
                try:
                    return await client.call_tool("move_joint", MOVE)
                except MCPError as error:
                    return error

    async def scenario():
        first, again = await required(), await required()
        (ask_id,) = cell.issuer.asks
        await approve(cell, ask_id)
        return ask_id, first, again, await required(), await required()

    ask_id, first, again, retry, third = with_cell(cell, scenario)
    (shown,) = UrlElicitationRequiredError.from_error(first.error).elicitations
    assert (shown.mode, shown.url, shown.elicitation_id) == ("url", page(ask_id), ask_id)
    assert first.data[DECISION_META]["approval_id"] == again.data[DECISION_META]["approval_id"] == ask_id
    assert not retry.is_error
    assert third.data[DECISION_META]["reason"] == "APPROVAL_USED"
    assert len(cell.arm.moves) == 1


FORGED = {
    "made up": {"requestState": "ab" * 16, "inputResponses": {"approval": {"action": "accept"}}},
    "made up, without response": {"requestState": "ab" * 16},
    "enormous": {"requestState": "a" * 10_000, "inputResponses": {"approval": {"action": "accept"}}},
    "no state": {"inputResponses": {"approval": {"action": "accept"}}},
}


@pytest.mark.parametrize("name", FORGED)
def test_a_forged_retry_moves_nothing_and_waits_for_nothing(cell, name, monkeypatch):
    """The SDK seals our state and refuses any other; without one there is nothing to wait for."""
    monkeypatch.setattr(deferred_result, "WAIT_S", 3_600.0)
    body = call_body()
    body["params"] |= FORGED[name]
    answer = with_cell(cell, lambda: cell.post(cell.holder, body)).json()
    if "result" in answer:
        assert answer["result"]["_meta"][DECISION_META]["decision"] == "DEFER"
    else:
        assert answer["error"]["data"]["reason"] == "invalid_request_state"
    assert cell.arm.moves == []


def test_only_so_many_wait_at_once(cell, monkeypatch):
    monkeypatch.setattr(deferred_result, "WAITERS", 1)
    monkeypatch.setattr(deferred_result, "WAIT_S", 3_600.0)
    cell.start()

    async def show(_, params):
        cell.shown.append(params.url)
        return ElicitResult(action="accept")

    async def scenario():
        both = [asyncio.create_task(use(cell, show))]
        async with asyncio.timeout(30):
            while not cell.shown:  # two first calls at once would be one too many for the arm
                await asyncio.sleep(0.02)
            both.append(asyncio.create_task(use(cell, show)))
            (turned_away,), (waiting,) = await asyncio.wait(both, return_when=asyncio.FIRST_COMPLETED)
        (ask_id,) = cell.issuer.asks
        await approve(cell, ask_id)
        return await turned_away, await waiting

    turned_away, moved = with_cell(cell, scenario)
    assert turned_away.meta[DECISION_META]["decision"] == "DEFER"
    assert not moved.is_error
    assert len(cell.arm.moves) == 1
