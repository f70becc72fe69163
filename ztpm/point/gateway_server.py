"""Gateway of one robot: perception, feeds, gate, tools, motion lease and the controller's ports in one process.

    python -m ztpm.point.gateway_server --config gateway.toml [--robot HOST] [--listen HOST]

Everybody finds the robot's state, and a stop, at the controller's ports on `listen_host`. The holder of the motion
lease finds the same ports at the end of its carriage, with its token's scope judged command by command. While nobody
has it, the cell's tools have the arm, over lines of their own to the same ports. The passphrase of the PEP's key comes
from the environment (`ZTPM_PASSPHRASE`). When it listens it prints one JSON line with `"ready": true`. SIGTERM stops
the arm first and everything else after it. With `--reports` it reports to the process that started it
(ztpm/base/report_server.py). With `--unsafe-observe` it enforces no policy (pep/gate/observe_only.py), and starts
before a simulated controller alone.
"""

from __future__ import annotations

import argparse
import asyncio
import contextlib
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Final
from urllib.parse import urlsplit

from capabilities.values.caps import DEFAULT as CAPS
from capabilities.values.chain import Chain
from pep.base.errors import JournalError
from pep.base.stop_model import SAFE_MODES
from pep.base.thread_priority import goes_first
from pep.gate.observe_only import Unwatched
from pep.mcp.mapping import ARM_TOOLS
from pep.mcp.ticket_layer import TicketLayer
from pep.rtde.judge.command_judge import LeasedJudge
from pep.rtde.judge.command_requests import ToolSetup
from pep.rtde.judge.execution import LeasedEffects
from pep.rtde.lease.lease import LeaseEnding, Leases
from pep.rtde.lease.lease_endpoint import LeaseEndpoint
from pep.rtde.lease.lease_port import LeasePort
from pep.rtde.line.controller_ports import LeasedPorts
from pep.rtde.line.gateway import Gateway
from pep.rtde.motion.motions import Motions
from pep.rtde.own.tool_lease import OwnLease, OwnLines
from pep.rtde.robot.dashboard import RemoteControl, confirm_model
from pep.rtde.robot.gripper import RobotiqGripper
from pep.rtde.script.control_script import allow_list, installed_body
from pep.watch.watch import Watch, WatchAges
from pep.world.cell_stream import CellStream
from pep.world.tool_poses import ToolPoses
from policies.primitives.tools import RUNNING
from ztpm.base.path_router import PathRouter
from ztpm.base.processes import STOP
from ztpm.base.stop_call import stop_url
from ztpm.codes.unavailable import unavailable
from ztpm.edge.places import Bounds
from ztpm.point.arm_tools import tool_motions, tools_app_of
from ztpm.point.enforcement_point import main_of
from ztpm.point.gateway_config import GatewayConfig, read_gateway_config
from ztpm.point.lease_listener import LeaseListener
from ztpm.point.live_report import LiveReport
from ztpm.point.open_stop import OpenStop
from ztpm.point.robot import PortStopper, confirm_kinematics, found_holding, readiness
from ztpm.point.robot_latch import RobotLatch
from ztpm.point.robot_point import RobotPoint, opened_cell
from ztpm.point.simulator_check import recognise
from ztpm.point.stop_door import StopDoor

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable, Coroutine, Mapping
    from typing import Any

    import httpx2

    from capabilities.keys.keys import PrivateKey
    from capabilities.keys.trust import TrustBundle
    from capabilities.statements.cell import Cell
    from pep.gate.observe_only import Simulated
    from pep.pit.assessment.led_motion import Led
    from pep.rtde.judge.stream_values import Certifying
    from pep.rtde.lease.lease import Lease
    from pep.rtde.robot.judge_port import PendingCommand, ProgramOwner
    from pep.rtde.wire.refusal import InputRefusal
    from policies.decision.policy import PolicySet

LOOK_S: Final = 0.1
"""Time between checks of the open lease's token; while it moves, revocations reach a view as fast."""
FAREWELL_S: Final = 0.1
"""Time from the notice of a lease's end to the end of its connections; ur_rtde looks every few ms."""
STANDS_S: Final = 6.0
"""Longest wait for standstill at the end."""
EQUIPPED_S: Final = 10.0
"""Longest wait for the tools to have the arm at the beginning; it takes half a second."""
VACATING: Final = "lease"
"""Holds the slot while the tools let go of the arm."""
WARNING: Final = "UNSAFE: no policy is enforced (--unsafe-observe); denied acts happen at the simulated controller\n"
TOOL_SERVERS: Final = 512
"""Connections of tool servers, one of which brings the calls of all agents: more than its own door lets in."""


