"""`ztpm up` as a user runs it: a process asked through its ports, ended, killed, started again."""

import json
import os
import select
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import httpx2
import pytest
from capabilities.keys import keys
from pep.mcp.mapping import ARM_TOOLS
from ztpm.base.layout import Layout, new_key, read_key
from ztpm.cell.setup import Addresses
from ztpm.stage.calls import call
from ztpm.stage.lending import lent
from ztpm.stage.stage import ACCELERATION_RAD_S2, RIGHT, SPEED_RAD_S, Stage
from ztpm_idp.client import Agent, Operator

PASSPHRASE = "a passphrase for tests"
READY_S, END_S, SEEN_S = 300, 60, 60  # a shared machine may give a tenth of a core
MEASUREMENT = bytes(range(32))
pytestmark = [pytest.mark.e2e, pytest.mark.timeout(900)]


HTTP = httpx2.Client(timeout=5, limits=httpx2.Limits(max_keepalive_connections=0))
"""One client for all that is asked of the page.

A client for each question would take its time from what is waited for."""


def until(seen, what, limit_s=SEEN_S):
    deadline = time.monotonic() + limit_s
    while not (found := seen()):
        assert time.monotonic() < deadline, what
        time.sleep(0.05)
    return found


def alive(pid):
    try:
        return Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except FileNotFoundError:
        return False


def until_refused(call):
    try:
        while call().decision != "PERMIT":
            time.sleep(0.05)
    except Exception:  # the server died in the middle, as it should
        return


class Running:
    """A `ztpm up`, ready."""

    def __init__(self, data, *options):
        command = [str(Path(sys.executable).with_name("ztpm")), "up", "--data", str(data), "--json", *options]
        self.errors = data.with_suffix(".stderr")
        with self.errors.open("ab") as errors:
            self.process = subprocess.Popen(
                command, stdout=subprocess.PIPE, stderr=errors, env={**os.environ, "ZTPM_PASSPHRASE": PASSPHRASE}
            )
        ready, _, _ = select.select([self.process.stdout], [], [], READY_S)
        line = self.process.stdout.readline() if ready else b""
        self.told = json.loads(line or b"{}")
        if self.told.get("ready") is not True:
            self.process.kill()
            self.process.wait()
            pytest.fail(f"not ready: {line!r} {self.errors.read_text()}")

    @property
    def pids(self):
        return self.told["processes"]

    def status(self):
        try:
            return HTTP.get(self.told["status"] + "status.json").json()
        except httpx2.HTTPError:
            return None

    def part(self, name):
        status = self.status()
        return status and next((part for part in status["parts"] if part["name"] == name), None)

    def end(self, number=signal.SIGTERM):
        self.process.send_signal(number)
        return self.process.wait(END_S)

    def kill_all(self):
        for pid in (self.process.pid, *self.pids.values()):
            os.kill(pid, signal.SIGKILL)
        self.process.wait(END_S)


@pytest.fixture
def up(tmp_path):
    started = []

    def start():
        started.append(Running(tmp_path / "cell"))
        return started[-1]

    yield start
    for running in started:
        if running.process.poll() is None:
            running.process.kill()
            running.process.wait()
        until(lambda: not any(map(alive, running.pids.values())), "no child outlives it")


class Caller:
    """An agent of the cell, with a token that lends it the arm."""

    def __init__(self, running):
        layout = Layout(Path(running.told["data"]))
        secret, issuer = PASSPHRASE.encode(), running.told["issuer"]
        self.alice = Operator("alice", read_key(layout.operator_key("alice"), secret), issuer)
        key = new_key(layout.agent_key("mover"), secret)
        self.alice.register_agent(
            "mover", keys.public_raw(key), software_digest=MEASUREMENT.hex(), model="none", role="mover"
        )
        self.alice.set_trust("mover", 900)
        self.agent = Agent("mover", key, issuer, MEASUREMENT)
        self.agent.attest()
        self.audience = running.told["audience"]
        stage = Stage(cell=type("Here", (), {"addresses": Addresses(running.told["controller"])})(), people={})
        self.lent = self.alice.issue(self.agent, lent(stage), purpose="move")

    def move(self, to=RIGHT, speed=SPEED_RAD_S):
        arguments = {"q_rad": list(to), "speed_rad_s": speed, "acceleration_rad_s2": ACCELERATION_RAD_S2}
        return call(self.audience, self.agent.auth(self.lent.token), "move_joint", arguments)


