"""Requests that reach the gateway of a robot: a ticketed call, this one and once; and every stop."""

import json

import pytest
from capabilities.statements.ticket import RequestDigests
from pep.base.clock import SystemClock
from pep.journal.replay_cache import ReplayCache
from pep.mcp.body_screen import BODY_BYTES
from pep.mcp.ticket_layer import TICKET
from tests.pep.kit import AUDIENCE, FailingJournal, refusal_body
from tests.pep.mcp.forwarding import URL, House, Shifted
from tests.pep.mcp.test_mcp import HEADERS, call_body

from capabilities.keys import keys
from capabilities.statements import ticket

pytestmark = [pytest.mark.e2e, pytest.mark.clause("TKT-8")]  # tickets live for half a second of real time


@pytest.fixture
def house(tmp_path):
    house = House(tmp_path, clock=SystemClock()).start()
    yield house
    house.close()


class Request:
    """A signed request to move, and a ticket for exactly it."""

    def __init__(self, house, rpc=None, **proof):
        self.house, self.holder = house, house.agent()
        self.body = json.dumps(rpc or call_body()).encode()
        self.proof = self.holder.proof(self.body, at=house.clock.wall_s(), **proof)
        self.headers = {**HEADERS, "authorization": f"DPoP {self.holder.text}", "dpop": self.proof}

    @property
    def carried(self):
        return RequestDigests.of(token=self.holder.text, proof=self.proof, body=self.body)

    def ticket(self, **changes):
        return self.house.ticket(self.carried, **changes)

    async def sent(self, **changes):
        """Sent with a good ticket, unless the test says otherwise."""
        given = {"body": self.body, "headers": self.headers, **changes}
        if "ticket" not in given:
            given["ticket"] = self.ticket()
        return await self.house.knock(given.pop("body"), given.pop("headers"), **given)


def refused(house, answer, reason, clause=None, status=403):
    assert (answer.status_code, answer.json()) == (status, refusal_body(reason))
    (record,) = [r["body"] for r in house.records("refusal")]
    assert (record["reason"], record["status"], record["where"].get("clause")) == (reason, status, clause)
    assert record["evidence"]["chain"] == "not collected"
    assert house.arm.moves == []
    assert house.records("decision") == []


def test_with_a_ticket_the_call_is_decided_as_ever(house):
    answer = house.run_behind(lambda: Request(house).sent())
    assert answer.json()["result"]["structuredContent"]["outcome"] == "reached"
    assert len(house.arm.moves) == 1
    (decision,) = house.records("decision")
    assert decision["body"]["decision"]["effect"] == "PERMIT"


def test_a_stranger_with_good_token_and_proof_has_no_ticket(house):
    refused(house, house.run_behind(lambda: Request(house).sent(ticket=None)), "TICKET_MISSING")


@pytest.mark.clause("TKT-6", "TKT-8")
@pytest.mark.parametrize("age_s", [0.6, 3.0, -0.4, -4.0])
def test_a_ticket_of_another_moment(house, age_s):
    async def scenario():
        request = Request(house)
        return await request.sent(ticket=request.ticket(at=house.clock.wall_s() - age_s))

    refused(house, house.run_behind(scenario), "VERDICT_EXPIRED", "TKT-6")


@pytest.mark.clause("TKT-7")
def test_a_ticket_is_good_once(house):
    async def scenario():
        request = Request(house)
        text = request.ticket()
        return [await request.sent(ticket=text) for _ in range(2)]

    first, second = house.run_behind(scenario)
    assert first.status_code == 200
    assert (second.status_code, second.json()["reason"]) == (403, "REPLAYED")
    assert len(house.arm.moves) == 1
    (record,) = house.records("refusal")
    assert record["body"]["where"]["clause"] == "TKT-7"


@pytest.mark.clause("TKT-7")
def test_a_ticket_is_used_up_by_a_request_that_is_refused_behind_it(house):
    async def scenario():
        request = Request(house, key=keys.generate())
        text = request.ticket()
        return [await request.sent(ticket=text) for _ in range(2)]

    first, second = house.run_behind(scenario)
    assert (first.status_code, first.json()["reason"]) == (401, "PROOF_WRONG_KEY")
    assert (second.status_code, second.json()["reason"]) == (403, "REPLAYED")


@pytest.mark.clause("TKT-7")
def test_a_store_that_is_full_refuses(house):
    house.layer._replay = ReplayCache(house.clock, capacity=0)
    refused(house, house.run_behind(lambda: Request(house).sent()), "REPLAYED", "TKT-7")


def test_a_stolen_tool_server_cannot_send_a_call_again(house):
    """With a new ticket of its own, the caller's proof is still good once."""

    async def scenario():
        request = Request(house)
        return [await request.sent(ticket=request.ticket()) for _ in range(2)]

    first, second = house.run_behind(scenario)
    assert first.status_code == 200
    assert (second.status_code, second.json()["reason"]) == (401, "REPLAYED")
    assert len(house.arm.moves) == 1


