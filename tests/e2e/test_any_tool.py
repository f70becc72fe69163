"""A plant's tool server, guarded from one example file, over real processes: lending, limits, people, revocation."""

from __future__ import annotations

import ast
import asyncio
import json
import os
import re
import secrets
import signal
import subprocess
import sys
import time
from contextlib import asynccontextmanager
from pathlib import Path

import httpx2
import pytest
from examples.plant import server
from mcp import Client
from mcp.client.streamable_http import streamable_http_client
from pep.mcp.guard import DECISION_META
from pep.point.evaluation_layer import WELL_KNOWN
from tests.ztpm_idp.test_process import PASSPHRASE, Process, free_port

from capabilities.keys import keys
from capabilities.proof.evaluation import prove_evaluation
from capabilities.proof.proof import prove
from capabilities.values.scope import Budget, Range, Restriction, Scope, Stems, Tier
from pep import grant, pins
from pep.base.declaration import declared
from ztpm_idp.client import Agent, Denied, Operator

pytestmark = pytest.mark.e2e
TOP = Path(__file__).parents[2]
EXAMPLE = TOP / "examples" / "plant.py"
PAGE = (TOP / "docs" / "guard.md").read_text("utf-8")
LINES, ADDED, COLUMNS = 80, 30, 100
"""Most lines of a whole example, and of those that guard its tools, with the six of guard.toml."""
OURS = re.compile(r"\b(Annotated|Metres|Percent|Speed|Within|Word|operation|guard)\b")
"""Names of which a line has one that a server without guard does not need."""
DEADLINE_S = 30.0
REVOKED_S = 1.0
"""Time within which a revocation reaches the guard."""
DRAWN_S = 4
"""Life of a drawn token; the next is drawn while a second of it is left, for a busy machine."""
STALE_S = 4.0
"""The lease of 2 s, and as long again for a busy machine."""
ACCEPTED = {"accept": "application/json, text/event-stream"}
MEASUREMENT = bytes(range(32))
ROWS = {tool.name: declared(tool.fn) for tool in server._tool_manager.list_tools()}


class Signed(httpx2.Auth):
    """Signs each request of the token's holder."""

    requires_request_body = True

    def __init__(self, token, key, audience):
        self.token, self.key, self.audience = token, key, audience

    def auth_flow(self, request):
        request.headers["Authorization"] = f"DPoP {self.token}"
        request.headers["DPoP"] = prove(
            self.key, method=request.method, url=self.audience, body=request.content, token=self.token,
            at=int(time.time()), jti=secrets.token_urlsafe(16),
        )  # fmt: skip
        yield request


