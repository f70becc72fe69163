"""The benchmark of decisions: every engine and case in one run."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final

from evaluation.decisions import cases, rules
from evaluation.decisions.casbin_abac import NAME as CASBIN
from evaluation.decisions.casbin_abac import Casbin
from evaluation.decisions.cedar import GROUPED, Cedar, GroupedCedar
from evaluation.decisions.cedar import NAME as CEDAR
from evaluation.decisions.ours import NAME as OURS
from evaluation.decisions.ours import RECORDED, OurDecisions, Recorded
from evaluation.decisions.readings import VERIFIED
from evaluation.decisions.rego import NAME as REGO
from evaluation.decisions.rego import Rego
from evaluation.harness import picture
from evaluation.harness.bench import Bench, LineUp, installed, ratio
from evaluation.harness.tables import figure, pivot, table
from evaluation.harness.timing import QUICK, Cell, Plan, Verdict, WrongAnswerError
from policies import load_shipped

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
    from pathlib import Path

    from rich.table import Table

    from evaluation.decisions.cases import Case
    from evaluation.decisions.engine import Engine, Said
    from evaluation.decisions.facts import Situation
    from evaluation.decisions.readings import Fact
    from evaluation.decisions.rules import Rule
    from evaluation.harness.bench import Result, Row
    from policies import PolicySet

FULL: Final = Plan(repeats=5, rounds=200, warm_up=20)
SHIPPED: Final = "paper-default"
OTHERS: Final[dict[str, Callable[[Sequence[Rule]], Engine]]] = {
    CEDAR: Cedar,
    GROUPED: GroupedCedar,
    CASBIN: Casbin,
    REGO: Rego,
}
"""Other engines by name; each needs its package only when it is called."""
RATIOS: Final[Mapping[str, tuple[str, str]]] = MappingProxyType(
    {
        "vs_cedarpy": (OURS, CEDAR),
        "vs_cedarpy_two_rules": (OURS, GROUPED),
        "vs_casbin": (OURS, CASBIN),
        "vs_regopy": (OURS, REGO),
        "recorded_vs_cedarpy": (RECORDED, CEDAR),
    }
)
"""Pairs of engines whose times are divided by each other."""
_COLOURS: Final = {OURS: picture.OURS, RECORDED: "#6fa8dc"}


@dataclass(frozen=True, slots=True)
class DecisionKey:
    """The key of a row.

    Attributes:
        peer, case: the engine and its case; None for an engine that is not installed.
        beside: the engine with which we took turns, in the very calls that the row is of.
    """

    peer: str
    case: str | None = None
    beside: str = ""


def line_up(
    plan: Plan,  # noqa: ARG001 - a case is asked as often as one likes
    *,
    seed: int,  # noqa: ARG001 - nothing is drawn
    told: Callable[[str], None],
    others: Mapping[str, Callable[[Sequence[Rule]], Engine]] = OTHERS,
) -> LineUp[DecisionKey]:
    """Cells of all engines, which agree; see `Bench.line_up`.

    Args:
        plan: how often.
        seed: of nothing here.
        told: receives the name of each step.
        others: the engines besides ourselves.

    Raises:
        WrongAnswerError: when two engines do not agree.
        NoPlainFormError: when the shipped set has a rule that the other engines cannot be given.
    """
    policies = load_shipped(SHIPPED)
    given = rules.compiled(policies, cases.POINTS)
    mine: list[Engine] = [OurDecisions(policies), Recorded(policies)]
    ready, unmeasured = installed({name: partial(make, given) for name, make in others.items()}, DecisionKey)
    told("asking every engine for every broken condition")
    engines = [*mine, *ready]
    agreed = agree(engines, policies)
    # We take turns with one other at a time: a slow engine empties the processor's caches for the next one.
    turns = [[*mine, other] for other in ready] or [mine]
    groups = [[_cell(engine, case, group[-1], policies) for engine in group] for case in cases.CASES for group in turns]
    versions = {engine.name: engine.version for engine in engines}
    return LineUp(groups, unmeasured, versions, more={"rules": len(given), "agreed": agreed})


def agree(engines: Iterable[Engine], policies: PolicySet) -> int:
    """Number of cases in which every engine has our answer, and blames our leading primitive.

    Raises:
        WrongAnswerError: in one it does not.
    """
    ours, *others = engines
    asked: list[tuple[str, Case, Mapping[str, Fact]]] = [(case.name, case, {}) for case in cases.CASES]
    asked += [(what, cases.PERMIT, changes) for what, changes in cases.BROKEN.items()]
    asked += [(f"stop: {what}", cases.STOP, cases.BROKEN[what]) for what in cases.BROKEN_STOP]
    for what, case, changes in asked:
        situation = case.situation(policies, changes)
        right = ours.read(ours.ask(ours.ready(situation)))
        for engine in others:
            said = engine.read(engine.ask(engine.ready(situation)))
            if said.effect is not right.effect or not _blames(said, right, situation):
                raise WrongAnswerError(f"{engine.name}, {what}: {said}, and ours {right}")
    return len(asked)


def _blames(said: Said, right: Said, situation: Situation) -> bool:
    """True where an engine blames our leading primitive, or where there is none to blame or it cannot say.

    A chain that is not verified fails every rule that needs one; only our engine knows which of them owns the fault.
    """
    if not right.blamed or said.blamed is None or situation.facts["chain"] != VERIFIED:
        return True
    return right.blamed[0] in said.blamed


def _cell(engine: Engine, case: Case, beside: Engine, policies: PolicySet) -> Cell[DecisionKey]:
    """A case for an engine; wrong are the cases that have another answer."""

    def ready(one: Case) -> Any:
        return engine.ready(one.situation(policies))

    def judge(answer: Any) -> Verdict:
        return Verdict.ALLOWED if engine.read(answer).effect is case.effect else Verdict.REFUSED

    wrong = {other.name: partial(ready, other) for other in cases.CASES if other.effect is not case.effect}
    of = DecisionKey(engine.name, case.name, beside.name)
    return Cell(of, engine.checks, partial(ready, case), engine.ask, judge, wrong)


def by_case(rows: Sequence[Row[DecisionKey]], name: str) -> dict[str, dict[str, float | None]]:
    """Ours over each engine's in each case, from the calls in which the two took turns.

    Args:
        rows: of one run.
        name: "p50_us" or "min_us".
    """
    took = {row.of: getattr(row, name) for row in rows if row.of.case is not None}
    return {
        key: {
            str(of.case): ratio(took[DecisionKey(mine, of.case, theirs)], took[of])
            for of in took
            if of.peer == theirs and DecisionKey(mine, of.case, theirs) in took
        }
        for key, (mine, theirs) in RATIOS.items()
    }


def ratios(rows: Sequence[Row[DecisionKey]], _: Mapping[str, Any], name: str) -> dict[str, float | None]:
    """Each ratio in the case that is worst for us; None for an engine that was not measured."""
    known = {key: [each for each in of.values() if each is not None] for key, of in by_case(rows, name).items()}
    return {key: max(values, default=None) for key, values in known.items()}


def tables(result: Result[DecisionKey]) -> Iterator[Table]:
    """Tables of durations, and of the checks behind each engine's answer."""
    measured = [row for row in result.rows if row.of.case is not None]
    texts = {
        ((row.of.peer, row.of.beside if row.of.peer != row.of.beside else OURS), str(row.of.case)): figure(
            row.p50_us, row.p99_us
        )
        for row in measured
    }
    yield pivot("median, µs (99th percentile)", ("engine", "in turns with"), texts)
    yield table(
        "what an answer rests on",
        ("engine", "checks"),
        rows={row.of.peer: row.checks for row in measured}.items(),
    )


