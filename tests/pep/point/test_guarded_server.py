"""A guard starts only before tools that are declared, registered and as approved; for each kind of the SDK's servers."""

import asyncio
import json
import socket
from typing import Annotated

import pytest
from mcp.server import MCPServer
from mcp.server.lowlevel.server import Server
from mcp_types import CallToolResult, ListToolsResult, TextContent, Tool
from pep.base.errors import ConfigError, DeclarationError, PepFault
from pep.base.ports import RegisteredTool
from pep.mcp.tool_digest import definition_digest
from pep.point.config_text import read_policies
from pep.point.guard_config import GuardConfig
from pep.point.tool_server import GuardedServer
from tests.pep.kit import AUDIENCE, CALIBRATION, ISSUER, PEP, Registry, issuer_keys
from tests.ztpm_idp.test_process import free_port

import pep
from capabilities.keys import keys
from capabilities.statements import observation
from pep import Within, operation, pins

PASSPHRASE = "correct horse battery staple"
TABLE = """
[tool.open_valve]
object = "valve-7"
base_tier = 1
[tool.open_valve.arguments]
percent = { low = 0, high = 1000, unit = "permille", scale = 10 }
"""
VALVE = Tool(
    name="open_valve",
    input_schema={"type": "object", "properties": {"percent": {"type": "number"}}, "required": ["percent"]},
)


def decorated():
    server = MCPServer("plant", log_level="ERROR")

    @server.tool()
    @operation("valve-7", base_tier=1)
    def open_valve(percent: Annotated[float, Within(0, 1_000, "permille", scale=10)]) -> float:
        """Open the valve."""
        return percent

    return server


def lowlevel(*tools):
    async def listed(ctx, params):
        return ListToolsResult(tools=list(tools or (VALVE,)))

    async def called(ctx, params):
        said = json.dumps(params.arguments)
        return CallToolResult(content=[TextContent(type="text", text=said)])

    return Server("plant", on_list_tools=listed, on_call_tool=called)


@pytest.fixture
def written(tmp_path, monkeypatch):
    """`guard.toml` and what it names."""
    monkeypatch.setenv("ZTPM_PASSPHRASE", PASSPHRASE)
    _, trust = issuer_keys()
    (tmp_path / "trust.json").write_bytes(trust.to_json())
    key = tmp_path / "pep.key"
    key.write_bytes(keys.to_pem(keys.generate(), PASSPHRASE.encode()))
    key.chmod(0o600)

    def write(table=""):
        path = tmp_path / "guard.toml"
        path.write_text(
            f'audience = "{AUDIENCE}"\npep_id = "{PEP}"\nissuer = "{ISSUER}"\n'
            f'trust_file = "trust.json"\npep_key_file = "pep.key"\nfolder = "state"\n{table}'
        )
        return path

    return write


def declared(guarded, *registered):
    """Rows that the start lets be called, with these tools registered."""

    async def start():
        try:
            guarded.follower.tool = {tool.name: tool for tool in registered}.get
            await guarded.declare()
            return dict(guarded._rows)
        finally:
            await guarded.release()

    return asyncio.run(start())


def pinned(pin, **changes):
    known = {"name": pin.name, "definition_digest": pin.definition_digest, "operation": pin.operation}
    return RegisteredTool(**{**known, "base_tier": pin.base_tier, **changes})


@pytest.mark.parametrize(("server", "table"), [(decorated, ""), (lowlevel, TABLE)])
def test_a_tool_as_approved_can_be_called(written, server, table):
    path, made = written(table), server()
    (pin,) = pins(made, path)
    rows = declared(pep.guard(made, path), pinned(pin))
    assert [(name, row.object) for name, row in rows.items()] == [("open_valve", "valve-7")]


@pytest.mark.parametrize(
    ("changes", "code"),
    [
        ({"definition_digest": "ab" * 32}, PepFault.TOOL_DEFINITION_CHANGED),
        ({"operation": "close_valve"}, PepFault.TOOL_UNKNOWN),
        (None, PepFault.TOOL_UNKNOWN),
    ],
)
def test_a_tool_that_nobody_approved_ends_the_start(written, changes, code):
    path = written()
    (pin,) = pins(decorated())
    guarded = GuardedServer(decorated(), GuardConfig.read(path))
    with pytest.raises(DeclarationError) as refused:
        declared(guarded, *([] if changes is None else [pinned(pin, **changes)]))
    assert (refused.value.code, "open_valve" in refused.value.detail) == (code, True)
    assert guarded._rows == {}, "and nothing can be called"