class Plant:
    """The provider and the guarded plant, each a process of its own, with two agents that are lent something."""

    def __init__(self, folder):
        self.folder = folder
        self.provider = Process(folder, oauth=True).start()
        self.audience = f"http://127.0.0.1:{free_port()}/mcp"
        self.child = self.signer = None
        self.gateway, self.signs_at = keys.generate(), ""

    def sign(self):
        """The signer beside a gateway, a process of its own."""
        key = self.folder / "gateway.key"
        key.write_bytes(keys.to_pem(self.gateway, PASSPHRASE.encode()))
        key.chmod(0o600)
        address = f"127.0.0.1:{free_port()}"
        options = ["--point", self.audience.removesuffix("/mcp"), "--key", str(key), "--listen", address]
        command = [sys.executable, "-m", "ztpm.point.evaluation_signer", *options]
        self.signer = subprocess.Popen(command, cwd=TOP, env=self.environment)
        self.signs_at = f"http://{address}"
        assert self.answers(f"{self.signs_at}{WELL_KNOWN}", self.signer) == 200

    def evaluated(self, agent, token, evaluations, **options):
        """Answers to a stock gateway, which knows no proofs of ours and passes on the agent's word on each."""
        for each in evaluations:
            proof = prove_evaluation(
                agent.key, each, audience=self.audience, token=token, at=int(time.time()), jti=secrets.token_urlsafe(16),
            )  # fmt: skip
            each["context"] = {"credentials": {"token": token, "proof": proof}}
        with httpx2.Client(timeout=30) as http:
            url = http.get(f"{self.signs_at}{WELL_KNOWN}").json()["access_evaluations_endpoint"]
            answer = http.post(url, json={"evaluations": evaluations, **options}, headers={"x-request-id": "e2e"})
        assert (answer.status_code, answer.headers["x-request-id"]) == (200, "e2e"), answer.text
        return answer.json()["evaluations"]

    def write_secrets(self):
        """The new key of the enforcement point, whose file is written beside the trust bundle."""
        key = keys.generate()
        path = self.folder / "pep.key"
        path.write_bytes(keys.to_pem(key, PASSPHRASE.encode()))
        path.chmod(0o600)
        with httpx2.Client() as http:
            (self.folder / "trust.json").write_bytes(http.get(f"{self.provider.issuer}/trust").content)
        return key

    def write(self):
        key = self.write_secrets()
        (self.folder / "guard.toml").write_text(
            f'audience = "{self.audience}"\npep_id = "plant"\nissuer = "{self.provider.issuer}"\n'
            'trust_file = "trust.json"\npep_key_file = "pep.key"\nfolder = "state"\nauthzen = true\n'
        )
        with self.provider.operator() as alice:
            alice.register_pep("plant", keys.public_raw(key), [self.audience])
            alice.register_pep("gateway", keys.public_raw(self.gateway), [self.audience])

        # A person looks at the tools and registers them.
        person = self.person
        person.write_bytes(keys.to_pem(self.provider.private["alice"], PASSPHRASE.encode()))
        person.chmod(0o600)
        pinned = subprocess.run(
            [sys.executable, "-m", "ztpm", "mcp", "pin", "--as", "alice", "--issuer", self.provider.issuer, "--key",
             str(person), "--server", "examples.plant:server", "--guard", str(self.folder / "guard.toml"), "--yes", "--json"],
            cwd=TOP, capture_output=True, text=True, timeout=DEADLINE_S, env=self.environment, check=True,
        )  # fmt: skip
        assert json.loads(pinned.stdout) == {"ok": True, "pinned": sorted(ROWS)}

    @property
    def person(self):
        """Her key's file."""
        return self.folder / "alice.key"

    @property
    def environment(self):
        return os.environ | {"ZTPM_PASSPHRASE": PASSPHRASE, "PYTHONPATH": str(TOP)}

    def pin(self, alice, tool, digest):
        alice.register_tool(
            audience=self.audience, name=tool.name, definition_digest=digest, operation=tool.operation,
            base_tier=int(tool.base_tier),
        )  # fmt: skip

    def agent(self, name):
        key = keys.generate()
        with self.provider.operator() as alice:
            alice.register_agent(name, keys.public_raw(key), software_digest=MEASUREMENT.hex(), model="m", role=name)
        made = Agent(name, key, self.provider.issuer, MEASUREMENT)
        made.attest()
        return made

    def lend(self, planner, worker):
        """The planner has all six tools; the worker has each narrower where it has more than one value, but one."""
        now = int(time.time())
        few = {"move_agv": (Budget("", self.audience, 600, 2),)}
        grants = (grant(row, *few.get(name, ())) for name, row in ROWS.items())
        scope = Scope(
            grants=tuple(sorted(grants, key=lambda each: (each.object, each.operation))),
            ceiling=Tier.HIGH_CONSEQUENCE,
            audiences=frozenset({self.audience}),
            delegates=frozenset({"worker"}),
            depth=1,
            not_before=now - 5,
            not_after=now + 600,
        )
        with self.provider.operator() as alice:
            whole = alice.issue(planner, scope, purpose="run the plant")
        kept = (
            grant(ROWS["open_valve"], percent=Range(0, 900)),
            grant(ROWS["search_docs"], query=Stems(frozenset({"oven", "pump 7"}), "")),
            grant(ROWS["delete_record"], id=Stems(frozenset({"/records/2026"}), "/")),
            grant(ROWS["read_sensor"]),
            grant(ROWS["move_agv"]),
        )
        kept = tuple(sorted(kept, key=lambda each: (each.object, each.operation)))
        less = planner.delegate(whole.token, worker, Restriction(grants=kept), purpose="air the hall")
        return whole, less

    def start(self):
        self.child = subprocess.Popen(
            [sys.executable, str(EXAMPLE), "serve", str(self.folder / "guard.toml")], cwd=TOP,
            stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
            env=self.environment,
        )  # fmt: skip
        return self

    def listens(self):
        return self.answers(self.audience, self.child)

    def answers(self, url, process):
        """Status of the first answer of a process that starts."""
        until = time.monotonic() + DEADLINE_S
        with httpx2.Client() as http:
            while time.monotonic() < until and process.poll() is None:
                try:
                    return http.get(url).status_code
                except httpx2.TransportError:
                    time.sleep(0.05)  # a process that starts has no other event for a stranger
        raise AssertionError(process.communicate(timeout=5)[0].decode())

    def used(self):
        """Lines that the example prints when it lends and calls."""
        done = subprocess.run(
            [sys.executable, str(EXAMPLE), "use", str(self.person), self.provider.issuer, self.audience], cwd=TOP,
            capture_output=True, text=True, timeout=DEADLINE_S, env=self.environment, check=False,
        )  # fmt: skip
        assert (done.returncode, done.stderr) == (0, "")
        return done.stdout.splitlines()

    def records(self):
        lines = (self.folder / "state" / "journal.ndjson").read_text().splitlines()
        return [json.loads(line) for line in lines]

    @asynccontextmanager
    async def caller(self, agent, token, **options):
        async with httpx2.AsyncClient(auth=Signed(token, agent.key, self.audience), timeout=30) as http:
            async with Client(streamable_http_client(self.audience, http_client=http), **options) as client:
                yield client

    def use(self, agent, token, tool, arguments):
        async def once():
            async with self.caller(agent, token) as client:
                return await client.call_tool(tool, arguments)

        return asyncio.run(once())

    def refused_after_s(self, agent, token, tool, arguments):
        """Seconds until a call is answered with 401, asked again and again."""
        body = {"jsonrpc": "2.0", "id": 1, "method": "tools/call", "params": {"name": tool, "arguments": arguments}}
        began = time.monotonic()
        with httpx2.Client(auth=Signed(token, agent.key, self.audience)) as http:
            while http.post(self.audience, json=body, headers=ACCEPTED).status_code != 401:
                assert time.monotonic() - began < DEADLINE_S
        return time.monotonic() - began

    def end(self):
        for process in (self.child, self.signer):
            if process is not None:
                process.kill()
                process.communicate()
        if self.provider.popen.poll() is None:
            self.provider.end(signal.SIGKILL)


