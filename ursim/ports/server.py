"""The whole controller: state, ports and the thread that ticks."""

from __future__ import annotations

import gc
import sys
import threading
import time
from collections import deque
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from pep.base.stop_model import STOP_DECELERATION_RAD_S2
from pep.rtde.wire.messages import ControlVersion
from ursim.motion.arm import ROBOTS, Arm
from ursim.motion.robot import TICK_S, Robot
from ursim.ports.arm_kinds import KINDS
from ursim.ports.controller import Controller
from ursim.ports.dashboard import Dashboard
from ursim.ports.gripper import ACKNOWLEDGED, MAX_LINE, Gripper
from ursim.ports.rtde_server import RtdeServer
from ursim.ports.script_ports import ScriptServer
from ursim.ports.sockets import Connection, Delivery, Port

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from ursim.motion.arm import Joints
    from ursim.motion.spatial import Triple

DASHBOARD, PRIMARY, SECONDARY, REALTIME, RTDE, GRIPPER = 29999, 30001, 30002, 30003, 30004, 63352
READ_ONLY: Final = 10  # to a port's number, gives that of its read-only twin
HOME: Final[Joints] = (0.0, -1.5708, 1.5708, -1.5708, -1.5708, 0.0)  # upright, elbow bent, tool down
SLIP_S: Final = 0.05  # a host that stalls longer than this loses ticks; below it they are made up for at once
SWITCH_S: Final = 0.0005  # how long a connection thread may keep the tick thread waiting for the interpreter
REMEMBERED: Final = 60_000  # ticks whose timing is kept: two minutes
OLDEST, NEWEST = (5, 11), (5, 22)  # PolyScope versions with the behaviour simulated here


@dataclass(frozen=True, slots=True)
class Settings:
    """Settings of a simulated controller.

    Attributes:
        host: IPv4 address; the ports are fixed, so each controller needs an address of its own.
        joints: joint angles at start [rad].
        stop_deceleration_rad_s2: of every stop that does not say its own.
        version: PolyScope, between `OLDEST` and `NEWEST`.
        object_width_m: width of the object between the gripper's fingers, if any.
        tcp_m: tool centre point of the installation, in the flange frame, not turned against it.
        payload: of the installation: mass [kg], and its centre in the flange frame [m].
        robot: name of the simulated arm, one of `KINDS`.
        programs: folder of saved programs that the dashboard server loads from.
    """

    host: str
    joints: Joints = HOME
    stop_deceleration_rad_s2: float = STOP_DECELERATION_RAD_S2
    version: ControlVersion = ControlVersion(5, 11, 6, 1010327)  # noqa: RUF009  frozen
    object_width_m: float | None = None
    tcp_m: Triple = (0.0, 0.0, 0.0)
    payload: tuple[float, Triple] = (0.0, (0.0, 0.0, 0.0))
    robot: str = "ur3e"
    programs: Path | None = None


