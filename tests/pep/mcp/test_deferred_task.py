"""A deferred call as a task: bounded, once, stopped by its caller, and never begun without its record."""

import asyncio
import sqlite3
from contextlib import asynccontextmanager
from dataclasses import replace

import httpx2
import pytest
from mcp import Client, MCPError
from mcp.client.streamable_http import streamable_http_client
from pep.base.clock import SystemClock
from pep.journal import task_store
from pep.journal.task_store import TASKS, TaskState, TaskStore
from pep.mcp import guard as guard_module
from pep.mcp.decision_result import DECISION_META
from pep.people.deferral import AskState
from tests.e2e.task_client import Tasks, begun, ended, look
from tests.pep.kit import AUDIENCE, MOVE, reading
from tests.pep.mcp.test_mcp import Cell, Signed
from tests.pep.mcp.test_mcp_defer import approve, use, with_cell

pytestmark = pytest.mark.real_time
ANOTHER = {**MOVE, "q_rad": [0.01, *MOVE["q_rad"][1:]]}


class TaskCell(Cell):
    """The cell, whose deferred calls may be tasks."""

    def start(self):
        self.kept = TaskStore(self.tmp / TASKS)
        own = guard_module.guard
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr("tests.pep.mcp.test_mcp.guard", lambda *args, **named: own(*args, kept=self.kept, **named))
            super().start()
        self.physics.answer = reading(3, 2_500)
        self.holder = self.agent()
        return self

    @asynccontextmanager
    async def client(self, holder=None):
        async with httpx2.AsyncClient(auth=Signed(holder or self.holder, self.clock), timeout=60) as http:
            async with Client(streamable_http_client(AUDIENCE, http_client=http), extensions=[Tasks()]) as client:
                yield client


@pytest.fixture
def cell(request, tmp_path):
    made = TaskCell(tmp_path, clock=SystemClock(), timeout_ms=getattr(request, "param", 60_000)).start()
    yield made
    made.gate.close()
    made.journal.close()
    made.kept.close()


def ask_of(task):
    return task.meta[DECISION_META]["approval_id"]


def reason(looked):
    return looked.result["_meta"][DECISION_META]["reason"]


def test_of_looks_at_once_one_acts_and_the_others_see_it_at_work(cell):
    async def scenario():
        moving, letting, act = asyncio.Event(), asyncio.Event(), cell.arm.act

        async def held(*args):
            end = await act(*args)
            moving.set()
            await letting.wait()
            return end

        cell.arm.act = held
        async with cell.client() as client, cell.client() as beside:
            task = await begun(client, "move_joint", MOVE)
            await approve(cell, ask_of(task))
            first = asyncio.create_task(ended(client.session, task.task_id))
            await moving.wait()
            seen = [await look(beside.session, task.task_id) for _ in range(3)]
            letting.set()
            return seen, await first, await look(beside.session, task.task_id)

    seen, done, again = with_cell(cell, scenario)
    assert [each.status for each in seen] == ["working"] * 3
    assert (done.status, again.result) == ("completed", done.result)
    assert len(cell.arm.moves) == 1


def test_its_caller_cancels_an_act_that_has_begun(cell):
    async def scenario():
        cell.arm.hold = asyncio.Event()
        async with cell.client() as client, cell.client() as beside:
            task = await begun(client, "move_joint", MOVE)
            await approve(cell, ask_of(task))
            acting = asyncio.create_task(ended(client.session, task.task_id))
            await cell.arm.hold.wait()
            await look(beside.session, task.task_id, "tasks/cancel")
            return await acting

    assert with_cell(cell, scenario).status == "cancelled"
    assert len(cell.arm.moves) == 1
    assert asyncio.run(cell.ended()) == "cancelled"


def test_an_act_whose_caller_goes_away_is_not_begun_again(cell):
    async def scenario():
        cell.arm.hold = asyncio.Event()
        async with cell.client() as beside:
            async with cell.client() as client:
                task = await begun(client, "move_joint", MOVE)
                await approve(cell, ask_of(task))
                acting = asyncio.create_task(ended(client.session, task.task_id))
                await cell.arm.hold.wait()
                acting.cancel()
            async with asyncio.timeout(20):
                while cell.slot.holder is not None:
                    await asyncio.sleep(0.02)
            return await ended(beside.session, task.task_id)

    over = with_cell(cell, scenario)
    assert (over.status, over.result["isError"], reason(over)) == ("completed", True, "EFFECT_FAILED")
    assert len(cell.arm.moves) == 1


