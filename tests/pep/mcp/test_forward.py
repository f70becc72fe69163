"""Tool server without a robot: every call goes on whole, ticketed and recorded, and comes back as it comes."""

import asyncio
import contextlib
import json
import socket

import httpx2
import pytest
from mcp import Client
from mcp.client.streamable_http import streamable_http_client
from pep.base.clock import SystemClock
from pep.mcp.guard import DECISION_META
from pep.mcp.ticket_layer import TICKET
from tests.pep.kit import AUDIENCE, HOST, MOVE, PORT, FailingJournal, full_scope, reading, refusal_body
from tests.pep.mcp.forwarding import DOOR, GATEWAY_PORT, URL, House
from tests.pep.mcp.test_mcp import HEADERS, Signed, call_body

from capabilities.keys import keys
from capabilities.statements import ticket
from capabilities.values import trace_context
from pep.mcp import forward

pytestmark = [pytest.mark.e2e, pytest.mark.clause("TKT-10")]  # tickets live for half a second of real time


@pytest.fixture
def house(tmp_path):
    house = House(tmp_path, clock=SystemClock()).start()
    yield house
    house.close()


async def until(holds):
    async with asyncio.timeout(10):
        while not holds():
            await asyncio.sleep(0.01)


def refused(house, answer, status, reason):
    assert (answer.status_code, answer.json()) == (status, refusal_body(reason))
    assert [body["reason"] for body in house.door_records("refusal")] == [reason]


@pytest.mark.clause("TKT-8", "TKT-10")
@pytest.mark.parametrize("mode", ["auto", "legacy"])
def test_the_sdk_client_moves_the_arm_through_both(house, mode):
    holder = house.agent()
    result = house.run(lambda: house.use(holder, "move_joint", MOVE, mode=mode))
    assert result.structured_content["outcome"] == "reached"
    assert result.meta[DECISION_META]["decision"] == "PERMIT"
    assert house.arm.moves == [(*MOVE["q_rad"], 0.5, 1.4)]
    (passed,), (decision,) = house.door_records("ticket"), house.records("decision")
    assert passed["proof"] == decision["body"]["proof"], "one call, by one name in both journals"
    assert (passed["tool"], passed["agent"], passed["hop"]) == ("move_joint", holder.name, holder.hop_id)
    assert passed["gateway"] == URL


def test_a_denial_comes_back_whole(house):
    holder = house.agent(scope=full_scope(house.clock.wall_s(), speed_high=300_000))
    told = house.run(lambda: house.use(holder, "move_joint", MOVE)).meta[DECISION_META]
    assert (told["reason"], told["nearest_permitted"], told["set_by"]["agent"]) == (
        "LIMIT_EXCEEDED_BY_REQUEST",
        300_000,
        "robotic",
    )


def test_a_deferral_comes_back_with_its_question(house):
    house.physics.answer = reading(3, 2_500)
    told = house.run(lambda: house.use(house.agent(), "move_joint", MOVE)).meta[DECISION_META]
    assert (told["decision"], bool(told["ask_id"])) == ("DEFER", True)


def test_what_a_stranger_sends_goes_no_further(house):
    holder = house.agent()

    async def scenario():
        return [
            await house.post(None, call_body()),
            await house.post(holder, call_body(), key=keys.generate()),
            await house.post(holder, None, content=b"{"),
        ]

    answers = house.run(scenario)
    assert [(a.status_code, a.json()["reason"]) for a in answers] == [
        (401, "TOKEN_MISSING"),
        (401, "PROOF_WRONG_KEY"),
        (400, "BODY_MALFORMED"),
    ]
    assert house.gateway.came == []


# -- what goes on


async def silent(scope, receive, send):
    """A gateway that never answers, until the connection goes."""
    while (await receive())["type"] != "http.disconnect":
        pass


async def plain(scope, receive, send):
    """A gateway that answers with headers of every sort."""
    await receive()
    headers = [
        (b"content-type", b"application/json"),
        (b"www-authenticate", b"DPoP"),
        (b"mcp-session-id", b"7"),
        (b"connection", b"x-secret"),
        (b"x-secret", b"1"),
        (b"proxy-authenticate", b"Basic"),
        (b"server", b"inner"),
        (b"set-cookie", b"a=b"),
    ]
    await send({"type": "http.response.start", "status": 418, "headers": headers})
    await send({"type": "http.response.body", "body": b'{"x":1}'})