def test_an_undeclared_tool_ends_the_start(written):
    with pytest.raises(DeclarationError) as refused:
        pins(lowlevel())
    assert refused.value.code is PepFault.TOOL_UNDECLARED
    written(TABLE)
    with pytest.raises(DeclarationError) as refused:
        pins(decorated(), written(TABLE))
    assert refused.value.code is PepFault.TOOL_TWICE


def test_the_digest_of_a_pin_is_the_served_tools():
    (pin,) = pins(decorated())
    assert pin.definition_digest == definition_digest(asyncio.run(decorated().list_tools())[0])


@pytest.mark.parametrize(
    "line",
    [
        "audience = 1",
        'audience = "http://example.org/mcp"',
        'issuer = ""',
        "further = 1",
        "tool = 3",
        "budgets = 3",
        'sensors = "8950"',
        'sensors = "127.0.0.1:x"',
        'sensors = "127.0.0.1:65536"',
        'sensors = ":1"',
        "sensors = 8950",
    ],
)
def test_the_configuration_is_read_strictly(written, line):
    path = written()
    name = line.partition(" ")[0]
    kept = [each for each in path.read_text().splitlines() if not each.startswith(f"{name} ")]
    path.write_text("\n".join([*kept, line]))
    with pytest.raises(ConfigError) as refused:
        GuardConfig.read(path)
    assert refused.value.code is PepFault.CONFIG_INVALID
    assert name in refused.value.detail


DEPENDS = (
    TABLE
    + """[tool.open_valve.when]
"zone-a/people" = { at_least = { 1 = 3 } }
"""
)


def test_the_sensors_of_the_rows_are_heard_at_the_configured_address(written):
    """`sensors` in guard.toml is all that it takes; a sensor that no row names is a stranger."""
    port = free_port()
    path = written(f'sensors = "127.0.0.1:{port}"\n{DEPENDS}')
    guarded, registry = GuardedServer(lowlevel(), GuardConfig.read(path)), Registry()
    signing = {name: registry.add_sensor(name) for name in ("zone-a", "zone-b")}
    (row,), (pin,) = guarded._configured.values(), pins(lowlevel(), path)

    def frame(name):
        at_ms = int(guarded.clock.wall_s() * 1000)
        counted = (observation.ObservedFact("people", "count", 0),)
        seen = observation.Observation(name, "0" * 32, 1, at_ms, CALIBRATION, False, (), (), counted)
        return observation.sign(seen, signing[name]).encode() + b"\n"

    async def push(name):
        reader, writer = await asyncio.open_connection("127.0.0.1", port)
        writer.write(frame(name))
        writer.write_eof()
        await reader.read()  # it is judged when the other side has closed
        writer.close()

    async def start():
        try:
            guarded.follower.tool = {"open_valve": pinned(pin)}.get
            guarded.follower.sensors = registry.sensors
            await guarded.declare()
            await push("zone-a")
            (known,) = guarded.facts.readings(row.facts)
            await push("zone-b")
            (noisy,) = guarded.facts.readings(row.facts)
            return known, noisy
        finally:
            await guarded.facts.close()
            await guarded.release()

    known, noisy = asyncio.run(start())
    assert (known.state, known.value, 20 <= known.age_ms < 500) == ("fresh", 0, True)
    assert (noisy.state, noisy.fault) == ("invalid", "UNKNOWN_SENSOR")
    assert guarded.gate._facts is guarded.facts


def test_a_row_that_depends_on_a_fact_which_nothing_hears_ends_the_start(written):
    path = written(DEPENDS)
    (pin,) = pins(lowlevel(), path)
    guarded = GuardedServer(lowlevel(), GuardConfig.read(path))
    with pytest.raises(ConfigError) as refused:
        declared(guarded, pinned(pin))
    assert refused.value.code is PepFault.CONFIG_INVALID
    assert {word for word in ("sensors", "open_valve", "zone-a/people") if word in refused.value.detail} == {
        "sensors", "open_valve", "zone-a/people"
    }  # fmt: skip
    assert guarded._rows == {}, "and nothing can be called"


