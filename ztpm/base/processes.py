"""Child processes that report readiness: started, watched and ended with deadlines, their output kept.

They end with this process, however it ends (ztpm/base/parent_watch.py), and some of them answer questions on their
standard input.
"""

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
from contextlib import suppress
from dataclasses import dataclass, field
from typing import IO, TYPE_CHECKING, Any, Final

from ztpm.preparing import SHOWN

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from ztpm.preparing import Preparing

READY_S: Final = 180.0
"""Longest silence: without a ready line, and without one about preparation."""
STOP_S: Final = 10.0
"""Longest wait for a clean end before the process is killed."""
KEPT_LINES: Final = 200
POLL_S: Final = 0.2
"""Longest time for which an end of the wait goes unnoticed."""
ANSWER: Final = '{"answer":'
"""Beginning of a line that answers a question; it is no output."""
REPORT: Final = "report"
STOP: Final = "stop"
"""Lanes of questions, by their member; a question of one lane waits for no answer of the other."""
PREPARING: Final = '{"preparing":'
"""Beginning of a line that tells of preparation; likewise no output."""


class ChildError(RuntimeError):
    """A child that did not become ready, or died.

    Attributes:
        name: of the child.
        last: line that it wrote last.
    """

    def __init__(self, name: str, cause: str, lines: Sequence[str]) -> None:
        super().__init__("\n".join((f"{name} did not become ready: {cause}", *lines)))
        self.name = name
        self.last = lines[-1] if lines else ""


def _said(line: str) -> dict[str, object]:
    """The JSON object of a line; empty for any other line."""
    if line.startswith("{"):
        with suppress(ValueError, RecursionError):
            said = json.loads(line)
            if isinstance(said, dict):
                return said
    return {}


def _how(status: int) -> str:
    """The end of a process, for people."""
    if status >= 0:
        return f"with exit status {status}"
    name = signal.Signals(-status).name if -status in set(signal.Signals) else f"signal {-status}"
    return f"by {name}" + (", as when memory runs out" if -status == signal.SIGKILL else "")


@dataclass
class _Lane:
    """Questions of one kind, one at a time."""

    asking: threading.Lock = field(default_factory=threading.Lock)
    answers: queue.SimpleQueue[dict[str, Any]] = field(default_factory=queue.SimpleQueue)
    unanswered: bool = False


