"""Gateway in a process of its own, before a controller, with all that decides behind it (`robot_cell`).

`python judged_gateway.py LISTEN ROBOT FOLDER` prints `ready`. Any client has the lease; each line on standard input
names operations that its token lacks from then on, or none; or it is `remember` or `forget`, after which earlier acts
of the arm count, or do not. The journal is FOLDER/journal.ndjson.
"""

import asyncio
import contextlib
import json
import random
import secrets
import subprocess
import sys
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace

import pep.gate.gate
import pep.world.cell_stream
from pep.base.thread_priority import goes_first
from pep.pit.assessment.readiness import compile_all
from pep.rtde.line.gateway import Gateway
from pep.rtde.line.lease_stop import StopMeans
from pep.world.sequence import Sequence
from tests.pep.rtde.packages import Ports
from tests.pep.kit import Still
from tests.pep.rtde.leased import leased_scope
from tests.pep.rtde.robot_cell import RobotCell

SEQUENCES = {"remember": Sequence, "forget": Still}


class Desk:
    """Everybody who comes has the same lease, with the token of the moment; and its judge."""

    def __init__(self, cell, robot):
        self.cell, self.loop = cell, asyncio.get_running_loop()
        self.ports = Ports(robot, self, closed=self.closed)
        self.decides = cell.open(robot, state=self.ports.state, stopper=self, program=self.ports)
        self.judge, self.withdrawn, self.refused = self.decides.judge, self.decides.withdrawn, self.decides.refused
        self.lease = SimpleNamespace()
        self.without(())

    def without(self, operations):
        scope = leased_scope(self.cell.clock.wall_s(), without=operations)
        # A new agent each time: one that is refused so often would be held to its minimum, whatever its token says.
        agent = self.cell.agent(name=f"robotic-{secrets.token_hex(4)}", scope=scope)
        self.credentials = self.cell.credentials(agent)
        self.lease.credentials = self.credentials

    def closed(self, *_):
        self.lease = SimpleNamespace(credentials=self.credentials)

    async def open(self, lease, port, back):
        return await self.ports.open(self.lease, port, back)

    # the judge's stopper
    def stop(self, reason):
        self.loop.call_soon_threadsafe(self.ports.stop, StopMeans.PROGRAM)

    @property
    def stopped_ms(self):
        return self.ports.stopped_ms


async def serve(listen, robot, folder):
    pep.gate.gate.PHYSICS_TIMEOUT_S, pep.world.cell_stream.STEP_S = 60.0, 20.0  # a loaded host is slow
    compile_all()  # its code read in at the first question held up the arm's watch
    cell = RobotCell(Path(folder))
    desk = Desk(cell, robot)
    gateway = Gateway(desk)
    await desk.ports.begin()
    await gateway.listen(listen)
    lines, loop = asyncio.StreamReader(), asyncio.get_running_loop()
    await loop.connect_read_pipe(lambda: asyncio.StreamReaderProtocol(lines), sys.stdin)
    goes_first()  # as the real one
    print("ready", flush=True)
    while line := (await lines.readline()).decode():
        if line.strip() in SEQUENCES:
            cell.gate._robot = replace(cell.gate._robot, sequence=SEQUENCES[line.strip()](cell.clock))
        else:
            desk.without(tuple(line.split()))
        print("done", flush=True)
    gateway.close()
    await cell.close()


@dataclass
class Judged:
    """A gateway.

    Attributes:
        host: where programs connect.
        journal: what it has recorded.
        process: of it.
    """

    host: str
    journal: Path
    process: subprocess.Popen

    def without(self, *operations):
        """The lease's token grants everything else from now on."""
        self._tell(" ".join(operations))

    @contextlib.contextmanager
    def remembering(self):
        """Lets earlier acts of the arm count for later ones meanwhile."""
        self._tell("remember")
        try:
            yield
        finally:
            self._tell("forget")

    def _tell(self, line):
        self.process.stdin.write(line + "\n")
        self.process.stdin.flush()
        assert self.process.stdout.readline() == "done\n"

    def records(self):
        """All of them, as far as they are whole."""
        return [json.loads(line) for line in self.journal.read_text().splitlines(keepends=True) if line.endswith("\n")]


@contextlib.contextmanager
def judged_gateway(robot, folder):
    """A gateway in front of `robot`, on a loopback address of its own."""
    host = f"127.{random.randint(1, 254)}.{random.randint(0, 254)}.{random.randint(1, 254)}"
    command = [sys.executable, "-m", "tests.pep.rtde.judged_gateway", host, robot, str(folder)]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        try:
            assert process.stdout.readline() == "ready\n"
            yield Judged(host, Path(folder) / "journal.ndjson", process)
        finally:
            process.stdin.close()
            try:
                process.wait(20)
            except subprocess.TimeoutExpired:
                process.kill()


if __name__ == "__main__":
    asyncio.run(serve(*sys.argv[1:]))
