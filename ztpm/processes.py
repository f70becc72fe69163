"""Child processes that say when they are ready: started, watched and ended with deadlines, their output kept."""

from __future__ import annotations

import collections
import json
import os
import queue
import signal
import subprocess
import sys
import threading
import time
from dataclasses import dataclass, field
from typing import IO, TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

READY_S: Final = 60.0
"""Longest wait for a ready line: imports of the MCP SDK and pinocchio take seconds on a loaded machine."""
STOP_S: Final = 10.0
"""Longest wait for a clean end before the process is killed."""
KEPT_LINES: Final = 200


class ChildError(RuntimeError):
    """A child that did not become ready, or died."""


@dataclass
class Child:
    """One running child process.

    Attributes:
        name: for messages.
        popen: the process.
        ready: the JSON object of its ready line.
        output: the last lines it wrote, for a failure report.
    """

    name: str
    popen: subprocess.Popen[bytes]
    ready: dict[str, object] = field(default_factory=dict)
    output: collections.deque[str] = field(default_factory=lambda: collections.deque(maxlen=KEPT_LINES))

    @classmethod
    def start(cls, name: str, module: str, *arguments: str, environment: Mapping[str, str]) -> Child:
        """A child running `python -m module arguments`, ready.

        Args:
            name: for messages.
            module: to run.
            arguments: of the command line.
            environment: variables added to this process's own.

        Raises:
            ChildError: when it ends or stays silent for `READY_S` seconds; its last lines are in the message.
        """
        command: Sequence[str] = (sys.executable, "-m", module, *arguments)
        popen = subprocess.Popen(  # noqa: S603 - our own interpreter and our own modules
            command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            env={**os.environ, "PYTHONUNBUFFERED": "1", **environment},
            start_new_session=True,
        )
        child = cls(name=name, popen=popen)
        lines: queue.SimpleQueue[str | None] = queue.SimpleQueue()
        for stream in (popen.stdout, popen.stderr):
            assert stream is not None
            threading.Thread(target=child._follow, args=(stream, lines), daemon=True).start()
        child._wait_ready(lines)
        return child

    def _follow(self, stream: IO[bytes], lines: queue.SimpleQueue[str | None]) -> None:
        for raw in stream:
            line = raw.decode("utf-8", "replace").rstrip()
            self.output.append(line)
            lines.put(line)
        lines.put(None)

    def _wait_ready(self, lines: queue.SimpleQueue[str | None]) -> None:
        deadline = time.monotonic() + READY_S
        while (left := deadline - time.monotonic()) > 0:
            try:
                line = lines.get(timeout=min(left, 0.5))
            except queue.Empty:
                line = ""
            if line and line.startswith("{"):
                try:
                    said = json.loads(line)
                except ValueError:
                    continue
                if isinstance(said, dict) and said.get("ready") is True:
                    self.ready = said
                    return
            if line is None and self.popen.poll() is not None:
                break
        self.stop()
        raise ChildError(f"{self.name} did not become ready:\n" + "\n".join(self.output))

    def tell(self, command: object) -> None:
        """One JSON line on the child's standard input."""
        assert self.popen.stdin is not None
        self.popen.stdin.write(json.dumps(command).encode() + b"\n")
        self.popen.stdin.flush()

    def pause(self) -> None:
        """The process stands still (SIGSTOP), as an unreachable machine would."""
        self.popen.send_signal(signal.SIGSTOP)

    def resume(self) -> None:
        """The process goes on."""
        self.popen.send_signal(signal.SIGCONT)

    def kill(self) -> None:
        """The process is gone at once (SIGKILL), as in a power cut."""
        self.popen.kill()
        self.popen.wait(STOP_S)

    def stop(self) -> int:
        """The process has ended; its exit code. Asked first (SIGTERM), killed after `STOP_S` seconds."""
        if self.popen.poll() is None:
            self.popen.send_signal(signal.SIGCONT)
            self.popen.terminate()
            try:
                self.popen.wait(STOP_S)
            except subprocess.TimeoutExpired:
                self.popen.kill()
                self.popen.wait(STOP_S)
        for stream in (self.popen.stdin, self.popen.stdout, self.popen.stderr):
            if stream is not None:
                try:
                    stream.close()
                except OSError:
                    continue
        return self.popen.returncode
