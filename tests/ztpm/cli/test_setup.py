"""`ztpm init` makes a whole cell or nothing; commands that read files end in a code, not a traceback."""

from __future__ import annotations

import json
import stat
import time
import tomllib

import pytest
from capabilities.values.caps import DEFAULT
from typer.testing import CliRunner
from ztpm.base.layout import Layout, read_key
from ztpm.cell.setup import SECOND_SENSOR_ID, SENSOR_ID
from ztpm.cell.simulated_platform import TRUST_DOMAIN, Attestor, workload_id
from ztpm.point.cell_config import read_cell
from ztpm.point.gateway_config import read_gateway_config
from ztpm.point.tool_proxy_config import read_door_config
from ztpm_idp.settings import load_keys, load_platform, load_settings

from capabilities.keys import keys
from capabilities.statements import workload
from ztpm.cli import app

pytestmark = pytest.mark.version

PASSPHRASE = "correct horse battery staple"


def run(*arguments):
    result = CliRunner().invoke(app, [*arguments, "--json"], env={"ZTPM_PASSPHRASE": PASSPHRASE})
    assert result.exception is None or isinstance(result.exception, SystemExit), result.exception
    return result.exit_code, [json.loads(line) for line in result.stdout.splitlines()]


@pytest.mark.parametrize(
    "name", ["plain", 'a "quoted" one', "back\\slash", "tab\tbed", "\U0001f916", "del\x7f", "new\nline"]
)
def test_whatever_the_directory_is_called_both_services_read_their_files(tmp_path, name):
    layout = Layout(tmp_path / name)
    assert run("init", "--data", str(layout.root), "--host", "127.0.0.1")[0] == 0
    settings = load_settings(layout.idp_config)
    own = load_keys(settings, layout.root, PASSPHRASE)
    assert load_platform(settings, layout.root, own).trust_domain == TRUST_DOMAIN
    assert settings.database_url == f"sqlite+aiosqlite:///{layout.database}"
    assert read_door_config(layout.cell_config).trust_file == layout.trust
    config = read_gateway_config(layout.gateway_config)
    assert config.trust_file == layout.trust
    cell = read_cell(config, at=time.time())
    assert (cell.author, list(cell.sensors)) == ("carol", [SENSOR_ID])
    assert layout.trust.is_file()


def test_the_cells_attestor_signs_what_its_provider_takes(tmp_path):
    layout = Layout(tmp_path / "cell")
    assert run("init", "--data", str(layout.root), "--host", "127.0.0.1")[0] == 0
    settings = load_settings(layout.idp_config)
    platform = load_platform(settings, layout.root, load_keys(settings, layout.root, PASSPHRASE))
    attestor = Attestor(read_key(layout.platform_key, PASSPHRASE.encode()), settings.issuer, lambda: 1_800_000_000.5)
    raw = keys.public_raw(keys.generate())
    token = attestor.source("mover", raw, b"m" * 32)()
    said = workload.open(token, platform, audience=settings.issuer, at=1_800_000_001, caps=DEFAULT)
    assert (said.id, said.key_thumbprint, said.measurement) == (workload_id("mover"), keys.thumbprint(raw), b"m" * 32)
    assert platform.holds(workload_id("mover"))


def test_nobody_else_can_read_anything_of_a_cell(tmp_path):
    layout = Layout(tmp_path / "cell")
    assert run("init", "--data", str(layout.root), "--second-sensor")[0] == 0
    files = [path for path in layout.root.rglob("*") if path.is_file()]
    assert {layout.database, layout.sensor_key, layout.second_sensor_key} <= set(files)
    sensors = read_cell(read_gateway_config(layout.gateway_config), at=time.time()).sensors
    assert list(sensors) == [SENSOR_ID, SECOND_SENSOR_ID]
    assert {path.name: stat.S_IMODE(path.stat().st_mode) for path in files if path.stat().st_mode & 0o077} == {}


@pytest.mark.parametrize(
    "wrong",
    [
        ("--host", "10.0.0.5"),
        ("--host", "0.0.0.0"),
        ("--host", '127.0.0.1"'),
        ("--policy", "paper-defualt"),
        ("--policy", "absent.toml"),
    ],
)
@pytest.mark.parametrize("there", [False, True])
def test_what_the_services_would_refuse_is_refused_and_leaves_nothing(tmp_path, wrong, there):
    where = tmp_path / "cell"
    if there:
        where.mkdir()
    status, (said,) = run("init", "--data", str(where), *wrong)
    assert (status, said["code"]) == (2, "CONFIG_INVALID")
    assert where.exists() == there
    assert list(tmp_path.rglob("*")) == ([where] if there else [])