@pytest.fixture
def plant(tmp_path):
    made = Plant(tmp_path)
    yield made
    made.end()


def told(answer):
    return answer.meta[DECISION_META]


def evaluation(tool, arguments, agent="worker"):
    """The question of AuthZEN about one call."""
    return {
        "subject": {"type": "agent", "id": agent},
        "action": {"name": tool, "properties": arguments},
        "resource": {"type": "object", "id": ROWS[tool].object},
    }


def gateway_asks(plant, worker, less):
    """A gateway that exists asks; nothing happens, and the answers are those that calls get."""
    plant.sign()
    before = len(plant.records())
    valve = [evaluation("open_valve", {"valve": 3, "percent": percent}) for percent in (45, 95, 85)]
    told = plant.evaluated(worker, less.token, [*valve, evaluation("read_sensor", {"id": 7}, agent="planner")])
    permitted, refused, deferred, other = (each["context"] for each in told)
    assert [each["decision"] for each in told] == [True, False, False, False]
    assert {"kind": "record"} in permitted["obligations"]
    assert (refused["reason"], refused["set_by"]["agent"], refused["nearest_permitted"]) == (
        "LIMIT_EXCEEDED_BY_REQUEST", "worker", 900,
    )  # fmt: skip
    assert (deferred["effect"], deferred["reason"], deferred["asked"]) == ("DEFER", "TIER_NEEDS_APPROVAL", False)
    assert other["reason"] == "SUBJECT_NOT_HOLDER"
    until_denied = {"options": {"evaluations_semantic": "deny_on_first_deny"}}
    valve = [evaluation("open_valve", {"valve": 3, "percent": percent}) for percent in (45, 95, 85)]
    assert len(plant.evaluated(worker, less.token, valve, **until_denied)) == 2
    records = [record for record in plant.records()[before:] if record["kind"] != "incident"]
    assert [(record["kind"], record["body"]["asked"]["caller"]) for record in records] == [
        ("advice", "pep gateway")
    ] * 6


def approve(plant, ask_id):
    """The approver reads the ask where the provider shows it, and signs."""
    until = time.monotonic() + DEADLINE_S
    with Operator("carol", plant.provider.private["carol"], plant.provider.issuer) as carol:
        while ask_id not in {each["ask_id"] for each in carol.approvals()}:
            assert time.monotonic() < until
            time.sleep(0.05)
        shown = carol.approval(ask_id)["shown"]
        assert carol.approve(ask_id)["state"] == "granted"
    return shown


