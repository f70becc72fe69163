"""Units and compose files of a cell are taken by their tools, and run commands of ours."""

import shlex
import shutil
import subprocess

import pytest
import yaml
from tests.house import pages
from ztpm.cell.service_files import Placed, service_files, shipped
from ztpm.cell.site import MACHINES

TOOL_S = 60
PLACES = {
    "of a bundle": Placed("/var/lib/ztpm/gateway"),
    "at home": Placed("/home/carol/my cell's 100%", "/home/carol/venv/bin/ztpm"),
    "elsewhere": Placed("/srv/cell", authority=False),
}


def tool(name):
    found = shutil.which(name)
    if found is None:
        pytest.skip(f"{name} is not on the path")
    return found


def lines(text, key):
    return [line.partition("=")[2] for line in text.splitlines() if line.startswith(f"{key}=")]


@pytest.mark.parametrize("placed", PLACES.values(), ids=PLACES)
def test_systemd_takes_every_unit(tmp_path, placed):
    made = {name: text for name, text in service_files(MACHINES, placed).items() if name.endswith(".service")}
    for name, text in made.items():
        program = shlex.split(lines(text, "ExecStart")[0])[0]
        (tmp_path / name).write_text(text.replace(program, "/bin/true", 1).replace(f"={program} ", "=/bin/true "))
    ran = subprocess.run(
        [tool("systemd-analyze"), "verify", "--man=no", *(str(tmp_path / name) for name in made)],
        capture_output=True, text=True, timeout=TOOL_S, check=False,
    )  # fmt: skip
    assert [line for line in ran.stderr.splitlines() if "ztpm-" in line] == []


@pytest.mark.parametrize("placed", PLACES.values(), ids=PLACES)
def test_what_is_run_is_a_command_with_the_cells_configuration(placed):
    for name, text in service_files(MACHINES, placed).items():
        if name.endswith(".service"):
            program, *words = shlex.split(lines(text, "ExecStart")[0].replace("%%", "%"))
            assert program == placed.program
            assert words[-1].startswith(placed.directory)
            pages.assert_command(["ztpm", *words])
            assert lines(text, "User") == ["ztpm"]
            assert lines(text, "NoNewPrivileges") == ["yes"]
            assert lines(text, "ProtectHome") == ["read-only" if placed.directory.startswith("/home") else "yes"]


def test_only_the_gateway_may_go_first_and_it_has_the_time_to_stop_an_arm():
    made = service_files(MACHINES, PLACES["elsewhere"])
    realtime = {name: lines(text, "LimitRTPRIO") for name, text in made.items() if name.endswith(".service")}
    assert realtime == {"ztpm-idp.service": [], "ztpm-gateway.service": ["1"], "ztpm-tools.service": []}
    assert lines(made["ztpm-gateway.service"], "TimeoutStopSec") == ["60"]
    assert "ztpm-gateway.service" in lines(made["ztpm-tools.service"], "After")[0]


def test_compose_takes_the_file(tmp_path):
    made = service_files(MACHINES, Placed(str(tmp_path)))["compose.yaml"]
    services = yaml.safe_load(made)["services"]
    assert list(services) == list(MACHINES)
    assert services["tools"]["depends_on"] == ["provider", "gateway"]
    for each in services.values():
        pages.assert_command(["ztpm", *each["command"]])
        assert (each["read_only"], each["cap_drop"], each["user"]) == (True, ["ALL"], "10001:10001")
    (tmp_path / "compose.yaml").write_text(made)
    (tmp_path / "secrets").mkdir()
    (tmp_path / "secrets/passphrase").write_text("a passphrase for tests")
    ran = subprocess.run(
        [tool("docker-compose"), "-f", str(tmp_path / "compose.yaml"), "config", "-q"],
        capture_output=True, text=True, timeout=TOOL_S, check=False,
    )  # fmt: skip
    assert ran.returncode == 0, ran.stderr


def test_the_shipped_files_are_these():
    for name, text in shipped().items():
        assert (pages.TOP / "deploy" / name).read_text() == text, "python -m docs.generate"
