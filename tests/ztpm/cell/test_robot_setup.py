"""`ztpm init --robot` makes a whole cell for the controller that is there, or nothing."""

import json
import os
import pty
import stat
import subprocess
import sys
import time

import pytest
from tests.e2e.tls import Authority
from tests.pep.pit.robot.test_calibration import ARMS, spelled
from typer.testing import CliRunner
from ursim.ports.launch import SimulatedController
from ztpm.base.layout import Layout, new_key, read_key
from ztpm.base.loopback import free_host, is_free
from ztpm.cell.setup import read_addresses
from ztpm.cli.doctor import arm_check
from ztpm.point.cell_config import read_cell, read_robot
from ztpm.point.gateway_config import read_gateway_config
from ztpm.point.tool_proxy_config import read_door_config
from ztpm_idp.safe_files import check_tls
from ztpm_idp.settings import load_keys, load_settings

from capabilities.keys import keys
from ztpm.cli import app

PASSPHRASE = "correct horse battery staple"
PEOPLE = ("--admin", "alice", "--admin", "bob")
STOP = ("--stop-deceleration", "4")
TOOL = {"tcp_m": (0.0, 0.0, 0.1767), "payload": (1.0, 0.0, 0.0, 0.058)}


@pytest.fixture(scope="module")
def robot():
    with SimulatedController.start(robot="ur5e", **TOOL) as found:
        yield found


def run(*arguments):
    result = CliRunner().invoke(app, [*map(str, arguments), "--json"], env={"ZTPM_PASSPHRASE": PASSPHRASE})
    assert result.exception is None or isinstance(result.exception, SystemExit), result.exception
    return result.exit_code, json.loads(result.stdout)


def test_every_process_reads_its_part_of_a_whole_cell(robot, tmp_path):
    layout = Layout(tmp_path / "the cell")
    table = "--table=-0.3,0,-0.06,1,1,0.1"
    status, told = run(
        "init", "--robot", robot.host, "--model", "ur5e", "--data", layout.root, *PEOPLE, *STOP, table,
        "--workspace=-0.7,-0.7,0,0.7,0.7,0.9", "--sensor", "camera-1", "--sensor", "scanner-1",
    )  # fmt: skip
    assert (status, told["robot"]["robot"], told["robot"]["serial"]) == (0, "ur5e", "20235300001")
    assert all(row["ok"] for row in told["network"] + told["checks"])
    settings = load_settings(layout.idp_config)
    load_keys(settings, layout.idp_config.parent, PASSPHRASE)
    assert settings.database_url == f"sqlite+aiosqlite:///{layout.database}"
    gateway, door = read_gateway_config(layout.gateway_config), read_door_config(layout.cell_config)
    stated = read_cell(gateway, at=time.time())
    assert (stated.author, stated.sensors) == ("alice", ("camera-1", "scanner-1"))
    assert (stated.objects[0].name, stated.workspace.high_um) == ("table", (700_000, 700_000, 900_000))
    assert read_robot(gateway, tool=stated.tool).model.name == "ur5e"
    assert gateway.cell.stop_deceleration_rad_s2 == 4.0
    assert (gateway.trust_file.resolve(), door.state_dir) == (layout.trust, layout.state)
    addresses = read_addresses(layout)
    assert (addresses.controller_host, addresses.audience) == (robot.host, told["audience"])
    assert arm_check(layout.gateway_config)[0] is True
    for key in (layout.gateway_key, layout.pep_key, layout.operator_key("bob")):
        read_key(key, PASSPHRASE.encode())
    for path in layout.root.rglob("*"):
        assert stat.S_IMODE(path.stat().st_mode) & 0o077 == 0, path
        if path.suffix in {".toml", ".jws"}:
            assert str(tmp_path) not in path.read_text(), "a directory may lie anywhere"


def test_a_directory_that_was_moved_is_the_same_cell(robot, tmp_path):
    run("init", "--robot", robot.host, "--data", tmp_path / "here", *PEOPLE, *STOP)
    (tmp_path / "here").rename(tmp_path / "there")
    assert arm_check(tmp_path / "there/gateway/gateway.toml")[0] is True