def test_an_act_that_an_earlier_process_left_is_not_begun_again(cell):
    async def scenario():
        async with cell.client() as client:
            task = await begun(client, "move_joint", MOVE)
            await approve(cell, ask_of(task))
            assert cell.kept.begin(task.task_id, at_ms=1)
            return await ended(client.session, task.task_id), await look(client.session, task.task_id)

    over, again = with_cell(cell, scenario)
    assert (over.status, reason(over), again.result) == ("completed", "EFFECT_FAILED", over.result)
    assert cell.arm.moves == []
    assert [record["body"]["reason"] for record in cell.records("refusal")] == ["EFFECT_FAILED"]


@pytest.mark.parametrize("cell", [300], indirect=True)
def test_silence_ends_a_task_and_asks_nobody_again(cell):
    async def scenario():
        async with cell.client() as client:
            task = await begun(client, "move_joint", MOVE)
            async with asyncio.timeout(10):
                while cell.asks.state_of(ask_of(task)) is AskState.OPEN:
                    await asyncio.sleep(0.02)
            told = await use(cell)  # the same call by hand hears of the end first; the next one would ask anew
            return told, await ended(client.session, task.task_id), await look(client.session, task.task_id)

    told, over, again = with_cell(cell, scenario)
    assert told.meta[DECISION_META]["reason"] == "APPROVAL_TIMEOUT"
    assert (over.status, reason(over), again.result) == ("completed", "APPROVAL_TIMEOUT", over.result)
    assert (cell.arm.moves, len(cell.issuer.asks)) == ([], 1)


def stopped(cell):
    cell.readiness.answer = replace(cell.readiness.answer, safety_mode=3)


def changed(cell):
    cell.registry.tools["move_joint"] = replace(cell.registry.tools["move_joint"], definition_digest="ab" * 32)


@pytest.mark.parametrize(
    ("since", "primitive", "denied", "seen"),
    [
        (stopped, "TEA-5", "ROBOT_SAFETY_STOP", ("robot", "safety_mode", 3)),
        (changed, "TEA-3", "TOOL_DEFINITION_CHANGED", ("tool", "approved_digest", "ab" * 32)),
    ],
)
def test_what_is_so_at_the_look_decides_and_not_what_was_so_at_the_call(cell, since, primitive, denied, seen):
    async def scenario():
        async with cell.client() as client:
            task = await begun(client, "move_joint", MOVE)
            await approve(cell, ask_of(task))
            since(cell)
            return await ended(client.session, task.task_id)

    over = with_cell(cell, scenario)
    told = over.result["_meta"][DECISION_META]
    assert (over.status, told["decision"], told["reason"], told["primitive"]) == (
        "completed",
        "DENY",
        denied,
        primitive,
    )
    evidence = cell.records("decision")[-1]["body"]["evidence"]
    assert evidence[seen[0]][seen[1]] == seen[2]
    assert cell.arm.moves == []


def test_a_look_whose_approval_was_used_meanwhile_waits_for_people_anew(cell):
    async def scenario():
        async with cell.client() as client:
            task = await begun(client, "move_joint", MOVE)
            await approve(cell, ask_of(task))
            used = await use(cell)
            waiting = await look(client.session, task.task_id)
            moved = len(cell.arm.moves)
            (anew,) = cell.issuer.asks.keys() - {ask_of(task)}
            await approve(cell, anew)
            return used, waiting, anew, moved, await ended(client.session, task.task_id)

    used, waiting, anew, moved, done = with_cell(cell, scenario)
    assert not used.is_error
    assert (waiting.status, anew in waiting.status_message, moved) == ("working", True, 1)
    assert (done.status, reason(done), len(cell.arm.moves)) == ("completed", "PERMITTED", 2)


def test_a_task_whose_question_was_lost_before_people_saw_it_puts_it_anew(cell):
    async def scenario():
        async with cell.client() as client:
            task = await begun(client, "move_joint", MOVE)
            cell.asks.refuse(ask_of(task), lost=True)
            waiting = await look(client.session, task.task_id)
            (anew,) = cell.issuer.asks.keys() - {ask_of(task)}
            await approve(cell, anew)
            return waiting, anew, await ended(client.session, task.task_id)

    waiting, anew, done = with_cell(cell, scenario)
    assert (waiting.status, anew in waiting.status_message) == ("working", True)
    assert (done.status, reason(done), len(cell.arm.moves)) == ("completed", "PERMITTED", 1)


def test_another_holder_of_the_same_agent_name_finds_nothing(cell):
    async def scenario():
        async with cell.client() as client:
            task = await begun(client, "move_joint", MOVE)
        for stranger in (cell.agent(), cell.agent(key=cell.holder.key, sponsor="bob")):
            async with cell.client(stranger) as client:
                for method in ("tasks/get", "tasks/cancel", "tasks/update"):
                    with pytest.raises(MCPError) as unknown:
                        await look(client.session, task.task_id, method)
                    assert unknown.value.code == -32602
        async with cell.client() as client:
            return await look(client.session, task.task_id)

    assert with_cell(cell, scenario).status == "working"
    assert len(cell.records("decision")) == 1, "a look decides nothing while people have not answered"


