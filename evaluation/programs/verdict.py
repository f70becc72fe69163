"""Verdict on a program that has ended: it ran, it was refused clearly, or it failed."""

from __future__ import annotations

import re
from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from evaluation.programs.catalog import ProgramRow

TOLD: Final = re.compile(r"^ztpm: ([A-Z][A-Z0-9_]*): (.*)$", re.MULTILINE)
"""Line by which `ztpm rtde run` tells why the gateway has refused something."""
OTHERS: Final = re.compile(r"^(ztpm: |RTDE\w+Interface|RTDE\w+: )")
"""Line of `ztpm rtde run` or of ur_rtde itself."""
LAST: Final = 200
"""Most characters of what a program said last."""


class ProgramOutcome(StrEnum):
    """ProgramOutcome of a program."""

    RAN = "ran"
    """It came to its end, and says that it did what it should."""
    REFUSED_CLEARLY = "refused_clearly"
    """It met the refusal of a call that nobody is granted, in one sentence, and ended by itself."""
    FAILED = "failed"


@dataclass(frozen=True, slots=True)
class Ended:
    """End of a program under `ztpm rtde run`.

    Attributes:
        status: exit status; None for one that did not end by itself in time.
        errors: all that was written on standard error.
    """

    status: int | None
    errors: str

    @property
    def told(self) -> list[tuple[str, str]]:
        """Reasons that the gateway told, each with its sentence, in order."""
        return TOLD.findall(self.errors)

    @property
    def last(self) -> str:
        """Last line that the program itself wrote."""
        own = [line for line in self.errors.splitlines() if line.strip() and not OTHERS.match(line)]
        return own[-1] if own else ""


@dataclass(frozen=True, slots=True)
class ProgramVerdict:
    """Verdict on one program.

    Attributes:
        outcome: of it.
        why: one line: what was refused or what went wrong; empty for one that ran.
    """

    outcome: ProgramOutcome
    why: str = ""


def judged(row: ProgramRow, ended: Ended) -> ProgramVerdict:
    """Verdict on the end of that program.

    Args:
        row: the program.
        ended: its end.
    """
    told = ended.told
    first = f"{told[0][0]}: {told[0][1]}" if told else ""
    if ended.status is None:
        return ProgramVerdict(ProgramOutcome.FAILED, f"it did not end; {first or 'nothing was refused'}")
    if row.refused is None:
        if ended.status == 0:
            return ProgramVerdict(ProgramOutcome.RAN)
        return ProgramVerdict(ProgramOutcome.FAILED, f"status {ended.status}; {first or ended.last[:LAST]}")
    if ended.status == 0:
        return ProgramVerdict(
            ProgramOutcome.FAILED, f"{row.refused.call} is never granted, and the program ended with 0"
        )
    if ended.status > KILLED:
        return ProgramVerdict(ProgramOutcome.FAILED, f"ended by signal {ended.status - KILLED}; {first}")
    if not told or told[0][0] != row.refused.reason or row.refused.call not in told[0][1]:
        return ProgramVerdict(
            ProgramOutcome.FAILED, f"{row.refused.call} was to be refused with its name; {first or 'nothing was'}"
        )
    return ProgramVerdict(ProgramOutcome.REFUSED_CLEARLY, first)


KILLED: Final = 128
"""Offset that a shell adds to the number of the signal that ended a program."""