class Simulator:
    """A controller that listens.

    Args:
        settings: of the controller.
        shutdown: called when a client shuts the controller down, or when it fails.

    Raises:
        OSError: a port is taken; `filename` names it.
        ValueError: joints outside the limits, a deceleration that is not positive, or an arm or version not simulated.
    """

    def __init__(self, settings: Settings, shutdown: Callable[[], None]) -> None:
        kind = KINDS.get(settings.robot)
        if kind is None:
            raise ValueError(f"{settings.robot} is not simulated; {', '.join(KINDS)} are")
        arm = Arm.load(ROBOTS / f"{settings.robot}.toml")
        if not arm.inside(settings.joints):
            raise ValueError("the joints to start at lie outside the limits")
        if not 0.0 < settings.stop_deceleration_rad_s2 <= arm.acceleration_limit_rad_s2:
            raise ValueError(f"the stop deceleration must lie in (0, {arm.acceleration_limit_rad_s2}] rad/s2")
        version = settings.version
        if not OLDEST <= (version.major, version.minor) <= NEWEST:
            raise ValueError(f"PolyScope {version.major}.{version.minor} is not simulated; 5.11 to 5.22 are")
        robot = Robot(arm, settings.joints, stop_deceleration_rad_s2=settings.stop_deceleration_rad_s2)
        robot.set_tcp((*settings.tcp_m, 0.0, 0.0, 0.0))
        robot.set_payload(*settings.payload)
        gripper = Gripper(object_width_m=settings.object_width_m)
        self.controller = controller = Controller(robot, gripper)
        dashboard = Dashboard(controller, version, shutdown, kind, settings.programs)
        scripts = ScriptServer(controller, version, kind)
        self.rtde = rtde = RtdeServer(controller, version)
        controller.listeners += [rtde.publish, scripts.publish, self._deliver]
        self._host = settings.host
        self.ports: list[Port] = []
        self.delivery = Delivery()
        try:
            self._listen(DASHBOARD, dashboard.serve)
            scripts.telling.append(self._listen(PRIMARY, scripts.greet_and_serve))
            scripts.telling.append(self._listen(PRIMARY + READ_ONLY, scripts.greet_and_refuse))
            scripts.stating.append(self._listen(SECONDARY, scripts.greet_and_serve))
            scripts.stating.append(self._listen(SECONDARY + READ_ONLY, scripts.greet_and_ignore))
            scripts.realtime.append(self._listen(REALTIME, scripts.serve, lossy=True))
            scripts.realtime.append(self._listen(REALTIME + READ_ONLY, scripts.ignore, lossy=True))
            self._listen(RTDE, rtde.serve)
            self._listen(GRIPPER, self._serve_gripper)
        except OSError:
            self._close()
            raise
        self.clock = Ticker(controller.tick, shutdown)

    def start(self) -> None:
        """Ticks and accepts connections from now on."""
        self.clock.start()
        for port in self.ports:
            port.start()

    def stop(self) -> None:
        """Closes every port and connection, then the clock; returns when it stands."""
        self._close()
        self.clock.stop()

    def _deliver(self) -> None:
        if self.delivery.touched:
            for port in self.ports:
                for connection in port.connections():
                    connection.deliver()

    def drop(self) -> None:
        """Closes every connection, as a pulled cable and plugged-in again would."""
        for port in self.ports:
            for connection in port.connections():
                connection.close()

    def _listen(self, number: int, serve: Callable[[Connection], None], *, lossy: bool = False) -> Port:
        port = Port(self._host, number, serve, self.delivery, lossy=lossy)
        self.ports.append(port)
        return port

    def _close(self) -> None:
        for port in self.ports:
            port.close()

    def _serve_gripper(self, connection: Connection) -> None:
        held = b""
        while received := connection.receive():
            *lines, held = (held + received).split(b"\n")
            if len(held) > MAX_LINE or any(len(line) > MAX_LINE for line in lines):
                return
            for line in lines:
                text = line.decode("ascii", "replace")
                reply = self.controller.ask(lambda text=text: self.controller.gripper.answer(text))  # type: ignore[misc]
                # The URCap's own preamble reads three bytes of an acknowledgement: nothing ends it.
                connection.send(reply.encode() + (b"" if reply == ACKNOWLEDGED else b"\n"))


class Ticker:
    """Calls `tick` every 2 ms from a thread of its own, and remembers how well it kept time.

    An event loop will not do: its timer rounds to whole milliseconds.

    Args:
        tick: one step.
        failed: called when a tick raises; the clock then stands still.
    """

    def __init__(self, tick: Callable[[], None], failed: Callable[[], None]) -> None:
        self._tick = tick
        self._failed = failed
        self._ending = threading.Event()
        self._thread = threading.Thread(target=self._run, name="tick", daemon=True)
        self._period_s: deque[float] = deque(maxlen=REMEMBERED)
        self._cost_s: deque[float] = deque(maxlen=REMEMBERED)
        self.ticks = 0
        self.slips = 0
        self.error: BaseException | None = None

    def start(self) -> None:
        """Ticks from now on."""
        sys.setswitchinterval(SWITCH_S)
        gc.freeze()  # objects built at start need not be looked at again
        self._thread.start()

    def stop(self) -> None:
        """No more ticks when this returns."""
        self._ending.set()
        self._thread.join()

    def report(self) -> dict[str, object]:
        """Timing so far, in microseconds: the period between ticks and the cost of one."""
        return {
            "ticks": self.ticks,
            "slips": self.slips,
            "period_us": _percentiles(self._period_s),
            "cost_us": _percentiles(self._cost_s),
        }

    def _run(self) -> None:
        due = last = time.perf_counter()
        try:
            while not self._ending.is_set():
                due += TICK_S
                delay = due - time.perf_counter()
                if delay > 0.0:
                    time.sleep(delay)
                elif delay < -SLIP_S:
                    due -= delay
                    self.slips += 1
                begun = time.perf_counter()
                self._tick()
                self._period_s.append(begun - last)
                self._cost_s.append(time.perf_counter() - begun)
                last = begun
                self.ticks += 1
        except BaseException as error:  # noqa: BLE001  a controller that cannot tick must not look alive
            self.error = error
            self._failed()


def _percentiles(seconds: deque[float]) -> dict[str, float]:
    ordered = sorted(seconds)
    if not ordered:
        return {}
    return {
        name: round(1e6 * ordered[min(len(ordered) - 1, int(part * len(ordered)))], 1)
        for name, part in (("p50", 0.5), ("p99", 0.99), ("p999", 0.999), ("max", 1.0))
    }
