"""What a run found: rows, and how they stand to sampling and to the controller's cycle."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final

from rich.table import Table

from evaluation.pit.cells import ASSESS, CHECKER, KERNEL, NUMPY_ASSESS, RULER, STREAM
from evaluation.pit.sampled import NAME as SAMPLED

if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

    from evaluation.harness.timing import Plan

CYCLE_US: Final = 2_000.0
"""One cycle of the controller at 500 Hz."""
AMONG_20: Final = "moveJ, 20 things"
SPEED_STEP: Final = "stream of joint speeds, 20 things, 2 people"
SERVO_STEP: Final = "stream of joint angles, 20 things, 2 people"


def peopled(form: str, things: int) -> str:
    """The name of a workload with two people."""
    return f"{form}, {things} things, 2 people"


TARGETS: Final[Mapping[tuple[str, str], tuple[float, float]]] = MappingProxyType(
    {
        **{(ASSESS, peopled("moveJ", n)): (200.0, 1_000.0) for n in (5, 20, 100)},
        (ASSESS, peopled("moveL", 5)): (1_000.0, 4_000.0),
        (ASSESS, peopled("moveL", 20)): (1_000.0, 4_000.0),
        (ASSESS, peopled("moveL", 100)): (4_000.0, 15_000.0),
        (ASSESS, peopled("20 moves", 20)): (5_000.0, 20_000.0),
        (NUMPY_ASSESS, peopled("moveJ", 20)): (5_000.0, 10_000.0),
        (NUMPY_ASSESS, peopled("moveJ", 100)): (20_000.0, 80_000.0),
        (STREAM, SPEED_STEP): (20.0, 100.0),
        (STREAM, SERVO_STEP): (20.0, 100.0),
        (CHECKER, peopled("moveJ", 20)): (20_000.0, 100_000.0),
    }
)
"""What we want of the median and of the 99th percentile, microseconds, by who answers and of what."""
SPEEDUPS: Final[Mapping[str, tuple[str, float]]] = MappingProxyType(
    {"kernel_speedup_20": (KERNEL, 100.0), "assess_speedup_20": (ASSESS, 10.0)}
)
"""Who is to be so many times faster than sampling."""


@dataclass(frozen=True, slots=True)
class Row:
    """One workload at one answerer, or why there are no figures.

    Attributes:
        peer, load: what it is of; the workload is None for a peer that is not installed.
        p50_us, min_us, p99_us: median over all calls, smallest median of a pass, 99th percentile.
        first_us: median over the calls that began a turn: somebody else was asked just before.
        cycles_p50, cycles_p99: the same in cycles of 2 ms.
        target_p50, target_p99: what we want of these, in cycles, or None.
        n: calls.
        checks: what an answer says.
        why: why there are no figures, or empty.
    """

    peer: str
    load: str | None
    p50_us: float | None = None
    first_us: float | None = None
    min_us: float | None = None
    p99_us: float | None = None
    cycles_p50: float | None = None
    cycles_p99: float | None = None
    target_p50: float | None = None
    target_p99: float | None = None
    n: int = 0
    checks: str = ""
    why: str = ""

    @property
    def met(self) -> str:
        """Whether what is wanted is had; empty where nothing is."""
        if None in (self.target_p50, self.target_p99, self.cycles_p50, self.cycles_p99):
            return ""
        wanted = ((self.cycles_p50, self.target_p50), (self.cycles_p99, self.target_p99))
        return "met" if all(is_ <= want for is_, want in wanted if is_ is not None and want is not None) else "missed"


def row(peer: str, load: str, checks: str, figures: Mapping[str, float], n: int) -> Row:
    """The row of a series."""
    p50, p99 = figures["p50_us"], figures["p99_us"]
    target = TARGETS.get((peer, load), (None, None))
    return Row(
        peer,
        load,
        p50_us=round(p50, 1),
        first_us=round(figures["first_us"], 1),
        min_us=round(figures["min_us"], 1),
        p99_us=round(p99, 1),
        cycles_p50=round(p50 / CYCLE_US, 4),
        cycles_p99=round(p99 / CYCLE_US, 4),
        target_p50=None if target[0] is None else target[0] / CYCLE_US,
        target_p99=None if target[1] is None else target[1] / CYCLE_US,
        n=n,
        checks=checks,
    )


@dataclass(frozen=True, slots=True)
class Result:
    """A whole run.

    Attributes:
        rows: of every answerer and workload.
        versions: of the engines.
        machine, plan, seconds: where, how often, how long.
    """

    rows: tuple[Row, ...]
    versions: Mapping[str, str]
    machine: Mapping[str, Any]
    plan: Plan
    seconds: float

    def to_json(self) -> dict[str, Any]:
        """Everything, as one JSON object."""
        return {
            "ok": True,
            "ratios": ratios(self.rows),
            "bars": {name: bar for name, (_, bar) in SPEEDUPS.items()},
            "rows": [asdict(each) | {"met": each.met} for each in self.rows],
            "versions": dict(self.versions),
            "machine": dict(self.machine),
            "plan": asdict(self.plan),
            "seconds": round(self.seconds, 1),
        }


def ratios(rows: tuple[Row, ...]) -> dict[str, float | None]:
    """How many times faster than sampling, and shares of the controller's cycle; None for what was not measured.

    `_first`: of the calls before which somebody else was asked, who left the processor's caches as theirs.
    """
    by = {(each.peer, each.load): each for each in rows if each.p50_us is not None}
    sampling = by.get((SAMPLED, AMONG_20))

    def faster(peer: str, figure: str = "p50_us") -> float | None:
        ours = by.get((peer, AMONG_20))
        if ours is None or sampling is None:
            return None
        return round(float(getattr(sampling, figure) / getattr(ours, figure)), 2)

    found = {name: faster(peer) for name, (peer, _) in SPEEDUPS.items()}
    found |= {f"{name}_first": faster(peer, "first_us") for name, (peer, _) in SPEEDUPS.items()}
    found["clearance_speedup_20"] = faster(RULER)
    steps = [by[STREAM, load] for load in (SPEED_STEP, SERVO_STEP) if (STREAM, load) in by]
    for name in ("p50", "p99"):
        shares = [getattr(each, f"cycles_{name}") for each in steps]
        found[f"stream_cycle_{name}"] = max(shares, default=None)
    return found


def ratios_line(found: Mapping[str, float | None]) -> str:
    """The ratios in one line."""
    said = ", ".join(f"{name} {'-' if value is None else f'{value:.2f}'}" for name, value in found.items())
    return f"times faster than sampling, and shares of a cycle of 2 ms: {said}"


def tables(result: Result) -> Iterator[Table]:
    """Durations, and what each answer says."""
    durations = Table(title="milliseconds, and cycles of 2 ms", title_justify="left", box=None, pad_edge=False)
    for heading in ("of what", "by"):
        durations.add_column(heading)
    for heading in ("p50 ms", "first ms", "p99 ms", "cycles p50", "wanted", "cycles p99", "wanted"):
        durations.add_column(heading, justify="right")
    durations.add_column("")
    measured = [each for each in result.rows if each.load is not None]
    for each in measured:
        assert each.p50_us is not None
        assert each.first_us is not None
        assert each.p99_us is not None
        durations.add_row(
            each.load,
            each.peer,
            f"{each.p50_us / 1_000:.3f}",
            f"{each.first_us / 1_000:.3f}",
            f"{each.p99_us / 1_000:.3f}",
            f"{each.cycles_p50:.3f}",
            "" if each.target_p50 is None else f"{each.target_p50:.3f}",
            f"{each.cycles_p99:.3f}",
            "" if each.target_p99 is None else f"{each.target_p99:.3f}",
            each.met,
        )
    says = Table(title="what an answer says", title_justify="left", box=None, pad_edge=False)
    says.add_column("by")
    says.add_column("says", overflow="fold")
    for peer, checks in {each.peer: each.checks for each in measured}.items():
        says.add_row(peer, checks)
    yield durations
    yield says
