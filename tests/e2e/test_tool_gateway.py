"""Gateway before servers that nobody changed: real processes over stdio and HTTP, an unchanged client, a real provider."""

from __future__ import annotations

import asyncio
import itertools
import json
import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path
from urllib.parse import urlsplit

import anyio
import httpx2
import pytest
from capabilities.values.scope import Range, Scope, Stems, Tier
from mcp import Client, MCPError, StdioServerParameters, UrlElicitationRequiredError
from mcp.client.stdio import stdio_client
from mcp.client.streamable_http import streamable_http_client
from mcp.types import ElicitResult
from pep.mcp.gateway.upstream import CONNECT_S
from pep.mcp.guard import DECISION_META
from pep.point.tool_gateway_config import ToolGatewayConfig
from tests.e2e.routed import Memory, by_credentials
from tests.e2e.task_client import Tasks, begun, look
from tests.e2e.test_any_tool import DEADLINE_S, TOP, Plant, approve, told
from tests.node_packages import installed, node
from tests.ztpm_idp.test_process import PASSPHRASE, free_port
from ztpm.base.layout import Layout

from capabilities.keys import keys
from pep import grant
from ztpm_idp.client import DPoPAuth

pytestmark = pytest.mark.e2e
NODE_CLIENTS = Path(__file__).parent / "node_clients"
MAPPING = """
[tool.write_note]
object = "notes"
base_tier = 1
[tool.write_note.arguments]
title = "text"
stars = { low = 0, high = 5, unit = "count", integer = true, above = { 4 = 3 } }
"""


async def in_time(client, tool, arguments, **options):
    """Answer to a call, sent again where the machine was too slow for a verdict's lifetime, as its remedy says."""
    until = time.monotonic() + DEADLINE_S
    while True:
        answer = await client.call_tool(tool, arguments, **options)
        if (answer.meta or {}).get(DECISION_META, {}).get("reason") != "VERDICT_EXPIRED" or time.monotonic() > until:
            return answer


