"""casbin as an ABAC matcher over one object that holds the facts.

casbin knows allow and deny, and says nothing of why. So there are two matchers, and two questions where the first says
yes: is it allowed at all, and may it be done without a person? Two noes and yeses make the three effects.
"""

from __future__ import annotations

from itertools import groupby
from types import SimpleNamespace
from typing import TYPE_CHECKING, Any

from evaluation.decisions.engine import Said
from evaluation.decisions.rules import Atom, Clause, Op, OtherFact, Rule
from evaluation.harness.absent import package
from policies import Effect

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from evaluation.decisions.facts import Situation

NAME = "casbin"
MODEL = """
[request_definition]
r = facts
r2 = facts

[policy_definition]
p = nothing
p2 = nothing

[policy_effect]
e = some(where (p.eft == allow))
e2 = some(where (p.eft == allow))

[matchers]
m = {denied}
m2 = {asked}
"""


class Casbin:
    """See the module."""

    name = NAME
    checks = "effect alone, by two questions; the facts as a ready object; no reason, detail, obligation or digest"

    def __init__(self, rules: Sequence[Rule]) -> None:
        casbin, self.version = package("casbin", "casbin")
        model = casbin.Model()
        texts = {
            effect: _matcher(prefix, [rule for rule in rules if rule.effect is effect])
            for effect, prefix in ((Effect.DENY, "r"), (Effect.DEFER, "r2"))
        }
        model.load_model_from_text(MODEL.format(denied=texts[Effect.DENY], asked=texts[Effect.DEFER]))
        self._enforcer = casbin.Enforcer(model)
        self._enforcer.add_function("within", lambda some, all_: some <= frozenset(all_))
        self._without_person = casbin.core_enforcer.EnforceContext("r2", "p2", "e2", "m2")

    def ready(self, situation: Situation) -> Any:
        """The object."""
        return SimpleNamespace(**situation.facts)

    def ask(self, question: Any) -> tuple[bool, bool]:
        """The answers to the two questions; the second is not asked after a no."""
        allowed = self._enforcer.enforce(question)
        return allowed, allowed and self._enforcer.enforce(self._without_person, question)

    def read(self, answer: tuple[bool, bool]) -> Said:
        """No, yes with a person, or yes."""
        allowed, alone = answer
        return Said(Effect.PERMIT if alone else Effect.DEFER if allowed else Effect.DENY, None)


def _matcher(prefix: str, rules: list[Rule]) -> str:
    """One expression: wherever a guard holds, all of its clauses do."""

    def guard(rule: Rule) -> str:
        return " && ".join(_atom(prefix, atom) for atom in rule.guard) or "True"

    return " && ".join(
        f"(!({when}) || ({_all(prefix, (clause for rule in same for clause in rule.holds))}))"
        for when, same in groupby(sorted(rules, key=guard), key=guard)
    )


def _all(prefix: str, clauses: Iterable[Clause]) -> str:
    said = (f"({' || '.join(_atom(prefix, atom) for atom in clause)})" for clause in clauses)
    return " && ".join(dict.fromkeys(said))


def _atom(prefix: str, atom: Atom) -> str:
    left, against = f"{prefix}.facts.{atom.fact}", atom.against
    right = f"{prefix}.facts.{against.name}" if isinstance(against, OtherFact) else repr(against)
    match atom.op:
        case Op.ONE_OF:
            return f"{left} in {right}"
        case Op.WITHIN:
            return f"within({left}, {right})"
        case Op.HAS:
            return f"{right} in {left}"
        case Op.EMPTY:
            return f"within({left}, ())"
        case _:
            return f"{left} {atom.op} {right}"
