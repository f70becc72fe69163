"""A guarded server over stdio, each kind a process of its own, in both eras of MCP."""

from __future__ import annotations

import asyncio
import json
import os
import queue
import signal
import subprocess
import sys
import threading
import time
from functools import cache
from pathlib import Path

import httpx2
import pytest
from capabilities.values.scope import Tier
from mcp import Client, MCPError, StdioServerParameters, UrlElicitationRequiredError, stdio_client
from mcp_types import ElicitResult
from pep.mcp.body_screen import LINE_BYTES
from pep.mcp.decision_result import DECISION_META
from pep.mcp.http_request import REFUSED_CODE
from tests.e2e.stdio_plant import KINDS, open_valve
from tests.e2e.task_client import TASKS as EXTENSION
from tests.e2e.task_client import Tasks
from tests.ztpm_idp.test_process import PASSPHRASE, Process

from capabilities.keys import keys
from capabilities.proof.mcp_meta import META, PROOF, TOKEN
from pep import grant, pins
from ztpm_idp.client import Denied, Operator
from ztpm_idp.client.signing import MetaAuth
from ztpm_idp.client.tools import signed

pytestmark = [pytest.mark.e2e, pytest.mark.timeout(300)]
TOP = Path(__file__).parents[2]
SERVER = TOP / "tests" / "e2e" / "stdio_plant.py"
DEADLINE_S = 60.0
PATIENCE_S = 20.0
STALE = "REVOCATION_VIEW_STALE"
MODES = ("legacy", "2026-07-28")
ENVELOPE = {
    "io.modelcontextprotocol/protocolVersion": "2026-07-28",
    "io.modelcontextprotocol/clientInfo": {"name": "raw", "version": "1"},
    "io.modelcontextprotocol/clientCapabilities": {},
}


class Plant:
    """One kind of server with its registration, and an agent that is lent its tool."""

    def __init__(self, provider, kind, folder, *, audience=""):
        self.provider, self.kind, self.folder = provider, kind, folder
        self.audience = audience or f"http://127.0.0.1:9/{kind}"
        make, table = KINDS[kind]
        key = keys.generate()
        path = folder / "pep.key"
        path.write_bytes(keys.to_pem(key, PASSPHRASE.encode()))
        path.chmod(0o600)
        with httpx2.Client() as http:
            (folder / "trust.json").write_bytes(http.get(f"{provider.issuer}/trust").content)
        self.config = folder / "guard.toml"
        self.config.write_text(
            f'audience = "{self.audience}"\npep_id = "{kind}"\nissuer = "{provider.issuer}"\n'
            f'trust_file = "trust.json"\npep_key_file = "pep.key"\nfolder = "state"\n{table}'
        )
        with provider.operator() as alice:
            alice.register_pep(kind, keys.public_raw(key), [self.audience])
            for tool in pins(make(), self.config):
                alice.register_tool(
                    audience=self.audience, name=tool.name, definition_digest=tool.definition_digest,
                    operation=tool.operation, base_tier=int(tool.base_tier),
                )  # fmt: skip
            self.agent = alice.new_agent(f"worker-{kind}", str(SERVER), role="worker")
            self.lent = self.lend(alice)

    def lend(self, alice, agent=None):
        return alice.lend(
            agent or self.agent,
            (grant(open_valve),),
            self.audience,
            purpose="air the hall",
            ceiling=Tier.HIGH_CONSEQUENCE,
        )

    @property
    def command(self):
        return StdioServerParameters(
            command=sys.executable, args=[str(SERVER), self.kind, str(self.config)], cwd=str(TOP),
            env=dict(os.environ) | {"ZTPM_PASSPHRASE": PASSPHRASE, "PYTHONPATH": str(TOP)},
        )  # fmt: skip

    def auth(self, *, key=None, token=None, audience=""):
        return MetaAuth(key or self.agent.key, lambda: token or self.lent.token, audience or self.audience)

    def reasons(self):
        lines = (self.folder / "state" / "journal.ndjson").read_text().splitlines()
        found = [each["body"]["reason"] for each in map(json.loads, lines) if each["kind"] == "refusal"]
        return [reason for reason in found if reason != STALE]


