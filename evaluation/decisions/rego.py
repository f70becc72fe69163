"""Rego through regopy (rego-cpp): a bundle that is compiled once, with one entry point; the facts as ready input."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

from evaluation.decisions.engine import Said
from evaluation.decisions.rules import Atom, Op, OtherFact, Rule
from evaluation.harness.absent import package
from policies import Effect

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence

    from evaluation.decisions.facts import Situation

NAME = "regopy"
ENTRY = "ztpm/verdict"


class Rego:
    """See the module."""

    name = NAME
    checks = "effect, and which rules speak; the facts as ready input; no detail, obligation or digest"

    def __init__(self, rules: Sequence[Rule]) -> None:
        self._rego, self.version = package("regopy", "regopy")
        builder = self._rego.Interpreter()
        builder.add_module("ztpm.rego", module(rules))
        self._bundle = builder.build(None, [ENTRY])
        self._interpreter = self._rego.Interpreter()

    def ready(self, situation: Situation) -> Any:
        """The input, converted."""
        plain = {k: sorted(v) if isinstance(v, frozenset) else v for k, v in situation.facts.items()}
        return self._rego.Input(plain)

    def ask(self, question: Any) -> Any:
        """The names of all rules that speak."""
        self._interpreter.set_input(question)
        return self._interpreter.query_bundle_entrypoint(self._bundle, ENTRY)

    def read(self, answer: Any) -> Said:
        """DENY before DEFER before PERMIT."""
        verdict = json.loads(answer.expressions()[0].json())
        denied, asked = verdict["denied"], verdict["asked"]
        effect = Effect.DENY if denied else Effect.DEFER if asked else Effect.PERMIT
        return Said(effect, tuple(name.rpartition(" ")[2] for name in (*denied, *asked)))


def module(rules: Sequence[Rule]) -> str:
    """The rules in Rego: each has a body of its own, and so has each clause with alternatives."""
    lines = [line for n, rule in enumerate(rules) for line in _rule(n, rule)]
    return "\n".join(["package ztpm", "import rego.v1", 'verdict := {"denied": denied, "asked": asked}', *lines])


def _rule(n: int, rule: Rule) -> Iterator[str]:
    into = "denied" if rule.effect is Effect.DENY else "asked"
    guard = "".join(f"{_atom(atom)}; " for atom in rule.guard)
    yield f'{into} contains "{rule.name.rpartition(" ")[0]} {rule.primitive}" if {{ {guard}not holds_{n} }}'
    parts = []
    for m, clause in enumerate(rule.holds):
        parts.append(_atom(clause[0]) if len(clause) == 1 else f"one_{n}_{m}")
        if len(clause) > 1:
            yield from (f"one_{n}_{m} if {{ {_atom(atom)} }}" for atom in clause)
    yield f"holds_{n} if {{ {'; '.join(parts)} }}"


def _atom(atom: Atom) -> str:
    left, against = f"input.{atom.fact}", atom.against
    right = f"input.{against.name}" if isinstance(against, OtherFact) else json.dumps(against)
    members = "{" + right[1:-1] + "}" if isinstance(against, tuple) else right
    match atom.op:
        case Op.ONE_OF:
            return f"{left} in {members}"
        case Op.WITHIN:
            return f"every member in {left} {{ member in {members} }}"
        case Op.HAS:
            return f"{right} in {left}"
        case Op.EMPTY:
            return f"count({left}) == 0"
        case _:
            return f"{left} {atom.op} {right}"