def test_the_request_goes_on_whole_and_nothing_is_added(house):
    holder = house.agent()
    extra = {
        TICKET: "of the caller's own",
        "x-other": "1",
        "cookie": "a=b",
        "te": "trailers",
        "keep-alive": "9",
        "user-agent": "t",
        "origin": f"http://{HOST}:{PORT}",
        "mcp-param-x": "y",
        "accept-encoding": "gzip",
    }

    async def scenario():
        await house.post(holder, call_body(), headers=extra)
        return await house.post(holder, call_body(), headers=extra)

    answer = house.run(scenario, plain)
    last = house.gateway.last
    headers = dict(last["headers"])
    assert len(headers) == len(last["headers"])
    assert set(headers) == {
        *HEADERS,
        "authorization",
        "dpop",
        "host",
        "origin",
        "content-length",
        "mcp-param-x",
        trace_context.HEADER,
        TICKET,
    }
    assert (last["method"], last["path"], json.loads(last["body"])) == ("POST", "/calls", call_body())
    assert headers["host"] == AUDIENCE.split("/")[2]
    assert {name: headers[name] for name in HEADERS} == HEADERS
    opened = ticket.open(headers[TICKET], {house.peps[DOOR]}, house.caps)
    assert opened.carried == ticket.RequestDigests.of(token=holder.text, proof=headers["dpop"], body=last["body"])
    # and back
    assert (answer.status_code, answer.content) == (418, b'{"x":1}')
    assert {"www-authenticate", "mcp-session-id", "content-type"} <= answer.headers.keys()
    assert not {"x-secret", "proxy-authenticate"} & answer.headers.keys()
    assert (answer.headers.get_list("server"), len(answer.headers.get_list("date"))) == ([], 1)


def test_each_request_has_a_ticket_of_its_own(house):
    async def scenario():
        for _ in range(2):
            await house.post(house.agent(), call_body("read_state", {}), headers={"mcp-name": "read_state"})

    house.run(scenario)
    issued = [dict(seen["headers"])[TICKET.encode()] for seen in house.gateway.came]
    names = [ticket.open(text.decode(), {house.peps[DOOR]}, house.caps).id for text in issued]
    assert len(set(names)) == 2
    assert names == [body["ticket"] for body in house.door_records("ticket")]


def test_a_header_twice_is_not_chosen_from(house):
    body = json.dumps(call_body()).encode()

    async def scenario():
        async with httpx2.AsyncClient(auth=Signed(house.agent(), house.clock), timeout=30) as http:
            return await http.post(AUDIENCE, content=body, headers=[*HEADERS.items(), ("mcp-name", "stop")])

    refused(house, house.run(scenario), 400, "BODY_MALFORMED")
    assert house.gateway.came == []


def test_foreign_host_and_origin_are_refused_where_the_tools_are(house):
    async def scenario():
        return [
            (await house.post(house.agent(), call_body(), headers=header)).status_code
            for header in ({"host": "evil.example"}, {"origin": "http://evil.example"})
        ]

    assert all(400 <= status < 500 for status in house.run(scenario))
    assert house.arm.moves == []


def test_a_tool_server_whose_clock_is_wrong_is_told_so(house):
    house.door_clock.by_s = -0.7
    answer = house.run(lambda: house.post(house.agent(), call_body()))
    assert (answer.status_code, answer.json()["reason"]) == (403, "VERDICT_EXPIRED")
    assert house.arm.moves == []


# -- on record first


def test_the_record_is_there_before_the_request(house):
    on_record = []
    house.gateway.before = lambda: on_record.append(len(house.door_records("ticket")))
    house.run(lambda: house.post(house.agent(), call_body()))
    assert on_record == [1]


def test_without_a_record_nothing_is_passed_on(house):
    house.edge._journal = FailingJournal(house.door_journal)
    answer = house.run(lambda: house.post(house.agent(), call_body()))
    assert (answer.status_code, answer.json()["reason"]) == (503, "RECORD_FAILED")
    assert house.gateway.came == []


def test_what_calls_no_tool_leaves_no_record(house):
    async def scenario():
        async with httpx2.AsyncClient(auth=Signed(house.agent(), house.clock), timeout=30) as http:
            async with Client(streamable_http_client(AUDIENCE, http_client=http)) as client:
                return {tool.name for tool in (await client.list_tools()).tools}

    assert {"move_joint", "stop"} <= house.run(scenario)
    assert house.door_records("ticket") == []