def test_a_stolen_tool_server_cannot_change_a_call(house):
    """It may sign a ticket for what it likes: the caller's proof is over the body."""

    async def scenario():
        request = Request(house)
        body = request.body.replace(b"0.5", b"1.0")
        changed = RequestDigests.of(token=request.holder.text, proof=request.proof, body=body)
        return await request.sent(body=body, ticket=house.ticket(changed))

    answer = house.run_behind(scenario)
    assert (answer.status_code, answer.json()["reason"]) == (401, "PROOF_NOT_FOR_THIS_REQUEST")
    assert house.arm.moves == []


@pytest.mark.parametrize("method", ["PUT", "DELETE", "GET"])
def test_a_stolen_tool_server_cannot_change_the_method(house, method):
    async def scenario():
        request = Request(house)
        body = b"" if method != "PUT" else request.body
        proof = request.holder.proof(body, at=house.clock.wall_s())
        carried = RequestDigests.of(token=request.holder.text, proof=proof, body=body)
        return await request.sent(
            body=body, headers={**request.headers, "dpop": proof}, ticket=house.ticket(carried), method=method
        )

    answer = house.run_behind(scenario)
    assert (answer.status_code, answer.json()["reason"]) == (401, "PROOF_NOT_FOR_THIS_REQUEST")


def test_a_stolen_tool_server_has_no_authority_of_its_own(house):
    async def scenario():
        body = json.dumps(call_body()).encode()
        return await house.knock(
            body, HEADERS, ticket=house.ticket(RequestDigests.of(token=None, proof=None, body=body))
        )

    answer = house.run_behind(scenario)
    assert (answer.status_code, answer.json()["reason"]) == (401, "TOKEN_MISSING")
    assert house.arm.moves == []


OTHERS = {
    "another body": lambda r: {"body": r.body + b" "},
    "another proof": lambda r: {"headers": {**r.headers, "dpop": r.holder.proof(r.body, at=r.house.clock.wall_s())}},
    "another token": lambda r: {"headers": {**r.headers, "authorization": f"DPoP {r.house.agent().text}"}},
    "no proof": lambda r: {"headers": {n: v for n, v in r.headers.items() if n != "dpop"}},
    "a bearer": lambda r: {"headers": {**r.headers, "authorization": f"Bearer {r.holder.text}"}},
}


@pytest.mark.clause("TKT-5")
@pytest.mark.parametrize("name", OTHERS)
def test_the_ticket_of_another_request(house, name):
    async def scenario():
        request = Request(house)
        return await request.sent(**OTHERS[name](request))

    refused(house, house.run_behind(scenario), "NOT_WHAT_WAS_DECIDED", "TKT-5")


@pytest.mark.clause("TKT-4")
@pytest.mark.parametrize("changes", [{"url": URL + "2"}, {"audience": AUDIENCE + "2"}])
def test_a_ticket_for_somewhere_else(house, changes):
    async def scenario():
        request = Request(house)
        return await request.sent(ticket=request.ticket(**changes))

    refused(house, house.run_behind(scenario), "NOT_WHAT_WAS_DECIDED", "TKT-4")


@pytest.mark.clause("TKT-1", "TKT-2")
@pytest.mark.parametrize(
    ("changes", "clause"),
    [({"key": keys.generate()}, "TKT-1"), ({"pep": "door-2"}, "TKT-2"), ({"pep": "door-3"}, "TKT-2")],
)
def test_a_ticket_by_another_key(house, changes, clause):
    async def scenario():
        request = Request(house)
        return await request.sent(ticket=request.ticket(**changes))

    refused(house, house.run_behind(scenario), "STATEMENT_UNTRUSTED", clause)


@pytest.mark.clause("TKT-3")
def test_the_ticket_of_a_revoked_tool_server(house):
    house.feed.revoke("key", keys.thumbprint(house.peps["door-1"]))
    refused(house, house.run_behind(lambda: Request(house).sent()), "STATEMENT_UNTRUSTED", "TKT-3")


def test_a_tool_server_that_was_taken_from_the_registry_is_a_stranger(house):
    del house.peps["door-1"]
    refused(house, house.run_behind(lambda: Request(house).sent()), "STATEMENT_UNTRUSTED", "TKT-1")


@pytest.mark.parametrize("text", ["", "x", "a.b.c", "\x7f", "A" * 3_000])
def test_what_is_no_ticket(house, text):
    refused(house, house.run_behind(lambda: Request(house).sent(ticket=text)), "STATEMENT_MALFORMED", "TKT-1")


@pytest.mark.parametrize("name", [TICKET, "authorization", "dpop", "mcp-name", "x-anything"])
def test_a_header_twice(house, name):
    async def scenario():
        request = Request(house)
        headers = {**request.headers, name.upper(): dict(request.headers).get(name, request.ticket())}
        if name == "x-anything":
            headers |= {"x-anything": "1"}
        return await request.sent(headers=headers)

    refused(house, house.run_behind(scenario), "BODY_MALFORMED", status=400)