@dataclass
class Child:
    """One running child process.

    Attributes:
        name: for messages.
        popen: the process.
        ready: the JSON object of its ready line.
        output: the last lines it wrote, for a failure report.
        since: monotonic time of its start, seconds.
        ended, preparing: as of `begin`.
    """

    name: str
    popen: subprocess.Popen[bytes]
    ready: dict[str, object] = field(default_factory=dict)
    output: collections.deque[str] = field(default_factory=lambda: collections.deque(maxlen=KEPT_LINES))
    since: float = field(default_factory=time.monotonic)
    ended: Callable[[], bool] = lambda: False
    preparing: Preparing = SHOWN
    _lines: queue.SimpleQueue[str | None] = field(default_factory=queue.SimpleQueue)
    _lanes: dict[str, _Lane] = field(default_factory=lambda: {REPORT: _Lane(), STOP: _Lane()})

    @classmethod
    def start(cls, name: str, module: str, *arguments: str, environment: Mapping[str, str], **options: Any) -> Child:
        """A child as of `begin`, ready.

        Raises:
            ChildError: see `until_ready`.
        """
        return cls.begin(name, module, *arguments, environment=environment, **options).until_ready()

    @classmethod
    def begin(
        cls,
        name: str,
        module: str,
        *arguments: str,
        environment: Mapping[str, str],
        ended: Callable[[], bool] = lambda: False,
        preparing: Preparing = SHOWN,
    ) -> Child:
        """Begins a child running `main` of the module. It ends when the calling thread does.

        Args:
            name: for messages.
            module: to run; its `main` takes no arguments and returns its exit status or nothing.
            arguments: of the command line.
            environment: variables added to this process's own.
            ended: when it says so, the wait for the child is over.
            preparing: shows what the child says it prepares, and for how long it is silent; on standard error by
                default.
        """
        command: Sequence[str] = (sys.executable, "-m", "ztpm.base.parent_watch", str(os.getpid()), module, *arguments)
        popen = subprocess.Popen(  # noqa: S603 - our own interpreter and our own modules
            command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            env={**os.environ, "PYTHONUNBUFFERED": "1", **environment},
            start_new_session=True,
        )
        return cls(name, popen, ended=ended, preparing=preparing)

    def until_ready(self) -> Child:
        """The child, once it says that it is ready.

        Raises:
            ChildError: when it ends or says nothing of that kind for `READY_S` seconds, or the wait is over; the
                message says which, how far it was, and its last lines; it has ended.
        """
        try:
            self._wait_ready()
        except BaseException:
            self.stop()
            raise
        return self

    def __post_init__(self) -> None:
        for stream in (self.popen.stdout, self.popen.stderr):
            assert stream is not None
            threading.Thread(target=self._follow, args=(stream,), daemon=True).start()

    def _follow(self, stream: IO[bytes]) -> None:
        for raw in stream:
            line = raw.decode("utf-8", "replace").rstrip()
            if line.startswith(ANSWER):
                with suppress(ValueError, RecursionError):
                    said = json.loads(line)
                    lane = self._lanes.get(said.get("lane", REPORT))
                    if lane is not None and isinstance(said["answer"], dict):
                        lane.answers.put(said["answer"])
                continue
            if not line.startswith(PREPARING):
                self.output.append(line)
            if not self.ready:  # no caller waits for lines afterwards
                self._lines.put(line)
        self._lines.put(None)

    def _wait_ready(self) -> None:
        try:
            cause = self._unready()
        finally:
            self.preparing.over()
        if cause:
            raise ChildError(self.name, cause, list(self.output))

    def _unready(self) -> str:
        """The reason why it never became ready; empty once it is."""
        heard, far = time.monotonic(), ""
        while not self.ended():
            try:
                line = self._lines.get(timeout=POLL_S)
            except queue.Empty:
                line = ""
            said, now = _said(line or ""), time.monotonic()
            if said.get("ready") is True:
                self.ready = said
                return ""
            if "preparing" in said:
                heard, far = now, f", after it said: {said['preparing']}"
                self.preparing.tell(said["preparing"])
            else:
                self.preparing.wait(f"starting the {self.name}, {now - self.since:.0f} s")
            # Both pipes may have ended a moment before the process has: then no line says so, and silence must do.
            if not line and (status := self.popen.poll()) is not None:
                return f"it ended {_how(status)}{far}"
            if now - heard > READY_S:
                return f"silent for {READY_S:.0f} s{far}"
        return f"nobody waits for it any more{far}"

    @property
    def alive(self) -> bool:
        """True until the child has ended."""
        return self.popen.poll() is None

    def tell(self, command: object) -> None:
        """Sends one JSON line to the child's standard input."""
        assert self.popen.stdin is not None
        self.popen.stdin.write(json.dumps(command).encode() + b"\n")
        self.popen.stdin.flush()

    def ask(self, question: object, *, timeout_s: float, lane: str = REPORT) -> dict[str, Any] | None:
        """The child's answer to a JSON line: the object behind `{"answer": `, or None when none comes in time.

        Any thread. A child that has not answered yet is not asked again, so that one that stands still is not buried
        in questions.

        Args:
            question: to be told.
            timeout_s: longest wait.
            lane: `REPORT`, or `STOP`, which waits for no report.
        """
        asked = self._lanes[lane]
        with asked.asking:
            while True:  # an answer that came too late answers nothing now
                try:
                    asked.answers.get_nowait()
                    asked.unanswered = False
                except queue.Empty:
                    break
            try:
                if not asked.unanswered:
                    self.tell(question)
                    asked.unanswered = True
                answer = asked.answers.get(timeout=timeout_s)
            except (OSError, ValueError, queue.Empty):  # ended, closed, silent
                return None
            asked.unanswered = False
            return answer

    def pause(self) -> None:
        """Suspends the process (SIGSTOP), so that it looks like an unreachable machine."""
        self.popen.send_signal(signal.SIGSTOP)

    def resume(self) -> None:
        """Resumes the process."""
        self.popen.send_signal(signal.SIGCONT)

    def kill(self) -> None:
        """Kills the process at once (SIGKILL), as in a power cut."""
        self.popen.kill()
        self.popen.wait(STOP_S)

    def stop(self) -> int:
        """Ends the process; its exit code.

        Asked first (SIGTERM), killed after `STOP_S` seconds.
        """
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
