"""Checks of the MCP conformance suite that a server passes by itself and behind a gateway; sessions there."""

from __future__ import annotations

import asyncio
import contextlib
import json
import time

import httpx2
import pytest
from mcp import MCPError, types
from mcp.client.subscriptions import ResourceUpdated, SubscriptionLost, ToolsListChanged
from mcp.types import METHOD_NOT_FOUND
from pep.mcp.gateway.paired_session import NOTICE_BYTES, NOTICES, QUESTION_BYTES, QUESTIONS
from pep.mcp.gateway.paired_session import WATCHED as WATCHED_MOST
from pep.mcp.guard import DECISION_META
from pep.mcp.session_layer import HOLDER_SESSIONS, HOLDER_STREAMS
from tests.e2e.conformance.front import Everything
from tests.e2e.conformance.signer import signing
from tests.e2e.conformance.suite import checked, failed, passed
from tests.e2e.test_any_tool import ACCEPTED, DEADLINE_S, Signed
from tests.e2e.test_tool_gateway import in_time

pytestmark = [pytest.mark.e2e, pytest.mark.timeout(240)]
DIFFERENT = {
    # A stream is between two neighbours: the gateway takes the server's up again by itself, and keeps its client's open.
    "2025-11-25": {
        ("server-sse-polling", "server-sse-disconnect-resume", "ServerDisconnectResume"),
        ("server-sse-polling", "server-sse-priming-event", "ServerSendsPrimingEvent"),
        ("server-sse-polling", "server-sse-retry-field", "ServerSendsRetryField"),
    },
    "2026-07-28": set(),
}
"""Checks that no gateway passes by its nature; none of their scenarios fails."""
AGAIN = 3
"""Attempts: on a busy machine a verdict comes too late, and the suite waits half a second for a stream."""
PROCESS_S = 0.2
"""A call that takes as long as this has waited for a process."""
WATCHED = "test://watched-resource"


@pytest.fixture(scope="module")
def front(tmp_path_factory):
    made = Everything(tmp_path_factory.mktemp("everything"))
    try:
        made.serve()
        made.write()
        made.pinned()
        yield made.start()
    finally:
        made.end()


@pytest.mark.parametrize("revision", DIFFERENT)
def test_what_a_server_passes_by_itself_it_passes_behind_the_gateway(front, revision):
    bare = checked(front.bare, revision)
    # Nothing is left out: all but the extension of tasks, which the server does not have.
    assert {each for each in failed(bare) if not each.startswith("tasks-")} == set()
    assert passed(bare) > DIFFERENT[revision]
    agent, token = front.holder("suite")
    with signing(front.audience, token, agent.key) as url:
        behind = set()
        for _ in range(AGAIN):
            told = checked(url, revision)
            behind |= passed(told)
            if passed(bare) - behind == DIFFERENT[revision]:
                break
    missed = passed(bare) - behind
    assert missed == DIFFERENT[revision], {key: told.get(key) for key in missed}
    assert not {key[0] for key in DIFFERENT[revision]} & failed(told)


class Sessions:
    """Raw requests of the older protocol."""

    def __init__(self, front, agent, token):
        self.http = httpx2.Client(auth=Signed(token, agent.key, front.audience), timeout=30)
        self.url = front.audience

    def post(self, body, session=None):
        headers = ACCEPTED | ({} if session is None else {"mcp-session-id": session})
        return self.http.post(self.url, json={"jsonrpc": "2.0"} | body, headers=headers)

    def opened(self):
        hello = {"protocolVersion": "2025-11-25", "capabilities": {}, "clientInfo": {"name": "raw", "version": "1"}}
        return self.post({"id": 1, "method": "initialize", "params": hello}).headers["mcp-session-id"]

    def ping(self, session):
        return self.post({"id": 2, "method": "ping"}, session).status_code


def test_a_session_is_of_the_key_that_opened_it_and_a_holder_has_so_many(front):
    one, other = (Sessions(front, *front.holder(name)) for name in ("one", "other"))
    first = one.opened()
    assert (one.ping(first), other.ping(first)) == (200, 404)
    # A session is no authority.
    assert httpx2.post(front.audience, json={}, headers=ACCEPTED | {"mcp-session-id": first}).status_code == 401
    kept = [one.opened() for _ in range(HOLDER_SESSIONS)]
    assert (one.ping(first), {one.ping(each) for each in kept}) == (404, {200})