class GatewayServer(RobotPoint):
    """All parts of one gateway, composed. To be made on the event loop that it runs on.

    Args:
        config: of the gateway.
        survey: the signed cell file, verified and in force.
        trust: the issuer's public keys.
        key: of this PEP.
        policies: what is decided by.
        http: client of the identity provider.
        certifier: makes what certifies the values of one stream, given what `CellStream` is given.
        unsafe_observe: the simulated controller, where no policy is enforced; None enforces.
    """

    bounds = Bounds(parties=TOOL_SERVERS, by_party=TOOL_SERVERS)

    def __init__(
        self,
        config: GatewayConfig,
        *,
        survey: Cell,
        trust: TrustBundle,
        key: PrivateKey,
        policies: PolicySet,
        http: httpx2.AsyncClient,
        certifier: Callable[..., Certifying] = CellStream,
        unsafe_observe: Simulated | None = None,
    ) -> None:
        super().__init__(config, survey=survey, trust=trust, key=key, http=http, unsafe_observe=unsafe_observe)
        watch = Watch if unsafe_observe is None else Unwatched
        self._listen_host, self._carriage_port = config.listen_host, config.carriage_port
        self._certifier = certifier
        gripper = RobotiqGripper(config.robot_host)
        found_holding(self.holding, gripper)
        self._loop = asyncio.get_running_loop()
        self.ports = LeasedPorts(
            config.robot_host,
            self.state,
            self,
            scripts=allow_list(installed_body),
            stop_deceleration_rad_s2=self.cell.stop_deceleration_rad_s2,
            clock=self.clock,
            closed=self._left,
        )
        remote = RemoteControl(config.robot_host)
        # Without its connection no program of a lease runs, and none of ours.
        ready = partial(readiness, self.state, remote, commanding=lambda: True, robot=self.robot, holding=self.holding)
        self.latch = RobotLatch(
            self,
            self.ports,
            policies=policies,
            key=key,
            under_way=lambda: self.motions.under_way,
            enforced=unsafe_observe is None,
        )
        self.readiness = ready(self.ports)
        self.leases = Leases()
        self.own = OwnLines(
            self.ports,
            fitted=self._fitted,
            free=lambda: self.leases.current is None,
            able=self._able,
            failed=lambda error: self.incidents.tell("own lines", error),
        )
        if config.calibration_file is not None:
            confirm_kinematics(self.readiness)
        # It compiles what its steps ask when it is made, or reads what was compiled before.
        self._stream(frozenset()).see(self.state.read().q_rad)
        self.judging = ThreadPoolExecutor(1, "rest")
        stopper = PortStopper(self.ports, self._loop)
        self.motions = Motions(
            starts=self.physics,
            hurry=self.follower.hurry,
            state=self.state,
            stopper=stopper,
            clock=self.clock,
            pause=time.sleep,
            ended=self.latch.latching.after,
        )
        watching = partial(
            watch, views=self.frames, limits=WatchAges.of(self.cell), clock=self.clock, submit=self.judging.submit
        )
        self.tools = tool_motions(self, lines=self.own, motions=self.motions, gripper=gripper, watching=watching)
        self.gate = self.gated(policies, slot=self.tools, latches=self.latch.latches)
        tools_app = tools_app_of(self, self.tools, self.gate, key, readiness=ready(self.own))
        self.judging_commands = LeasedJudge(
            gate=self.gate,
            effects=LeasedEffects(
                motions=self.motions,
                acts=self.physics,
                remaining=self.physics,
                certifying=self._stream,
                posing=ToolPoses(self.holding),
                declared=self.holding.declared,
                watching=watching,
                fingers=self.tools,
                record=self.gate.record,
                parameters=policies.parameters,
                audience=config.audience,
                clock=self.clock,
            ),
            asks=self.asks,
            registry=self.follower,
            readiness=self.readiness,
            stopper=stopper,
            fitted=self._fitted,
            audience=config.audience,
            clock=self.clock,
        )
        self.open_stop = OpenStop(
            leases=self.leases,
            tools=self.tools,
            latching=self.latch.latching,
            words=self.latch.words,
            gate=self.gate,
            end=self._end,
        )
        self.carriages = LeasePort(self.leases, self.ports, clock=self.clock, begun=self.gate.looked, ended=self._ended)
        self.arrivals = LeaseListener(self.carriages)
        self.gateway = Gateway(self.ports)
        door = LeaseEndpoint(
            leases=self.leases,
            authority=self.authority,
            clock=self.clock,
            journal=self.journal,
            caps=CAPS,
            url=config.url,
            audience=config.audience,
            signer=key,
            port=config.carriage_port,
            lease_ms=policies.parameters.lease_motion_ms,
            vacated=self._vacated,
        ).app()
        # Every caller reaches the tools by a tool server alone.
        calls = TicketLayer(
            tools_app,
            edge=self.gate,
            tools=ARM_TOOLS,
            peps=self.follower.peps,
            feed=self.follower,
            replay=self.replay,
            audience=config.audience,
            url=config.calls_url,
            clock=self.clock,
            caps=CAPS,
        )
        stop = StopDoor(self.open_stop)
        self.app = PathRouter(calls, {urlsplit(stop_url(config.url)).path: stop, urlsplit(config.url).path: door})
        self._lease_ms = policies.parameters.lease_motion_ms
        self._ending: tuple[Lease, LeaseEnding] | None = None  # of a lease that is ended here, as its program is told
        self._tasks: list[asyncio.Task[object]] = []
        self._notes: set[asyncio.Task[None]] = set()

    def recover(self) -> None:
        """Likewise, and its latch, which is judged by what was left open."""
        self.latch.recover()
        super().recover()

    def beside(self) -> dict[str, Coroutine[Any, Any, None]]:
        """Tasks that run as long as it serves, by name."""
        return {**super().beside(), **self.latch.beside()}

    @property
    def answers(self) -> Mapping[str, Callable[[], Awaitable[dict[str, object]]]]:
        """Likewise, with the cell as it is now, and the stop of its page."""
        return {**super().answers, **LiveReport(self, lambda: self.motions.under_way).answers, STOP: self.open_stop}

    async def report(self) -> dict[str, object]:
        """Report on robot and its latch, perception and revocation view."""
        told = await super().report()
        robot = told.get("robot")
        latch = self.latch.latches.summary()
        return {**told, "robot": {**robot, "latch": latch}} if isinstance(robot, dict) else told

    async def begin(self) -> None:
        """Opens the controller's ports, once it has said that its arm is the model's.

        Raises:
            ConfigError: `CONFIG_INVALID`: its arm is another one.
            RobotError: `ROBOT_UNREACHABLE`: it does not say.
            UnavailableError: `PORT_UNUSABLE`: an address or a port of them cannot be had.
        """
        await asyncio.to_thread(confirm_model, self.config.robot_host, self.robot.model.name)
        await self.ports.begin()
        try:
            await self.arrivals.listen(self.config.host, self._carriage_port)
            await self.gateway.listen(self._listen_host)
        except OSError as error:
            place = f"{self.config.host}, {self._listen_host}"
            raise unavailable(error, place, code="PORT_UNUSABLE") from error
        self._tasks = [
            self.incidents.watched("leases", self._look()),
            self.incidents.watched("own lines", self.own.keep()),
        ]
        await self._equipped()
        goes_first()  # what was slow to make is made: what it does from now on a program waits for

    async def stand(self) -> None:
        """Ends the lease, with the arm standing still."""
        self.gateway.close()
        await self._end(LeaseEnding.GATEWAY)
        await self.tools.stop()
        self.arrivals.close()
        self.carriages.end(LeaseEnding.GATEWAY)
        await self.judging_commands.close()
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(STANDS_S):
                while not self.ports.ladder.over:  # noqa: ASYNC110 - the arm itself sets no event
                    await asyncio.sleep(LOOK_S)

    async def close(self) -> None:
        """Ends the connections to the robot."""
        await self.open_stop.close()
        await self.tools.close()
        self.motions.close()
        self.latch.latching.close()
        for task in self._tasks:
            task.cancel()
        await asyncio.gather(*self._notes, return_exceptions=True)
        self.ports.close()
        self.judging.shutdown(wait=False, cancel_futures=True)
        self.readiness.close()

    # ---- the judge of the ports, which are there before it

    def judge(self, held: PendingCommand) -> None:
        """See `Judge.judge`."""
        self.judging_commands.judge(held)

    def withdrawn(self, held: PendingCommand) -> None:
        """See `Judge.withdrawn`."""
        self.judging_commands.withdrawn(held)

    def refused(self, holder: ProgramOwner, refused: InputRefusal, what: str) -> None:
        """See `Judge.refused`."""
        self.judging_commands.refused(holder, refused, what)

    # ---- the tools' own lines

    def _able(self) -> bool:
        """True where the arm could move: powered, no safety stop, remote control."""
        robot = self.readiness.reading()
        return robot.robot_mode == RUNNING and robot.safety_mode in SAFE_MODES and robot.remote_control is True

    def _vacated(self) -> bool:
        """True once the tools have let go of the arm: no motion of theirs runs, or is about to begin."""
        if not self.tools.reserve(VACATING):
            return False
        try:
            self.own.give_way()
        finally:
            self.tools.release(VACATING)
        return True

    async def _equipped(self) -> None:
        """Waits until the tools have the arm, or long enough: an arm that is off has its gateway too."""
        with contextlib.suppress(TimeoutError):
            async with asyncio.timeout(EQUIPPED_S):
                while not self.own.up:  # noqa: ASYNC110 - a look at the controller, which sets no event
                    await asyncio.sleep(FAREWELL_S)

    # ---- the lease

    def _left(self, holder: ProgramOwner, ending: LeaseEnding) -> None:
        """Handles the end of a lease's control connection."""
        if isinstance(holder, OwnLease):
            self.own.give_way()
        else:
            self.carriages.end(ending)

    def _stream(self, touch: frozenset[str], led: Led | None = None) -> Certifying:
        return self._certifier(
            holding=self.holding, cell=self.cell, frames=self.frames, touch=touch, clock=self.clock, led=led
        )

    def _fitted(self) -> ToolSetup:
        holding = self.holding
        return ToolSetup((*self.robot.tool.tcp_m, 0.0, 0.0, 0.0), holding.carried_kg, holding.centre_m, holding.loads)

    def _ended(self, lease: Lease, ending: LeaseEnding) -> None:
        if self._ending is not None and self._ending[0] is lease:
            ending = self._ending[1]  # also where the program has left meanwhile
        self.latch.latching.lease_ended(ending)
        self.ports.over(lease, ending)
        chain = lease.credentials.chain
        body = {
            "at": self.clock.wall_s(),
            "agent": lease.agent,
            "hop": chain.leaf.hop_id if isinstance(chain, Chain) else "",
            "ending": str(ending),
        }
        task = asyncio.get_running_loop().create_task(self._noted(body))
        self._notes.add(task)
        task.add_done_callback(self._notes.discard)

    async def _noted(self, body: dict[str, object]) -> None:
        with contextlib.suppress(JournalError):  # the lease is over either way
            await self.gate.record("lease-ended", body)

    async def _look(self) -> None:
        """Ends a lease when its token is over, or when its validity cannot be told any more."""
        while True:
            await asyncio.sleep(LOOK_S)
            try:
                self.carriages.look()
                if not self._stands():
                    await self._end(LeaseEnding.AUTHORITY)
            except Exception as error:  # noqa: BLE001 - who looks goes on looking
                self.incidents.tell("leases", error)

    def _stands(self) -> bool:
        """True while the token of the open lease is valid, or without a lease."""
        lease = self.leases.current
        token = None if lease is None else lease.credentials.token
        if token is None:
            return True
        try:
            return isinstance(self.authority.verify(token, lease_ms=self._lease_ms), Chain)
        except Exception:  # noqa: BLE001 - a verification that breaks has not verified
            return False

    async def _end(self, ending: LeaseEnding) -> None:
        """Ends the lease, if there is one, and tells its program."""
        lease = self.leases.current
        if lease is not None:
            self._ending = lease, ending
            self.latch.latching.lease_ended(ending)
            try:
                self.ports.over(lease, ending)
                await asyncio.sleep(FAREWELL_S)
            finally:
                if self.leases.current is lease:
                    self.carriages.end(ending)