class Raw:
    """The server's process with its bare streams, spoken to in one era."""

    def __init__(self, plant, mode):
        self.plant, self.mode, self.next, self.permitted = plant, mode, 0, 0
        given = plant.command
        self.popen = subprocess.Popen(
            [given.command, *given.args], cwd=given.cwd, env=given.env, stdin=subprocess.PIPE, stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
        )  # fmt: skip
        self.lines, self.noise = queue.Queue(), []
        threading.Thread(target=lambda: [self.lines.put(line) for line in self.popen.stdout], daemon=True).start()
        threading.Thread(target=lambda: self.noise.extend(self.popen.stderr), daemon=True).start()

    def write(self, raw):
        self.popen.stdin.write(raw + b"\n")
        self.popen.stdin.flush()

    def read(self):
        """The next line of stdout, a message of the protocol."""
        try:
            return json.loads(self.lines.get(timeout=DEADLINE_S))
        except queue.Empty:
            raise AssertionError(b"".join(self.noise).decode()) from None

    def request(self, method, params=None):
        self.next += 1
        message = {"jsonrpc": "2.0", "id": self.next, "method": method}
        params = dict(params or {})
        if self.mode != "legacy":
            params[META] = {**params.get(META, {}), **ENVELOPE}
        return message | ({"params": params} if params else {})

    def ask(self, method, params=None):
        sent = self.request(method, params)
        self.write(json.dumps(sent).encode())
        answer = self.read()
        assert answer["id"] == sent["id"]
        return answer

    def open(self):
        if self.mode == "legacy":
            hello = {"protocolVersion": "2025-11-25", "capabilities": {}, "clientInfo": {"name": "raw", "version": "1"}}
            assert self.ask("initialize", hello)["result"]["protocolVersion"] == "2025-11-25"
            self.write(b'{"jsonrpc":"2.0","method":"notifications/initialized"}')
        else:
            assert "dev.ztpm/pep" in json.dumps(self.ask("server/discover"))
        return self

    def call(self, params):
        """Reason of a call's refusal, or its decision."""
        until = time.monotonic() + PATIENCE_S
        answer = self.ask("tools/call", params)
        while answer.get("error", {}).get("message") == STALE and time.monotonic() < until:
            time.sleep(0.1)  # a busy machine has not heard the feed; no proof was looked at
            answer = self.ask("tools/call", params)
        if "error" in answer:
            assert answer["error"]["code"] == REFUSED_CODE
            return answer["error"]["message"]
        decision = answer["result"][META][DECISION_META]["decision"]
        self.permitted += decision == "PERMIT"
        return decision

    def hostile(self, line):
        """Reason of the refusal of a line that no reader may take."""
        self.write(line)
        answer = self.read()
        assert (answer["id"], answer["error"]["code"]) == (None, REFUSED_CODE)
        return answer["error"]["message"]

    def heard(self, words):
        """Number of times that it, or its tool, said this on standard error."""
        return b"".join(self.noise).count(words)

    def end(self):
        """Stdin ends, and so does the server."""
        self.popen.stdin.close()
        code = self.popen.wait(DEADLINE_S)
        return code, self.lines.empty()


@pytest.fixture(scope="module")
def provider(tmp_path_factory):
    made = Process(tmp_path_factory.mktemp("provider")).start()
    yield made
    if made.popen.poll() is None:
        made.end(signal.SIGKILL)


@pytest.fixture(scope="module")
def plant_of(provider, tmp_path_factory):
    """The plant of a kind, made once in any order of the kinds."""
    return cache(lambda kind: Plant(provider, kind, tmp_path_factory.mktemp(kind)))


SERVED = [pytest.param(kind, marks=pytest.mark.campaign if kind == "lowlevel" else ()) for kind in KINDS]
"""Kinds of servers; an `MCPServer` has a low-level one in it."""


@pytest.fixture(scope="module", params=SERVED)
def plant(request, plant_of):
    if request.param == "fastmcp":
        pytest.importorskip("fastmcp.server", reason="the extra `fastmcp` is not installed")
    return plant_of(request.param)


@pytest.fixture(scope="module", params=MODES)
def served(request, plant):
    """The server, begun once for each era: what one test sends changes nothing for the next."""
    made = Raw(plant, request.param).open()
    yield made
    made.popen.kill()
    made.popen.wait()


@pytest.fixture
def wire(served):
    """Its streams; all that comes back in a test answers what the test sent."""
    served.refused = len(served.plant.reasons())
    yield served
    assert served.lines.empty()


def call_of(percent):
    return {"name": "open_valve", "arguments": {"percent": percent}}


