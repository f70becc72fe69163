"""Results of a run of the programs: an outcome each, and how many there are of each kind."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Any

from evaluation.harness.tables import table
from evaluation.programs.verdict import ProgramOutcome

if TYPE_CHECKING:
    from rich.table import Table


@dataclass(frozen=True, slots=True)
class ProgramResult:
    """Result of one program.

    Attributes:
        name: of it.
        outcome: of it.
        why: one line: what was refused or what went wrong; empty for one that ran.
        asked: questions that a person answered meanwhile.
        tries: runs until the verdict.
        seconds: how long the last one took.
    """

    name: str
    outcome: ProgramOutcome
    why: str
    asked: int
    tries: int
    seconds: float


@dataclass(frozen=True, slots=True)
class ProgramsResult:
    """Result of a run.

    Attributes:
        programs: in order.
        seconds: how long all of it took.
        machine: that of the run.
    """

    programs: tuple[ProgramResult, ...]
    seconds: float
    machine: dict[str, Any]

    def count(self, outcome: ProgramOutcome) -> int:
        """Number of programs with that outcome."""
        return sum(one.outcome is outcome for one in self.programs)

    @property
    def asked(self) -> int:
        """Questions that people answered in all."""
        return sum(one.asked for one in self.programs)

    @property
    def ok(self) -> bool:
        """True where none failed."""
        return self.count(ProgramOutcome.FAILED) == 0

    def to_json(self) -> dict[str, Any]:
        """Plain JSON of the result."""
        return {
            **{str(outcome): self.count(outcome) for outcome in ProgramOutcome},
            "asked": self.asked,
            "programs": [asdict(one) | {"seconds": round(one.seconds, 1)} for one in self.programs],
            "seconds": round(self.seconds, 1),
            "machine": self.machine,
        }


def tables(result: ProgramsResult) -> list[Table]:
    """Table of the programs, for people."""
    rows = ((one.name, str(one.outcome), str(one.asked), f"{one.seconds:.0f}", one.why) for one in result.programs)
    return [table("Programs under `ztpm rtde run`", ("program", "outcome", "asked", "s", "why"), (), rows)]


def last_line(result: ProgramsResult) -> str:
    """The figures."""
    counts = ", ".join(f"{result.count(outcome)} {outcome}" for outcome in ProgramOutcome)
    return f"{len(result.programs)} programs: {counts}; {result.asked} questions answered"
