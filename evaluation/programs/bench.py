"""Bench of the programs: a cell of their own, in which each runs as a person would run it."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
import time
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING, Final

from capabilities.statements import cell as cell_statement
from capabilities.statements.observation import Box
from capabilities.values.scope import Scope, Tier
from capabilities.values.units import Unit, si
from evaluation.programs.catalog import CatalogError, cell_text, scope_of
from evaluation.programs.verdict import Ended
from ztpm.base.layout import SURVEYOR, read_key, write_private
from ztpm.cell.cell import PASSPHRASE_VARIABLE
from ztpm.cell.setup import sensor_keys
from ztpm.cell.survey import DAYS, draft
from ztpm.program.program_lease import PLACE
from ztpm.stage.approving import approving
from ztpm.stage.lending import sweep_scope
from ztpm.stage.live import stage

if TYPE_CHECKING:
    from collections.abc import Iterator

    from evaluation.programs.catalog import ProgramRow
    from ztpm.base.layout import Layout
    from ztpm.stage.stage import Stage

SPONSOR, APPROVER, EYES = "alice", "bob", "orchestrator"
"""People who lend and answer, and the agent by which the bench reads the state."""
TABLE: Final = "table"
"""Name of the one thing that the simulated arm can press on."""
LIFETIME_S: Final = 900
PATIENCE_S: Final = 20
"""So long the cell waits for a person."""
LONGEST_S: Final = 90.0
"""Longest run of a program: the longest of ours takes a third of it."""
ENDS_S: Final = 5.0
"""Time to end for one that is told to."""


@dataclass(frozen=True, slots=True)
class ProgramRun:
    """Run of one program.

    Attributes:
        ended: its end.
        asked: questions that a person answered meanwhile.
        seconds: how long it took.
    """

    ended: Ended
    asked: int
    seconds: float


@dataclass
class ProgramBench:
    """Running cell, and a folder for what programs write.

    Attributes:
        stage: its people and agents.
        folder: for files.
    """

    stage: Stage
    folder: Path
    _begun: int = field(default=0, init=False)

    def run(self, row: ProgramRow) -> ProgramRun:
        """Runs the program with an agent and a token of its own, as it is but for the address.

        Args:
            row: the program; its cell is this one.
        """
        self.stage.place(row.start_rad)
        self.stage.scene(people=list(row.people), objects=list(row.objects))
        self._begun += 1
        agent = f"{row.name}-{self._begun}"
        token = self._token(agent, row)
        own = ["--token", str(token), "--data", str(self.stage.cell.layout.root), "--"]
        command = [sys.executable, "-m", "ztpm", "rtde", "run", agent, *own, sys.executable, str(row.path), PLACE]
        began = time.monotonic()
        with approving(self.stage.person(APPROVER)) as answered:
            ended = self._ended(command)
        return ProgramRun(ended, len(answered), time.monotonic() - began)

    def _token(self, agent: str, row: ProgramRow) -> Path:
        """File of a token for that program's scope."""
        holder = self.stage.new_agent(agent, sponsor=SPONSOR, role="program")
        holder.attest()
        stated, now = scope_of(row), int(time.time())
        scope = Scope(
            grants=stated.grants or (),
            ceiling=Tier.HIGH_CONSEQUENCE if stated.ceiling is None else stated.ceiling,
            audiences=frozenset({self.stage.cell.addresses.audience}),
            delegates=frozenset(),
            depth=0,
            not_before=now - 1,
            not_after=now + LIFETIME_S,
        )
        file = self.folder / f"{agent}.token"
        issued = self.stage.person(SPONSOR).issue(holder, scope, purpose=row.does)
        write_private(file, issued.token.encode())
        return file

    def _ended(self, command: list[str]) -> Ended:
        secret = {PASSPHRASE_VARIABLE: self.stage.cell.passphrase.decode()}
        with subprocess.Popen(  # noqa: S603 - our own
            command,
            cwd=self.folder,
            env=os.environ | secret,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.PIPE,
            text=True,
        ) as running:
            try:
                _, errors = running.communicate(timeout=LONGEST_S)
            except subprocess.TimeoutExpired:
                running.terminate()  # it passes that on
                try:
                    _, errors = running.communicate(timeout=ENDS_S)
                except subprocess.TimeoutExpired:
                    running.kill()
                    _, errors = running.communicate()
                return Ended(None, errors)
        return Ended(running.returncode, errors)


@contextmanager
def bench(cell: str) -> Iterator[ProgramBench]:
    """Bench on a fresh cell that stands as that draft says, removed afterwards.

    Args:
        cell: name of a file of `cells`.

    Raises:
        CatalogError: the draft is none.
        ztpm.base.processes.ChildError: a process does not become ready.
    """

    def surveyed(layout: Layout, passphrase: bytes) -> None:
        signed = _signed(cell, layout, passphrase)
        layout.cell_file.unlink()
        write_private(layout.cell_file, signed)

    with (
        tempfile.TemporaryDirectory(prefix="ztpm-programs-") as folder,
        stage(prepare=surveyed, defer_timeout_s=PATIENCE_S) as on_stage,
    ):
        eyes = on_stage.new_agent(EYES, sponsor=SPONSOR, role="planner")
        eyes.attest()
        audience, now = on_stage.cell.addresses.audience, int(time.time())
        scope = sweep_scope(audience, delegates=frozenset(), now=now, lifetime_s=LIFETIME_S)
        issued = on_stage.person(SPONSOR).issue(eyes, replace(scope, ceiling=Tier.NO_EFFECT), purpose="reads the state")
        on_stage.tokens[EYES] = issued.token
        on_stage.cell.robot.tell({"fault": "surface", "z_m": table_top_m(_stands(cell, on_stage.cell.layout))})
        yield ProgramBench(on_stage, Path(folder))


def table_top_m(stands: cell_statement.Cell) -> float:
    """Height of the top of that cell's table, on which the simulated tool can press, m.

    Raises:
        CatalogError: no box of it is called so.
    """
    for thing in stands.objects:
        if thing.name == TABLE and isinstance(thing.shape, Box):
            return si(thing.shape.center_um[2] + thing.shape.half_um[2], Unit.MICROMETRE)
    raise CatalogError(f"cells/{stands.name}.toml: no box that is the {TABLE}")


def _signed(name: str, layout: Layout, passphrase: bytes) -> bytes:
    """Cell file of that draft, signed by the cell's surveyor."""
    key = read_key(layout.operator_key(SURVEYOR), passphrase)
    return cell_statement.sign(_stands(name, layout), key).encode() + b"\n"


def _stands(name: str, layout: Layout) -> cell_statement.Cell:
    """Cell of that draft, with the author, audience and sensors of this one."""
    from ztpm.cell.setup import read_addresses

    quoted = ", ".join(f'"{sensor}"' for sensor in sensor_keys(layout))
    whose = f'author = "{SURVEYOR}"\naudience = "{read_addresses(layout).audience}"\nsensors = [{quoted}]\n'
    try:
        return draft(whose + cell_text(name), at=int(time.time()), days=DAYS)
    except (OSError, ValueError) as error:
        raise CatalogError(f"cells/{name}.toml: {error}") from error
