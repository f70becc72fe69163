"""Processes of a cell that begin as copies of one that has imported and compiled all that they run.

A start from nothing is seen by the tests of `ztpm up` and of the demo. Others begin a dozen processes for what those do afterwards, and
need not wait for the same imports each time. A copy is a process of its own in all else: with a session, an environment, three pipes and
the watch over its parent, here the process that it is a copy of, which ends with the tests.
"""

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
from pathlib import Path

from ztpm.base.processes import Child

TOP = Path(__file__).parents[2]
MODULES = (
    "ursim.__main__", "ursim.sensor.sensor", "uvicorn", "ztpm.edge.server", "ztpm.point.gateway_server",
    "ztpm.point.provider_server", "ztpm.point.tool_proxy", "ztpm_idp.app",
)  # fmt: skip
"""Modules that the processes of a cell run, or load once they run."""
MESSAGE_BYTES = 1 << 16
READY_S = 600.0
POLL_S = 0.02


class Forked:
    """A copy as its starter sees it: as much of `subprocess.Popen` as `Child` asks for."""

    def __init__(self, pid, stdin, stdout, stderr, status):
        self.pid, self.returncode = pid, None
        self.stdin, self.stdout, self.stderr = (
            os.fdopen(stdin, "wb", 0),
            os.fdopen(stdout, "rb"),
            os.fdopen(stderr, "rb"),
        )
        self._status = os.fdopen(status, "rb", 0)

    def poll(self):
        return self._ended(0)

    def wait(self, timeout=None):
        if self._ended(timeout) is None:
            raise subprocess.TimeoutExpired(str(self.pid), timeout)
        return self.returncode

    def _ended(self, timeout):
        if self.returncode is None and select.select([self._status], [], [], timeout)[0]:
            self.returncode = int(self._status.read(16) or -signal.SIGKILL)
        return self.returncode

    def send_signal(self, number):
        if self.poll() is None:
            os.kill(self.pid, number)

    def terminate(self):
        self.send_signal(signal.SIGTERM)

    def kill(self):
        self.send_signal(signal.SIGKILL)


class Forks:
    """The process that is copied, ready."""

    def __init__(self):
        ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
        with theirs:
            self._process = subprocess.Popen(
                [sys.executable, "-m", "tests.e2e.forked", str(theirs.fileno())],
                pass_fds=[theirs.fileno()], stdin=subprocess.DEVNULL, start_new_session=True,
                env=os.environ | {"PYTHONUNBUFFERED": "1", "PYTHONPATH": os.pathsep.join([str(TOP), os.environ.get("PYTHONPATH", "")])},
            )  # fmt: skip
        self._link = ours
        ours.settimeout(READY_S)
        assert ours.recv(MESSAGE_BYTES) == b"ready"

    def begin(self, module, *arguments, environment):
        """A copy that runs this module as `python -m ztpm.base.parent_watch` would."""
        theirs, ours = [], []
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
        return Forked(pid, *ours)

    def end(self):
        self._link.close()
        self._process.wait(READY_S)


@cache
def forks():
    """The process that is copied, of these tests; begun by the first use."""
    started = Forks()
    atexit.register(started.end)
    return started


def begin(name, module, *arguments, environment):
    """A child of a cell, as `Child.begin` begins one from nothing."""
    return Child(name, forks().begin(module, *arguments, environment=environment))


def run(link, said, given):
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


def main():
    """Process that is copied: each message begins a copy, the end of the connection is its own."""
    from pep.pit.assessment.readiness import compile_all

    link = socket.socket(fileno=int(sys.argv[1]))
    for module in MODULES:
        importlib.import_module(module)
    compile_all()
    gc.collect()
    gc.freeze()
    link.send(b"ready")
    copies = {}  # where to say how each ended, by its pid
    while True:
        if select.select([link], [], [], POLL_S)[0]:
            text, given, _, _ = socket.recv_fds(link, MESSAGE_BYTES, 4)
            if not text:
                return
            pid = os.fork()
            if pid == 0:
                for each in copies.values():
                    os.close(each)
                return run(link, json.loads(text), given)
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