def test_what_comes_over_a_line_is_verified_as_over_http_and_nothing_but_the_protocol_comes_back(plant, wire):
    mode, sign = wire.mode, plant.auth().signed
    called = sign("tools/call", call_of(40))
    other, foreign = plant.auth(key=keys.generate()), plant.auth(audience="http://127.0.0.1:9/other")
    swapped = {**sign("tools/call", call_of(40)), "arguments": {"percent": 41}}
    spoilt = sign("tools/call", call_of(40))
    assert wire.call(called) == "PERMIT"
    refused = {
        "replayed": (called, "REPLAYED"),
        "bare": (call_of(40), "TOKEN_MISSING"),
        "meta of another type": ({**call_of(40), META: "x"} if mode == "legacy" else call_of(40), "TOKEN_MISSING"),
        "swapped": (swapped, "PROOF_NOT_FOR_THIS_REQUEST"),
        "another key": (other.signed("tools/call", call_of(40)), "PROOF_WRONG_KEY"),
        "another audience": (foreign.signed("tools/call", call_of(40)), "PROOF_NOT_FOR_THIS_REQUEST"),
        "another method": (sign("tools/list", call_of(40)), "PROOF_NOT_FOR_THIS_REQUEST"),
        "null": ({**spoilt, META: {**spoilt[META], TOKEN: None}}, "TOKEN_MALFORMED"),
        "a list": ({**spoilt, META: {**spoilt[META], PROOF: []}}, "PROOF_MALFORMED"),
        "giant token": ({**spoilt, META: {**spoilt[META], TOKEN: "x" * 30_000}}, "TOKEN_TOO_LARGE"),
        "giant proof": ({**spoilt, META: {**spoilt[META], PROOF: "x" * 30_000}}, "PROOF_MALFORMED"),
        "giant body": ({**spoilt, "more": "x" * 40_000}, "BODY_TOO_LARGE"),
    }
    said = {what: wire.call(params) for what, (params, _) in refused.items()}
    assert said == {what: reason for what, (_, reason) in refused.items()}

    # a list shows the holder alone what there is; whatever else has authority needs it, too
    bare, shown = wire.ask("tools/list"), wire.ask("tools/list", sign("tools/list", {}))
    assert [[tool["name"] for tool in each["result"]["tools"]] for each in (bare, shown)] == [[], ["open_valve"]]
    assert wire.ask("resources/list")["error"]["message"] == "TOKEN_MISSING"

    # and the server lives on, one act richer; what the tool and its child wrote went elsewhere
    assert wire.call(sign("tools/call", call_of(39))) == "PERMIT"
    assert plant.reasons()[wire.refused :] == [*said.values(), "TOKEN_MISSING"]


def test_a_line_that_two_readers_could_read_differently_goes_no_further(plant, wire):

    def spelled(old, new):
        """A call that is in order but for these bytes: its holder signed it."""
        line = json.dumps(wire.request("tools/call", plant.auth().signed("tools/call", call_of(40)))).encode()
        assert old in line
        return line.replace(old, new)

    number = b'"percent": 40'
    hostile = (
        (spelled(number, b'"percent": 40, "percent": 100'), "BODY_MALFORMED"),
        (spelled(number, b'"percent": NaN'), "NOT_FINITE"),
        (spelled(number, b'"percent": -Infinity'), "NOT_FINITE"),
        (spelled(number, b'"percent": 1e999'), "NOT_FINITE"),
        (spelled(number, b'"percent": 9007199254740993'), "OUT_OF_RANGE"),
        (spelled(b'"jsonrpc"', b'"method": "ping", "jsonrpc"'), "BODY_MALFORMED"),
        (spelled(number, b'"percent": ' + b"[" * 100 + b"]" * 100), "BODY_MALFORMED"),
        (b"[" * 60_000, "BODY_MALFORMED"),
        (b"[" + spelled(number, number) + b"]", "BODY_MALFORMED"),
        (spelled(number, b'"percent": "\\ud800"'), "BODY_MALFORMED"),
        (spelled(number, b'"percent": "\xff"'), "BODY_MALFORMED"),
        (b"\xef\xbb\xbf" + spelled(number, number), "BODY_MALFORMED"),
        (b"GET / HTTP/1.1", "BODY_MALFORMED"),
        (b'{"jsonrpc": "1.0", "id": 1, "method": "ping"}', "BODY_MALFORMED"),
        (b'"' + b"x" * LINE_BYTES + b'"', "BODY_TOO_LARGE"),
        (b"x" * 3_000_000, "BODY_TOO_LARGE"),
    )
    said = [wire.hostile(line) for line, _ in hostile]
    assert said == [reason for _, reason in hostile]
    wire.write(b"")
    wire.write(b"  \r")
    assert wire.call(plant.auth().signed("tools/call", call_of(40))) == "PERMIT", "it lives on"
    assert plant.reasons()[wire.refused :] == said


def test_a_server_ends_with_its_stdin_and_what_its_tool_and_child_wrote_went_elsewhere(plant, served):
    assert served.call(plant.auth().signed("tools/call", call_of(38))) == "PERMIT"
    acts = served.permitted
    assert served.end() == (0, True)
    assert served.heard(b"noise of the tool") == served.heard(b"noise of a child") == served.heard(b"opened ") == acts
    assert served.heard(plant.lent.token.encode()) == 0


def approve(plant, ask_id):
    """The approver reads the ask where the provider shows it, and signs."""
    until = time.monotonic() + DEADLINE_S
    with Operator("carol", plant.provider.private["carol"], plant.provider.issuer) as carol:
        while ask_id not in {each["ask_id"] for each in carol.approvals()}:
            assert time.monotonic() < until
            time.sleep(0.05)
        assert carol.approve(ask_id)["state"] == "granted"