CALIBRATION = spelled(next(iter(ARMS.values())))
REFUSED = {
    "another model": (("--model", "ur3e"), "ROBOT_DIFFERS", 2),
    "no shipped model": (("--model", "ur5"), "CONFIG_INVALID", 2),
    "another tool": (("--tool", "welder"), "ROBOT_DIFFERS", 2),
    "a calibration of another arm": (("--calibration", "CALIBRATION"), "ROBOT_DIFFERS", 2),
    "a calibration that is none": (("--calibration", "NONE"), "UNREADABLE", 2),
    "a table that is no box": (("--table", "1,2,3"), "USAGE", 2),
    "a table that is nowhere": (("--table", "0,0,nan,1,1,1"), "USAGE", 2),
    "a workspace the wrong way round": (("--workspace", "1,1,1,-1,-1,-1"), "DRAFT_MALFORMED", 2),
    "a policy that is none": (("--policy", "whatever"), "CONFIG_INVALID", 2),
    "half of a certificate": (("--tls-key", "NONE"), "USAGE", 2),
    "its own address": (("--host", "ROBOT"), "USAGE", 2),
    "parts of one machine": (("--bundle", "parts"), "USAGE", 2),
    "a person twice": (("--admin", "alice"), "USAGE", 2),
    "an author without a key": (("--author", "carol"), "USAGE", 2),
}


@pytest.mark.parametrize(("options", "code", "status"), REFUSED.values(), ids=REFUSED)
def test_what_is_refused_leaves_nothing(robot, tmp_path, options, code, status):
    (tmp_path / "calibration.yaml").write_text(CALIBRATION)
    (tmp_path / "none.yaml").write_text("kinematics: []\n")
    words = {"CALIBRATION": tmp_path / "calibration.yaml", "NONE": tmp_path / "none.yaml", "ROBOT": robot.host}
    given = [words.get(word, word) for word in options]
    found = run("init", "--robot", robot.host, "--data", tmp_path / "cell", *PEOPLE, *STOP, *given)
    assert (found[0], found[1]["code"]) == (status, code), found
    assert sorted(path.name for path in tmp_path.iterdir()) == ["calibration.yaml", "none.yaml"]


def test_what_is_not_said_is_named_where_nobody_can_be_asked(robot, tmp_path):
    status, told = run("init", "--robot", robot.host, "--data", tmp_path / "cell")
    assert (status, told["code"]) == (2, "USAGE")
    assert "--admin" in told["detail"]
    assert "--stop-deceleration" in told["detail"]
    assert not (tmp_path / "cell").exists()


def test_a_controller_without_the_tool_or_none_is_refused(tmp_path):
    with SimulatedController.start(robot="ur5e") as bare:
        assert (
            run("init", "--robot", bare.host, "--data", tmp_path / "cell", *PEOPLE, *STOP)[1]["code"] == "ROBOT_DIFFERS"
        )
    nobody = free_host(b"nobody", lambda host: is_free(host, 29999))
    status, told = run("init", "--robot", nobody, "--data", tmp_path / "cell", *PEOPLE, *STOP)
    assert (status, told["code"]) == (1, "ROBOT_UNREACHABLE")
    assert not (tmp_path / "cell").exists()


def test_a_directory_with_anything_in_it_is_left_as_it_is(robot, tmp_path):
    (tmp_path / "kept").write_text("mine")
    assert run("init", "--robot", robot.host, "--data", tmp_path, *PEOPLE, *STOP)[1]["code"] == "EXISTS"
    assert [path.name for path in tmp_path.iterdir()] == ["kept"]


def test_a_person_in_a_terminal_is_asked_for_what_is_not_said(robot, tmp_path):
    """A real terminal: host, administrators, stop, table and workspace, in this order."""
    leader, follower = pty.openpty()
    env = os.environ | {"ZTPM_PASSPHRASE": PASSPHRASE}
    command = [sys.executable, "-m", "ztpm", "init", "--robot", robot.host, "--data", str(tmp_path / "cell")]
    with subprocess.Popen(command, stdin=follower, stdout=subprocess.PIPE, stderr=subprocess.PIPE, env=env) as asked:
        os.write(leader, b"\nalice, bob\n4\n-0.3,0,-0.06,1,1,0.1\n\n")
        out, errors = asked.communicate(timeout=60)
    for descriptor in (leader, follower):
        os.close(descriptor)
    assert asked.returncode == 0, (out, errors)
    assert errors.decode().count(":") >= 5
    layout = Layout(tmp_path / "cell")
    stated = read_cell(read_gateway_config(layout.gateway_config), at=time.time())
    assert ([each.name for each in stated.objects], stated.workspace) == (["table"], None)
    assert sorted(path.stem for path in layout.operator_key("any").parent.iterdir()) == ["alice", "bob"]


