"""Program that knows ur_rtde and nothing of ZTPM, as `ztpm rtde run` runs it."""

from __future__ import annotations

import os
import subprocess
import sys
from typing import TYPE_CHECKING, Final, Self

from ztpm.base.layout import write_private
from ztpm.cell.cell import PASSPHRASE_VARIABLE
from ztpm.program.program_lease import PLACE
from ztpm.stage.stage import SEND_TRIES, WAIT_S, StageError

if TYPE_CHECKING:
    from collections.abc import Sequence
    from types import TracebackType

    from ztpm.stage.stage import Stage

MOVES: Final = f"""
import sys, time
from rtde_control import RTDEControlInterface
control = RTDEControlInterface(sys.argv[1])
print(sys.argv[1], flush=True)
sys.stdin.readline()
speed, acceleration, *there = map(float, sys.argv[2:])
for _ in range({SEND_TRIES}):
    moved = control.moveJ(there, speed, acceleration)
    if moved:
        break
    time.sleep(0.01)
print("moved" if moved else "refused", flush=True)
"""
"""One synchronous move: address, speed, acceleration, six angles.

It says where it is connected to, waits for a line, and says whether ur_rtde called the move a success. What is refused
it asks for again, as the story's tools do: on a loaded machine a verdict may come too late to act on."""


class Program:
    """The program under way, in an agent's lease. Use it as a context: it has ended afterwards.

    Args:
        stage: the running stage, with its gateway.
        agent: holder of the lease; its token is the stage's.
        to: joint angles of the move, rad.
        speed: of the leading axis, rad/s.
        acceleration: likewise, rad/s2.
    """

    def __init__(self, stage: Stage, agent: str, *, to: Sequence[float], speed: float, acceleration: float) -> None:
        layout = stage.cell.layout
        token = layout.root / f"{agent}.token"
        token.unlink(missing_ok=True)
        write_private(token, stage.tokens[agent].encode())
        numbers = map(repr, (speed, acceleration, *to))
        own = [sys.executable, "-m", "ztpm", "rtde", "run", agent, "--token", str(token), "--data", str(layout.root)]
        self._child = subprocess.Popen(  # noqa: S603 - our own command, no shell
            [*own, "--", sys.executable, "-c", MOVES, PLACE, *numbers],
            env=os.environ | {PASSPHRASE_VARIABLE: stage.cell.passphrase.decode()},
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )

    def said(self) -> str:
        """The program's next line.

        Raises:
            StageError: it has ended.
        """
        assert self._child.stdout is not None
        line = self._child.stdout.readline().strip()
        if not line:
            raise StageError(f"the program has ended: {self._child.communicate(timeout=WAIT_S)[1].strip()[-300:]}")
        return line

    def go(self) -> None:
        """Lets the program go on to its move."""
        assert self._child.stdin is not None
        self._child.stdin.write("\n")
        self._child.stdin.flush()

    def status(self) -> int:
        """Exit status of `ztpm rtde run`, once it has ended."""
        return self._child.wait(timeout=WAIT_S)

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._child.terminate()
        try:
            self._child.communicate(timeout=WAIT_S)
        except subprocess.TimeoutExpired:
            self._child.kill()
            self._child.communicate()