class Front(Plant):
    """The provider, a gateway, and two servers behind it: notes over stdio, slow ones over HTTP."""

    def __init__(self, folder):
        super().__init__(folder)
        self.calls, self.changed = folder / "calls.ndjson", folder / "changed.json"
        self.slow_port, self.slow = free_port(), None
        self.numbers = itertools.count(1)

    @property
    def environment(self):
        own = {
            "FOREIGN_CALLS": str(self.calls),
            "FOREIGN_CHANGED": str(self.changed),
            "SLOW_TOKEN": "the gateway's own",
        }
        return super().environment | own

    @property
    def config(self):
        return self.folder / "gateway.toml"

    def serve_slow(self):
        command = [sys.executable, "-m", "tests.e2e.foreign_server", "slow", str(self.slow_port)]
        self.slow = subprocess.Popen(command, cwd=TOP, env=self.environment)
        assert self.answers(f"http://127.0.0.1:{self.slow_port}/mcp", self.slow) in {400, 405, 406}

    def configure(self, servers):
        """Writes the configuration of a gateway before these servers, in TOML, and registers it."""
        key = self.write_secrets()
        self.config.write_text(f"""
            audience = "{self.audience}"
            pep_id = "gateway"
            issuer = "{self.provider.issuer}"
            trust_file = "trust.json"
            pep_key_file = "pep.key"
            folder = "state"
            {servers}
        """)
        with self.provider.operator() as alice:
            alice.register_pep("gateway", keys.public_raw(key), [self.audience])
        self.person.write_bytes(keys.to_pem(self.provider.private["alice"], PASSPHRASE.encode()))
        self.person.chmod(0o600)
        self.rows = ToolGatewayConfig.read(self.config).rows()

    def write(self):
        (self.folder / "notes.toml").write_text(MAPPING)
        self.configure(f"""
            [upstream.notes]
            command = [{json.dumps(sys.executable)}, "-m", "tests.e2e.foreign_server", "notes"]
            folder = {json.dumps(str(TOP))}
            environment = ["FOREIGN_CALLS", "FOREIGN_CHANGED"]
            mapping = "notes.toml"
            resources = true
            prompts = true
            [upstream.slow]
            url = "http://127.0.0.1:{self.slow_port}/mcp"
            prefix = "slow_"
            timeout_s = 20
            sessions = 0
            bearer = "SLOW_TOKEN"
            tasks = true
            [upstream.slow.tool.work]
            object = "slow"
            base_tier = 1
            [upstream.slow.tool.work.arguments]
            seconds = {{ low = 0, high = 8000, unit = "ms", scale = 1000 }}
            [upstream.slow.tool.ask]
            object = "slow"
            base_tier = 0
            [upstream.slow.tool.brew]
            object = "slow"
            base_tier = 1
        """)

    def pinned(self, timeout_s=DEADLINE_S):
        """Lines for the person, once the tools are registered and the lock file is written."""
        done = subprocess.run(
            [sys.executable, "-m", "ztpm", "mcp", "pin", "--as", "alice", "--issuer", self.provider.issuer, "--key",
             str(self.person), "--gateway", str(self.config), "--yes"],
            cwd=TOP, capture_output=True, text=True, timeout=timeout_s, env=self.environment, check=False,
        )  # fmt: skip
        assert done.returncode == 0, done.stdout + done.stderr
        return done.stdout

    def start(self):
        command = [sys.executable, "-m", "ztpm", "mcp", "gateway", "--config", str(self.config), "--json"]
        with (self.folder / "gateway.log").open("w") as log:
            self.child = subprocess.Popen(
                command, cwd=TOP, env=self.environment, stdout=subprocess.PIPE, stderr=log, text=True
            )
        self.ready = json.loads(self.child.stdout.readline())
        return self

    def stop(self):
        self.child.send_signal(signal.SIGTERM)
        self.child.communicate(timeout=DEADLINE_S)

    def use(self, agent, token, tool, arguments):
        async def once():
            async with self.caller(agent, token) as client:
                return await in_time(client, tool, arguments)

        return asyncio.run(once())

    def agent(self, name):
        """An agent of this name and a number: a test that is begun again needs another one."""
        return super().agent(f"{name}-{next(self.numbers)}")

    def lend(self, agent, *grants, ceiling=Tier.REVERSIBLE):
        now = int(time.time())
        scope = Scope(
            grants=tuple(sorted(grants, key=lambda each: (each.object, each.operation))), ceiling=ceiling,
            audiences=frozenset({self.audience}), delegates=frozenset(), depth=0, not_before=now - 5,
            not_after=now + 600,
        )  # fmt: skip
        with self.provider.operator() as alice:
            return alice.issue(agent, scope, purpose="try the servers").token

    def heard(self):
        """Calls that the servers noted."""
        return [json.loads(line) for line in self.calls.read_text().splitlines()] if self.calls.exists() else []

    def listed(self, agent, token):
        async def once():
            async with self.caller(agent, token) as client:
                return sorted(each.name for each in (await client.list_tools()).tools)

        return asyncio.run(once())

    def end(self):
        if self.slow is not None:
            self.slow.kill()
        super().end()


@pytest.fixture(scope="module")
def served(tmp_path_factory):
    made = Front(tmp_path_factory.mktemp("front"))
    try:
        made.serve_slow()
        made.write()
        made.said = made.pinned()
        yield made.start()
    finally:
        made.end()


@pytest.fixture
def front(served):
    served.calls.unlink(missing_ok=True)
    return served


