"""Supervision of a cell's processes: each death is recorded, stops the arm where it must, and is mended.

A death that cannot be mended ends the cell.

| process | when it dies | | --- | --- | | sensor | started again as often as it takes, with the scene that it was told;
until then perception is stale | | identity provider | started again, at most three times in ten minutes; until then the
view ages and motion is denied | | gateway | the arm is stopped through the dashboard at once, beside its watchdog; then
as above | | controller | the gateway, whose connections died with it, ends too; then both are started again, as above |
| tool server | the gateway stops what it called for, since nobody waits for that; then as above |

A process that lives and does not answer is shown on the status page; it is not killed, since nothing moves without it
anyway.
"""

from __future__ import annotations

import collections
import threading
from typing import TYPE_CHECKING, Any, Final

from pep.base.errors import RobotError
from pep.pit.files.old_files import renewed_shown
from pep.pit.files.plain_file import FILE_LIMIT_BYTES, value_of
from pep.pit.files.shown_file import shown_of
from pep.rtde.robot.dashboard import stop_program
from ztpm.base.processes import Child, ChildError

if TYPE_CHECKING:
    from collections.abc import Callable
    from pathlib import Path

    from ztpm.base.event_log import EventLog
    from ztpm.cell.cell import Cell

TICK_S: Final = 0.2
"""Time between two looks at the processes."""
RESTARTS: Final = {"idp": 3, "robot": 3, "gateway": 3, "tools": 3}
"""Most restarts within `WINDOW_S`; a process that dies more often has a fault that a restart does not mend."""
WINDOW_S: Final = 600.0
BACKOFF_S: Final = 0.5
BACKOFF_MOST_S: Final = 8.0
"""Pause before a restart: half a second, twice as long for each further death within the window, at most this."""
TOLD_LINES: Final = 20
"""Last lines of a dead process that are put on record."""
STOP_S: Final = 5.0
"""Longest wait for the dashboard's stop, when everything ends."""
EMPTY_SCENE: Final[dict[str, object]] = {"people": [], "objects": []}


class ChildLostError(RuntimeError):
    """A process that died too often.

    Attributes:
        name: of the process.
        lines: the last that it said.
    """

    def __init__(self, name: str, lines: list[str]) -> None:
        super().__init__(f"{name} died too often")
        self.name = name
        self.lines = lines


class SceneFile:
    """Scene of the simulated sensor, read from a file whenever that changes.

    Args:
        path: of the file; none is an empty scene.
        log: told about a file that holds no scene.
    """

    def __init__(self, path: Path, log: EventLog) -> None:
        self._path = path
        self._log = log
        self._seen: tuple[int, int] | None = None
        self.scene = EMPTY_SCENE

    def changed(self) -> bool:
        """True where there is another scene now; an unreadable file leaves the scene as it was."""
        try:
            status = self._path.stat()
            seen = (status.st_mtime_ns, status.st_size)
        except OSError:
            seen = None
        if seen == self._seen:
            return False
        self._seen = seen
        try:
            scene = EMPTY_SCENE if seen is None else _scene(self._path)
        except (OSError, ValueError, RecursionError) as error:
            self._log.note("scene-refused", f"{self._path} holds no scene; what is seen stays", why=str(error)[:200])
            return False
        different = scene != self.scene
        self.scene = scene
        return different


def _scene(path: Path) -> dict[str, object]:
    """The sensor's command out of a world file."""
    with path.open("rb") as file:
        content = file.read(FILE_LIMIT_BYTES + 1)
    value: Any = renewed_shown(value_of(content, path))
    shown_of(value)
    return {**EMPTY_SCENE, **value["view"]}