# -- a gateway that is not there


def test_a_gateway_that_is_gone(house):
    answer = house.run(lambda: house.post(house.agent(), call_body()), gateway=False)
    refused(house, answer, 503, "GATEWAY_UNREACHABLE")
    assert len(house.door_records("ticket")) == 1, "that it was tried is on record"


def test_a_gateway_that_does_not_begin_to_answer(house, monkeypatch):
    monkeypatch.setattr(forward, "ANSWER_S", 0.2)
    answer = house.run(lambda: house.post(house.agent(), call_body()), gateway=silent)
    refused(house, answer, 503, "GATEWAY_UNREACHABLE")


def test_a_refusal_for_a_gateway_that_is_gone_needs_no_journal(house):
    house.edge._journal = FailingJournal(house.door_journal, fail_from=1)
    answer = house.run(lambda: house.post(house.agent(), call_body()), gateway=False)
    assert (answer.status_code, answer.json()["reason"]) == (503, "GATEWAY_UNREACHABLE")


def test_an_answer_that_breaks_off_is_not_made_whole(house):
    async def breaks(scope, receive, send):
        await send({"type": "http.response.start", "status": 200, "headers": [(b"content-type", b"text/event-stream")]})
        await send({"type": "http.response.body", "body": b"data: 1\n\n", "more_body": True})

    async def scenario():
        with pytest.raises(httpx2.HTTPError):
            await house.post(house.agent(), call_body())

    house.run(scenario, gateway=breaks)
    (incident,) = house.door_records("incident")
    assert (incident["what"], incident["ticket"]) == ("gateway", house.door_records("ticket")[0]["ticket"])


def test_an_answer_comes_back_piece_by_piece(house, monkeypatch):
    """However long it lasts: the bound is on its beginning."""
    monkeypatch.setattr(forward, "ANSWER_S", 0.3)
    heard = []

    async def scenario():
        on = asyncio.Event()

        async def streams(scope, receive, send):
            headers = [(b"content-type", b"text/event-stream")]
            await send({"type": "http.response.start", "status": 200, "headers": headers})
            await send({"type": "http.response.body", "body": b"data: 1\n\n", "more_body": True})
            await on.wait()
            await send({"type": "http.response.body", "body": b"data: 2\n\n"})

        house.gateway.app = streams
        begun = house.clock.monotonic_ms()
        async with (
            httpx2.AsyncClient(auth=Signed(house.agent(), house.clock), timeout=30) as http,
            http.stream("POST", AUDIENCE, json=call_body(), headers=HEADERS) as answer,
        ):
            assert answer.headers["content-type"] == "text/event-stream"
            async for piece in answer.aiter_raw():
                heard.append(piece)
                await until(lambda: house.clock.monotonic_ms() - begun > 400)
                on.set()

    house.run(scenario, gateway=silent)
    assert heard == [b"data: 1\n\n", b"data: 2\n\n"]


def test_a_caller_that_goes_away_ends_its_call_at_the_gateway(house):
    async def scenario():
        house.arm.hold = asyncio.Event()
        call = asyncio.create_task(house.use(house.agent(), "move_joint", MOVE))
        await house.arm.hold.wait()
        call.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await call
        return await house.ended()

    assert house.run(scenario) == "cancelled"


def test_a_caller_that_goes_away_while_its_answer_comes_ends_it(house):
    """A legacy client's answer is a stream from the first moment."""

    async def scenario():
        house.arm.hold = asyncio.Event()
        call = asyncio.create_task(house.use(house.agent(), "move_joint", MOVE, mode="legacy"))
        await house.arm.hold.wait()
        call.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await call
        return await house.ended()

    assert house.run(scenario) == "cancelled"


# -- stops


def stop_post(house, holder=None, **more):
    return house.post(holder, call_body("stop", {}), headers={"mcp-name": "stop", **more})


@pytest.mark.clause("TKT-9", "TKT-10")
def test_a_stop_works_without_any_credentials(house):
    told = house.run(lambda: stop_post(house)).json()["result"]["structuredContent"]
    assert (told["outcome"], told["q_rad"], house.arm.stops) == ("stopped", [], 1)
    (passed,) = house.door_records("ticket")
    assert (passed["tool"], passed["agent"], passed["proof"]) == ("stop", None, "")


