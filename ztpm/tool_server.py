"""The cell's MCP tool server: perception, feeds, gate, guard and robot in one process.

    python -m ztpm.tool_server --config cell.toml

The passphrase of the PEP's key comes from the environment (`ZTPM_PASSPHRASE`). When it listens it prints one JSON line
with `"ready": true`. SIGTERM stops the arm first and everything else after it. With `--reports` it tells whoever
started it how things stand (ztpm/report.py).
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import gc
import json
import logging
import os
import resource
import signal
import sys
import traceback
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Final

import httpx2
import uvicorn

from capabilities import keys
from capabilities.caps import DEFAULT as CAPS
from capabilities.freshness import Memory, earliest_iat_s, retention_ms
from capabilities.verify import Verifier
from pep import records
from pep.approvals import Asks
from pep.asking import Asking
from pep.authority import Authority
from pep.clock import HeldClock, SystemClock, TimeMark
from pep.context.flow import Flow
from pep.context.frames import Frames
from pep.errors import PepError, PepFault
from pep.feed import Follower, MarkFile
from pep.gate import Gate
from pep.governor import Pacing
from pep.holding import Holding
from pep.mcp.arm import arm_server
from pep.mcp.deadline import DeadlineProtocol
from pep.mcp.guard import guard
from pep.mcp.mapping import ARM_TOOLS
from pep.mcp.vouching import Vouching
from pep.observation import Marked, Unwatched
from pep.perception import Receiver
from pep.pit import surveyed
from pep.pit.engine import chosen
from pep.question import Asker
from pep.record import FileJournal
from pep.replay import ReplayCache
from pep.rtde.dashboard import RemoteControl, stop_program
from pep.rtde.devices import Devices
from pep.rtde.drive import Drive
from pep.rtde.governed import SpeedControl
from pep.rtde.gripper import RobotiqGripper
from pep.rtde.jog import Jog
from pep.rtde.limits import Ur3eLimits
from pep.rtde.outputs import DigitalOutputs
from pep.rtde.program import ProgramWatch
from pep.rtde.slider import SpeedSlider
from pep.rtde.state import ReceivedState
from pep.rtde.telemetry import Telemetry
from pep.sequence import Sequence
from pep.ship import Shipper
from pep.sim.recognition import recognise
from pep.watch import Limits, Watch
from pep.world import CellPhysics
from ztpm.report import report_of, serve_reports
from ztpm.robot import (
    PROGRAM_S,
    commanded,
    committed,
    confirm_kinematics,
    connect,
    connect_outputs,
    found_holding,
    readiness,
)
from ztpm.tool_config import CellConfig, read_cell, read_config, read_key, read_policies, read_robot, read_trust
from ztpm.trust_mark import check_mark

if TYPE_CHECKING:
    from collections.abc import Iterator

    from capabilities.keys import PrivateKey
    from capabilities.statements.cell import Cell
    from capabilities.trust import TrustBundle
    from pep.observation import Simulated
    from policies.policy import PolicySet

FIRST_VIEW_S: Final = 30.0
"""Longest wait for the first verified view before the server listens anyway, denying everything until it comes."""
SHUTDOWN_S: Final = 3
KEEP_ALIVE_S: Final = 5
SWITCH_S: Final = 0.001
CONNECTIONS: Final = 64
"""Callers at once; a cell has a handful of agents. The next are told 503."""


class _Server(uvicorn.Server):
    """A server that leaves signals to the composition: the arm is stopped before anything else ends."""

    @contextlib.contextmanager
    def capture_signals(self) -> Iterator[None]:
        """No signal is captured here."""
        yield


class ToolServer:
    """All parts of one cell, composed.

    Args:
        config: of the cell.
        survey: the signed cell file, verified and in force.
        trust: the issuer's public keys.
        key: of this PEP.
        policies: what is decided by.
        http: client of the identity provider.
        unsafe_observe: the simulated controller, where nothing is to be enforced; None enforces.

    Attributes:
        robot: the arm's model, with its tool and empty fingers.
        ended: set it to end the server.
    """

    def __init__(
        self,
        config: CellConfig,
        *,
        survey: Cell,
        trust: TrustBundle,
        key: PrivateKey,
        policies: PolicySet,
        http: httpx2.AsyncClient,
        unsafe_observe: Simulated | None = None,
    ) -> None:
        self.config = config
        # Proofs, tokens and statements are judged by a wall time that nobody can set back.
        self.clock = HeldClock(SystemClock(), mark=TimeMark(config.state_dir / "time.json"), skew_s=CAPS.skew_s)
        # Rounded up: a proof counts whole seconds, and one made before the start must not pass for one made after it.
        self.started_s = earliest_iat_s(self.clock.wall_s(), memory=Memory.KEPT, caps=CAPS)
        self.journal = FileJournal.open(config.journal_file, pep_id=config.pep_id, clock=self.clock)
        self.http = http
        self.ended = asyncio.Event()
        self.follower = Follower(
            self.http,
            issuer=config.issuer,
            audience=config.audience,
            trust=trust,
            caps=CAPS,
            clock=self.clock,
            mark=MarkFile(config.state_dir / "feed.json"),
            incident=self._feed_incident,
        )
        self.shipper = Shipper(
            self.journal,
            self.http,
            issuer=config.issuer,
            key=key,
            clock=self.clock,
            incident=lambda error: self._log("ledger", error),
        )
        self.cell = surveyed(survey, config.cell)
        self.frames = Frames(sensors=self.follower, named=frozenset(survey.sensors), clock=self.clock, caps=CAPS)
        self.receiver = Receiver(self.frames, clock=self.clock, incident=self._frame_incident)
        self.state = ReceivedState(config.robot_host)
        chosen()  # compiled before anybody may ask: a minute or more the very first time, a second from then on
        self.robot = robot = read_robot(config, tool=survey.tool)
        holding = Holding(robot, self.cell)
        gripper = RobotiqGripper(config.robot_host)
        found_holding(holding, gripper)
        self.physics = CellPhysics(
            holding=holding,
            cell=self.cell,
            valid_until_s=survey.not_after,
            frames=self.frames,
            state=self.state,
            clock=self.clock,
        )
        # The watch is there before the program that it is to see start.
        program = ProgramWatch(config.robot_host)
        program.listening(within_s=PROGRAM_S)
        control = commanded(
            connect(config.robot_host), program, robot, self.cell, holding, audience=config.audience, clock=self.clock
        )
        telemetry = Telemetry(config.robot_host)
        self.readiness = readiness(
            telemetry, RemoteControl(config.robot_host), program, control, robot=robot, holding=holding
        )
        if config.calibration_file is not None:
            confirm_kinematics(self.readiness)
        self.judging = ThreadPoolExecutor(1, "rest")
        # An observed motion begins wherever the arm is: what was denied may never have been assessed.
        start_of = self.physics.start_of if unsafe_observe is None else lambda _: self.state.read().q_rad
        journal = self.journal if unsafe_observe is None else Marked(self.journal)
        io = connect_outputs(config.robot_host)
        self.slider = SpeedSlider(io)
        self.drive = Drive(
            control=control,
            state=self.state,
            gripper=gripper,
            dashboard_stop=lambda: stop_program(config.robot_host),
            start_of=start_of,
            watching=partial(
                Watch if unsafe_observe is None else Unwatched,
                remaining=self.physics,
                views=self.frames,
                limits=Limits.of(self.cell),
                clock=self.clock,
                submit=self.judging.submit,
            ),
            hurry=self.follower.hurry,
            audience=config.audience,
            clock=self.clock,
            speed=SpeedControl(self.slider, Pacing.of(self.cell)),
        )
        self.devices = Devices(
            self.drive,
            Jog(self.drive, control, start_of=start_of, clock=self.clock),
            DigitalOutputs(
                io,
                telemetry,
                audience=config.audience,
                stopped_ms=lambda: control.stopped_ms,
            ),
            partial(committed, self.physics, control, holding),
        )
        self.replay = ReplayCache(self.clock)
        asker = Asker(pep=config.pep_id, audience=config.audience, issuer=config.issuer, key=key)
        self.asks = Asks(
            clock=self.clock,
            journal=journal,
            timeout_ms=config.defer_timeout_s * 1000,
            asker=asker,
            approvers=self.follower,
            caps=CAPS,
        )
        self.asking = Asking(
            self.asks,
            self.http,
            asker=asker,
            trust=trust,
            caps=CAPS,
            clock=self.clock,
            incident=self._feed_incident,
        )
        self.authority = Authority(
            verifier=Verifier(trust, CAPS),
            feed=self.follower,
            replay=self.replay,
            clock=self.clock,
            caps=CAPS,
            audience=config.audience,
            started_s=self.started_s,
        )
        self.gate = Gate(
            clock=self.clock,
            authority=self.authority,
            registry=self.follower,
            limits=Ur3eLimits(),
            slot=self.devices,
            readiness=self.readiness,
            sequence=Sequence(self.clock),
            physics=self.physics,
            policies=policies,
            journal=self.journal,
            asks=self.asks,
            announcer=self.asking,
            unsafe_observe=unsafe_observe,
        )
        self.app = guard(
            arm_server(self.devices, self.physics.summary),
            gate=self.gate,
            authority=self.authority,
            registry=self.follower,
            bindings=ARM_TOOLS,
            asks=self.asks,
            audience=config.audience,
            issuer=config.issuer,
            clock=self.clock,
            vouching=Vouching(
                key=key,
                audience=config.audience,
                # Its own receipts alone: of other admission points the registry does not tell.
                admitters={config.audience: keys.public_raw(key)}.copy,
                flow=Flow(self.clock),
                caps=CAPS,
            ),
        )
        self._told: dict[str, int] = {}

    def recover(self) -> None:
        """What an earlier process left unfinished has an end on record, and what it accepted is not accepted again."""
        permits = records.unfinished(self.journal.records())
        self.asks.recover(self.journal.records())
        self.gate.conduct.recall(self.journal.records())
        earliest_ms = (self.clock.wall_s() * 1000) - retention_ms(CAPS)
        expires_ms = self.clock.monotonic_ms() + retention_ms(CAPS)
        for record in self.journal.records():
            if record["kind"] == "decision" and record["at_ms"] >= earliest_ms and record["body"]["proof"]:
                self.replay.remember(bytes.fromhex(record["body"]["proof"]), expires_ms=expires_ms)
        if self.journal.repaired_bytes:
            self.journal.append("incident", {"what": "torn-tail", "bytes": self.journal.repaired_bytes})
        for request_id, digest in permits:
            self.journal.append("outcome", {"request_id": request_id, "decision": digest, "outcome": "unknown"})
        self.asks.expire()

    async def run(self, *, reports: bool = False) -> None:
        """The server has run until it was told to end, and the arm stands still; `reports`: it has told of itself."""
        loop = asyncio.get_running_loop()
        config = uvicorn.Config(
            self.app,
            host=self.config.host,
            port=self.config.port,
            log_level="error",
            access_log=False,
            h11_max_incomplete_event_size=32_768,
            http=DeadlineProtocol,
            timeout_graceful_shutdown=SHUTDOWN_S,
            timeout_keep_alive=KEEP_ALIVE_S,
            limit_concurrency=CONNECTIONS,
        )
        server = _Server(config)
        for number in (signal.SIGTERM, signal.SIGINT):
            loop.add_signal_handler(number, self.ended.set)
        keeping = self.clock.run(failed=lambda error: self._log("clock", error), set_back=self._clock_incident)
        parts = [self.follower.run(), self.asking.run(), self.shipper.run(), keeping]
        if reports:
            parts.append(serve_reports(lambda: report_of(self)))
        tasks = [asyncio.create_task(part) for part in parts]
        try:
            await self._first_view()
            # Not before: a frame is judged by the registered keys, and without them every sensor is a stranger.
            await self.receiver.listen(self.config.host, self.config.perception_port)
            serving = asyncio.create_task(server.serve())
            while not server.started and not serving.done():  # noqa: ASYNC110 - uvicorn offers no event for it
                await asyncio.sleep(0.01)
            if server.started:
                gc.collect()
                gc.freeze()  # else each full collection looks at all that was built at start, while an arm moves
                sys.stdout.write(json.dumps({"ready": True, "audience": self.config.audience}) + "\n")
                sys.stdout.flush()
            await asyncio.wait({serving, asyncio.create_task(self.ended.wait())}, return_when=asyncio.FIRST_COMPLETED)
            await self.drive.stop()
            server.should_exit = True
            await serving
        finally:
            await self._close(tasks)

    async def _first_view(self) -> None:
        """The first verified views are there and proofs made now are accepted, or it was waited long enough."""
        deadline_ms = self.clock.monotonic_ms() + int(FIRST_VIEW_S * 1000)
        while not self.ended.is_set() and self.clock.monotonic_ms() < deadline_ms:
            ages_ms = self.follower.view().age_ms, self.follower.conduct().age_ms
            if max(ages_ms) < FIRST_VIEW_S * 1000 and self.clock.wall_s() >= self.started_s:
                return
            await asyncio.sleep(0.02)

    async def _close(self, tasks: list[asyncio.Task[None]]) -> None:
        await self.devices.close()
        self.slider.close()
        for task in tasks:
            task.cancel()
        await asyncio.gather(*tasks, return_exceptions=True)
        with contextlib.suppress(OSError):  # what the last mark says is at most a period old
            await asyncio.to_thread(self.clock.keep)
        await self.receiver.close()
        self.judging.shutdown(wait=False, cancel_futures=True)
        self.gate.close()
        await self.http.aclose()
        self.state.close()
        self.readiness.close()
        self.journal.close()

    def _feed_incident(self, error: PepError) -> None:
        """A refused answer is on record, once a minute for each kind; an unreachable provider is only told."""
        self._log("feed", error)
        now = self.clock.monotonic_ms()
        if error.code is PepFault.FEED_UNREACHABLE or now - self._told.get(error.code, now - 60_000) < 60_000:
            return
        self._told[error.code] = now
        self._note({"what": "feed", "fault": str(error.code), "detail": error.detail})

    def _clock_incident(self, held_s: float) -> None:
        self._note({"what": "clock", "fault": str(PepFault.CLOCK_SET_BACK), "held_s": int(held_s)})

    def _frame_incident(self, sensor: str, fault: str, detail: str, count: int) -> None:
        self._note({"what": "perception", "sensor": sensor, "fault": fault, "detail": detail, "count": count})

    def _note(self, body: dict[str, object]) -> None:
        noted = asyncio.get_running_loop().create_task(self.gate.record("incident", body))
        noted.add_done_callback(lambda task: None if task.cancelled() else self._log("journal", task.exception()))

    def _log(self, what: str, error: BaseException | None) -> None:
        if error is not None:
            logging.getLogger("ztpm.tool_server").warning("%s: %s", what, error)


async def serve(config: CellConfig, *, reports: bool = False, unsafe_observe: bool = False) -> None:
    """The cell's tool server has run and ended, its arm standing still; `reports` as for `ToolServer.run`.

    Args:
        config: of the cell.
        reports: it has told of itself.
        unsafe_observe: nothing was enforced, everything decided and recorded: with a simulated controller alone.

    Raises:
        PepError: when a part cannot be had; nothing was served then.
    """
    # Before anything is opened: a real robot is never observed.
    simulated = recognise(config.robot_host) if unsafe_observe else None
    policies, trust, key = read_policies(config), read_trust(config), read_key(config)
    survey = read_cell(config, at=SystemClock().wall_s())
    check_mark(trust, config.state_dir / "trust.json", at=SystemClock().wall_s(), caps=CAPS)
    http = httpx2.AsyncClient()
    server = ToolServer(
        config, survey=survey, trust=trust, key=key, policies=policies, http=http, unsafe_observe=simulated
    )
    server.recover()
    await server.run(reports=reports)


def main() -> None:
    """The command line. Exit code 1 for whatever keeps it from serving."""
    parser = argparse.ArgumentParser(prog="python -m ztpm.tool_server", description="The MCP tool server of a cell.")
    parser.add_argument("--config", type=Path, required=True)
    parser.add_argument("--reports", action="store_true", help="answer questions on standard input")
    parser.add_argument(
        "--unsafe-observe", action="store_true", help="enforce nothing; refused unless the controller is simulated"
    )
    options = parser.parse_args()
    # The watch looks every few ms: whoever else computes hands the interpreter over within one (5 by default).
    sys.setswitchinterval(SWITCH_S)
    # As many sockets as the system allows: a stop may need one while strangers hold theirs idle.
    most = resource.getrlimit(resource.RLIMIT_NOFILE)[1]
    resource.setrlimit(resource.RLIMIT_NOFILE, (most, most))
    status = 1
    try:
        asyncio.run(serve(read_config(options.config), reports=options.reports, unsafe_observe=options.unsafe_observe))
        status = 0
    except PepError as error:
        sys.stderr.write(f"{error}\n")
    except Exception:  # noqa: BLE001 - whatever it is, the process ends, and says why where somebody still reads
        with contextlib.suppress(OSError):
            traceback.print_exc()
    finally:
        # A thread inside ur_rtde that still waits for a controller that is gone would be joined for ever; and whoever
        # read what we say may be gone, too.
        for stream in (sys.stdout, sys.stderr):
            with contextlib.suppress(OSError):
                stream.flush()
        os._exit(status)


if __name__ == "__main__":
    main()
