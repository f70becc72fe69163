"""A deferred call over restarts of either side: a served plant, a real provider, the SDK's own client."""

from __future__ import annotations

import asyncio
import os
import signal
import subprocess
import sys
import time
from contextlib import asynccontextmanager

import httpx2
import pytest
from mcp import Client, MCPError
from mcp.client.streamable_http import streamable_http_client
from mcp_types import ElicitResult
from pep.mcp.decision_result import DECISION_META
from tests.e2e.task_client import Tasks, begun, ended, look
from tests.e2e.test_any_tool import Signed
from tests.e2e.test_stdio import DEADLINE_S, SERVER, TOP, Plant, approve
from tests.e2e.test_tool_gateway import in_time
from tests.ztpm_idp.test_process import Process, free_port

from ztpm_idp.client import Denied, Operator

pytestmark = [pytest.mark.e2e, pytest.mark.timeout(200)]


class Served(Plant):
    """A guarded server over HTTP, a process that can be begun again; its agent, and another one."""

    def __init__(self, provider, folder):
        super().__init__(provider, "sdk", folder, audience=f"http://127.0.0.1:{free_port()}/mcp")
        self.child = None
        with provider.operator() as alice:
            self.other = alice.new_agent("other", str(SERVER), role="worker")
            self.lent_other = self.lend(alice, self.other)

    def start(self):
        command = [sys.executable, str(SERVER), self.kind, str(self.config), "http"]
        with (self.folder / "log").open("a") as log:
            self.child = subprocess.Popen(command, cwd=TOP, env=self.command.env, stdout=log, stderr=log)
        until = time.monotonic() + DEADLINE_S
        with httpx2.Client() as http:
            while True:
                assert time.monotonic() < until and self.child.poll() is None, (self.folder / "log").read_text()
                try:
                    if http.get(self.audience).status_code == 401:
                        return self
                except httpx2.TransportError:
                    time.sleep(0.05)  # a process that starts has no other event for a stranger

    def stop(self):
        """It ends at once, as in a power cut."""
        self.child.kill()
        self.child.wait()

    def opened(self):
        """Acts of the tool."""
        return (self.folder / "log").read_text().count("opened ")

    @asynccontextmanager
    async def client(self, agent=None, lent=None, extensions=(Tasks(),), **options):
        auth = Signed((lent or self.lent).token, (agent or self.agent).key, self.audience)
        async with httpx2.AsyncClient(auth=auth, timeout=30) as http:
            async with Client(
                streamable_http_client(self.audience, http_client=http), extensions=list(extensions), **options
            ) as client:
                yield client

    def within(self, scenario, **options):
        """Result of a scenario with a client of its own, begun anew as after its restart."""

        async def once():
            async with self.client(**options) as client:
                return await scenario(client)

        return asyncio.run(once())

    def task(self, percent):
        """The task that a call becomes, and its question."""
        task = self.within(lambda client: begun(client, "open_valve", {"percent": percent}))
        assert (task.status, task.poll_interval_ms) == ("working", 1_000)
        assert 600_000 < task.ttl_ms <= 1_300_000
        told = task.meta[DECISION_META]
        assert told["decision"] == "DEFER"
        return task.task_id, told["approval_id"]

    def refused(self, scenario, **options):
        """Code of the error of a scenario."""

        async def once():
            async with self.client(**options) as client:
                with pytest.raises(MCPError) as error:
                    await scenario(client)
            return error.value.code

        return asyncio.run(once())


@pytest.fixture(scope="module")
def plant(tmp_path_factory):
    folder = tmp_path_factory.mktemp("deferred")
    made = Served(Process(folder).start(), folder)
    try:
        yield made.start()
    finally:
        made.stop()
        if made.provider.popen.poll() is None:
            made.provider.end(signal.SIGKILL)


def told_of(looked):
    return looked.result["_meta"][DECISION_META]