def test_an_address_that_is_taken_ends_the_start(written):
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        path = written(f'sensors = "127.0.0.1:{taken.getsockname()[1]}"\n{DEPENDS}')
        (pin,) = pins(lowlevel(), path)
        with pytest.raises(ConfigError) as refused:
            declared(GuardedServer(lowlevel(), GuardConfig.read(path)), pinned(pin))
    assert (refused.value.code, "sensors" in refused.value.detail) == (PepFault.CONFIG_INVALID, True)


@pytest.mark.parametrize(
    ("audience", "stated", "listens"),
    [
        ("http://127.0.0.1:8900/mcp", {}, ("127.0.0.1", 8900)),
        ("http://[::1]:8900/mcp", {}, ("::1", 8900)),
        ("http://localhost/mcp", {}, ("localhost", 80)),
        ("http://127.0.0.1:8900/mcp", {"host": "0.0.0.0", "port": 81}, ("0.0.0.0", 81)),  # noqa: S104 - a container's
        ("https://plant.example/mcp", {"port": 8900}, ("127.0.0.1", 8900)),
        ("https://plant.example:8443/mcp", {}, None),
    ],
)
def test_it_listens_at_its_audience_or_where_it_is_told(written, monkeypatch, audience, stated, listens):
    heard = []
    monkeypatch.setattr("uvicorn.Server.run", lambda self: heard.append(self.config))
    path = written()
    path.write_text(path.read_text().replace(AUDIENCE, audience))
    app = pep.guard(decorated(), path)
    try:
        if listens is None:
            with pytest.raises(ConfigError) as refused:
                app.run(**stated)
            assert (refused.value.code, "port" in refused.value.detail) == (PepFault.CONFIG_INVALID, True)
        else:
            app.run(**stated)
        assert [(each.app, each.host, each.port) for each in heard] == ([(app, *listens)] if listens else [])
    finally:
        asyncio.run(app.release())


def test_it_is_told_that_it_listens_once_it_does(written, monkeypatch):
    heard = []

    async def startup(self, sockets=None):
        heard.append("listens")

    monkeypatch.setattr("uvicorn.Server.startup", startup)
    monkeypatch.setattr("uvicorn.Server.run", lambda self: asyncio.run(self.startup()))
    app = pep.guard(decorated(), written())
    monkeypatch.setattr(app, "listens", lambda: heard.append("told"))
    try:
        app.run()
        assert heard == ["listens", "told"]
    finally:
        asyncio.run(app.release())


def test_a_set_beside_the_configuration_extends_one_beside_itself(written, tmp_path, monkeypatch):
    monkeypatch.chdir("/")
    path = written('policy = "sets/line.toml"\n')
    (tmp_path / "sets").mkdir()
    line, plant = tmp_path / "sets" / "line.toml", tmp_path / "sets" / "plant.toml"
    line.write_text('name = "line"\nversion = 1\nextends = "plant.toml"\n')
    plant.write_text('name = "plant"\nversion = 1\nextends = "tools"\n[parameters]\nhops_max_count = 2\n')
    read = read_policies(GuardConfig.read(path))
    assert (read.name, read.parameters.hops_max_count, read.floor.name) == ("line", 2, "plant")
    plant.write_text('name = "plant"\nversion = 1\nextends = "line.toml"\n')
    with pytest.raises(ConfigError) as refused:
        read_policies(GuardConfig.read(path))
    assert "BASE_CYCLE" in refused.value.detail
    plant.unlink()
    with pytest.raises(ConfigError) as refused:
        read_policies(GuardConfig.read(path))
    assert "UNKNOWN_BASE" in refused.value.detail


def test_a_set_of_its_own_is_the_default(written):
    config = GuardConfig.read(written())
    assert (config.policy, config.journal_file.parent.name) == ("tools", "state")


@pytest.mark.clause("BDG-6")
def test_workers_may_share_one_store_of_budgets(written):
    path = written()
    assert GuardConfig.read(path).budget_file == path.parent / "state" / "budgets.sqlite"
    path.write_text(path.read_text() + '\nbudgets = "shared/spent.sqlite"\n')
    assert GuardConfig.read(path).budget_file == path.parent / "shared" / "spent.sqlite"