def client(front, holder, mode="legacy", **options):
    agent, token = holder
    return front.caller(agent, token, mode=mode, **options)


def says(text):
    async def sampled(context, params):
        content = types.TextContent(type="text", text=text)
        return types.CreateMessageResult(role="assistant", content=content, model="m")

    return sampled


def test_a_server_asks_the_client_that_it_works_for_and_no_other(front):
    holders = [front.holder(f"asked-{number}") for number in range(3)]
    prompt = {"prompt": "who are you?"}

    async def asked():
        async with (
            client(front, holders[0], sampling_callback=says("Ada")) as ada,
            client(front, holders[1], sampling_callback=says("Bob")) as bob,
            client(front, holders[2]) as mute,
        ):
            both = [in_time(each, "test_sampling", prompt) for each in (ada, bob)]
            told = [each.content[0].text for each in await asyncio.gather(*both)]
            assert told == ["LLM response: Ada", "LLM response: Bob"]
            # One process beside that of all: it is of who comes first, and nobody can be asked over the other.
            first = await in_time(bob, "desk_test_sampling", prompt)
            assert first.content[0].text == "LLM response: Bob"
            with pytest.raises(MCPError):
                await in_time(ada, "desk_test_sampling", prompt)
            # A server hears what this client can do, and cannot ask for more.
            for each, known in ((mute, []), (ada, ["sampling"])):
                said = (
                    (await in_time(each, "test_declared", {}, meta={"example/kept": 1, "dev.ztpm/other": 1}))
                    .content[0]
                    .text
                )
                declared, headers, meta = json.loads(said)
                assert (list(declared), set(meta) - {"traceparent"}) == (known, {"example/kept"})
                assert not {"authorization", "dpop"} & set(headers)
            for each, tool, arguments in (
                (mute, "test_sampling", prompt),
                (ada, "test_elicitation", {"message": "who?"}),
            ):
                with pytest.raises(MCPError) as refused:
                    await in_time(each, tool, arguments)
                assert refused.value.code == METHOD_NOT_FOUND

    asyncio.run(asked())


def test_no_verdict_waits_for_the_connection_that_its_caller_gets(front):
    """It is a process, which starts in some ten times a verdict's lifetime."""
    holder = front.holder("first")

    async def first():
        async with client(front, holder) as caller:
            began = time.monotonic()
            answer = await caller.call_tool("desk_test_touch_resource", {"uri": WATCHED})
            return time.monotonic() - began, answer.meta[DECISION_META]["reason"]

    # A process may still be that of the client before, and a machine that does much else late for other reasons.
    answers = [asyncio.run(first()) for _ in range(6)]
    assert "PERMITTED" in {reason for took, reason in answers[1:] if took > PROCESS_S}, answers


class Heard:
    """Notices that reach a client."""

    def __init__(self):
        self.all = []

    async def __call__(self, message):
        self.all.append(getattr(message, "method", message))

    async def has(self, method):
        async with asyncio.timeout(DEADLINE_S):
            while method not in self.all:
                await asyncio.sleep(0.02)


def test_a_client_of_the_older_protocol_hears_what_it_set_and_nothing_of_others(front):
    holders = [front.holder(f"hears-{number}") for number in range(2)]
    touch = {"uri": WATCHED}

    async def used():
        one, other = Heard(), Heard()
        async with (
            client(front, holders[0], message_handler=one) as watching,
            client(front, holders[1], message_handler=other) as beside,
        ):
            subscribe = types.SubscribeRequest(params=types.SubscribeRequestParams(uri=WATCHED))
            unsubscribe = types.UnsubscribeRequest(params=types.UnsubscribeRequestParams(uri=WATCHED))
            errors = types.SetLevelRequest(params=types.SetLevelRequestParams(level="error"))
            await watching.session.send_request(subscribe, types.EmptyResult)
            await beside.session.send_request(errors, types.EmptyResult)
            for each in (watching, beside):
                await in_time(each, "test_tool_with_logging", {})
            await in_time(beside, "test_touch_resource", touch)
            await one.has("notifications/resources/updated")
            await one.has("notifications/message")
            await in_time(watching, "test_trigger_tool_change", {})
            await one.has("notifications/tools/list_changed")
            await watching.session.send_request(unsubscribe, types.EmptyResult)
            one.all.clear()
            await in_time(beside, "test_touch_resource", touch)
            await in_time(watching, "test_tool_with_logging", {})  # what comes after it has come
            await one.has("notifications/message")
            assert "notifications/resources/updated" not in one.all
            assert other.all == []

    asyncio.run(used())