def test_a_task_is_done_once_by_the_look_after_the_approval_over_restarts_of_both_sides(plant):
    before = plant.opened()
    task_id, ask_id = plant.task(85)
    assert plant.task(85) == (task_id, ask_id), "the same question is one task"
    looked = plant.within(lambda client: look(client.session, task_id))
    assert (looked.status, ask_id in looked.status_message) == ("working", True)

    # nobody else finds it, and no client that cannot look after one
    named = lambda client: look(client.session, task_id)  # noqa: E731
    assert plant.refused(named, agent=plant.other, lent=plant.lent_other) == -32602
    assert plant.refused(lambda client: look(client.session, "0" * 32)) == -32602
    assert plant.refused(lambda client: look(client.session, task_id, "tasks/cancel"), extensions=()) == -32021
    assert plant.within(lambda client: look(client.session, task_id)).status == "working"

    # an answer of the client's own host is none, and the provider may be away for a while
    update = {"approval": {"action": "accept"}}
    plant.within(lambda client: look(client.session, task_id, "tasks/update", input_responses=update))
    os.kill(plant.provider.popen.pid, signal.SIGSTOP)
    try:
        until = time.monotonic() + 3.0
        while time.monotonic() < until:
            assert plant.within(lambda client: look(client.session, task_id)).status == "working"
    finally:
        os.kill(plant.provider.popen.pid, signal.SIGCONT)
    assert plant.opened() == before

    approve(plant, ask_id)
    plant.stop()
    plant.start()
    done = plant.within(lambda client: ended(client.session, task_id))
    assert (done.status, done.result["structuredContent"], told_of(done)["decision"]) == (
        "completed", {"result": 85.0}, "PERMIT",
    )  # fmt: skip
    assert {"request_digest", "tool_digest"} <= told_of(done).keys()
    assert plant.opened() == before + 1
    plant.stop()
    plant.start()
    again = plant.within(lambda client: look(client.session, task_id))
    assert (again.status, again.result) == ("completed", done.result)
    another, asked = plant.task(85)
    assert another != task_id and asked != ask_id, "the approval is used, and people are asked anew"
    assert plant.opened() == before + 1


def test_a_page_and_an_error_lead_to_one_act_each_over_a_restart_in_between(plant):
    before, pages = plant.opened(), []

    async def show(context, asked):
        pages.append(asked.url)
        await asyncio.to_thread(plant.stop)
        await asyncio.to_thread(plant.start)
        for ask_id in (asked.url.split("/approvals/")[1].split("/")[0], error["approval_id"]):
            await asyncio.to_thread(approve, plant, ask_id)
        return ElicitResult(action="accept")

    call = lambda percent: lambda client: in_time(client, "open_valve", {"percent": percent})  # noqa: E731
    error = plant.within(call(91), extensions=()).meta[DECISION_META]
    assert (error["decision"], error["retry_after_s"], plant.opened()) == ("DEFER", 1, before)
    done = plant.within(call(92), extensions=(), elicitation_callback=show)
    assert (done.structured_content, len(pages)) == ({"result": 92.0}, 1)

    async def retried():
        async with plant.agent.tools(plant.audience, plant.lent.token, patience_s=DEADLINE_S) as tools:
            while True:
                try:
                    return await tools.call("open_valve", {"percent": 91})
                except Denied as denied:
                    assert denied.reason == "VERDICT_EXPIRED"  # a machine too slow for the verdict's lifetime

    assert asyncio.run(retried()).structured_content == {"result": 91.0}
    for percent in (91, 92):
        assert plant.within(call(percent), extensions=()).meta[DECISION_META]["decision"] == "DEFER"
    assert plant.opened() == before + 2


def test_a_cancelled_task_never_happens_whatever_people_say(plant):
    before = plant.opened()
    task_id, ask_id = plant.task(86)
    for _ in range(2):
        plant.within(lambda client: look(client.session, task_id, "tasks/cancel"))
    approve(plant, ask_id)
    assert plant.within(lambda client: look(client.session, task_id)).status == "cancelled"
    assert plant.opened() == before


def test_a_denied_task_is_over_and_asks_nobody_again(plant):
    before = plant.opened()
    task_id, ask_id = plant.task(87)
    until = time.monotonic() + DEADLINE_S
    with Operator("carol", plant.provider.private["carol"], plant.provider.issuer) as carol:
        while ask_id not in {each["ask_id"] for each in carol.approvals()}:
            assert time.monotonic() < until
            time.sleep(0.05)
        carol.deny(ask_id)
        done = plant.within(lambda client: ended(client.session, task_id))
        assert (done.status, done.result["isError"], told_of(done)["reason"]) == (
            "completed", True, "APPROVAL_DENIED",
        )  # fmt: skip
        assert plant.within(lambda client: look(client.session, task_id)).result == done.result
        assert not [
            each for each in carol.approvals() if each["operation"] == "open_valve" and each["ask_id"] == ask_id
        ]
    assert plant.opened() == before


def test_an_approved_task_does_nothing_for_a_token_that_was_revoked_since(plant):
    before = plant.opened()
    with plant.provider.operator() as alice:
        lent = plant.lend(alice)
        task = plant.within(lambda client: begun(client, "open_valve", {"percent": 89}), lent=lent)
        approve(plant, task.meta[DECISION_META]["approval_id"])
        alice.revoke("token", lent.token_id, "enough")
    until = time.monotonic() + DEADLINE_S
    body = {"jsonrpc": "2.0", "id": 1, "method": "tasks/get", "params": {"taskId": task.task_id}}
    with httpx2.Client(auth=Signed(lent.token, plant.agent.key, plant.audience)) as http:
        # Without a client's abilities nothing is looked at, so only the edge answers here.
        while http.post(plant.audience, json=body).status_code != 401:
            assert time.monotonic() < until
    assert plant.opened() == before
