"""Telling of the story on a terminal: a row for each finished step, then the figures of all."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, Final

from rich.padding import Padding
from rich.table import Table
from rich.text import Text

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rich.console import Console

    from ztpm.demo.run import StepReport, Story

WIDE: Final = 110
"""Columns from which on the sentence of a step stands beside its figures, and not below them."""
STANDS_RAD: Final = 0.005
"""Less than this is shown as standing still."""
COLOURS: Final = {"PERMIT": "green", "DENY": "red", "DEFER": "yellow", "DONE": "blue"}
FIGURES: Final = {"": 1, "step": 22, "decision": 8, "tier": 4, "rad": 5, "ms": 5}
"""Columns of figures, and their widths."""
RIGHT: Final = frozenset({"tier", "rad", "ms"})
NEXT: Final = (
    ("ztpm up", "the same cell, kept running, with a status page (docs/cell.md)"),
    ("ztpm explain REPLAYED", "why that happened and what helps, for any code above"),
    ("ztpm eval stops", "many stops, each compared with the stop model"),
    ("ztpm rtde run --help", "your own ur_rtde program under a lease (docs/programs.md)"),
)
"""Commands to try after the story, and what each shows."""


@dataclass(frozen=True, slots=True)
class Figures:
    """Figures of all steps of a story.

    Attributes:
        steps, as_told: number of all, and of those that were as told.
        seconds: from the start of the command to its last step.
        attacks, refused: attacks, and those refused as told.
        refusal_ms_median: from a request to its refusal.
        stops: stops whose cause had an instant.
        stop_ms_slowest: longest time from the cause to standstill.
        motions: steps in which the arm moved.
        unrecorded: those of them without a PERMIT on the PEP's record.
    """

    steps: int
    as_told: int
    seconds: float
    attacks: int
    refused: int
    refusal_ms_median: float | None
    stops: int
    stop_ms_slowest: float | None
    motions: int
    unrecorded: int

    @property
    def ok(self) -> bool:
        """True where every step was as told."""
        return self.as_told == self.steps


def figures(told: Sequence[StepReport], seconds: float, *, moved_rad: float) -> Figures:
    """Figures of the steps that were played.

    Args:
        told: the steps.
        seconds: they took, start included.
        moved_rad: less than this is standing still.
    """
    refusals = sorted(step.latency_ms for step in told if step.decision == "DENY" and step.latency_ms)
    stops = [step.stop_ms for step in told if step.stop_ms is not None]
    moved = [step for step in told if step.moved_rad > moved_rad]
    return Figures(
        steps=len(told),
        as_told=sum(step.ok for step in told),
        seconds=round(seconds, 1),
        attacks=sum(step.attack for step in told),
        refused=sum(step.attack and step.ok for step in told),
        refusal_ms_median=round(refusals[len(refusals) // 2], 1) if refusals else None,
        stops=len(stops),
        stop_ms_slowest=round(max(stops), 1) if stops else None,
        motions=len(moved),
        unrecorded=sum(not (step.recorded and step.decision == "PERMIT") for step in moved),
    )


def as_json(step: StepReport) -> dict[str, object]:
    """The step for machines."""
    stop_ms = None if step.stop_ms is None else round(step.stop_ms, 1)
    rounded = {"latency_ms": round(step.latency_ms, 1), "moved_rad": round(step.moved_rad, 4), "stop_ms": stop_ms}
    return {**asdict(step), **rounded}


class Telling:
    """Prints each finished row once.

    Args:
        console: of the reader.
        chapters: of the story; each is announced with its first step.
    """

    def __init__(self, console: Console, chapters: Sequence[Story]) -> None:
        self._console = console
        self._wide = console.width >= WIDE
        self._begin = {chapter.steps[0].id: (number, chapter) for number, chapter in enumerate(chapters, 1)}

    def announce(self, step: str) -> None:
        """Prints the chapter's heading where the step begins one."""
        if step not in self._begin:
            return
        number, chapter = self._begin[step]
        self._console.print()
        self._console.print(Text(f"{number}  {chapter.title[0].upper()}{chapter.title[1:]}", style="bold"))
        if number == 1:
            self._row(
                [Text(name, style="dim") for name in FIGURES],
                Text("what was seen" if self._wide else "and what was seen", style="dim"),
            )

    def tell(self, step: StepReport) -> None:
        """Prints the row of a step that is over."""
        mark = Text("✓", style="green") if step.ok else Text("✗", style="bold red")
        cells = [
            mark,
            Text(step.id, style="" if step.ok else "bold red"),
            Text(step.decision, style=COLOURS.get(step.decision, "")),
            Text("" if step.tier is None else str(step.tier)),
            Text(f"{step.moved_rad:.2f}" if step.moved_rad >= STANDS_RAD else "still"),
            Text(f"{step.latency_ms:.0f}"),
        ]
        self._row(cells, Text.assemble(step.told, (f" ({step.reason})", "dim")))

    def end(self, sums: Figures) -> None:
        """Prints the figures of all steps, and commands to try next."""
        print_ = self._console.print
        print_()
        style = "bold green" if sums.ok else "bold red"
        print_(Text(f"{sums.as_told} of {sums.steps} steps as told, in {sums.seconds:.0f} s", style=style))
        kept = "nothing moved without a record" if not sums.unrecorded else f"{sums.unrecorded} without a record"
        attacks = f"{sums.refused}" if sums.refused == sums.attacks else f"{sums.refused} of {sums.attacks}"
        self._pairs(
            (f"{attacks} attacks refused", _ms("median", sums.refusal_ms_median)),
            (f"{sums.stops} stops", _ms("slowest, from its cause to standstill:", sums.stop_ms_slowest)),
            (f"{sums.motions} motions", kept),
        )
        print_()
        print_(Text("Next", style="bold"))
        self._pairs(*NEXT)

    def _row(self, cells: Sequence[Text], said: Text) -> None:
        grid = Table.grid(padding=(0, 2, 0, 0), expand=self._wide)
        for name, width in FIGURES.items():
            grid.add_column(width=width, no_wrap=True, justify="right" if name in RIGHT else "left")
        if self._wide:
            grid.add_column(ratio=1, overflow="fold")
            grid.add_row(*cells, said)
            self._console.print(grid, soft_wrap=False)
            return
        grid.add_row(*cells)
        self._console.print(grid, Padding(said, (0, 0, 0, 3)), sep="", soft_wrap=False)

    def _pairs(self, *pairs: tuple[str, str]) -> None:
        grid = Table.grid(padding=(0, 2, 0, 0))
        grid.add_column(no_wrap=True)
        grid.add_column(overflow="fold")
        for pair in pairs:
            grid.add_row(*map(Text, pair))
        self._console.print(Padding(grid, (0, 0, 0, 3)), soft_wrap=False)


def _ms(what: str, value: float | None) -> str:
    return "" if value is None else f"{what} {value:.0f} ms"
