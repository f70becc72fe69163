"""Processes of a cell that begin as copies of one that has imported and compiled all that they run.

A start from nothing is measured and tested elsewhere. Campaigns that begin a dozen processes for what those do
afterwards need not wait for the same imports each time. A copy is a process of its own in all else: with a session, an
environment, three pipes and the watch over its parent, here the process that it is a copy of, which ends with its own.
"""

from __future__ import annotations

import atexit
import gc
import importlib
import json
import os
import select
import signal
import socket
import subprocess
import sys
from functools import cache
from typing import TYPE_CHECKING, Any, Final

from ztpm.base.processes import Child

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

MODULES: Final = (
    "ursim.__main__", "ursim.sensor.sensor", "uvicorn", "ztpm.edge.server", "ztpm.point.gateway_server",
    "ztpm.point.provider_server", "ztpm.point.tool_proxy", "ztpm_idp.app",
)  # fmt: skip
"""Modules that the processes of a cell run, or load once they run."""
MESSAGE_BYTES: Final = 1 << 16
READY_S: Final = 600.0
POLL_S: Final = 0.02


class Copy:
    """A copy as its starter sees it: as much of `subprocess.Popen` as `Child` asks for.

    Args:
        pid: of the copy.
        ends: descriptors of its standard input, output and errors, and of the word of its end.

    Attributes:
        pid: as given.
        returncode: of the copy, or None while it runs.
        stdin, stdout, stderr: its standard streams, from this side.
    """

    def __init__(self, pid: int, ends: Sequence[int]) -> None:
        stdin, stdout, stderr, status = ends
        self.pid = pid
        self.returncode: int | None = None
        self.stdin, self.stdout, self.stderr = (
            os.fdopen(stdin, "wb", 0),
            os.fdopen(stdout, "rb"),
            os.fdopen(stderr, "rb"),
        )
        self._status = os.fdopen(status, "rb", 0)

    def poll(self) -> int | None:
        """Its exit status, or None while it runs."""
        return self._ended(0)

    def wait(self, timeout: float | None = None) -> int:
        """Its exit status.

        Raises:
            subprocess.TimeoutExpired: it still runs after `timeout` seconds.
        """
        status = self._ended(timeout)
        if status is None:
            raise subprocess.TimeoutExpired(str(self.pid), timeout or 0.0)
        return status

    def _ended(self, timeout: float | None) -> int | None:
        if self.returncode is None and select.select([self._status], [], [], timeout)[0]:
            self.returncode = int(self._status.read(16) or -signal.SIGKILL)
        return self.returncode

    def send_signal(self, number: int) -> None:
        """Sends a signal, unless it has ended."""
        if self.poll() is None:
            os.kill(self.pid, number)

    def terminate(self) -> None:
        """Asks it to end."""
        self.send_signal(signal.SIGTERM)

    def kill(self) -> None:
        """Kills it."""
        self.send_signal(signal.SIGKILL)


class Original:
    """The process that is copied, ready."""

    def __init__(self) -> None:
        ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        with theirs:
            self._original = subprocess.Popen(  # noqa: S603 - our own interpreter and this very module
                [sys.executable, "-m", __name__, str(theirs.fileno())],
                pass_fds=[theirs.fileno()],
                stdin=subprocess.DEVNULL,
                start_new_session=True,
                env=os.environ | {"PYTHONUNBUFFERED": "1", "PYTHONPATH": os.pathsep.join(filter(None, sys.path))},
            )
        self._link = ours
        ours.settimeout(READY_S)
        if ours.recv(MESSAGE_BYTES) != b"ready":
            raise ChildProcessError("the process to be copied ended before it was ready")

    def begin(self, module: str, *arguments: str, environment: Mapping[str, str]) -> Copy:
        """A copy that runs this module as `python -m ztpm.base.parent_watch` would."""
        theirs, ours = list[int](), list[int]()
        for theirs_reads in (True, False, False, False):  # its input, output, errors; the copied one's word of its end
            ends = os.pipe()
            theirs.append(ends[not theirs_reads])
            ours.append(ends[theirs_reads])
        try:
            said = {"arguments": [module, *arguments], "environment": {**os.environ, **environment}}
            socket.send_fds(self._link, [json.dumps(said).encode()], theirs)
            pid = int(self._link.recv(MESSAGE_BYTES))
        finally:
            for each in theirs:
                os.close(each)
        return Copy(pid, ours)

    def end(self) -> None:
        """Ends it, and all its copies with it."""
        self._link.close()
        self._original.wait(READY_S)


@cache
def original() -> Original:
    """The process that is copied, of this program; begun by the first use."""
    started = Original()
    atexit.register(started.end)
    return started


def begin(name: str, module: str, *arguments: str, environment: Mapping[str, str], **rest: Any) -> Child:
    """A child of a cell, as `Child.begin` begins one from nothing."""
    return Child(name, original().begin(module, *arguments, environment=environment), **rest)  # type: ignore[arg-type]


def _run(link: socket.socket, said: Mapping[str, Any], given: Sequence[int]) -> None:
    """Whole life of a copy."""
    link.close()
    os.setsid()
    for number, each in enumerate(given[:3]):
        os.dup2(each, number)
    for each in given:
        os.close(each)
    signal.signal(signal.SIGINT, signal.default_int_handler)
    os.environ.clear()
    os.environ.update(said["environment"])
    from ztpm.base import parent_watch

    sys.argv[:] = ["parent_watch", str(os.getppid()), *said["arguments"]]
    parent_watch.main()


def main() -> None:
    """Process that is copied: each message begins a copy, the end of the connection is its own."""
    from pep.pit.assessment.readiness import compile_all

    link = socket.socket(fileno=int(sys.argv[1]))
    for module in MODULES:
        importlib.import_module(module)
    compile_all()
    gc.collect()
    gc.freeze()
    link.send(b"ready")
    copies: dict[int, int] = {}  # where to say how each ended, by its pid
    while True:
        if select.select([link], [], [], POLL_S)[0]:
            text, given, _, _ = socket.recv_fds(link, MESSAGE_BYTES, 4)
            if not text:
                return None
            pid = os.fork()
            if pid == 0:
                for each in copies.values():
                    os.close(each)
                return _run(link, json.loads(text), given)
            for each in given[:3]:
                os.close(each)
            copies[pid] = given[3]
            link.send(str(pid).encode())
        for pid in [*copies]:
            ended, status = os.waitpid(pid, os.WNOHANG)
            if ended:
                where = copies.pop(pid)
                os.write(where, str(os.waitstatus_to_exitcode(status)).encode())
                os.close(where)


if __name__ == "__main__":
    main()
