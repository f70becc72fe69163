"""`ztpm mcp discover` on real servers, as processes over both transports, and on the journal of a gate."""

import asyncio
import contextlib
import json
import os
import pty
import socket
import subprocess
import sys
import time
import tomllib
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import pytest
from capabilities.keys import keys
from capabilities.values.scope import Tier
from capabilities.values.scope_json import scope_from_json
from mcp_types import CallToolRequestParams, CallToolResult, TextContent, Tool
from pep.base.ports import RegisteredTool
from pep.mcp.guard import DECISION_META, Guard
from pep.mcp.http_request import CREDENTIALS
from pep.mcp.tool_digest import definition_digest
from pep.point.guard_config import GuardConfig
from policies.decision.load import load_shipped
from tests.pep.kit import AUDIENCE, ISSUER, PEP, Rig, full_scope, issuer_keys
from tests.ztpm_idp.test_process import free_port
from ztpm.cli import tool_list
from ztpm.codes.code_table import code_table
from ztpm.preparing import WIPED

import pep
from pep import grant, pins

TOP = Path(__file__).parents[3]
PATIENT = ("--wait", "300")
"""A busy machine takes a minute to start a server."""
SERVER = """
import json, os, sys
from pathlib import Path
import anyio, uvicorn
from mcp.server.lowlevel.server import Server
from mcp.server.stdio import stdio_server
from mcp_types import CallToolResult, ListToolsResult, TextContent, Tool

given = json.loads(Path(sys.argv[1]).read_text())
tools = [Tool.model_validate(each) for each in given["tools"]]
if "told" in given:
    Path(given["told"]).write_text(json.dumps(dict(os.environ)))

async def listed(ctx, params):
    at = int(params.cursor or 0) if params else 0
    after = at + given["page"]
    more = str(0 if given.get("ring") else after) if after < len(tools) or given.get("ring") else None
    return ListToolsResult(tools=tools[at:after], next_cursor=more)

async def called(ctx, params):
    return CallToolResult(content=[TextContent(type="text", text=json.dumps(params.arguments))])

server = Server("plant kit", version="7", on_list_tools=listed, on_call_tool=called)

async def over_stdio():
    async with stdio_server() as (read, write):
        await server.run(read, write, server.create_initialization_options())

if __name__ == "__main__":
    if len(sys.argv) > 2:
        uvicorn.run(server.streamable_http_app(), port=int(sys.argv[2]), log_level="error")
    else:
        anyio.run(over_stdio)
"""


def tool(name, properties=None, *, required=None, description="", annotations=None):
    properties = properties or {}
    schema = {
        "type": "object",
        "properties": properties,
        "required": sorted(properties) if required is None else required,
    }
    made = {"name": name, "description": description, "inputSchema": schema}
    return {**made, **({} if annotations is None else {"annotations": annotations})}


READS, ADDS = {"readOnlyHint": True}, {"readOnlyHint": False, "destructiveHint": False}
TOOLS = [
    tool("open_valve", {
        "percent": {"type": "number", "minimum": 0, "maximum": 100, "description": "Opening in percent"},
        "bleed": {"type": "boolean", "default": False},
    }, required=["percent"], description="Open the valve so far.", annotations=ADDS),
    tool("read_page", {"path": {"type": "string"}, "note": {"anyOf": [{"type": "string"}, {"type": "null"}], "default": None}},
         required=["path"], annotations=READS),
    tool("note", {"words": {"type": ["string", "null"]}}),
    tool("obey", description="Look.\u200b"),
    tool("gauge", annotations=READS),
]  # fmt: skip
CALLABLE = {"open_valve", "read_page", "gauge"}


@pytest.fixture
def served(tmp_path):
    """Writes a server of these tools; its command."""
    script = tmp_path / "server.py"
    script.write_text(SERVER)

    def write(tools=TOOLS, *, page=2, **more):
        listed = tmp_path / "tools.json"
        listed.write_text(json.dumps({"tools": tools, "page": page, **more}))
        return [sys.executable, str(script), str(listed)]

    return write


@contextlib.contextmanager
def over_http(command):
    """The server as a process over HTTP, once it takes connections; its address."""
    port = free_port()
    process = subprocess.Popen([*command, str(port)])
    try:
        deadline = time.monotonic() + 60
        while True:
            with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", port), timeout=1):
                break
            assert process.poll() is None and time.monotonic() < deadline
            time.sleep(0.05)
        yield f"http://127.0.0.1:{port}/mcp"
    finally:
        process.terminate()
        process.wait(timeout=30)