def mandated(plant, planner):
    """A connection of the planner's outlives two tokens; the mandate's revocation ends it."""
    now = int(time.time())
    scope = Scope(
        grants=(grant(ROWS["read_sensor"]),), ceiling=Tier.NO_EFFECT, audiences=frozenset({plant.audience}),
        delegates=frozenset(), depth=0, not_before=now - 5, not_after=now + 7 * 86_400,
    )  # fmt: skip

    async def work(alice, mandate_id):
        used, until = [], time.monotonic() + DEADLINE_S
        async with planner.tools(plant.audience, planner.renewal(mandate_id, lifetime_s=DRAWN_S)) as tools:
            while len(used) < 3:
                assert time.monotonic() < until
                assert told(await tools.call("read_sensor", {"id": 7}))["decision"] == "PERMIT"
                draws = alice.mandate(mandate_id)["draws"]
                assert sum(each["live"] for each in draws) <= 2
                used = [each["token_id"] for each in reversed(draws)]
                await asyncio.sleep(0.2)  # a token ends with the time, and with nothing else
            alice.revoke("mandate", mandate_id, "enough")
            revoked = time.monotonic()
            with pytest.raises(Denied) as denied:
                while time.monotonic() < until:
                    await tools.call("read_sensor", {"id": 7})
            return used, denied.value.reason, time.monotonic() - revoked

    with plant.provider.operator() as alice:
        mandate_id = alice.sign_mandate("planner", scope, purpose="watch the hall")
        used, reason, after_s = asyncio.run(work(alice, mandate_id))
        shown = alice.mandate(mandate_id)
    # The sponsor sees each draw, and the first had ended while the work went on.
    assert [each["token_id"] for each in reversed(shown["draws"])][:3] == used
    assert shown["draws"][-1]["not_after"] < time.time()
    assert (reason, shown["state"]) == ("REVOKED", "revoked")
    assert after_s < REVOKED_S
    with pytest.raises(Denied) as ended:
        planner.renewal(mandate_id).token()
    assert ended.value.reason == "MANDATE_REVOKED"


def test_the_example_is_one_short_file():
    text = EXAMPLE.read_text()
    lines = text.splitlines()
    assert len(lines) <= LINES and max(map(len, lines)) <= COLUMNS
    assert f"a whole plant in {len(lines)} lines" in PAGE
    formatted = [
        sys.executable,
        "-m",
        "ruff",
        "format",
        "--check",
        "--no-cache",
        "--line-length",
        str(COLUMNS),
        EXAMPLE,
    ]
    assert subprocess.run(formatted, cwd=TOP, capture_output=True, check=False).returncode == 0

    # of ours it imports the packages alone
    nodes = ast.parse(text).body
    imported = {each.module for each in nodes if isinstance(each, ast.ImportFrom)}
    imported |= {alias.name for each in nodes if isinstance(each, ast.Import) for alias in each.names}
    others = imported - sys.stdlib_module_names
    assert others == {"mcp.server", "capabilities", "pep", "ztpm_idp.client"}

    # what its author adds to guard the tools; who lends and calls them is another program
    (use,) = (each for each in nodes if isinstance(each, ast.AsyncFunctionDef))
    code = lines[: use.lineno - 1] + lines[use.end_lineno :]
    start = next(at for at, line in enumerate(code) if line.startswith("import "))
    added = [line for line in code[start:] if OURS.search(line)]
    assert len(added) >= 2 * len(ROWS) and 6 + len(added) <= ADDED


