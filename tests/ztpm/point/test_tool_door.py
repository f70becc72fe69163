"""The process of a tool server without a robot: configured strictly, light, and before a guarded gateway over real sockets."""

import asyncio
import contextlib
import json
import os
import signal
import subprocess
import sys
from contextlib import asynccontextmanager
from pathlib import Path

import httpx2
import pytest
from capabilities.statements.registry import PartyEntry
from pep.base.clock import SystemClock
from pep.base.errors import ConfigError, PepFault
from policies.decision.load import load_shipped
from tests.pep import kit
from tests.pep.kit import AUDIENCE, HOST, MOVE, PORT
from tests.pep.mcp.forwarding import DOOR, GATEWAY_PORT, URL, House, listening
from tests.pep.mcp.test_mcp import call_body
from ztpm.point.tool_proxy import ToolProxy
from ztpm.point.tool_proxy_config import ToolProxyConfig, read_door_config

from capabilities.keys import keys

ISSUER_PORT = PORT - 1
PASSPHRASE = "secret words"
HEAVY = (
    "numpy",
    "numba",
    "llvmlite",
    "pinocchio",
    "coal",
    "rtde_control",
    "rtde_receive",
    "rtde_io",
    "mcp",
    "sqlalchemy",
)
"""Packages that a process which only verifies and passes on does not need."""
GOOD = {
    "audience": f'"{AUDIENCE}"',
    "host": f'"{HOST}"',
    "port": str(PORT),
    "pep_id": f'"{DOOR}"',
    "issuer": '"http://127.0.0.1:8898/ztpm"',
    "trust_file": '"/nonexistent/trust.json"',
    "pep_key_file": '"/nonexistent/pep.key"',
    "journal_file": '"/nonexistent/journal"',
    "state_dir": '"/nonexistent"',
    "policy": '"paper-default"',
    "gateway_url": f'"{URL}"',
}


def toml(**changes):
    return "".join(f"{key} = {value}\n" for key, value in {**GOOD, **changes}.items() if value is not None)


def test_the_good_one():
    config = ToolProxyConfig.from_toml(toml())
    assert (config.gateway_url, config.port, config.policy) == (URL, PORT, "paper-default")


@pytest.mark.parametrize("key", GOOD)
def test_nothing_may_be_missing_or_of_another_type(key):
    for value in (None, "[]", "true", '""'):
        with pytest.raises(ConfigError) as raised:
            ToolProxyConfig.from_toml(toml(**{key: value}))
        assert raised.value.code is PepFault.CONFIG_INVALID
        assert raised.value.detail.startswith(key)


BAD = {
    "plain http to another machine": {"gateway_url": '"http://robot.example/calls"'},
    "no path": {"gateway_url": '"http://127.0.0.1:8902"'},
    "a query": {"gateway_url": '"http://127.0.0.1:8902/calls?x=1"'},
    "another scheme": {"gateway_url": '"ftp://127.0.0.1/calls"'},
    "listens everywhere": {"host": '"0.0.0.0"'},
    "no port": {"port": "0"},
    "what only a robot has": {"robot_host": '"127.0.0.1"'},
}


@pytest.mark.parametrize("name", BAD)
def test_bad_ones(name):
    with pytest.raises(ConfigError) as raised:
        ToolProxyConfig.from_toml(toml(**BAD[name]))
    assert raised.value.code is PepFault.CONFIG_INVALID
    assert raised.value.detail.startswith(next(iter(BAD[name])))


def test_a_gateway_on_another_machine_is_reached_by_tls():
    config = ToolProxyConfig.from_toml(toml(gateway_url='"https://robot.example/calls"'))
    assert config.gateway_url == "https://robot.example/calls"


def test_it_loads_no_physics_and_no_robot():
    """Nor do the parts common to all enforcement points: such a process starts in a second."""
    ask = "import json, sys; import ztpm.point.tool_proxy; print(json.dumps(sorted(sys.modules)))"
    loaded = json.loads(subprocess.run([sys.executable, "-c", ask], capture_output=True, check=True, timeout=60).stdout)
    assert "ztpm.point.enforcement_point" in loaded
    assert [
        name for name in loaded if name.split(".")[0] in HEAVY or name.startswith(("pep.pit", "pep.rtde", "ursim"))
    ] == []


def test_the_process_says_what_is_wrong_and_ends(tmp_path):
    (tmp_path / "door.toml").write_text(toml(gateway_url='"http://robot.example/calls"'))
    command = [sys.executable, "-m", "ztpm.point.tool_proxy", "--config", str(tmp_path / "door.toml")]
    ended = subprocess.run(command, capture_output=True, text=True, timeout=60)
    assert (ended.returncode, ended.stdout) == (2, "")
    assert (
        ended.stderr.startswith(f"CONFIG_INVALID: {tmp_path}/door.toml: gateway_url") and ended.stderr.count("\n") == 1
    )