def assert_private(running):
    """Another host's name and another user of this machine see nothing."""
    other_host = HTTP.get(running.told["status"], headers={"Host": "evil.example"})
    assert (other_host.status_code, other_host.text) == (421, "WRONG_HOST\n")
    if os.getuid() == 0:  # only root can be somebody else
        code = (
            "import http.client\n"
            f"c = http.client.HTTPConnection({running.told['controller']!r}, {httpx2.URL(running.told['status']).port}, timeout=10)\n"
            "c.request('GET', '/status.json'); r = c.getresponse(); print(r.status, r.read().decode())\n"
        )
        asked = ["/usr/bin/env", "python3", "-I", "-c", code]
        done = subprocess.run(asked, capture_output=True, text=True, timeout=30, user=65_534, group=65_534, check=False)
        assert done.stdout.split() == ["403", "NOT_YOURS"], done.stderr


def test_up_shows_how_it_stands_ends_in_order_or_not_and_comes_back_as_it_was(up, tmp_path):
    first = up()
    assert set(first.pids) == {"identity provider", "controller", "sensor", "gateway", "tool server"}
    assert first.told["differing"] == []

    # the page: for people and programs, its own scripts alone, everything answers
    page = HTTP.get(first.told["status"])
    assert page.status_code == 200
    assert page.headers["content-security-policy"].startswith("default-src 'none'; style-src 'self';")
    assert "<noscript><meta http-equiv" in page.text, "without a script it loads itself again"
    assert HTTP.get(first.told["status"] + "console.css").headers["content-type"].startswith("text/css")
    assert HTTP.post(first.told["status"]).status_code == 405
    status = until(lambda: (s := first.status()) and s["perception"]["perception"] == "fresh" and s, "fresh perception")
    assert all(part["pid"] and part["answers"] is not False for part in status["parts"])
    assert (status["robot"]["moving"], status["view"]["age_ms"] < 2_000) == (False, True)

    assert_private(first)

    # a second one on the same directory is refused, and the first does not notice
    second = subprocess.run(
        [str(Path(sys.executable).with_name("ztpm")), "up", "--data", str(tmp_path / "cell"), "--json"],
        capture_output=True, timeout=READY_S, env={**os.environ, "ZTPM_PASSPHRASE": PASSPHRASE}, check=False,
    )  # fmt: skip
    assert (second.returncode, json.loads(second.stdout)["code"]) == (1, "RUNNING_ALREADY")
    assert str(first.process.pid) in json.loads(second.stdout)["detail"]

    # a permitted motion and an open question are on the page
    caller = Caller(first)
    until(lambda: caller.move().decision == "PERMIT", "it moves")
    scene = tmp_path / "cell" / "cell" / "scene.json"
    scene.write_text(json.dumps({"people": [{"id": "p1", "x_m": -0.62, "y_m": -0.3}]}))
    until(lambda: first.status()["perception"]["people"] == 1, "the person of the scene file")
    until(lambda: caller.move((-0.6, *RIGHT[1:])).decision == "DEFER", "people are asked")
    status = until(lambda: (s := first.status()) and s["asks"] and s, "the open ask")
    assert status["asks"][0]["agent"] == "mover"
    decided = [(d["effect"], d["agent"], d["outcome"]) for d in status["decisions"]]
    assert decided.index(("DEFER", "mover", "")) < decided.index(("PERMIT", "mover", "done"))
    assert status["asks"][0]["ask_id"] in HTTP.get(first.told["status"]).text

    # SIGTERM: exit 0, nobody is left
    assert first.end() == 0
    assert not any(map(alive, first.pids.values()))

    # again: the same addresses, the same agents and decisions, nothing registered anew; the scene is still what it was
    ledger_kinds = lambda: [json.loads(line).get("kind") for line in caller.alice.export_ledger().splitlines()]
    again = up()
    assert {k: again.told[k] for k in ("issuer", "audience", "status")} == {
        k: first.told[k] for k in ("issuer", "audience", "status")
    }
    assert (ledger_kinds().count("tool-registered"), again.told["differing"]) == (len(ARM_TOOLS), [])
    status = until(lambda: (s := again.status()) and s["perception"]["people"] == 1 and s, "the same scene")
    assert any(d["effect"] == "PERMIT" and d["outcome"] == "done" for d in status["decisions"])
    assert [agent["id"] for agent in caller.alice.agents()] == ["mover"]

    # as in a power cut: what was acknowledged is not lost
    epoch = caller.alice.revoke("hop", caller.lent.hop_id, "before the power cut")
    again.kill_all()
    until(lambda: not any(map(alive, again.pids.values())), "everything is dead")
    third = up()
    log = [json.loads(line) for line in Path(third.told["data"], "up.log").read_text().splitlines()]
    assert [event["pid"] for event in log if event["event"] == "stale-lock"] == [again.process.pid]
    status = until(lambda: (s := third.status()) and s["view"]["epoch"] == epoch and s, "the revocation")
    assert any(d["effect"] == "PERMIT" and d["outcome"] == "done" for d in status["decisions"])
    until(lambda: caller.move().reason == "REVOKED", "the token is dead")

    # it alone is killed: its children end by themselves, and the next one waits for its addresses meanwhile
    third.process.kill()
    third.process.wait(END_S)
    fourth = up()
    assert not any(map(alive, third.pids.values()))
    assert fourth.end(signal.SIGINT) == 0