def test_servers_that_nobody_changed(front):
    assert '+          "description": "Write a note."' in front.said
    assert (front.ready["tools"], front.ready["withheld"]) == (["slow_ask", "slow_brew", "slow_work", "write_note"], {})
    agent = front.agent("keeper")
    notes = grant(front.rows["write_note"], stars=Range(0, 3), title=Stems(frozenset({"public "}), ""))
    token = front.lend(agent, notes, grant(front.rows["slow_work"]), grant(front.rows["slow_ask"]))
    only_notes = front.lend(agent, notes)

    # A list is of its caller's tools; a tool that is not mapped is nobody's.
    assert front.listed(agent, token) == ["slow_ask", "slow_work", "write_note"]
    assert front.listed(agent, only_notes) == ["write_note"]
    assert told(front.use(agent, token, "wipe", {}))["reason"] == "TOOL_UNKNOWN"

    # Permitted: the decided arguments arrive, and nothing of the caller's credentials.
    done = front.use(agent, token, "write_note", {"title": "public one", "stars": 3})
    assert (done.content[0].text, told(done)["decision"]) == ("write_note done", "PERMIT")
    (heard,) = front.heard()
    assert heard["arguments"] == {"title": "public one", "stars": 3}
    assert not [key for key in heard["meta"] if key.startswith("dev.ztpm")]
    # Refused by the token's limit, and not heard of by the server.
    refused = told(front.use(agent, token, "write_note", {"title": "public one", "stars": 4}))
    assert (refused["reason"], refused["nearest_permitted"]) == ("LIMIT_EXCEEDED_BY_REQUEST", 3)
    refused = told(front.use(agent, token, "write_note", {"title": "secret one", "stars": 1}))
    assert refused["decision"] == "DENY"
    assert len(front.heard()) == 1

    # Over HTTP: neither the token nor the proof goes on, and the gateway has a token of its own there.
    assert told(front.use(agent, token, "slow_work", {"seconds": 0.1}))["decision"] == "PERMIT"
    heard = front.heard()[-1]
    assert (heard["tool"], heard["arguments"]) == ("work", {"seconds": 0.1})
    assert (heard["authorization"], "dpop" in heard["headers"]) == ("Bearer the gateway's own", False)


@pytest.mark.campaign
def test_a_changed_definition_is_not_called_until_it_is_approved_again(front):
    agent = front.agent("changer")
    token = front.lend(agent, grant(front.rows["write_note"]))
    note = {"title": "a", "stars": 1}
    assert told(front.use(agent, token, "write_note", note))["decision"] == "PERMIT"
    for how in ({}, {"title": "Note"}, {"annotations": {"readOnlyHint": True}}, {"twice": True}):
        front.changed.write_text(json.dumps(how))
        assert told(front.use(agent, token, "write_note", note))["reason"] == "TOOL_DEFINITION_CHANGED"
        assert front.listed(agent, token) == []
    assert len(front.heard()) == 1
    front.changed.unlink()
    assert told(front.use(agent, token, "write_note", note))["decision"] == "PERMIT"
    front.changed.write_text("{}")
    said = front.pinned()
    assert "say it to nobody" in said
    until = time.monotonic() + DEADLINE_S
    while told(front.use(agent, token, "write_note", note))["decision"] != "PERMIT":
        assert time.monotonic() < until
    front.changed.unlink()
    front.pinned()


def test_a_person_is_asked_and_the_retry_happens_once(front):
    agent = front.agent("asker")
    token = front.lend(agent, grant(front.rows["write_note"]), ceiling=Tier.HIGH_CONSEQUENCE)
    note = {"title": "five stars", "stars": 5}
    deferred = told(front.use(agent, token, "write_note", note))
    assert (deferred["decision"], front.heard()) == ("DEFER", [])
    answer = told(front.use(agent, token, "write_note", note))
    approve(front, answer["approval_id"])
    until = time.monotonic() + DEADLINE_S
    while told(front.use(agent, token, "write_note", note))["decision"] != "PERMIT":
        assert time.monotonic() < until
        time.sleep(0.1)
    assert told(front.use(agent, token, "write_note", note))["decision"] == "DEFER"
    assert len(front.heard()) == 1