# --- a mapping out of a server ---------------------------------------------------------------------------------------


def checked(text):
    """The tables of a mapping that says what a person has to do."""
    assert text.startswith("# A proposal, by `ztpm mcp discover`. A person must review each line")
    assert "\u200b" not in text
    assert "# LEFT OUT: note. ARGUMENT_UNDECLARABLE" in text and "# LEFT OUT: obey. HIDDEN_TEXT" in text
    tables = tomllib.loads(text)["tool"]
    assert set(tables) == CALLABLE
    assert {name: table["base_tier"] for name, table in tables.items()} == {"open_valve": 2, "read_page": 0, "gauge": 0}
    return tables


@pytest.mark.e2e
def test_a_server_over_stdio_is_listed_whole_and_proposed(run, served):
    told = run("mcp", "discover", *PATIENT, "--", *served())
    assert told.status == 0
    tables = checked(told.out)
    assert tables["open_valve"]["object"] == "plant-kit"
    assert tables["open_valve"]["arguments"]["percent"] == {"low": 0, "high": 1000, "unit": "permille", "scale": 10}
    assert "3 of 5 tools proposed" in told.err and "ztpm mcp pin" in told.err and "\u27e8" not in told.err


@pytest.mark.e2e
def test_a_server_over_http_is_proposed_and_its_tools_are_guarded(run, served, tmp_path, monkeypatch):
    """The proposal, unchanged, is what a guard before the same server starts and decides with."""
    out = tmp_path / "mapping.toml"
    with over_http(served()) as url:
        told = run("mcp", "discover", "--url", url, "--object", "valve-7", "--out", out, "--json")
        assert told.status == 0
        said = told.json
        assert (said["proposed"], said["left_out"], said["object"], said["out"]) == (3, 2, "valve-7", str(out))
        assert {each["name"]: each.get("code") for each in said["tools"] if "code" in each} == {
            "note": "ARGUMENT_UNDECLARABLE", "obey": "HIDDEN_TEXT",
        }  # fmt: skip
        assert run("mcp", "discover", "--url", url, "--out", out).err.startswith("EXISTS: ")
        assert run("mcp", "discover", "--url", url, "--object", "valve-7", "--out", out, "--force").status == 0
    checked(out.read_text())

    path = guard_file(tmp_path, monkeypatch, out.read_text())
    rows = GuardConfig.read(path).rows()
    assert set(rows) == CALLABLE
    listed = [Tool.model_validate(each) for each in TOOLS if each["name"] in CALLABLE]
    server = low_level(listed)
    assert {pin.name for pin in pins(server, path)} == CALLABLE
    guarded = pep.guard(server, path)
    assert guarded is not None

    rig = Plant(tmp_path / "rig", rows, listed)
    assert rig.use("open_valve", percent=40, bleed=False)["decision"] == "PERMIT"
    assert rig.use("read_page", path="/srv/docs/a")["decision"] == "PERMIT"
    assert rig.use("read_page", path="/srv/docs/a", note="x")["reason"] == "PARAMETERS_WRONG"
    assert rig.use("read_page", path="docs/a")["reason"] == "NOT_CANONICAL"
    assert rig.use("open_valve", percent=101, bleed=False)["decision"] == "DENY"
    assert rig.called == [{"percent": 40.0, "bleed": False}, {"path": "/srv/docs/a", "note": None}]
    rig.close()

    # What was permitted is the least scope, and that scope permits it again.
    scope_file = tmp_path / "scope.json"
    told = run("mcp", "discover", "--journal", rig.path, "--agent", rig.holder.name, "--out", scope_file)
    assert told.status == 0 and "not what is needed" in told.out and "ztpm token issue" in told.out
    scope = scope_from_json(json.loads(scope_file.read_text()))
    assert [(each.object, each.operation) for each in scope.grants] == [
        ("valve-7", "open_valve"),
        ("valve-7", "read_page"),
    ]
    again = Plant(tmp_path / "again", rows, listed, grants=scope.grants, ceiling=scope.ceiling)
    assert again.use("open_valve", percent=40, bleed=False)["decision"] == "PERMIT"
    assert again.use("open_valve", percent=41, bleed=False)["reason"] == "LIMIT_EXCEEDED_BY_REQUEST"
    again.close()