def test_a_caller_has_so_many_tasks_and_is_told_by_an_error_beyond_them(cell, monkeypatch):
    monkeypatch.setattr(task_store, "OF_A_CALLER", 1)

    async def scenario():
        async with cell.client() as client:
            first = await begun(client, "move_joint", MOVE)
            beyond = await begun(client, "move_joint", ANOTHER)
            await look(client.session, first.task_id, "tasks/cancel")
            third = await begun(client, "move_joint", ANOTHER)
            with pytest.raises(MCPError):
                await look(client.session, first.task_id)
            return beyond, third

    beyond, third = with_cell(cell, scenario)
    assert (beyond.is_error, beyond.meta[DECISION_META]["decision"]) == (True, "DEFER")
    assert third.status == "working"


def test_without_its_store_a_deferral_is_an_error_and_no_look_acts(cell):
    async def scenario():
        async with cell.client() as client:
            task = await begun(client, "move_joint", MOVE)
            await approve(cell, ask_of(task))
            cell.kept._database.execute("DROP TABLE tasks")
            with pytest.raises(MCPError) as broken:
                await look(client.session, task.task_id)
            return broken.value.code, await begun(client, "move_joint", ANOTHER)

    code, told = with_cell(cell, scenario)
    assert (code, told.meta[DECISION_META]["decision"], cell.arm.moves) == (-32603, "DEFER", [])


def test_a_result_that_is_too_long_to_keep_is_told_once(cell, monkeypatch):
    monkeypatch.setattr("pep.mcp.deferred_task.ANSWER_BYTES", 100)

    async def scenario():
        async with cell.client() as client:
            task = await begun(client, "move_joint", MOVE)
            await approve(cell, ask_of(task))
            return await ended(client.session, task.task_id), await look(client.session, task.task_id)

    done, again = with_cell(cell, scenario)
    assert (done.status, reason(done), again.status, again.error["code"]) == (
        "completed", "PERMITTED", "failed", -32603,
    )  # fmt: skip
    assert len(cell.arm.moves) == 1


def test_a_header_that_names_another_task_is_refused(cell):
    async def scenario():
        async with cell.client() as client:
            task = await begun(client, "move_joint", MOVE)
        meta = {
            "io.modelcontextprotocol/protocolVersion": "2026-07-28",
            "io.modelcontextprotocol/clientInfo": {"name": "raw", "version": "1"},
            "io.modelcontextprotocol/clientCapabilities": {"extensions": {"io.modelcontextprotocol/tasks": {}}},
        }
        body = {"jsonrpc": "2.0", "id": 1, "method": "tasks/get", "params": {"taskId": task.task_id, "_meta": meta}}
        return [
            (await cell.post(cell.holder, body, headers={"mcp-method": "tasks/get", "mcp-name": name})).json()
            for name in (task.task_id, "0" * 32)
        ]

    right, wrong = with_cell(cell, scenario)
    assert (right["result"]["status"], right["result"]["resultType"]) == ("working", "complete")
    assert wrong["error"]["code"] == -32020


def test_a_kept_task_lasts_over_processes_and_no_longer_than_its_time(tmp_path):
    store = TaskStore(tmp_path / TASKS)
    made = store.keep(caller="a", ask_id="q", call="{}", at_ms=1_000, ends_ms=2_000)
    assert (tmp_path / TASKS).stat().st_mode & 0o077 == 0
    store.close()
    store = TaskStore(tmp_path / TASKS)
    assert store.find(made.task_id, caller="a", at_ms=1_999) == made
    assert store.find(made.task_id, caller="b", at_ms=1_500) is None
    assert store.begin(made.task_id, at_ms=1_500) and not store.begin(made.task_id, at_ms=1_500)
    assert not store.cancel(made.task_id, at_ms=1_500)
    store.end(made.task_id, state=TaskState.ENDED, answer="[]", at_ms=1_600)
    store.end(made.task_id, state=TaskState.CANCELLED, answer="", at_ms=1_700)
    over = store.find(made.task_id, caller="a", at_ms=1_800)
    assert (over.state, over.answer, over.call) == (TaskState.ENDED, "[]", "")
    assert store.find(made.task_id, caller="a", at_ms=2_000) is None
    store.keep(caller="a", ask_id="r", call="{}", at_ms=2_000, ends_ms=3_000)
    store.close()
    with sqlite3.connect(tmp_path / TASKS) as database:
        assert database.execute("SELECT ask_id FROM tasks").fetchall() == [("r",)]