def bridged(front, agent, token):
    """The command with which a host starts the bridge."""
    data = front.folder / "data"
    layout = Layout(data)
    layout.agent_key(agent.id).parent.mkdir(parents=True, exist_ok=True)
    layout.agent_key(agent.id).write_bytes(keys.to_pem(agent.key, PASSPHRASE.encode()))
    layout.agent_key(agent.id).chmod(0o600)
    layout.trust.write_bytes((front.folder / "trust.json").read_bytes())
    said = front.folder / f"{agent.id}.token"
    said.write_text(token)
    arguments = ["connect", agent.id, front.audience, "--token", str(said), "--data", str(data)]
    return StdioServerParameters(
        command=sys.executable, args=["-m", "ztpm", "mcp", *arguments], env=front.environment, cwd=TOP
    )


@pytest.mark.campaign
def test_a_deferral_is_told_in_the_form_that_its_client_knows_also_over_a_bridge(front):
    agent = front.agent("former")
    token = front.lend(agent, grant(front.rows["write_note"]), ceiling=Tier.HIGH_CONSEQUENCE)
    pages = []

    async def show(context, asked):
        pages.append(asked.url)
        await asyncio.to_thread(approve, front, asked.url.split("/approvals/")[1].split("/")[0])
        return ElicitResult(action="accept")

    def taken(task):
        seen.append(task.status)
        threading.Thread(target=approve, args=(front, task.meta[DECISION_META]["approval_id"]), daemon=True).start()

    async def done(client, note):
        """The result of a call that the older protocol has to begin again."""
        until = time.monotonic() + DEADLINE_S
        while True:
            try:
                return await in_time(client, "write_note", note)
            except MCPError as error:
                assert time.monotonic() < until
                (page,) = UrlElicitationRequiredError.from_error(error.error).elicitations
                if page.url not in pages:
                    await show(None, page)
                await asyncio.sleep(0.1)

    seen = []
    forms = {
        "task": {"extensions": [Tasks(taken)]},
        "page": {"elicitation_callback": show},
        "older": {"elicitation_callback": show, "mode": "legacy"},
    }

    async def all_of_them():
        command = bridged(front, agent, token)
        with (front.folder / "forms.log").open("w") as log:
            for form, options in forms.items():
                async with front.caller(agent, token, **options) as client:
                    answer = await done(client, {"title": form, "stars": 5})
                    assert told(answer)["decision"] == "PERMIT", form
                async with Client(stdio_client(command, errlog=log), **options) as client:
                    answer = await done(client, {"title": f"{form} over a bridge", "stars": 5})
                    assert told(answer)["decision"] == "PERMIT", form

    asyncio.run(all_of_them())
    assert (seen, len(set(pages)), len(pages)) == (["working"] * 2, 4, 4)
    titles = [each["arguments"]["title"] for each in front.heard()]
    assert titles == [f"{form}{where}" for form in forms for where in ("", " over a bridge")]


def test_a_task_of_a_server_is_its_callers_alone_and_goes_on_over_a_restart_of_the_gateway(front):
    agent, other = front.agent("brewer"), front.agent("guest")
    brew = grant(front.rows["slow_brew"])
    token, others = front.lend(agent, brew), front.lend(other, brew)
    tasked = {"extensions": [Tasks()]}

    async def begun_two():
        async with front.caller(agent, token, **tasked) as client:
            return [await begun(client, "slow_brew", {}) for _ in range(2)]

    first, second = asyncio.run(begun_two())
    assert (first.status, first.meta[DECISION_META]["decision"]) == ("input_required", "PERMIT")
    assert not first.task_id.startswith("brew") and first.task_id != second.task_id
    front.stop()
    front.start()

    async def looked_after():
        async with front.caller(other, others, **tasked) as client:
            for task_id in (first.task_id, "brew-0"):
                for method in ("tasks/get", "tasks/update", "tasks/cancel"):
                    with pytest.raises(MCPError) as unknown:
                        await look(client.session, task_id, method)
                    assert unknown.value.code == -32602
        async with front.caller(agent, token, **tasked) as client:
            asked = await look(client.session, first.task_id)
            assert (asked.status, asked.task_id) == ("input_required", first.task_id)
            ada = {"who": {"action": "accept", "content": {"name": "Ada"}}}
            await look(client.session, first.task_id, "tasks/update", input_responses=ada)
            await look(client.session, second.task_id, "tasks/cancel")
            return [await look(client.session, each.task_id) for each in (first, second)]

    done, cancelled = asyncio.run(looked_after())
    assert (done.status, done.result["content"][0]["text"]) == ("completed", "tea for Ada")
    assert done.result["_meta"][DECISION_META] == first.meta[DECISION_META]
    assert cancelled.status == "cancelled"
    about = [each for each in front.heard() if "method" in each]
    assert {each["task"] for each in about} == {"brew-0", "brew-1"}
    assert not [key for each in about for key in each["meta"] if key.startswith("dev.ztpm")]
    # A client that knows no tasks gets none, and nothing of the other tasks of the server.
    assert front.use(agent, token, "slow_brew", {}).content[0].text == "brewed at once"


