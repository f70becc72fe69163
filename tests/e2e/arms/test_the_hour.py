"""The first hour with a robot on another host, by the commands of docs/deployment.md."""

import contextlib
import json
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from tests.e2e.arms.namespaces import ROBOT, cable, on

pytestmark = [pytest.mark.e2e, pytest.mark.campaign, pytest.mark.timeout(180)]
# the suite has the parts: tests/ztpm/cell/test_robot_setup.py

PAGE = (Path(__file__).parents[3] / "docs/deployment.md").read_text("utf-8")
COMMANDS, SENSOR_LINES = 15, 5
"""Most commands that a person types, and lines of Python."""
WAIT_S = 60
PASSPHRASE = "a passphrase for tests"


def block(mark):
    (found,) = re.findall(rf"<!-- {re.escape(mark)} -->\n```\w+\n(.*?)```", PAGE, re.DOTALL)
    return found


class Desk:
    """A shell on a host: each line as a person types it."""

    def __init__(self, host, folder):
        self._host = host
        self.jobs = []
        programs = f"{Path(sys.executable).parent}:{os.environ['PATH']}"
        own = {"ZTPM_DATA": "cell", "ZTPM_AS": "alice", "ZTPM_PASSPHRASE": PASSPHRASE, "PATH": programs}
        self._options = {"cwd": folder, "env": os.environ | own, "stdout": subprocess.PIPE, "text": True}

    def types(self, line):
        """Ends with the command; its standard output and standard error."""
        ran = subprocess.run(
            on(self._host, "bash", "-c", line), stderr=subprocess.PIPE, timeout=WAIT_S, check=False, **self._options
        )
        assert ran.returncode == 0, (line, ran.stdout, ran.stderr)
        return ran.stdout, ran.stderr

    def begins(self, line):
        """A command that goes on; its errors are read with its output."""
        words = line.removesuffix("&").strip()
        command = on(self._host, "bash", "-c", f"exec {words}")
        self.jobs.append(subprocess.Popen(command, stderr=subprocess.STDOUT, **self._options))
        return self.jobs[-1]

    def kill(self, line):
        """`kill %N`."""
        job = self.jobs[int(line.removeprefix("kill %")) - 1]
        job.terminate()
        job.communicate(timeout=WAIT_S)


def until(job, words):
    """Lines of the job up to the one with these words."""
    told = []
    for line in job.stdout:
        told.append(line)
        if words in line:
            return told
    pytest.fail(f"it ended without {words!r}: {''.join(told)}")


@contextlib.contextmanager
def hosts(folder, *arm):
    """Two hosts, and a simulated arm with its tool on the robot's; a desk on each."""
    with cable() as (cell, robot):
        desk, bench = Desk(cell, folder), Desk(robot, folder)
        try:
            until(bench.begins(f"python -m ztpm rtde sim --host {ROBOT} {' '.join(arm)}"), "listens")
            yield desk
        finally:
            for job in reversed([*bench.jobs, *desk.jobs]):
                job.terminate()
            for job in [*bench.jobs, *desk.jobs]:
                job.communicate(timeout=WAIT_S)


def test_the_hour_is_the_pages_commands(tmp_path):
    lines = block("commands: first steps").splitlines()
    camera = block("file: camera.py")
    assert len(lines) <= COMMANDS
    assert len(list(filter(None, camera.splitlines()))) <= SENSOR_LINES
    assert all(line.split()[0] in {"ztpm", "python", "kill"} for line in lines)
    (tmp_path / "camera.py").write_text(camera)
    (tmp_path / "first.py").write_text(block("file: first.py"))
    (tmp_path / "camera-1.txt").write_text("0.6 m above the table; measured by carol\n")
    init, up, enrol, sees, register, attest, issue, moves, too_fast, blinds, asks, shows, approves = lines
    with hosts(tmp_path, "--robot ur5e --tool robotiq_2f85") as desk:
        made, _ = desk.types(init)
        assert re.search(r"A ur5e at 10\.0\.99\.2: serial number \d+, .*5\.11", made)
        assert "OPEN" not in made
        until(desk.begins(up), "The cell is up")
        desk.types(enrol)
        desk.begins(sees)
        for line in (register, attest, issue):
            desk.types(line)
        assert desk.types(moves)[0].split() == ["True", "0.05"]
        said, why = desk.types(too_fast)
        assert (said.split(), "LIMIT_EXCEEDED_BY_REQUEST" in why) == (["False", "0.0"], True)
        desk.kill(blinds)
        waiting = desk.begins(asks)
        until(waiting, "TIER_NEEDS_APPROVAL")
        (ask,) = re.findall(r"^[0-9a-f]{32}\b", desk.types(shows)[0], re.MULTILINE)
        desk.types(approves.replace("ASK", ask))
        assert "True 0.05" in waiting.communicate(timeout=WAIT_S)[0]
    assert json.loads((tmp_path / "cell/controller.json").read_text())["robot"] == "ur5e"
    assert 'issuer = "https://' in (tmp_path / "cell/gateway/gateway.toml").read_text()


def test_each_machine_serves_with_its_part_alone(tmp_path):
    """Provider, gateway and tool server, each from a directory of its own; one command enrols each."""
    (tmp_path / "camera-1.txt").write_text("0.6 m above the table; measured by carol\n")
    (init,), enrols = block("commands: several machines").splitlines(), block("commands: enrol").splitlines()
    with hosts(tmp_path, "--robot ur5e --tool robotiq_2f85") as desk:
        desk.types(f"{init} --json")
        made = subprocess.run(
            [sys.executable, "-m", "ztpm", "person", "new-key", "camera-1.key", "--json"],
            cwd=tmp_path, env=os.environ | {"ZTPM_PASSPHRASE": PASSPHRASE}, capture_output=True, text=True, check=True,
        )  # fmt: skip
        parts = {name: tmp_path / "parts" / name for name in ("provider", "gateway", "tools")}
        keys = {str(path.relative_to(tmp_path)) for path in tmp_path.rglob("*.key")} - {"camera-1.key"}
        assert {key for key in keys if key.startswith("cell/")} == {
            "cell/operators/alice.key", "cell/operators/bob.key", "cell/tls/ca.key",
        }  # fmt: skip
        assert {key for key in keys if key.startswith(("parts/gateway", "parts/tools"))} == {
            "parts/gateway/gateway/gateway.key", "parts/gateway/tls/gateway.key",
            "parts/tools/cell/pep.key", "parts/tools/tls/tools.key",
        }  # fmt: skip
        authority = "SSL_CERT_FILE={}/tls/ca.pem".format
        until(desk.begins(f"ztpm idp serve --config {parts['provider']}/idp/idp.toml"), '"ready": true')
        for line in enrols:
            desk.types(line.replace("PUBLIC", json.loads(made.stdout)["public"]))
        for name, words in (("gateway", "rtde gateway --config {}/gateway/gateway.toml"),
                            ("tools", "mcp serve --config {}/cell/cell.toml")):  # fmt: skip
            served = words.format(parts[name])
            until(desk.begins(f"env {authority(parts[name])} ztpm {served}"), '"ready": true')
        shown, _ = desk.types("ztpm pep list --json")
        assert {row["id"] for row in json.loads(shown)["peps"]} == {"gateway-1", "cell-1"}