async def serve(
    config: GatewayConfig,
    *,
    reports: bool = False,
    unsafe_observe: bool = False,
    certifier: Callable[..., Certifying] = CellStream,
) -> None:
    """Runs the gateway to its end, with the arm standing still.

    Args:
        config: of it.
        reports: it has told of itself.
        certifier: see `GatewayServer`.
        unsafe_observe: it has enforced no policy, and has recorded each decision. Only before a simulated controller.

    Raises:
        PepError: when a part cannot be had; nothing was served then. `NOT_SIMULATED` comes before anything is opened.
    """
    simulated = recognise(config.robot_host) if unsafe_observe else None
    if simulated is not None:
        sys.stderr.write(WARNING)
        sys.stderr.flush()
    server = GatewayServer(config, **opened_cell(config), unsafe_observe=simulated, certifier=certifier)
    server.recover()
    await server.run(reports=reports)


def main(certifier: Callable[..., Certifying] = CellStream) -> None:
    """Command line of the gateway.

    Args:
        certifier: see `GatewayServer`; a benchmark brings one of its own.
    """
    parser = argparse.ArgumentParser(
        prog="python -m ztpm.point.gateway_server", description="The gateway of one robot."
    )
    parser.add_argument("--config", type=Path, required=True)
    parser.add_argument("--robot", help="address of the controller, in place of robot_host")
    parser.add_argument("--listen", help="address to listen on as the controller, in place of listen_host")
    parser.add_argument("--reports", action="store_true", help="answer questions on standard input")
    parser.add_argument(
        "--unsafe-observe", action="store_true", help="enforce no policy; refused unless the controller is simulated"
    )
    options = parser.parse_args()

    async def served() -> None:
        config = read_gateway_config(options.config)
        config = replace(
            config,
            robot_host=options.robot or config.robot_host,
            listen_host=options.listen or config.listen_host,
        )
        config.check()
        await serve(config, reports=options.reports, unsafe_observe=options.unsafe_observe, certifier=certifier)

    main_of(served, config=options.config, service="ztpm-gateway")


if __name__ == "__main__":
    main()