def draw(result: Result[DecisionKey], file: Path) -> None:
    """A bar for each case and engine; of ours, those in turns with the first of the others."""
    rows = [row for row in result.rows if row.p50_us is not None]
    first = rows[0].of.beside
    bars = [
        (f"{row.of.case}: {row.of.peer}", row.p50_us, row.p99_us, _COLOURS.get(row.of.peer, picture.OTHERS))
        for row in sorted(rows, key=lambda row: [case.name for case in cases.CASES].index(str(row.of.case)))
        if row.of.beside in (row.of.peer, first) and row.p50_us is not None and row.p99_us is not None
    ]
    picture.bars(file, f"One decision, {result.more['rules']} rules", result.machine, bars, unit="µs")


def _remarks(result: Result[DecisionKey]) -> Iterator[str]:
    yield from (f"{row.of.peer}: {row.why}" for row in result.rows if row.of.case is None)
    yield f"All engines agree in {result.more['agreed']} cases, on {result.more['rules']} rules."


BENCH: Final = Bench(
    line_up,
    FULL,
    QUICK,
    ratios,
    f"{OURS} over each, in its worst case",
    tables,
    draw,
    remarks=_remarks,
    more=lambda rows, more: {
        "ratios_of_minima": ratios(rows, more, "min_us"),
        "ratios_by_case": by_case(rows, "p50_us"),
    },
)