@pytest.mark.clause("TKT-9", "TKT-10")
def test_a_stop_needs_no_journal_no_right_clock_and_no_standing(house):
    house.edge._journal = FailingJournal(house.door_journal)
    house.door_clock.by_s = -60
    house.peps.clear()
    answer = house.run(lambda: stop_post(house, house.agent()))
    assert answer.json()["result"]["structuredContent"]["outcome"] == "stopped"
    assert house.arm.stops == 1


@pytest.mark.clause("TKT-9", "TKT-10")
def test_a_stop_with_a_header_twice_is_a_stop(house):
    body = json.dumps(call_body("stop", {})).encode()
    headers = [*{**HEADERS, "mcp-name": "stop"}.items(), ("dpop", "a"), ("dpop", "b")]

    async def scenario():
        async with httpx2.AsyncClient(timeout=30) as http:
            return await http.post(AUDIENCE, content=body, headers=headers)

    assert house.run(scenario).json()["result"]["structuredContent"]["outcome"] == "stopped"


@pytest.mark.clause("TKT-10")
def test_a_stop_goes_on_when_its_caller_has_gone(house):
    async def scenario():
        on, ended = asyncio.Event(), asyncio.get_running_loop().create_future()

        async def slow(scope, receive, send):
            house.gateway.app = plain
            stop = asyncio.create_task(on.wait())
            gone = asyncio.create_task(silent(scope, receive, send))
            await asyncio.wait({stop, gone}, return_when=asyncio.FIRST_COMPLETED)
            ended.set_result("stopped" if stop.done() else "cut off")
            gone.cancel()

        house.gateway.app = slow
        call = asyncio.create_task(stop_post(house))
        await until(lambda: house.gateway.came)
        call.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await call
        # Another call makes its whole way through both after the caller has gone: a cut connection would be seen.
        assert (await house.post(house.agent(), call_body())).status_code == 418
        on.set()
        async with asyncio.timeout(10):
            return await ended

    assert house.run(scenario, gateway=silent) == "stopped"


@pytest.mark.clause("TKT-10")
def test_a_stop_is_sent_again_over_a_connection_that_broke(house):
    """Once, and only a stop: a motion that is sent twice may move twice."""

    async def scenario(tool, arguments):
        came = []

        async def taken(reader, writer):
            head = await reader.readuntil(b"\r\n\r\n")
            size = next(
                int(line.split(b":")[1]) for line in head.lower().split(b"\r\n") if line.startswith(b"content-length")
            )
            came.append(await reader.readexactly(size))
            if len(came) == 2:
                writer.write(b"HTTP/1.1 200 OK\r\ncontent-length: 2\r\n\r\n{}")
                await writer.drain()
            writer.close()

        server = await asyncio.start_server(taken, HOST, GATEWAY_PORT)
        async with server:
            answer = await house.post(house.agent(), call_body(tool, arguments), headers={"mcp-name": tool})
        return answer.status_code, len(came)

    assert house.run(lambda: scenario("stop", {}), gateway=False) == (200, 2)
    assert house.run(lambda: scenario("move_joint", MOVE), gateway=False) == (503, 1)


def test_the_client_notices_a_peer_that_is_gone():
    """The system probes a silent connection: no bound on the length of a motion is needed."""

    async def scenario():
        async def answered(reader, writer):
            await reader.readuntil(b"\r\n\r\n")
            writer.write(b"HTTP/1.1 200 OK\r\ncontent-length: 0\r\n\r\n")
            await writer.drain()

        server = await asyncio.start_server(answered, HOST, GATEWAY_PORT)
        async with server, forward.client() as http, http.stream("POST", URL) as answer:
            own = answer.extensions["network_stream"].get_extra_info("socket")
            return [
                own.getsockopt(level, name)
                for level, name in (
                    (socket.SOL_SOCKET, socket.SO_KEEPALIVE),
                    (socket.IPPROTO_TCP, socket.TCP_KEEPIDLE),
                    (socket.IPPROTO_TCP, socket.TCP_KEEPINTVL),
                    (socket.IPPROTO_TCP, socket.TCP_KEEPCNT),
                )
            ]

    assert asyncio.run(scenario()) == [1, forward.PROBE_S, forward.PROBE_S, 2]