def test_an_agent_calls_waits_for_people_and_is_stopped_by_a_revocation(plant):
    pages = []

    def asked(page):
        pages.append(page)
        threading.Thread(target=approve, args=(plant, page.split("/approvals/")[1].split("/")[0]), daemon=True).start()

    async def work(alice):
        lent = plant.lend(alice)
        tools = plant.agent.tools_stdio(
            plant.command, lent.token, audience=plant.audience, patience_s=DEADLINE_S, asked=asked
        )
        async with tools:
            listed = [tool.name for tool in await tools.list()]
            opened = await tools.call("open_valve", {"percent": 45.04})
            with pytest.raises(Denied) as wide:
                await tools.call("open_valve", {"percent": 200})
            approved = await tools.call("open_valve", {"percent": 85})
            alice.revoke("token", lent.token_id, "enough")
            until = time.monotonic() + DEADLINE_S
            with pytest.raises(Denied) as revoked:
                while time.monotonic() < until:
                    await tools.call("open_valve", {"percent": 1})
        return listed, opened, wide.value, approved, revoked.value

    with plant.provider.operator() as alice:
        listed, opened, wide, approved, revoked = asyncio.run(work(alice))
    assert listed == ["open_valve"]
    assert opened.structured_content == {"result": 45.0}
    assert wide.reason
    assert (approved.structured_content, len(pages)) == ({"result": 85.0}, 1)
    assert revoked.reason == "REVOKED"


@pytest.mark.parametrize("mode", ["legacy", "auto"])
def test_the_sdks_own_client_retries_over_a_signing_transport(plant, mode):
    """Its retry after an elicitation has the same `_meta`; the transport signs it anew.

    A client of the older protocol has the page in an error, and its call is begun again.
    """
    pages = []

    async def show(ctx, asked):
        pages.append(asked.url)
        ask_id = asked.url.split("/approvals/")[1].split("/")[0]
        await asyncio.to_thread(approve, plant, ask_id)
        return ElicitResult(action="accept")

    async def work():
        transport = signed(stdio_client(plant.command), plant.auth())
        async with Client(transport, mode=mode, elicitation_callback=show) as client:
            until = time.monotonic() + DEADLINE_S
            while True:
                try:
                    return await client.call_tool("open_valve", {"percent": 86 if mode == "legacy" else 87})
                except MCPError as error:
                    assert mode == "legacy" and time.monotonic() < until
                    if not pages:
                        (page,) = UrlElicitationRequiredError.from_error(error.error).elicitations
                        await show(None, page)

    told = asyncio.run(work()).meta[DECISION_META]
    assert (told["decision"], len(pages)) == ("PERMIT", 1)


def test_the_sdks_own_client_looks_after_a_task(plant):
    seen = []

    def begun(task):
        told = task.meta[DECISION_META]
        seen.append(told["decision"])
        threading.Thread(target=approve, args=(plant, told["approval_id"]), daemon=True).start()

    async def work():
        transport = signed(stdio_client(plant.command), plant.auth())
        async with Client(transport, extensions=[Tasks(begun)]) as client:
            assert EXTENSION in client.server_capabilities.extensions
            return await client.call_tool("open_valve", {"percent": 88.04})

    done = asyncio.run(work())
    assert (seen, done.structured_content, done.is_error) == (["DEFER"], {"result": 88.0}, False)
    assert (done.meta[DECISION_META]["decision"], done.meta[DECISION_META]["rounded"]) == ("PERMIT", {"percent": 88.0})


def test_a_server_without_registration_does_not_start_and_says_why(plant, tmp_path):
    config = plant.config.read_text().replace(plant.audience, "http://127.0.0.1:9/unknown")
    for name in ("trust.json", "pep.key"):
        (tmp_path / name).write_bytes((plant.folder / name).read_bytes())
    (tmp_path / "pep.key").chmod(0o600)
    (tmp_path / "guard.toml").write_text(config)
    given = plant.command
    done = subprocess.run(
        [given.command, str(SERVER), plant.kind, str(tmp_path / "guard.toml")], cwd=TOP, env=given.env, input=b"",
        capture_output=True, timeout=DEADLINE_S, check=False,
    )  # fmt: skip
    assert (done.returncode, done.stdout) == (1, b"")
    assert b"Traceback" not in done.stderr
    assert done.stderr.strip()


def test_no_server_is_an_error_that_says_so(plant):
    from ztpm_idp.client import ClientError

    missing = StdioServerParameters(command=str(plant.folder / "missing"))

    async def work():
        async with plant.agent.tools_stdio(missing, plant.lent.token, audience=plant.audience):
            pass

    with pytest.raises(ClientError) as refused:
        asyncio.run(work())
    assert refused.value.code == "UNREACHABLE"
