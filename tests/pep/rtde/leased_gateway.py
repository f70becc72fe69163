"""Gateway in a process of its own, with a judge whose answers are told.

`python -m tests.pep.rtde.leased_gateway LISTEN ROBOT FILE` prints `ready`; each line on its standard input is the judge's
next manner. FILE gets one line for each word of the judge: what it was asked, what it answered, and what was withdrawn.
"""

import asyncio
import contextlib
import random
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace

from pep.base.thread_priority import goes_first
from pep.rtde.lease.lease import LeaseEnding
from pep.rtde.line.gateway import Gateway
from policies.words.reason_table import Reason
from tests.pep.rtde.packages import Ports
from tests.pep.rtde.whole_commands import WholeCommands

LATER_S = 1.0
REPOSITORY = Path(__file__).parents[3]


class Judge:
    """Judge with a manner that is told to it.

    `permit`, `refuse`, `defer:S` (then permits, S seconds later; `LATER_S` without), `silent`, `stop` (permits, then
    stops), `steps:N` (N values of a stream pass), `zeros`, `break` (raises).
    """

    def __init__(self, out):
        self.manner, self.out = "permit", out

    def note(self, word, command):
        self.out.write(f"{word} {command!r}\n")

    def judge(self, held):
        self.note("asked", held.command)
        manner, _, number = self.manner.partition(":")
        loop = asyncio.get_running_loop()
        if manner == "permit":
            held.forward(Count(self, 10**9))
        elif manner == "steps":
            held.forward(Count(self, int(number)))
        elif manner == "zeros" and not any(held.command.qd_rad_s):
            held.forward(Zeros(self))
        elif manner in ("refuse", "zeros"):
            held.deny(Reason.ABOVE_CEILING, "too high")
        elif manner == "defer":
            held.defer("somebody is asked")
            loop.call_later(
                float(number or LATER_S),
                lambda: self.note("sent" if held.forward(Count(self, 10**9)) else "late", held.command),
            )
        elif manner == "break":
            raise ValueError
        elif manner == "stop":
            held.forward(Count(self, 10**9))
            loop.call_later(LATER_S, held.stop, Reason.IMPACT_ROSE, "somebody came near")

    def withdrawn(self, held):
        self.note("withdrawn", held.command)
        if self.manner == "break":
            raise ValueError

    def refused(self, holder, refused, what):
        self.note(f"refused {refused.reason}", what)


class Zeros(WholeCommands):
    """Values that move nothing pass."""

    def __init__(self, judge):
        self.judge = judge

    def judged(self, command):
        return Reason.IMPACT_ROSE if any(command.qd_rad_s) else None

    def ended(self):
        self.judge.note("ended", None)


class Count(WholeCommands):
    """The first so many values pass."""

    def __init__(self, judge, most):
        self.judge, self.left = judge, most

    def judged(self, command):
        self.left -= 1
        return None if self.left >= 0 else Reason.IMPACT_ROSE

    def ended(self):
        self.judge.note("ended", None)


class Anybody:
    """Owner of a lease, whose token grants nothing."""

    credentials = SimpleNamespace(chain=None)


class Holding:
    """Everybody who comes has the same lease."""

    def __init__(self, ports):
        self.ports, self.lease = ports, Anybody()

    async def open(self, lease, port, back):
        return await self.ports.open(self.lease, port, back)

    def closed(self, lease):
        self.lease = Anybody()


async def serve(listen, robot, file, judged=Judge):
    judge = judged(Path(file).open("a", buffering=1))
    ports = Ports(robot, judge, closed=lambda lease, _: holding.closed(lease))
    holding = Holding(ports)
    gateway = Gateway(holding)
    await ports.begin()
    await gateway.listen(listen)
    lines = asyncio.StreamReader()
    loop = asyncio.get_running_loop()
    await loop.connect_read_pipe(lambda: asyncio.StreamReaderProtocol(lines), sys.stdin)
    goes_first()  # as the real one
    print("ready", flush=True)
    while line := (await lines.readline()).decode().strip():
        if line == "over":
            ports.over(holding.lease, LeaseEnding.AUTHORITY)
            holding.closed(None)
        else:
            judge.manner = line
        print("done", flush=True)
    gateway.close()
    ports.close()


@dataclass
class Running:
    """A gateway.

    Attributes:
        host: where programs connect.
        file: what its judge said.
        process: of it.
    """

    host: str
    file: Path
    process: subprocess.Popen

    def tell(self, line):
        """The judge answers so from now on; `over` ends the lease."""
        self.process.stdin.write(line + "\n")
        self.process.stdin.flush()
        assert self.process.stdout.readline() == "done\n"

    def heard(self):
        """Words of the judge so far."""
        return self.file.read_text().splitlines()


@contextlib.contextmanager
def leased_gateway(robot, file, module="tests.pep.rtde.leased_gateway", errors=None):
    """Gateway in front of `robot`, on a loopback address of its own, for any client."""
    host = f"127.{random.randint(1, 254)}.{random.randint(0, 254)}.{random.randint(1, 254)}"
    Path(file).touch()
    command = [sys.executable, "-m", module, host, robot, str(file)]
    with subprocess.Popen(
        command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=errors, text=True, cwd=REPOSITORY
    ) as process:
        try:
            assert process.stdout.readline() == "ready\n"
            yield Running(host, Path(file), process)
        finally:
            process.stdin.close()
            try:
                process.wait(10)
            except subprocess.TimeoutExpired:
                process.kill()


if __name__ == "__main__":
    asyncio.run(serve(*sys.argv[1:]))