def test_progress_questions_and_cancellation_go_through(front):
    agent = front.agent("worker")
    token = front.lend(agent, grant(front.rows["slow_work"]), grant(front.rows["slow_ask"]))

    async def all_of_it():
        seen = []

        async def progressed(progress, total, message):
            seen.append((progress, total, message))

        async with front.caller(agent, token) as client:
            await in_time(client, "slow_work", {"seconds": 0.4}, progress_callback=progressed)
            assert seen == [(step, 4, f"step {step}") for step in (1, 2, 3, 4)]
            with anyio.move_on_after(1.5):
                await client.call_tool("slow_work", {"seconds": 8})
        until = time.monotonic() + DEADLINE_S
        while {"cancelled": True} not in front.heard():
            assert time.monotonic() < until
            await asyncio.sleep(0.05)

        async def answered(context, params):
            return ElicitResult(action="accept", content={"name": "Ada"})

        # The server's answer is a question, which a client of the older protocol hears as one.
        for mode in ("2026-07-28", "legacy"):
            async with front.caller(agent, token, elicitation_callback=answered, mode=mode) as client:
                assert (await in_time(client, "slow_ask", {})).content[0].text == "hello Ada"
        async with front.caller(agent, token, mode="legacy") as client:
            with pytest.raises(MCPError):
                await in_time(client, "slow_ask", {})

    asyncio.run(all_of_it())


def test_prompts_resources_and_instructions_as_they_were_reviewed(front):
    agent = front.agent("reader")
    token = front.lend(agent, grant(front.rows["write_note"]))

    async def read():
        async with front.caller(agent, token) as client:
            assert client.instructions == "notes: Use notes well.\n\nslow: Use slow well."
            assert [each.name for each in (await client.list_prompts()).prompts] == ["greet"]
            assert (await client.get_prompt("greet")).messages[0].content.text == "hello"
            assert [str(each.uri) for each in (await client.list_resources()).resources] == ["note://1"]
            assert (await client.read_resource("note://1")).contents[0].text == "the note"

    asyncio.run(read())
    # Nothing was reviewed: neither prompts nor instructions go on.
    front.stop()
    lock = front.folder / "gateway.lock.json"
    kept = lock.read_bytes()
    lock.unlink()
    front.start()

    async def withheld():
        async with front.caller(agent, token) as client:
            assert client.instructions is None
            assert (await client.list_prompts()).prompts == []

    asyncio.run(withheld())
    lock.write_bytes(kept)