def guard_file(folder, monkeypatch, tables):
    """`guard.toml` with the tables, and what it names."""
    monkeypatch.setenv("ZTPM_PASSPHRASE", "correct horse battery staple")
    _, trust = issuer_keys()
    (folder / "trust.json").write_bytes(trust.to_json())
    key = folder / "pep.key"
    key.write_bytes(keys.to_pem(keys.generate(), b"correct horse battery staple"))
    key.chmod(0o600)
    path = folder / "guard.toml"
    path.write_text(
        f'audience = "{AUDIENCE}"\npep_id = "{PEP}"\nissuer = "{ISSUER}"\n'
        f'trust_file = "trust.json"\npep_key_file = "pep.key"\nfolder = "state"\n{tables}'
    )
    return path


def low_level(listed):
    from mcp.server.lowlevel.server import Server
    from mcp_types import ListToolsResult

    async def tools(ctx, params):
        return ListToolsResult(tools=listed)

    async def called(ctx, params):
        return CallToolResult(content=[TextContent(type="text", text="done")])

    return Server("plant kit", on_list_tools=tools, on_call_tool=called)


class Plant(Rig):
    """A gate without a robot, behind a guard whose rows were proposed; its tools remember their arguments."""

    def __init__(self, folder, rows, listed, *, grants=None, ceiling=Tier(3)):
        folder.mkdir()
        super().__init__(folder)
        self.policies = load_shipped("tools")
        self.build()
        self.gate._robot = None
        self.rows, self.listed, self.called = rows, listed, []
        self.registry.tools = {
            each.name: RegisteredTool(each.name, definition_digest(each), each.name, rows[each.name].base_tier)
            for each in listed
        }
        from pep.mcp.declared_tools import rows_of

        self.rows = rows_of(listed, decorated={}, configured=rows)
        lent = grants or tuple(
            sorted((grant(row) for row in rows.values()), key=lambda each: (each.object, each.operation))
        )
        self.holder = self.agent(scope=replace(full_scope(self.clock.wall_s()), grants=lent, ceiling=ceiling))

    def use(self, name, **arguments):
        async def own(ctx, params):
            self.called.append(params.arguments)
            return CallToolResult(content=[TextContent(type="text", text="done")])

        async def served(ctx, name):
            return self.listed

        stands = Guard(
            call=own, served=served, gate=self.gate, registry=self.registry, tools=self.rows, asks=self.asks,
            readiness=None, audience=AUDIENCE, clock=self.clock,
        )  # fmt: skip
        ctx = SimpleNamespace(request=SimpleNamespace(scope={CREDENTIALS: self.credentials(self.holder)}))
        answer = asyncio.run(stands(ctx, CallToolRequestParams(name=name, arguments=arguments)))
        return answer.meta[DECISION_META]

    def close(self):
        self.gate.close()
        self.journal.close()


@pytest.mark.e2e
def test_a_command_gets_no_secret_of_the_environment(run, served, tmp_path, monkeypatch):
    told = tmp_path / "told.json"
    monkeypatch.setenv("PLANT_KEY", "of the plant")
    assert run("mcp", "discover", "--env", "PLANT_KEY", "--json", *PATIENT, "--", *served(told=str(told))).status == 0
    got = json.loads(told.read_text())
    assert got["PLANT_KEY"] == "of the plant"
    assert "ZTPM_PASSPHRASE" in os.environ and "ZTPM_PASSPHRASE" not in got


MANY = [tool(f"t{i}") for i in range(tool_list.TOOLS + 1)]
LARGE = [tool(f"t{i}", description="a" * 60_000) for i in range(80)]


@pytest.mark.e2e
@pytest.mark.parametrize(
    ("tools", "more", "code"),
    [
        ([tool("look"), tool("read"), tool("look")], {}, "TOOL_TWICE"),
        ([], {}, "NO_TOOLS"),
        (MANY, {"page": 100}, "TOOL_LIST_TOO_LARGE"),
        (LARGE, {"page": 5}, "TOOL_LIST_TOO_LARGE"),
        ([tool("look")], {"ring": True}, "SERVER_MALFORMED"),
    ],
)
def test_a_list_that_nobody_can_review_is_refused(run, served, tools, more, code):
    with over_http(served(tools, **more)) as url:
        told = run("mcp", "discover", "--url", url, "--json", *PATIENT)
    assert (told.status, told.json["code"]) == (code_table()[code].status, code)
    assert told.json["next"]