def test_questions_notices_and_streams_are_bounded(front):
    asking, listening = front.holder("bounded"), front.holder("listens-often")

    async def tried():
        heard = Heard()
        async with client(front, asking, sampling_callback=says("yes"), message_handler=heard) as asked:

            async def answered(times, size):
                return int((await in_time(asked, "test_asks", {"times": times, "size": size})).content[0].text)

            assert (await answered(QUESTIONS + 4, 10), await answered(1, QUESTION_BYTES)) == (QUESTIONS, 0)
            assert await answered(1, 10) == 1
            await in_time(asked, "test_logs", {"times": 1, "size": NOTICE_BYTES})
            began = time.monotonic()
            await in_time(asked, "test_logs", {"times": 8 * NOTICES, "size": 10})
            await heard.has("notifications/message")
            await in_time(asked, "test_simple_text", {})
            assert len(heard.all) <= (time.monotonic() - began + 2) * NOTICES
            for number in range(WATCHED_MOST + 1):
                params = types.SubscribeRequestParams(uri=f"test://watched/{number}")
                subscribe = asked.session.send_request(types.SubscribeRequest(params=params), types.EmptyResult)
                with contextlib.nullcontext() if number < WATCHED_MOST else pytest.raises(MCPError):
                    await subscribe
        async with client(front, listening, "2026-07-28") as often, contextlib.AsyncExitStack() as open_ones:
            for _ in range(HOLDER_STREAMS):
                await open_ones.enter_async_context(often.listen(tools_list_changed=True))
            with pytest.raises((MCPError, SubscriptionLost)):
                await open_ones.enter_async_context(often.listen(tools_list_changed=True))

    asyncio.run(tried())


def test_changes_of_a_server_of_the_older_protocol_reach_clients_of_the_newer_one(front):
    listener, toucher = front.holder("listens-anew"), front.holder("touches-anew")

    async def listened():
        async with client(front, listener, "2026-07-28") as hearing, client(front, toucher, "2026-07-28") as touching:
            async with hearing.listen(resource_subscriptions=[WATCHED], tools_list_changed=True) as changes:
                heard = set()
                for tool, arguments in (("touch_resource", {"uri": WATCHED}), ("trigger_tool_change", {})):
                    await in_time(touching, f"desk_test_{tool}", arguments)
                    async with asyncio.timeout(DEADLINE_S):
                        heard.add(await anext(changes))
                assert heard == {ResourceUpdated(WATCHED), ToolsListChanged()}

    asyncio.run(listened())


def test_a_stream_of_changes_ends_with_the_authority_of_its_holder(front):
    listener, toucher = front.holder("listens"), front.holder("touches")

    async def listened():
        async with client(front, listener, "2026-07-28") as hearing, client(front, toucher, "2026-07-28") as touching:
            async with hearing.listen(resource_subscriptions=[WATCHED]) as changes:
                await in_time(touching, "test_trigger_tool_change", {})  # nobody asked to hear of it
                await in_time(touching, "test_touch_resource", {"uri": "test://static-text"})
                await in_time(touching, "test_touch_resource", {"uri": WATCHED})
                async with asyncio.timeout(DEADLINE_S):
                    assert await anext(changes) == ResourceUpdated(WATCHED)
                    await asyncio.to_thread(revoke, listener[0])
                    with pytest.raises(SubscriptionLost):
                        await anext(changes)

    def revoke(agent):
        with front.provider.operator() as alice:
            alice.revoke("agent", agent.id, "enough")

    asyncio.run(listened())
    # Of the older protocol it is the stream that a client opens for what comes later.
    reader = front.holder("reads")
    raw = Sessions(front, *reader)
    headers = {"accept": "text/event-stream", "mcp-session-id": raw.opened()}
    with raw.http.stream("GET", raw.url, headers=headers) as stream:
        assert stream.status_code == 200
        revoke(reader[0])
        assert list(stream.iter_raw()) == []