class Surroundings(House):
    """A guarded gateway, the identity provider on the wire, and the files of a door that is to be started."""

    log = None

    def lay_out(self):
        (self.tmp / "state").mkdir()
        self.issuer.pep_key = keys.public_raw(self.door_key)
        self.issuer.peps = tuple(PartyEntry(name, raw) for name, raw in self.peps.items())
        (self.tmp / "trust.json").write_bytes(self.trust.to_json())
        (self.tmp / "pep.key").write_bytes(keys.to_pem(self.door_key, PASSPHRASE.encode()))
        (self.tmp / "pep.key").chmod(0o600)
        files = {
            "trust_file": "trust.json",
            "pep_key_file": "pep.key",
            "journal_file": "passed.ndjson",
            "state_dir": "state",
        }
        self.config = self.tmp / "door.toml"
        self.config.write_text(
            toml(issuer=f'"{kit.ISSUER}"', **{key: f'"{self.tmp / name}"' for key, name in files.items()})
        )
        return self

    async def provider(self, scope, receive, send):
        """Answers of the identity provider."""
        if scope["type"] != "http":
            raise RuntimeError("no lifespan")
        body, more = b"", True
        while more:
            message = await receive()
            body, more = body + message.get("body", b""), message.get("more_body", False)
        url = f"http://{HOST}:{ISSUER_PORT}{scope['path']}?{scope['query_string'].decode()}"
        request = httpx2.Request(scope["method"], url, headers=scope["headers"], content=body)
        answer = self.issuer.handle(request)
        await send({"type": "http.response.start", "status": answer.status_code, "headers": []})
        await send({"type": "http.response.body", "body": answer.content})

    @asynccontextmanager
    async def running(self):
        """The door's process, which has said that it is ready; ended in the end."""
        async with contextlib.AsyncExitStack() as stack:
            await stack.enter_async_context(listening(self.gateway, GATEWAY_PORT))
            await stack.enter_async_context(listening(self.provider, ISSUER_PORT))
            pipe = asyncio.subprocess.PIPE
            door = await asyncio.create_subprocess_exec(
                sys.executable, "-m", "ztpm.point.tool_proxy", "--config", str(self.config), "--reports",
                stdin=pipe, stdout=pipe, stderr=self.log, env={**os.environ, "ZTPM_PASSPHRASE": PASSPHRASE},
            )  # fmt: skip
            try:
                async with asyncio.timeout(40):
                    assert json.loads(await door.stdout.readline()) == {"ready": True, "audience": AUDIENCE}
                yield door
            finally:
                if door.returncode is None:
                    door.kill()
                await door.wait()

    def kept(self):
        return [json.loads(line) for line in (self.tmp / "passed.ndjson").read_text().splitlines()]


@pytest.fixture
def surroundings(tmp_path, monkeypatch):
    monkeypatch.setattr(kit, "ISSUER", f"http://{HOST}:{ISSUER_PORT}/ztpm")
    made = Surroundings(tmp_path, clock=SystemClock()).start().lay_out()
    yield made
    made.close()


async def until(holds):
    async with asyncio.timeout(20):
        while not holds():
            await asyncio.sleep(0.02)


@pytest.mark.e2e
@pytest.mark.clause("TKT-8", "TKT-9", "TKT-10")
def test_the_process_serves_a_cell_behind_a_gateway(surroundings):
    """A motion, a stranger's stop, a revocation unheard by the gateway, a lost gateway, and an end."""
    cell = surroundings

    async def scenario():
        async with cell.running() as door:
            moved = await cell.use(cell.agent(), "move_joint", MOVE)
            stopped = await cell.post(None, call_body("stop", {}), headers={"mcp-name": "stop"})
            door.stdin.write(b'{"report": true}\n')
            async with asyncio.timeout(10):
                report = json.loads(await door.stdout.readline())["answer"]
            mapped = Path(f"/proc/{door.pid}/maps").read_text() if sys.platform == "linux" else ""
            await until(lambda: any(record["kind"] == "ticket" for record in cell.issuer.shipped))
            cell.issuer.revoke("agent", "robotic")
            answers = []

            async def asked():
                answers.append(
                    await cell.post(cell.agent(), call_body("read_state", {}), headers={"mcp-name": "read_state"})
                )
                return answers[-1].status_code == 401

            async with asyncio.timeout(20):
                while not await asked():
                    await asyncio.sleep(0.05)
            cell.gateway.app = None  # it breaks on every call from now on
            other = cell.agent(name="vision")
            gone = await cell.post(other, call_body())
            door.send_signal(signal.SIGTERM)
            async with asyncio.timeout(20):
                status = await door.wait()
            return moved, stopped, report, mapped, answers[-1], gone, status

    moved, stopped, report, mapped, revoked, gone, status = asyncio.run(scenario())
    assert moved.structured_content["outcome"] == "reached"
    assert stopped.json()["result"]["structuredContent"]["outcome"] == "stopped"
    assert (len(cell.arm.moves), cell.arm.stops) == (1, 1)
    assert report["view"]["age_ms"] < 2_000
    assert not [name for name in HEAVY[:-2] if f"/{name}/" in mapped], "nor loaded later, when something is asked"
    assert revoked.json()["reason"] == "REVOKED"
    assert gone.status_code == 500
    assert status == 0
    tickets = [record["body"] for record in cell.kept() if record["kind"] == "ticket"]
    assert [body["tool"] for body in tickets][:2] == ["move_joint", "stop"]
    assert tickets[0]["proof"] == cell.records("decision")[0]["body"]["proof"]


@pytest.mark.clause("PRF-8", "STM-26")
def test_what_an_earlier_process_passed_on_is_not_passed_on_again(surroundings):
    """A proof from the future stays fresh over a restart: its record says that it was used."""
    cell = surroundings
    name, word = "ab" * 32, "cd" * 32

    def made():
        return ToolProxy(
            read_door_config(cell.config),
            trust=cell.trust,
            key=cell.door_key,
            policies=load_shipped("paper-default"),
            http=cell.issuer.client(),
        )

    async def scenario():
        first = made()
        await first.edge.record("ticket", {"ticket": "0e" * 16, "proof": name, "tool": "move_joint"})
        await first.edge.record("ticket", {"ticket": "0f" * 16, "proof": "", "tool": "stop"})
        await first.edge.record("stop", {"person": "bob", "proof": word})
        first.edge.close()
        first.journal.close()
        second = made()
        second.recover()
        second.edge.close()
        second.journal.close()
        return second.replay._seen

    assert asyncio.run(scenario()) == {bytes.fromhex(name), bytes.fromhex(word)}