@pytest.mark.campaign
def test_dead_children_are_mended_and_on_record_and_one_that_dies_too_often_ends_everything(up, tmp_path):
    from rtde_receive import RTDEReceiveInterface

    running = up()
    caller = Caller(running)
    for name in ("sensor", "identity provider", "controller", "tool server"):
        pid = running.pids[name]
        os.kill(pid, signal.SIGKILL)
        until(
            lambda: (part := running.part(name)) and part["pid"] not in (None, pid) and part["restarts"] >= 1,
            f"{name} runs again",
            READY_S,
        )

    # the gateway dies while the arm moves: the arm is stopped in its place, long before the gateway is back
    def whole():
        status = running.status()
        return status and not status["incomplete"] and status["perception"]["perception"] == "fresh" and status

    def gateway(status):
        return next(part["pid"] for part in status["parts"] if part["name"] == "gateway")

    pid = gateway(until(whole, "everything works", READY_S))
    eyes = RTDEReceiveInterface(running.told["controller"])
    try:
        # Until its gateway is gone: on a loaded machine a call may be refused, since a view grew too old for it.
        threading.Thread(target=until_refused, args=(caller.move,), daemon=True).start()
        until(lambda: max(map(abs, eyes.getActualQd())) > 0.2, "it moves")
        os.kill(pid, signal.SIGKILL)
        until(lambda: max(map(abs, eyes.getActualQd())) < 1e-3, "it stands", 2)
        assert abs(eyes.getActualQ()[0] - RIGHT[0]) > 0.1, "stopped, not arrived"
    finally:
        eyes.disconnect()
    until(lambda: (s := whole()) and gateway(s) not in (None, pid), "the gateway is back", READY_S)
    until(lambda: caller.move().decision == "PERMIT", "it moves again")
    log = [json.loads(line) for line in Path(running.told["data"], "up.log").read_text().splitlines()]
    assert [e["process"] for e in log if e["event"] == "restarted"] == ["sensor", "idp", "robot", "tools", "gateway"]
    assert "arm-stopped" in {event["event"] for event in log}

    # From now on the provider cannot start: its database is no database. Written before the kill: the supervisor is quick.
    pids = {part["name"]: part["pid"] for part in running.status()["parts"]}
    for path in (tmp_path / "cell" / "idp").glob("idp.sqlite*"):
        path.write_bytes(b"not a database" * 100)
    os.kill(pids["identity provider"], signal.SIGKILL)
    assert running.process.wait(READY_S) == 1
    told = json.loads(running.process.stdout.read().splitlines()[-1])
    assert (told["ok"], told["code"]) == (False, "PROCESS_LOST")
    assert "idp" in told["detail"], "it is named"
    assert not any(map(alive, pids.values()))