@pytest.mark.timeout(200)
def test_a_plant_is_guarded(plant):
    plant.write()
    planner, worker = plant.agent("planner"), plant.agent("worker")
    whole, less = plant.lend(planner, worker)
    assert plant.start().listens() == 401

    # the example lends, calls, and is told what is refused, by whom, and what would be permitted
    done, refused = plant.used()
    assert done == "valve 3 is 40.0 % open"
    assert f"\n{done}\n" in PAGE
    assert re.match(
        r"Denied: LIMIT_EXCEEDED_BY_REQUEST\. percent is 450 permille.* set by worker-\d+ for alice", refused
    )
    assert "nearest permitted is 400 permille" in refused

    # permitted, of the rounded number, and recorded before
    opened = plant.use(worker, less.token, "open_valve", {"valve": 3, "percent": 45.04})
    assert (told(opened)["decision"], told(opened)["rounded"]) == ("PERMIT", {"percent": 45.0})
    assert opened.structured_content == {"result": "valve 3 is 45.0 % open"}
    kinds = [record["kind"] for record in plant.records()]
    assert kinds.index("decision") < kinds.index("outcome")
    assert told(plant.use(worker, less.token, "read_sensor", {"id": 7}))["tier"] == 0

    # the hop's own limit, and who set it
    refused = told(plant.use(worker, less.token, "open_valve", {"valve": 3, "percent": 95}))
    assert (refused["decision"], refused["reason"]) == ("DENY", "LIMIT_EXCEEDED_BY_REQUEST")
    assert (refused["parameter"], refused["set_by"]["agent"], refused["nearest_permitted"]) == (
        "percent",
        "worker",
        900,
    )
    heat = ("set_temperature", {"degrees": 80})
    assert told(plant.use(worker, less.token, *heat))["reason"] == "NOT_GRANTED"

    gateway_asks(plant, worker, less)

    # texts and paths: the worker's own limits, what is nearest to them, and other spellings, which are none
    found = plant.use(worker, less.token, "search_docs", {"query": "pump 7: sp"})
    assert found.structured_content == {"result": ["pump 7: spare parts"]}
    for tool, arguments, nearest in (
        ("search_docs", {"query": "pump 8"}, "pump 7"),
        ("delete_record", {"id": "/records/1999/7"}, "/records/2026"),
        ("delete_record", {"id": "/records/20267"}, "/records/2026"),
    ):
        refused = told(plant.use(worker, less.token, tool, arguments))
        assert (refused["reason"], refused["nearest_permitted"]) == ("LIMIT_EXCEEDED_BY_REQUEST", nearest)
        assert (refused["set_by"]["agent"], refused["kind"]) == ("worker", "text" if tool == "search_docs" else "path")
    for tool, arguments in (
        ("search_docs", {"query": "pump 7\u200b"}),
        ("delete_record", {"id": "/records/2026/../1999"}),
        ("delete_record", {"id": "/records/2026/%2e%2e"}),
    ):
        assert told(plant.use(worker, less.token, tool, arguments))["reason"] == "NOT_CANONICAL"
    record = ("delete_record", {"id": "/records/2026/7"})
    assert told(plant.use(planner, whole.token, *record))["reason"] == "TIER_NEEDS_APPROVAL"

    # a row raises the tier: people are asked in words, and answer
    call = ("open_valve", {"valve": 3, "percent": 85})
    asked = told(plant.use(worker, less.token, *call))
    assert (asked["decision"], asked["reason"], asked["raised_by"]) == ("DEFER", "TIER_NEEDS_APPROVAL", ["percent"])
    shown = approve(plant, asked["ask_id"])
    assert (shown["operation"], shown["object"], shown["agent"]) == ("open_valve", "valves", "worker")
    assert (shown["perception"], shown["tier"], shown["index_milli"]) == ("none", 3, 0)
    until = time.monotonic() + DEADLINE_S
    while (answer := told(plant.use(worker, less.token, *call)))["decision"] != "PERMIT":
        assert answer["decision"] == "DEFER" and time.monotonic() < until, answer

    # two drives in ten minutes, which the agents share, and the rest is told
    drive = ("move_agv", {"x": 1.0, "y": 2.0, "speed": 0.5})
    for agent, token in ((planner, whole), (worker, less)):
        assert told(plant.use(agent, token.token, *drive))["decision"] == "PERMIT"
    spent = told(plant.use(worker, less.token, *drive))
    assert (spent["decision"], spent["reason"], spent["left"]) == ("DENY", "BUDGET_SPENT", 0)
    assert (spent["set_by"]["hop"], spent["set_by"]["agent"]) == (0, "planner")
    assert 500 < spent["more_at"] - time.time() < 620

    # a revocation reaches the guard within a second
    with plant.provider.operator() as alice:
        alice.revoke("hop", less.hop_id, "no more")
    assert plant.refused_after_s(worker, less.token, "read_sensor", {"id": 7}) < REVOKED_S
    assert plant.records()[-1]["body"]["reason"] == "REVOKED"
    (ended,) = plant.evaluated(worker, less.token, [evaluation("read_sensor", {"id": 7})])
    assert ended == {"decision": False, "context": {"effect": "DENY", "reason": "REVOKED"}}
    assert told(plant.use(planner, whole.token, "read_sensor", {"id": 7}))["decision"] == "PERMIT"

    # work outlives a token that is drawn from a mandate, and ends with the mandate
    mandated(plant, planner)

    # without the provider the view ages, and nothing is permitted any more
    plant.provider.end(signal.SIGKILL)
    assert plant.refused_after_s(planner, whole.token, "open_valve", {"valve": 1, "percent": 1}) < STALE_S
    assert plant.records()[-1]["body"]["reason"] == "REVOCATION_VIEW_STALE"


@pytest.mark.timeout(100)
def test_a_tool_that_is_not_as_approved_is_not_served(plant):
    plant.write()
    with plant.provider.operator() as alice:
        changed = next(pin for pin in pins(server) if pin.name == "move_agv")
        plant.pin(alice, changed, "ab" * 32)
    said, _ = plant.start().child.communicate(timeout=60)
    assert plant.child.returncode != 0
    assert "TOOL_DEFINITION_CHANGED: move_agv" in said.decode()