def test_a_database_url_with_options_is_no_directory_name(tmp_path):
    status, (said,) = run("init", "--data", str(tmp_path / "what?mode=memory"))
    assert (status, said["code"]) == (2, "CONFIG_INVALID")
    assert list(tmp_path.iterdir()) == []


def test_a_directory_that_holds_anything_is_left_as_it_is(tmp_path):
    (tmp_path / "mine").write_text("x")
    status, (said,) = run("init", "--data", str(tmp_path))
    assert (status, said["code"]) == (2, "EXISTS")
    assert [path.name for path in tmp_path.iterdir()] == ["mine"]


def test_a_policy_file_is_written_whole(tmp_path, monkeypatch):
    from importlib import resources

    text = resources.files("policies").joinpath("sets", "paper-default.toml").read_text("utf-8")
    (tmp_path / "mine.toml").write_text(text)
    monkeypatch.chdir(tmp_path)
    assert run("init", "--data", "cell", "--policy", "mine.toml")[0] == 0
    assert tomllib.loads(Layout(tmp_path / "cell").cell_config.read_text())["policy"] == str(tmp_path / "mine.toml")


def test_policy_check_prints_the_parameters():
    status, (said,) = run("policy", "check")
    assert status == 0
    assert {row["name"]: row["value"] for row in said["parameters"]}["lease_motion_ms"] == 2_000
    table = CliRunner().invoke(app, ["policy", "check"])
    assert "lease_motion_ms" in table.stdout


ENTRY = {"v": 1, "seq": 1, "prev": "0" * 64, "at_ms": 0, "actor": "a", "kind": "agent-registered", "body": {"id": "x"}}
RECORD = {
    "kind": "decision",
    "body": {"decision": {"effect": "DENY", "reason": "REVOKED"}, "request": {"operation": "stop"}},
}


def shown(tmp_path, *lines):
    (tmp_path / "ledger").write_bytes(
        b"\n".join(line if isinstance(line, bytes) else json.dumps(line).encode() for line in lines)
    )
    return run("audit", "show", str(tmp_path / "ledger"))


def test_a_ledger_is_shown(tmp_path):
    record = ENTRY | {"kind": "pep-record", "body": {"record": RECORD}}
    assert shown(tmp_path, ENTRY, record, {"checkpoint": "x"}) == (0, [ENTRY, record])
    table = CliRunner().invoke(
        app, ["audit", "show", str(tmp_path / "ledger"), "--kind", "decision"], env={"COLUMNS": "200"}
    )
    assert [line.split()[-3:] for line in table.stdout.splitlines()[1:]] == [["DENY", "REVOKED", "stop"]]


@pytest.mark.parametrize(
    ("line", "code"),
    [
        (b"{", "LINE_MALFORMED"),
        (b"\xff", "LINE_MALFORMED"),
        (b'{"seq":1,"seq":2}', "LINE_MALFORMED"),
        (b'{"seq":NaN}', "LINE_MALFORMED"),
        (b"[" * 100_000, "LINE_MALFORMED"),
        (b"5", "ENTRY_MALFORMED"),
        ({}, "ENTRY_MALFORMED"),
        ({"seq": 1}, "ENTRY_MALFORMED"),
        (ENTRY | {"body": "text"}, "ENTRY_MALFORMED"),
        (ENTRY | {"body": None}, "ENTRY_MALFORMED"),
        (ENTRY | {"body": {"record": 5}}, "ENTRY_MALFORMED"),
        (ENTRY | {"body": {"record": {"kind": "x"}}}, "ENTRY_MALFORMED"),
        (ENTRY | {"body": {"record": {"kind": "x", "body": []}}}, "ENTRY_MALFORMED"),
    ],
)
def test_a_line_that_is_no_entry_is_named(tmp_path, line, code):
    status, said = shown(tmp_path, ENTRY, line)
    assert (status, said[-1]["code"]) == (2, code)
    assert said[-1]["detail"].startswith("line 2")


def test_nothing_in_a_ledger_speaks_to_the_terminal(tmp_path):
    hostile = ENTRY | {"actor": "\x1b[2Jx [red]y[/]", "at_ms": 2**53 - 1}
    shown(tmp_path, hostile)
    table = CliRunner().invoke(app, ["audit", "show", str(tmp_path / "ledger")], env={"COLUMNS": "200"})
    assert table.exit_code == 0
    assert "\x1b" not in table.stdout
    assert "[red]y[/]" in table.stdout