@pytest.mark.e2e
@pytest.mark.parametrize(
    ("words", "code"),
    [
        (["--url", "http://127.0.0.1:9/mcp"], "SERVER_UNREACHABLE"),
        (["--stdio", "no-such-command-anywhere"], "SERVER_UNREACHABLE"),
        (["--stdio", f"{sys.executable} -c 'import sys; sys.exit(7)'"], "SERVER_UNREACHABLE"),
        (["--wait", "1", "--", sys.executable, "-c", "import time; time.sleep(60)"], "SERVER_UNREACHABLE"),
        (["--", "cat"], "SERVER_MALFORMED"),
        (["--url", "ftp://host/mcp"], "USAGE"),
        (["--stdio", "a 'b"], "USAGE"),
        (["--stdio", " "], "USAGE"),
        (["--env", "NO_SUCH_VARIABLE_HERE", "--", "cat"], "USAGE"),
        (["--object", "a b", "--", "cat"], "USAGE"),
        (["--agent", "mover", "--", "cat"], "USAGE"),
        (["--url", "http://127.0.0.1:9/mcp", "--", "cat"], "USAGE"),
        ([], "USAGE"),
    ],
)
def test_what_cannot_be_read_says_why_and_what_next(run, words, code):
    told = run("mcp", "discover", "--json", *PATIENT, *words)
    assert (told.json["code"], told.status) == (code, code_table()[code].status)
    assert told.json["next"]


EARLY = """
import json, sys
for line in sys.stdin:
    asked = json.loads(line)
    if asked["method"] == "initialize":
        made = {"protocolVersion": "2024-11-05", "capabilities": {"tools": {}}, "serverInfo": {"name": "early", "version": "1"}}
    elif asked["method"] == "tools/list":
        made = {"tools": [{"name": "look", "inputSchema": {"type": "object"}}]}
    elif "id" in asked:
        sys.exit("unknown method " + asked["method"])
    else:
        continue
    print(json.dumps({"jsonrpc": "2.0", "id": asked["id"], "result": made}), flush=True)
"""


@pytest.mark.e2e
def test_a_server_that_ends_at_a_question_of_a_newer_protocol_is_asked_in_the_older_one(run):
    """So servers of the first releases of the SDK do: they end at a method that they do not know."""
    told = run("mcp", "discover", "--json", *PATIENT, "--", sys.executable, "-c", EARLY)
    assert (told.status, told.json["server"]["name"], told.json["proposed"]) == (0, "early", 1)


@pytest.mark.e2e
def test_the_last_word_of_a_process_is_told_and_controls_nothing(run):
    said = "import sys; sys.exit('set \\x1b[31mPLANT_KEY')"
    told = run("mcp", "discover", *PATIENT, "--", sys.executable, "-c", said)
    assert told.err.startswith("SERVER_UNREACHABLE: ") and "PLANT_KEY" in told.err and "\x1b" not in told.err


@pytest.mark.e2e
@pytest.mark.parametrize("columns", [80, 120])
def test_nothing_that_is_shown_is_wider_than_the_terminal(served, columns):
    """The table, on a real terminal; sentences wrap where the terminal does."""
    near, far = pty.openpty()
    command = [sys.executable, "-m", "ztpm", "mcp", "discover", *PATIENT, "--", *served()]
    environment = os.environ | {"COLUMNS": str(columns), "PYTHONPATH": str(TOP), "TERM": "dumb"}
    ran = subprocess.run(command, stdout=subprocess.PIPE, stderr=far, env=environment, timeout=330, check=True)
    os.close(far)
    shown = b""
    with contextlib.suppress(OSError):  # the other end is closed
        while chunk := os.read(near, 65_536):
            shown += chunk
    os.close(near)
    lines = [line.rpartition(WIPED)[2].rstrip() for line in shown.decode().split("\r\n")]
    begin = next(at for at, line in enumerate(lines) if line.startswith("tool "))
    end = next(at for at, line in enumerate(lines) if line.startswith("3 of 5"))
    assert all(len(line) <= columns for line in lines[begin:end])
    assert tomllib.loads(ran.stdout.decode())


# --- a scope out of a journal ----------------------------------------------------------------------------------------