def test_parts_have_the_keys_of_their_machine_and_no_others(robot, tmp_path):
    hosts = ("--host", "10.0.5.30", "--gateway-host", "10.0.5.20", "--provider-host", "10.0.5.10")
    status, told = run(
        "init",
        "--robot",
        robot.host,
        "--data",
        tmp_path / "cell",
        *PEOPLE,
        *STOP,
        *hosts,
        "--bundle",
        tmp_path / "parts",
    )
    assert (status, sorted(told["bundles"])) == (0, ["gateway", "provider", "tools"])
    keys = {str(path.relative_to(tmp_path)) for path in tmp_path.rglob("*.key")}
    assert {key for key in keys if not key.startswith("parts/provider/")} == {
        "cell/operators/alice.key", "cell/operators/bob.key", "cell/tls/ca.key",
        "parts/gateway/gateway/gateway.key", "parts/gateway/tls/gateway.key",
        "parts/tools/cell/pep.key", "parts/tools/tls/tools.key",
    }  # fmt: skip
    assert not list((tmp_path / "cell").rglob("idp*"))
    for machine in ("provider", "gateway", "tools"):
        part = tmp_path / "parts" / machine
        assert (part / "trust.json").exists() and (part / "tls/ca.pem").exists()
        assert len(list((part / "deploy").glob("*.service"))) == 1
    assert arm_check(tmp_path / "parts/gateway/gateway/gateway.toml")[0] is True
    assert read_addresses(Layout(tmp_path / "cell")).hosts == {
        "provider": "10.0.5.10", "gateway": "10.0.5.20", "tools": "10.0.5.30",
    }  # fmt: skip


def test_parts_that_cannot_be_made_leave_no_cell(robot, tmp_path):
    (tmp_path / "parts").write_text("a file")
    status, told = run(
        "init", "--robot", robot.host, "--data", tmp_path / "cell", *PEOPLE, *STOP, "--host", "10.0.5.30",
        "--bundle", tmp_path / "parts",
    )  # fmt: skip
    assert (status != 0, told["ok"]) == (True, False)
    assert [path.name for path in tmp_path.iterdir()] == ["parts"]


def test_a_certificate_is_renewed_by_the_cells_authority_alone(robot, tmp_path):
    run("init", "--robot", robot.host, "--data", tmp_path / "cell", *PEOPLE, *STOP, "--host", "10.0.5.30")
    renew = ("enrol", "certificate", "gateway", "--host", "10.0.5.20", "--out", tmp_path / "renewed")
    assert run(*renew, "--data", tmp_path / "cell")[0] == 0
    check_tls(tmp_path / "renewed/gateway.pem", tmp_path / "renewed/gateway.key", at=time.time())
    assert run(*renew, "--data", tmp_path / "cell")[1]["code"] == "EXISTS"
    run("init", "--robot", robot.host, "--data", tmp_path / "loopback", *PEOPLE, *STOP)
    assert run(*renew, "--data", tmp_path / "loopback")[1]["code"] == "KEYS_UNREADABLE"


def test_a_certificate_of_ones_own_is_every_machines(robot, tmp_path):
    authority = Authority(tmp_path, ["10.0.5.30"])
    options = ("--tls-certificate", authority.certificate, "--tls-key", authority.key, "--host", "10.0.5.30")
    assert run("init", "--robot", robot.host, "--data", tmp_path / "cell", *PEOPLE, *STOP, *options)[0] == 0
    layout = Layout(tmp_path / "cell")
    assert not layout.authority.exists()
    gateway, tools = read_gateway_config(layout.gateway_config), read_door_config(layout.cell_config)
    assert {config.tls_certificate_file.read_bytes() for config in (gateway, tools)} == {
        authority.certificate.read_bytes()
    }


def test_enrolling_asks_for_the_cell_and_reads_what_init_wrote(robot, tmp_path):
    key = tmp_path / "alice.key"
    new_key(key, PASSPHRASE.encode())
    away = ("--issuer", "http://127.0.0.1:9/ztpm", "--key", key, "--as", "alice")
    public = keys.b64u(keys.public_raw(read_key(key, PASSPHRASE.encode())))
    assert run("enrol", "gateway", "gateway-1", "--public", public, *away)[1]["code"] == "WHICH_AUDIENCE"
    run("init", "--robot", robot.host, "--data", tmp_path / "cell", *PEOPLE, *STOP)
    own = ("--data", tmp_path / "cell", "--as", "alice")
    assert run("enrol", "tools", "cell-1", *own)[1]["code"] == "UNREACHABLE"
    Layout(tmp_path / "cell").controller.write_text("[]")
    assert run("enrol", "tools", "cell-1", *own)[1]["code"] == "UNREADABLE"
