"""The whole benchmark of decisions: every engine and case in one run."""

from __future__ import annotations

import random
import time
from dataclasses import dataclass, field
from functools import partial
from typing import TYPE_CHECKING, Any, Final

from evaluation.decisions import cases, rules
from evaluation.decisions.bench import Result, Row
from evaluation.decisions.casbin_abac import NAME as CASBIN
from evaluation.decisions.casbin_abac import Casbin
from evaluation.decisions.cedar import GROUPED, Cedar, GroupedCedar
from evaluation.decisions.cedar import NAME as CEDAR
from evaluation.decisions.ours import Ours, Recorded
from evaluation.decisions.readings import VERIFIED
from evaluation.decisions.rego import NAME as REGO
from evaluation.decisions.rego import Rego
from evaluation.harness import timing
from evaluation.harness.absent import AbsentError
from evaluation.harness.machine import machine
from evaluation.harness.timing import Plan, WrongAnswerError
from evaluation.tokens.cell import Verdict
from policies import load_shipped

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping, Sequence

    from evaluation.decisions.cases import Case
    from evaluation.decisions.engine import Engine, Said
    from evaluation.decisions.facts import Situation
    from evaluation.decisions.readings import Fact
    from evaluation.decisions.rules import Rule
    from evaluation.harness.timing import Series
    from policies import PolicySet

FULL: Final = Plan(repeats=5, rounds=200, warm_up=20)
SHIPPED: Final = "paper-default"
OTHERS: Final[dict[str, Callable[[Sequence[Rule]], Engine]]] = {
    CEDAR: Cedar,
    GROUPED: GroupedCedar,
    CASBIN: Casbin,
    REGO: Rego,
}
"""By name; each needs its package only when it is called."""


@dataclass(frozen=True, slots=True)
class Question:
    """One case asked of one engine, to be timed; see `evaluation.tokens.cell.Cell`."""

    engine: Engine
    case: Case
    fresh: Callable[[], Any]
    act: Callable[[Any], Any]
    judge: Callable[[Any], Verdict]
    wrong: Mapping[str, Callable[[], Any]] = field(default_factory=dict)

    @property
    def name(self) -> str:
        """Which question it is, for people."""
        return f"{self.engine.name}, {self.case.name}"


def run(
    plan: Plan,
    *,
    seed: int,
    told: Callable[[str], None],
    others: Mapping[str, Callable[[Sequence[Rule]], Engine]] = OTHERS,
) -> Result:
    """All engines and cases, measured in turns.

    Args:
        plan: how often.
        seed: of the order of turns.
        told: is told what happens now.
        others: the engines besides ourselves.

    Raises:
        WrongAnswerError: when two engines do not agree, or one does not answer what it must.
        NoPlainFormError: when the shipped set has a rule that the other engines cannot be given.
    """
    began = time.monotonic()
    policies = load_shipped(SHIPPED)
    given = rules.compiled(policies, cases.POINTS)
    engines: list[Engine] = [Ours(policies), Recorded(policies)]
    rows: list[Row] = []
    for name, make in others.items():
        try:
            engines.append(make(given))
        except AbsentError as absent:
            rows.append(Row(name, None, why=str(absent)))
    told("asking every engine for every broken condition")
    agreed = agree(engines, policies)
    told("measuring")
    # We take turns with one other at a time: a slow engine empties the processor's caches for whoever comes next.
    mine, others_ready = engines[:2], engines[2:]
    turns = [[*mine, other] for other in others_ready] or [mine]
    groups = [[_question(engine, case, policies) for engine in group] for case in cases.CASES for group in turns]
    for group in groups:
        for question in group:
            timing.prove(question)
    found = timing.measure(groups, plan, clock_ns=time.perf_counter_ns, order=random.Random(seed))  # noqa: S311 - turns
    for group, series in zip(groups, found, strict=True):
        beside = group[-1].engine.name
        rows += [_row(question, beside, one) for question, one in zip(group, series, strict=True)]
    return Result(
        rows=tuple(rows),
        versions={engine.name: engine.version for engine in engines},
        rules=len(given),
        agreed=agreed,
        machine=machine(),
        plan=plan,
        seconds=time.monotonic() - began,
    )


def agree(engines: Iterable[Engine], policies: PolicySet) -> int:
    """In how many cases every engine has our answer, and blames our leading primitive.

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
    """Whether an engine blames our leading primitive, where anybody is to blame and it can say whom.

    A chain that is not verified fails every rule that needs one; which of them owns the fault, ours alone knows.
    """
    if not right.blamed or said.blamed is None or situation.facts["chain"] != VERIFIED:
        return True
    return right.blamed[0] in said.blamed


def _question(engine: Engine, case: Case, policies: PolicySet) -> Question:
    """A case for an engine; wrong are the cases that have another answer."""

    def ready(one: Case) -> Any:
        return engine.ready(one.situation(policies))

    def judge(answer: Any) -> Verdict:
        return Verdict.ALLOWED if engine.read(answer).effect is case.effect else Verdict.REFUSED

    wrong = {other.name: partial(ready, other) for other in cases.CASES if other.effect is not case.effect}
    return Question(engine, case, partial(ready, case), engine.ask, judge, wrong)


def _row(question: Question, beside: str, series: Series) -> Row:
    figures = series.figures()
    return Row(
        question.engine.name,
        question.case.name,
        beside,
        p50_us=round(figures["p50_us"], 2),
        min_us=round(figures["min_us"], 2),
        p99_us=round(figures["p99_us"], 2),
        n=series.count,
        checks=question.engine.checks,
    )
