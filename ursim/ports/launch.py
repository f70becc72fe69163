"""A simulated controller in a process of its own, for tests and demonstrations."""

from __future__ import annotations

import json
import random
import select
import subprocess
import sys
import time
from typing import TYPE_CHECKING, Any, Final, Self

from pep.base.stop_model import STOP_DECELERATION_RAD_S2

if TYPE_CHECKING:
    from collections.abc import Sequence
    from pathlib import Path
    from types import TracebackType

START_DEADLINE_S: Final = 20.0  # a loaded host may take seconds to import; an idle one takes a third of one
STOP_DEADLINE_S: Final = 5.0
ATTEMPTS: Final = 5  # loopback addresses tried when none is asked for


class LaunchError(RuntimeError):
    """Controller that did not become ready; the message holds its output."""


class SimulatedController:
    """A running controller process; leaving the `with` block ends it.

    Attributes:
        host: the address its ports listen on.
        process: the process.
    """

    def __init__(self, host: str, process: subprocess.Popen[str]) -> None:
        self.host = host
        self.process = process
        self.report: dict[str, Any] | None = None

    @classmethod
    def start(
        cls,
        joints: Sequence[float] | None = None,
        host: str | None = None,
        *,
        stop_deceleration_rad_s2: float = STOP_DECELERATION_RAD_S2,
        version: str | None = None,
        gripper_object_m: float | None = None,
        tcp_m: Sequence[float] | None = None,
        payload: Sequence[float] | None = None,
        robot: str | None = None,
        programs: Path | None = None,
    ) -> SimulatedController:
        """A controller that is ready to be connected to.

        Args:
            joints: six joint angles [rad] to start at.
            host: the address to listen on; None finds a free one in 127.0.0.0/8.
            stop_deceleration_rad_s2: of every stop that does not say its own.
            version: PolyScope version, for example "5.15".
            gripper_object_m: width of the object between the gripper's fingers.
            tcp_m: tool centre point of the installation, in the flange frame.
            payload: of the installation: kg, and its centre [m] in the flange frame.
            robot: name of the arm, for example "ur5e".
            programs: folder of saved programs.

        Raises:
            LaunchError: it ended, or was not ready within `START_DEADLINE_S`.
        """
        options = [f"--stop-deceleration={stop_deceleration_rad_s2}", "--commands"]
        if joints is not None:
            options.append("--joints=" + ",".join(repr(float(angle)) for angle in joints))
        if programs is not None:
            options.append(f"--programs={programs}")
        if robot is not None:
            options.append(f"--robot={robot}")
        if version is not None:
            options.append(f"--polyscope={version}")
        if gripper_object_m is not None:
            options.append(f"--gripper-object={gripper_object_m}")
        for name, numbers in (("tcp", tcp_m), ("payload", payload)):
            if numbers is not None:
                options.append(f"--{name}=" + ",".join(repr(float(number)) for number in numbers))
        taken = ""
        for _ in range(1 if host else ATTEMPTS):
            address = host or f"127.{random.randint(1, 254)}.{random.randint(0, 254)}.{random.randint(1, 254)}"  # noqa: S311
            process = subprocess.Popen(  # noqa: S603  our own module, no shell
                [sys.executable, "-m", "ursim", f"--host={address}", *options],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                text=True,
            )
            controller = cls(address, process)
            told = controller._hear(START_DEADLINE_S)
            if told is not None and told.get("ready"):
                return controller
            controller.stop()
            if told is None or told.get("error") != "PORT_UNUSABLE":
                raise LaunchError(f"the controller on {address} did not become ready: {told}")
            taken = str(told.get("address"))
        raise LaunchError(f"{taken} cannot be listened on")

    def fault(self, name: str, **details: object) -> None:
        """Injects one of the faults of `ursim.ports.faults`."""
        assert self.process.stdin is not None
        self.process.stdin.write(json.dumps({"fault": name, **details}) + "\n")
        self.process.stdin.flush()

    def stop(self) -> int:
        """Ends the process and gives its exit status; its timing is in `report` afterwards."""
        if self.process.poll() is None:
            self.process.terminate()
        told = self._hear(STOP_DEADLINE_S)
        self.report = told or self.report
        try:
            status = self.process.wait(STOP_DEADLINE_S)
        except subprocess.TimeoutExpired:
            self.process.kill()
            status = self.process.wait()
        for pipe in (self.process.stdin, self.process.stdout):
            if pipe is not None:
                pipe.close()
        return status

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.stop()

    def _hear(self, deadline_s: float) -> dict[str, Any] | None:
        """The next JSON line it prints, or None when it ends or the deadline passes first."""
        output = self.process.stdout
        if output is None or output.closed:
            return None
        due = time.monotonic() + deadline_s
        while (left := due - time.monotonic()) > 0:
            ready, _, _ = select.select([output], [], [], left)
            if not ready:
                return None
            line = output.readline()
            if not line:
                return None
            try:
                told = json.loads(line)
            except ValueError:
                continue
            if isinstance(told, dict):
                return told
        return None
