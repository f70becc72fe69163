"""Ports of the controller for the holder of the lease, with the one writer behind them.

An unmodified ur_rtde program works when the judge permits its commands, and moves nothing when it does not. A client
without a lease is served by `StatePorts`.
"""

from __future__ import annotations

import asyncio
import contextlib
from functools import partial
from typing import TYPE_CHECKING, Final

from pep.base.errors import PepFault, RobotError
from pep.rtde.lease.lease import LeaseEnding
from pep.rtde.line.active_lease import ActiveLease
from pep.rtde.line.control_program import Phase
from pep.rtde.line.conversations import LeasedDashboardPort, LeasedRtdePort, LeasedScriptPort
from pep.rtde.line.gateway import StatePorts, stop_text
from pep.rtde.line.gripper_port import LeasedGripperPort
from pep.rtde.line.lease_stop import STOPPED, LeaseStopLadder, StopMeans
from pep.rtde.robot.connections import DASHBOARD, GRIPPER, PRIMARY, REALTIME, RTDE, SECONDARY
from pep.rtde.robot.dashboard import stop_program
from pep.rtde.robot.newest_state import SILENCE_MS
from pep.rtde.robot.primary_line import PrimaryLine
from pep.rtde.robot.state_receiver import SURE_MS
from pep.rtde.script.control_script import scripts_for
from policies.words.reason_table import Reason

if TYPE_CHECKING:
    from collections.abc import Callable, Coroutine, Sequence

    from pep.base.ports import Clock
    from pep.rtde.robot import connections
    from pep.rtde.robot.connections import ReplyChannel
    from pep.rtde.robot.judge_port import Judge, ProgramOwner
    from pep.rtde.robot.state_receiver import Package, StateReceiver
    from pep.rtde.script.control_script import ControlScript
    from pep.rtde.wire.primary_frames import Key

MAJOR: Final = 5
"""PolyScope 5, of e-Series: another one's script is another."""
BEGINS_S: Final = 10.0
"""Longest wait for the controller at the beginning."""
LOOK_S: Final = 0.02
"""Pause between two looks at the clock, beside those at each package."""