@pytest.fixture(scope="module")
def journal(tmp_path_factory):
    """The journal of a gate that permitted two motions of a robot and denied a third; and its holder."""
    rig = Rig(tmp_path_factory.mktemp("observed"))
    holder = rig.agent(scope=full_scope(rig.clock.wall_s(), speed_high=600_000))

    def move(speed):
        arguments = {"q_rad": [0.1, -1.2, 1.0, -1.1, -1.57, 0.0], "speed_rad_s": speed, "acceleration_rad_s2": 1.4}
        asyncio.run(rig.gate.run(rig.call(holder, arguments=arguments), rig.effect))
        rig.clock.advance(1_000)

    for speed in (0.5, 0.25, 0.7):
        move(speed)
    rig.gate.close()
    rig.journal.close()
    return rig.path, holder.name


def test_a_scope_is_around_the_permitted_acts_alone(run, journal):
    path, agent = journal
    told = run("mcp", "discover", "--journal", path, "--agent", agent, "--json").json
    scope = scope_from_json(told["scope"])
    (lent,) = scope.grants
    speed = next(limit for limit in lent.limits if "speed" in limit.parameter.name)
    assert (speed.bound.low, speed.bound.high) == (250_000, 500_000)
    assert [each["acts"] for each in told["grants"]] == [2]
    assert [(each["acts"], each["why"].split()[0]) for each in told["not_included"]] == [(1, "DENY")]
    assert scope.ceiling == told["grants"][0]["highest_tier"]
    assert told["unread"] == {}


def test_the_scope_alone_is_on_standard_output(run, journal):
    path, agent = journal
    told = run("mcp", "discover", "--journal", path, "--agent", agent)
    assert scope_from_json(json.loads(told.out)).grants
    assert "not what is needed" in told.err and "Not included:" in told.err and "ztpm token issue" in told.err


def test_an_exported_ledger_has_the_same_acts(run, journal, tmp_path):
    path, agent = journal
    ledger = tmp_path / "ledger.ndjson"
    ledger.write_text("".join(
        json.dumps({"kind": "pep-record", "body": {"record": json.loads(line)}}) + "\n"
        for line in path.read_text().splitlines()
    ))  # fmt: skip
    words = ["mcp", "discover", "--agent", agent, "--json", "--journal"]
    assert run(*words, ledger).json == run(*words, path).json


@pytest.mark.parametrize(
    ("words", "code"),
    [
        (["--agent", "nobody"], "NO_ACTS"),
        (["--agent", "robotic", "--audience", "http://127.0.0.1:1/other"], "NO_ACTS"),
        ([], "USAGE"),
        (["--agent", "robotic", "--object", "x"], "USAGE"),
    ],
)
def test_a_record_without_such_acts_names_the_agents_that_it_has(run, journal, words, code):
    path, agent = journal
    told = run("mcp", "discover", "--journal", path, "--json", *words)
    assert (told.status, told.json["code"]) == (2, code)
    assert code == "USAGE" or agent == "robotic" or agent in told.json["detail"]


@pytest.mark.parametrize("line", ['{"v":1', "[]", '{"kind":"decision","seq":1}', '{"a":1,"a":2}', "x" * 1_048_600])
def test_a_malformed_line_is_named_and_nothing_is_proposed(run, journal, tmp_path, line):
    path, agent = journal
    broken = tmp_path / "broken.ndjson"
    broken.write_bytes(path.read_bytes() + line.encode() + b"\n")
    told = run("mcp", "discover", "--journal", broken, "--agent", agent, "--json")
    number = len(path.read_bytes().splitlines()) + 1
    assert (told.status, told.json["code"]) == (2, "LINE_MALFORMED")
    assert f"line {number}" in told.json["detail"] and "scope" not in told.json


def test_a_record_of_another_form_is_counted_and_not_believed(run, journal, tmp_path):
    path, agent = journal
    lines = path.read_text().splitlines()
    changed = []
    for line in lines:
        record = json.loads(line)
        if record["kind"] == "decision" and "0.25" not in line and not changed:
            record["body"].pop("form")
            changed.append(record)
        lines[lines.index(line)] = json.dumps(record)
    older = tmp_path / "older.ndjson"
    older.write_text("\n".join(lines) + "\n")
    told = run("mcp", "discover", "--journal", older, "--agent", agent, "--json").json
    assert (told["unread"], told["grants"][0]["acts"]) == ({"NO_REPLAY": 1}, 1)
