"""One run: the same client against a controller that is reached directly, and through the gateway."""

from __future__ import annotations

import json
import os
import secrets
import subprocess
import sys
import tempfile
import time
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Final

import numpy as np

from evaluation.harness.machine import machine
from evaluation.pit import cells, truth, workload
from evaluation.pit.bench import SERVO_STEP
from evaluation.rtde import client
from evaluation.rtde.bench import StreamBrokenError, StreamResult, row_of
from pep.base.operations import SERVO_JOINT
from pep.rtde.command.limits import widest
from pep.rtde.robot.connections import PORTS
from ztpm.base.layout import OPERATORS, Layout, write_private
from ztpm.base.loopback import free_host, is_free
from ztpm.base.processes import Child
from ztpm.cell.cell import PASSPHRASE_VARIABLE, Cell
from ztpm.cell.setup import free_addresses, initialise
from ztpm.program.program_lease import PLACE
from ztpm.stage.lending import sweep_scope
from ztpm.stage.stage import LEFT, Stage

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from capabilities.values.scope import Scope
    from evaluation.rtde.bench import StreamRow

DIRECT, RELAYED, POLICY, WHOLE = "direct", "two relays that only pass on", "gateway, without physics", "gateway"
AGENT: Final = "streamer"
LIFETIME_S: Final = 900
ANSWER_S: Final = 60.0
STEPS: Final = 2_000
"""Steps of a prepared stream that are timed for the share of the cycle."""


def run(seconds: float, *, told: Callable[[str], None]) -> StreamResult:
    """The stream, once on each way.

    Args:
        seconds: how long each.
        told: receives the name of each step.

    Raises:
        StreamBrokenError: a value was refused.
    """
    began = time.monotonic()
    with tempfile.TemporaryDirectory(prefix="ztpm-bench-") as folder, _place(Path(folder)) as place:
        rows = []
        for way, host, module in (
            (DIRECT, place.host, ""),
            (RELAYED, place.relayed, ""),
            (POLICY, PLACE, "evaluation.rtde.bare"),
            (WHOLE, PLACE, "ztpm.point.gateway_server"),
        ):
            told(f"{way}: {seconds:g} s at {client.HZ} Hz")
            rows.append(place.streamed(way, host, module, seconds))
    told("a prepared stream, step by step")
    return StreamResult(tuple(rows), physics_us=_physics_us(), seconds=time.monotonic() - began, machine=machine())


@dataclass(frozen=True, slots=True)
class _Place:
    """Place of a run.

    Attributes:
        cell: identity provider, controller and sensor run.
        stage: its people and agents.
        tap: before the controller, at `host`.
        relayed: where two processes pass everything on to the tap: as many as a gateway is, and nothing else in them.
        folder: for files.
    """

    cell: Cell
    stage: Stage
    tap: Child
    host: str
    relayed: str
    folder: Path

    def streamed(self, way: str, host: str, module: str, seconds: float) -> StreamRow:
        """One stream to that host, through the gateway that the module is, if there is one."""
        cell, file = self.cell, self.folder / "sent.json"
        secret = {PASSPHRASE_VARIABLE: cell.passphrase.decode()}
        program = [sys.executable, client.__file__, host, str(seconds), str(file)]
        if module:
            cell.end("gateway")
            config = ("--config", str(cell.layout.gateway_config), "--robot", self.host)
            cell.gateway = Child.start("gateway", module, *config, environment=secret)
            own = ["--token", str(self.folder / "token"), "--data", str(cell.layout.root), "--"]
            program = [sys.executable, "-m", "ztpm", "rtde", "run", AGENT, *own, *program]
        done = subprocess.run(program, env=os.environ | secret, capture_output=True, text=True, check=False)  # noqa: S603 - our own
        if done.returncode != 0:
            raise StreamBrokenError(f"{way}: {done.stderr.strip()[-300:]}")
        sent = json.loads(file.read_bytes())
        if len(sent) < int(seconds * client.HZ):
            ends = [row["body"].get("reason") for row in self.stage.journal(since=0) if row["kind"] == "outcome"]
            raise StreamBrokenError(f"{way}: {len(sent)} values were taken, {ends[-1:]}")
        answer = self.tap.ask({}, timeout_s=ANSWER_S)
        if answer is None:
            raise StreamBrokenError("the tap does not answer")
        return row_of(way, sent, {value: came_ns for came_ns, value in answer["written"]})


@contextmanager
def _place(root: Path) -> Iterator[_Place]:
    """A cell whose gateway reaches the controller by a tap, and an agent that may stream."""
    layout, addresses = Layout(root / "cell"), free_addresses(secrets.token_bytes(16))
    passphrase = secrets.token_urlsafe(16).encode()
    initialise(layout, addresses, passphrase=passphrase, policy="paper-default", defer_timeout_s=20)
    with Cell.start(layout, addresses, passphrase=passphrase, joints=LEFT) as cell:
        stage = Stage(cell=cell, people={})
        stage.people = {name: stage.operator_from_disk(name) for name in OPERATORS}
        cell.register(stage.person("carol"))
        agent = stage.new_agent(AGENT, sponsor="alice", role="streamer")
        agent.attest()
        issued = stage.person("alice").issue(agent, _scope(addresses.audience), purpose="benchmark")
        write_private(root / "token", issued.token.encode())
        with ExitStack() as relays:
            robot, taps = addresses.host, []
            for name in ("tap", "relay", "relay"):
                host = free_host(secrets.token_bytes(16), lambda host: all(is_free(host, port) for port in PORTS))
                ends = ("--listen", host, "--robot", robot)
                child = Child.start(name, "evaluation.rtde.tap", *ends, environment={})
                relays.callback(child.stop)
                taps.append((child, host))
                robot = host
            try:
                yield _Place(cell, stage, *taps[0], robot, root)
            finally:
                stage.close()


def _scope(audience: str) -> Scope:
    """Scope of the demo, with streams of joint angles within the robot's own limits."""
    scope = sweep_scope(audience, delegates=frozenset(), now=int(time.time()), lifetime_s=LIFETIME_S)
    grants = (*scope.grants, widest(SERVO_JOINT))
    return replace(scope, grants=tuple(sorted(grants, key=lambda each: (each.object, each.operation))))


def _physics_us() -> float:
    """Median of one step of a stream of joint angles, as `ztpm eval bench pit` asks it, microseconds."""
    asked = [truth.ready(each) for each in workload.steps(np.random.default_rng(1), 20, 1, servo=True)]
    cell = cells.streaming(asked, SERVO_STEP)
    took = []
    for _ in range(STEPS):
        fresh = cell.fresh()
        began = time.perf_counter_ns()
        cell.act(fresh)
        took.append(time.perf_counter_ns() - began)
    return float(np.median(took)) / 1e3