def test_a_body_that_is_too_large(house):
    body = b'{"x":"' + b"a" * BODY_BYTES + b'"}'
    ticketed = house.ticket(RequestDigests.of(token=None, proof=None, body=body))
    answer = house.run_behind(lambda: house.knock(body, HEADERS, ticket=ticketed))
    refused(house, answer, "BODY_TOO_LARGE", status=400)
    assert house.tickets._seen == set(), "refused before anything else was asked"


def test_nothing_answers_anywhere_else(house):
    async def scenario():
        request = Request(house)
        addresses = (AUDIENCE.replace("8899", "8896"), URL + "/", URL + "?x=1", URL.removesuffix("/calls") + "/")
        return [(await request.sent(url=url)).status_code for url in addresses]

    assert house.run_behind(scenario) == [404] * 4
    assert house.tickets._seen == set(), "nothing was asked of them"


def test_what_the_app_behind_sees_is_the_request_at_the_audience_and_no_ticket(house):
    inner = []

    async def app(scope, receive, send):
        inner.append((scope["path"], scope["raw_path"], dict(scope["headers"]), await receive()))
        await send({"type": "http.response.start", "status": 204, "headers": []})
        await send({"type": "http.response.body", "body": b""})

    house.layer._app = app

    async def scenario():
        request = Request(house)
        await request.sent()
        return request

    request = house.run_behind(scenario)
    ((path, raw_path, headers, first),) = inner
    assert (path, raw_path) == ("/mcp", b"/mcp")
    assert TICKET.encode() not in headers
    assert headers[b"host"].decode() == AUDIENCE.split("/")[2]
    assert headers[b"dpop"].decode() == request.proof
    assert (first["body"], first["more_body"]) == (request.body, False)


# -- stops


STOPS = {
    "no ticket": lambda house, body: None,
    "no ticket at all": lambda house, body: "x",
    "an old ticket": lambda house, body: house.ticket(
        RequestDigests.of(token=None, proof=None, body=body), at=house.clock.wall_s() - 9
    ),
    "a stranger's ticket": lambda house, body: house.ticket(
        RequestDigests.of(token=None, proof=None, body=body), key=keys.generate()
    ),
    "a ticket for something else": lambda house, body: house.ticket(
        RequestDigests.of(token=None, proof=None, body=b"")
    ),
    "a good ticket": lambda house, body: house.ticket(RequestDigests.of(token=None, proof=None, body=body)),
}


@pytest.mark.clause("TKT-9")
@pytest.mark.parametrize("name", STOPS)
def test_a_stop_needs_no_ticket(house, name):
    body = json.dumps(call_body("stop", {})).encode()

    async def scenario():
        return await house.knock(body, {**HEADERS, "mcp-name": "stop"}, ticket=STOPS[name](house, body))

    answer = house.run_behind(scenario)
    assert answer.json()["result"]["structuredContent"]["outcome"] == "stopped"
    assert house.arm.stops == 1
    assert house.records("refusal") == []


@pytest.mark.clause("TKT-9")
def test_a_stop_is_no_way_in_for_anything_else(house):
    """Beside the tool's name nothing makes a call a stop: no header, no second name, no other method."""
    bodies = [
        json.dumps({**call_body(), "stop": True}).encode(),
        json.dumps({**call_body("stop", {}), "method": "tools/list"}).encode(),
        b'{"jsonrpc":"2.0","id":1,"method":"tools/call","params":{"name":"stop","name":"move_joint","arguments":{}}}',
        json.dumps([call_body("stop", {}), call_body()]).encode(),
        json.dumps(call_body("STOP", {})).encode(),
        b"",
    ]

    async def scenario():
        return [(await house.knock(body, {**HEADERS, "mcp-name": "stop"})).json()["reason"] for body in bodies]

    assert house.run_behind(scenario) == ["TICKET_MISSING"] * len(bodies)
    assert (house.arm.stops, house.arm.moves) == (0, [])


def test_a_refusal_that_cannot_be_recorded_is_still_a_refusal(house):
    house.gate._journal = FailingJournal(house.journal)
    answer = house.run_behind(lambda: Request(house).sent(ticket=None))
    assert (answer.status_code, answer.json()["reason"]) == (403, "TICKET_MISSING")


@pytest.mark.clause("TKT-7")
def test_the_memory_of_tickets_is_bounded(house):
    """An expired ticket is forgotten, and only tickets of enrolled tool servers are remembered."""

    async def scenario():
        request = Request(house)
        await request.sent(ticket=request.ticket(key=keys.generate()))
        return await request.sent()

    house.run_behind(scenario)
    assert len(house.tickets._seen) == 1
    house.tickets._clock = Shifted(house.clock, by_s=(ticket.retention_ms(house.caps) + 1) / 1_000)
    house.tickets.first_use("0f" * 16, key=house.peps["door-1"], expires_ms=0)
    assert len(house.tickets._seen) == 1