class Supervision:
    """Starts a cell's processes, keeps them running, ends them. All of it from one thread.

    Args:
        cell: its identity provider runs already.
        scene: scene of the sensor.
        log: of what happens.
        ended: set it, from anywhere, to end.
        clock: monotonic, seconds.

    Attributes:
        restarts: number of restarts of each process.
    """

    def __init__(
        self, cell: Cell, *, scene: SceneFile, log: EventLog, ended: threading.Event, clock: Callable[[], float]
    ) -> None:
        self.cell = cell
        self.restarts: collections.Counter[str] = collections.Counter()
        self._scene = scene
        self._log = log
        self._ended = ended
        self._clock = clock
        self._deaths: dict[str, collections.deque[float]] = collections.defaultdict(collections.deque)
        self._guard: threading.Thread | None = None

    def start(self) -> None:
        """Starts controller and sensor, where they are simulated, gateway and tool server.

        Raises:
            ChildError: when one does not become ready.
        """
        if self.cell.simulated:
            self.cell.start_robot()
            self._log.note("started", "the controller runs")
        with self.cell.beside():
            if self.cell.simulated:
                self._start_sensor()
            self.cell.start_gateway()
            self.cell.start_tools()
        self._guard_arm()
        beside = "sensor, gateway" if self.cell.simulated else "gateway"
        self._log.note("started", f"{beside} and tool server run")

    def run(self) -> None:
        """Keeps the processes running until the end is asked for.

        Raises:
            ChildLostError: when one dies too often.
        """
        while not self._ended.wait(TICK_S):
            self.look()

    def look(self) -> None:
        """Restarts every process that died since the last look, and shows the sensor its scene.

        Raises:
            ChildLostError: when one dies too often.
        """
        for name, child in self.cell.children.items():
            if not child.alive and not self._ended.is_set():
                self._mend(name, child)
                return  # the restarted processes are looked at the next time
        if self.cell.simulated and self._scene.changed():
            self._show(self.cell.sensor)

    def stop(self) -> None:
        """Ends every process, the controller after the arm stands still."""
        for name in ("tools", "gateway"):
            self.cell.end(name)
        if self._guard is not None:
            self._guard.join(STOP_S)
        self.cell.stop()

    def _mend(self, name: str, child: Child) -> None:
        """Restarts the dead process, and each that cannot go on without it."""
        lines = list(child.output)[-TOLD_LINES:]
        self._log.note(
            "died", f"{child.name} died with status {child.popen.returncode}",
            process=name, status=child.popen.returncode, lines=lines,
        )  # fmt: skip
        while True:
            pause_s = self._pause_s(name, lines)
            if self._ended.wait(pause_s):
                return
            self.restarts[name] += 1
            try:
                self._restart(name)
            except ChildError as error:
                lines = str(error).splitlines()[-TOLD_LINES:]
                self._log.note("restart-failed", f"{child.name} did not start again", process=name, lines=lines)
                continue
            self._log.note("restarted", f"{child.name} runs again", process=name, restarts=self.restarts[name])
            return

    def _pause_s(self, name: str, lines: list[str]) -> float:
        """Pause before the restart.

        Raises:
            ChildLostError: when there were enough.
        """
        now, deaths = self._clock(), self._deaths[name]
        deaths.append(now)
        while now - deaths[0] > WINDOW_S:
            deaths.popleft()
        if name in RESTARTS and len(deaths) > RESTARTS[name]:
            raise ChildLostError(name, lines)
        # The exponent is bounded: a sensor may die for days.
        return min(BACKOFF_S * 2.0 ** min(len(deaths) - 1, 8), BACKOFF_MOST_S)

    def _restart(self, name: str) -> None:
        match name:
            case "sensor":
                self._start_sensor()
            case "tools":
                self.cell.start_tools()
            case "gateway":
                self._start_gateway()
            case "robot":
                self.cell.end("gateway")
                self.cell.start_robot()
                self._start_gateway()
            case _:
                self.cell.start_idp()

    def _start_sensor(self) -> None:
        """Starts the sensor with its scene before its first frame, so that it never sees an empty cell."""
        self.cell.start_sensor("--paused")
        self._scene.changed()
        self._show(self.cell.sensor)

    def _show(self, sensor: Child) -> None:
        try:
            sensor.tell(self._scene.scene)
            sensor.tell({"pause": False})
        except OSError:  # it has died; the next look finds it
            return

    def _start_gateway(self) -> None:
        self.cell.start_gateway()
        self._guard_arm()

    def _guard_arm(self) -> None:
        self._guard = threading.Thread(target=self._arm_stands_after, args=(self.cell.gateway,), daemon=True)
        self._guard.start()

    def _arm_stands_after(self, gateway: Child) -> None:
        """Stops the arm at once through the dashboard when the gateway is gone, and not in order."""
        if gateway.popen.wait() == 0:
            return
        try:
            stop_program(self.cell.addresses.controller_host)
        except RobotError as error:
            self._log.note("stop-failed", f"the arm could not be stopped: {error}")
        else:
            self._log.note("arm-stopped", "the gateway is gone: the arm was stopped through the dashboard")