@pytest.mark.campaign
def test_a_client_that_knows_only_stdio(front):
    agent = front.agent("desk")
    token = front.lend(agent, grant(front.rows["write_note"], stars=Range(0, 3)), grant(front.rows["slow_work"]))
    data = front.folder / "data"
    layout = Layout(data)
    layout.agent_key(agent.id).parent.mkdir(parents=True, exist_ok=True)
    layout.agent_key(agent.id).write_bytes(keys.to_pem(agent.key, PASSPHRASE.encode()))
    layout.agent_key(agent.id).chmod(0o600)
    layout.trust.write_bytes((front.folder / "trust.json").read_bytes())
    (front.folder / "desk.token").write_text(token)
    arguments = ["-m", "ztpm", "mcp", "connect", agent.id, front.audience, "--token", str(front.folder / "desk.token")]

    async def used(mode):
        seen = []

        async def progressed(progress, total, message):
            seen.append(progress)

        with (front.folder / "bridge.log").open("w") as log:
            command = StdioServerParameters(
                command=sys.executable, args=[*arguments, "--data", str(data)], env=front.environment, cwd=TOP
            )
            async with Client(stdio_client(command, errlog=log), mode=mode) as client:
                names = sorted(each.name for each in (await client.list_tools()).tools)
                done = await in_time(client, "write_note", {"title": "a", "stars": 2})
                refused = await in_time(client, "write_note", {"title": "a", "stars": 4})
                await in_time(client, "slow_work", {"seconds": 0.2}, progress_callback=progressed)
        return names, told(done)["decision"], told(refused)["reason"], seen

    for mode in ("2026-07-28", "legacy"):
        assert asyncio.run(used(mode)) == (
            ["slow_work", "write_note"], "PERMIT", "LIMIT_EXCEEDED_BY_REQUEST", [1, 2, 3, 4],
        )  # fmt: skip
    with (front.folder / "stranger.log").open("w") as log:
        done = subprocess.run(
            [sys.executable, *arguments[:-1], str(front.folder / "desk.token"), "--data", str(data / "none")],
            cwd=TOP, env=front.environment, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=log, check=False,
        )  # fmt: skip
    assert (done.returncode, done.stdout) == (2, b"")
    elsewhere = [each.replace(front.audience, "http://plant.example/mcp") for each in arguments]
    done = subprocess.run(
        [sys.executable, *elsewhere, "--data", str(data)], cwd=TOP, env=front.environment, stdin=subprocess.DEVNULL,
        capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert (done.returncode, done.stdout) == (2, "")
    assert "URL: plain HTTP on loopback only" in done.stderr


async def placed(http, origin, path):
    """The object that a server tells at a path, however it is asked there."""
    url = f"{origin}{path}"
    told, head, before = await http.get(url), await http.head(url), await http.options(url)
    assert (told.status_code, head.status_code, before.status_code, head.content) == (200, 200, 204, b"")
    assert {each.headers["access-control-allow-origin"] for each in (told, head, before)} == {"*"}
    return told.json()


def test_a_stock_oauth_client_finds_its_way_and_calls(front):
    origin, key = front.audience.removesuffix("/mcp"), keys.generate(keys.Algorithm.P256)
    notes = grant(front.rows["write_note"], stars=Range(0, 3))
    now = int(time.time())
    scope = Scope(
        grants=(notes,), ceiling=Tier.REVERSIBLE, audiences=frozenset({front.audience}), delegates=frozenset(), depth=0,
        not_before=now - 5, not_after=now + 600,
    )  # fmt: skip
    with front.provider.operator() as alice:
        alice.register_client("nightly", "The nightly job", key=keys.public_raw(key))
        alice.sign_mandate("nightly", scope, purpose="note what happened")

    async def found():
        async with httpx2.AsyncClient(timeout=DEADLINE_S) as http:
            root = "/.well-known/oauth-protected-resource"
            resources = [await placed(http, origin, f"{root}{rest}") for rest in ("", "/", "/mcp", "/mcp/")]
            (resource,) = {json.dumps(each): each for each in resources}.values()
            assert resource["resource"] == front.audience
            (issuer,) = resource["authorization_servers"]
            parts = urlsplit(issuer)
            path = f"/.well-known/oauth-authorization-server{parts.path}"
            server = await placed(http, f"{parts.scheme}://{parts.netloc}", path)
            assert (server["issuer"], issuer) == (front.provider.issuer, front.provider.issuer)
            # While the provider does not answer, the gateway still says where it is.
            os.kill(front.provider.popen.pid, signal.SIGSTOP)
            try:
                assert await placed(http, origin, root) == resource
            finally:
                os.kill(front.provider.popen.pid, signal.SIGCONT)

    asyncio.run(found())

    async def called(wrapped):
        memory = Memory()
        auth = by_credentials("nightly", key, memory, url=front.audience, issuer=front.provider.issuer)
        async with (
            httpx2.AsyncClient(auth=wrapped(auth), timeout=DEADLINE_S) as http,
            Client(streamable_http_client(front.audience, http_client=http)) as client,
        ):
            names = [each.name for each in (await client.list_tools()).tools]
            done = await in_time(client, "write_note", {"title": "a", "stars": 2})
            refused = await in_time(client, "write_note", {"title": "a", "stars": 4})
        return memory.tokens.access_token, names, told(done)["decision"], told(refused)["reason"]

    expected = ["write_note"], "PERMIT", "LIMIT_EXCEEDED_BY_REQUEST"
    _, *bound = asyncio.run(called(lambda auth: DPoPAuth(auth, keys.generate())))
    bearer, *plain = asyncio.run(called(lambda auth: auth))
    assert tuple(bound) == tuple(plain) == expected
    assert len(front.heard()) == 2

    def inspector(*options):
        """The Inspector's command line, with the access token in a header."""
        launcher = "node_modules/@modelcontextprotocol/inspector/clients/launcher/build/index.js"
        command = [node(), str(installed(NODE_CLIENTS) / launcher), "--cli", front.audience, "--transport", "http"]
        header = ["--header", f"Authorization: Bearer {bearer}"]
        done = subprocess.run(
            [*command, *options, *header], env=os.environ | {"HOME": str(front.folder)}, capture_output=True, text=True,
            timeout=DEADLINE_S, check=False,
        )  # fmt: skip
        assert done.stdout, done.stderr
        return json.loads(done.stdout)

    assert [each["name"] for each in inspector("--method", "tools/list")["tools"]] == ["write_note"]
    call = ("--method", "tools/call", "--tool-name", "write_note", "--tool-arg", "title=a")
    assert inspector(*call, "stars=2")["_meta"][DECISION_META]["decision"] == "PERMIT"
    assert inspector(*call, "stars=4")["_meta"][DECISION_META]["reason"] == "LIMIT_EXCEEDED_BY_REQUEST"


@pytest.mark.campaign
def test_a_server_that_goes_and_comes_back(front):
    """Last of all: a server that the others use is gone afterwards."""
    front.stop()
    front.slow.kill()
    front.slow.wait()
    begun = time.monotonic()
    front.start()
    assert front.ready["tools"] == ["write_note"]
    agent = front.agent("waiter")
    token = front.lend(agent, grant(front.rows["slow_work"]), grant(front.rows["write_note"]))
    first = told(front.use(agent, token, "write_note", {"title": "a", "stars": 1}))
    assert first["decision"] == "PERMIT", first
    assert told(front.use(agent, token, "slow_work", {"seconds": 0}))["reason"] == "TOOL_UNKNOWN"
    assert time.monotonic() - begun < 2 * CONNECT_S, "neither waits for the server that is away"
    front.serve_slow()
    until = time.monotonic() + DEADLINE_S
    while told(front.use(agent, token, "slow_work", {"seconds": 0}))["decision"] != "PERMIT":
        assert time.monotonic() < until
        time.sleep(0.2)
    front.slow.kill()
    front.slow.wait()
    refused = told(front.use(agent, token, "slow_work", {"seconds": 0}))
    assert refused["reason"] == "UPSTREAM_UNREACHABLE"
    # A process behind the gateway is begun again.
    children = subprocess.run(["pgrep", "-P", str(front.child.pid)], capture_output=True, text=True, check=True)
    os.kill(int(children.stdout.split()[0]), signal.SIGKILL)
    assert told(front.use(agent, token, "write_note", {"title": "b", "stars": 1}))["decision"] == "PERMIT"