class LeasedPorts:
    """Ports that the gateway opens: one lease at a time, and clients without a lease.

    Args:
        robot: host of the controller.
        state: of that controller; its `told` is ours from `begin` to `close`.
        judge: decides about the holder's commands.
        scripts: every control script there is (`pep.rtde.script.control_script.allow_list`).
        stop_deceleration_rad_s2: of the cell's stop model.
        clock: the monotonic one counts.
        closed: is told of a lease whose control connection has ended, and why; the arm is being stopped then.

    Attributes:
        stopped_ms: monotonic time of the newest stop, of any sender; None while there was none.
    """

    def __init__(
        self,
        robot: str,
        state: StateReceiver,
        judge: Judge,
        *,
        scripts: Sequence[ControlScript],
        stop_deceleration_rad_s2: float,
        clock: Clock,
        closed: Callable[[ProgramOwner, LeaseEnding], None],
    ) -> None:
        self.robot = robot
        self.judge = judge
        self.deceleration = stop_deceleration_rad_s2
        self.clock = clock
        self.closed = closed
        self._all_scripts = scripts
        self._anybody = StatePorts(robot, stop_deceleration_rad_s2=stop_deceleration_rad_s2, stopping=self.note)
        self._stop_text = stop_text(stop_deceleration_rad_s2)
        self.state = state
        self.ladder = LeaseStopLadder()
        self.stopped_ms: int | None = None
        self._primary = PrimaryLine(robot, clock=clock, told=self._told, lost=self._unheard)
        self._tasks: set[asyncio.Task[None]] = set()
        self._tenant: ActiveLease | None = None
        self._past: ProgramOwner | None = (
            None  # the lease that was over last; its connections may be there a little longer
        )

    async def begin(self) -> None:
        """Listens to the controller from now on; returns once it has said something.

        Raises:
            RobotError: `ROBOT_UNREACHABLE` when it has not within `BEGINS_S`.
        """
        try:
            async with asyncio.timeout(BEGINS_S):
                await self._primary.begin()
        except TimeoutError:
            self.close()
            raise RobotError(PepFault.ROBOT_UNREACHABLE, f"{self.robot}, port {PRIMARY}") from None
        self.state.told = partial(self._hears, asyncio.get_running_loop())
        self._do(self._keep_looking())

    def undisturbed(self) -> bool:
        """True while the controller runs the control script that we sent for the lease, and nothing hides that."""
        running = self._tenant is not None and self._tenant.program.phase is Phase.RUNNING
        return running and self._primary.hears

    @property
    def scripts(self) -> Sequence[ControlScript]:
        """Control scripts that may be uploaded to this controller; none while its version is unknown or not `MAJOR`."""
        version = self.state.version
        if version is None or version.major != MAJOR:
            return ()
        return scripts_for(version.minor, self._all_scripts)

    def close(self) -> None:
        """Ends the lease, and serves nobody any more."""
        if self._tenant is not None:
            self._tenant.end(LeaseEnding.GATEWAY)
        self.state.told = None
        self._primary.close()
        for task in self._tasks:
            task.cancel()

    async def open(
        self, lease: ProgramOwner | None, port: int, back: ReplyChannel
    ) -> connections.ProgramConnection | Reason:
        """Connection to that port, or the reason why there is none."""
        if lease is None or port not in (DASHBOARD, PRIMARY, SECONDARY, REALTIME, RTDE, GRIPPER):
            return await self._anybody.open(lease, port, back)
        tenant = self.taken(lease)
        if isinstance(tenant, Reason):
            return tenant
        line: LeasedRtdePort | LeasedScriptPort | LeasedDashboardPort | LeasedGripperPort
        if port == RTDE:
            line = LeasedRtdePort(tenant, back)
        elif port == DASHBOARD:
            line = LeasedDashboardPort(tenant, back)
        elif port == GRIPPER:
            line = LeasedGripperPort(tenant, back)
        else:
            line = LeasedScriptPort(tenant, back, self.scripts)
        refused = await line.robot.reach(self.robot, port)
        if refused is not None:
            line.left()
        return refused or line

    def taken(self, lease: ProgramOwner) -> ActiveLease | Reason:
        """Lease at the controller, which ends any other one there; or the reason why there is none."""
        if self.state.version is None or self.state.silent_ms > SILENCE_MS:
            return Reason.ROBOT_NOT_RUNNING
        if lease is self._past:
            return Reason.NOT_GRANTED
        if self._tenant is None or self._tenant.lease is not lease:
            if self._tenant is not None:
                self._tenant.end(LeaseEnding.CLOSED)
            self._tenant = ActiveLease(self, lease)
        return self._tenant

    def over(self, lease: ProgramOwner, ending: LeaseEnding) -> None:
        """Ends the lease, which opens nothing any more; the arm is being stopped when this returns."""
        self._past = lease
        tenant = self._tenant
        if tenant is not None and tenant.lease is lease:
            self._tenant = None
            tenant.end(ending)

    # ---- stopping

    def counted(self) -> None:
        """Counts a stop: every permit of an earlier request is void from now on. From any thread."""
        self.stopped_ms = self.clock.monotonic_ms()

    def stop(self, rung: StopMeans) -> None:
        """Begins to stop the arm, this way or a harder one."""
        self.counted()
        current, tenant = self.state.current(SURE_MS), self._tenant
        idle = current is not None and current.still and current.runtime_state == STOPPED
        if rung is StopMeans.PROGRAM and idle and (tenant is None or not tenant.program.sent):
            if tenant is not None:
                tenant.script_over(Reason.ROBOT_NOT_RUNNING)
            return
        if self.ladder.begin(rung, newest=self.state.newest(), at_ms=self.clock.monotonic_ms()):
            self._take(rung)

    def note(self, rung: StopMeans) -> None:
        """Counts a stop that was sent past the ladder; a harder one follows where it does not help."""
        self.counted()
        self.ladder.begin(rung, newest=self.state.newest(), at_ms=self.clock.monotonic_ms())

    def _take(self, rung: StopMeans) -> None:
        if rung is StopMeans.REGISTERS:
            return
        if rung is StopMeans.PROGRAM and self._primary.connected:
            self._primary.send(self._stop_text)
        else:
            self._do(self._stop_by_dashboard())
        if self._tenant is not None:  # after the stop: nothing that it is in may keep that
            self._tenant.script_over(Reason.ROBOT_NOT_RUNNING)

    async def _stop_by_dashboard(self) -> None:
        with contextlib.suppress(RobotError):  # the ladder sees what the arm does, and asks again
            await asyncio.to_thread(stop_program, self.robot)

    # ---- looking

    def _told(self, event: Key) -> None:
        if self._tenant is not None:
            self._tenant.program.told(event)

    def _unheard(self) -> None:
        if self._tenant is not None:
            self._tenant.program.unheard()

    def _hears(self, loop: asyncio.AbstractEventLoop, package: Package) -> None:
        """Takes in a package, from the receiver's thread."""
        with contextlib.suppress(RuntimeError):  # the loop has ended
            loop.call_soon_threadsafe(self._heard, package)

    def _heard(self, package: Package) -> None:
        at_ms = self.clock.monotonic_ms()
        self._climb(at_ms)
        if self._tenant is not None:
            self._tenant.heard(package, at_ms)

    def _climb(self, at_ms: int) -> None:
        stopping = self._tenant is not None and self._tenant.stopping
        rung = self.ladder.look(self.state.newest(), at_ms=at_ms, carried_out=not stopping)
        if rung is not None:
            self._take(rung)

    async def _keep_looking(self) -> None:
        while True:
            await asyncio.sleep(LOOK_S)
            try:
                self._look()
            except Exception as error:  # noqa: BLE001 - who looks goes on looking
                told = {"message": "a look at the lease broke", "exception": error}
                asyncio.get_running_loop().call_exception_handler(told)

    def _look(self) -> None:
        at_ms = self.clock.monotonic_ms()
        try:
            tenant = self._tenant
            if tenant is not None:
                if tenant.control is not None and self.state.silent_ms > SILENCE_MS:
                    tenant.control.lose(LeaseEnding.ROBOT)
                tenant.look(at_ms)
        finally:
            self._climb(at_ms)

    def _do(self, what: Coroutine[None, None, None]) -> None:
        task = asyncio.get_running_loop().create_task(what)
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
