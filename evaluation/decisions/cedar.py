"""Cedar through cedarpy: a parsed policy set, no entities, the facts as context.

Cedar knows permit and forbid. A DEFER is a `forbid` whose id says so: where no other one speaks, a person is asked. A
policy that errors is skipped by Cedar; here an error is a denial, as in ours.
"""

from __future__ import annotations

import json
from itertools import groupby
from typing import TYPE_CHECKING, Any

from evaluation.decisions.engine import Said
from evaluation.decisions.rules import Atom, Clause, Op, OtherFact, Rule
from evaluation.harness.absent import package
from evaluation.tokens.workload import OBJECT
from policies import Effect

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from evaluation.decisions.facts import Situation
    from evaluation.decisions.readings import Fact

NAME = "cedarpy"
GROUPED = "cedarpy, two rules"


class Cedar:
    """One `forbid` for each rule: the answer names every primitive whose conditions do not hold."""

    name = NAME
    checks = "effect, and which rules speak; facts as JSON text made beforehand; no detail, obligation or digest"

    def __init__(self, rules: Sequence[Rule]) -> None:
        self._cedar, self.version = package("cedarpy", "cedarpy")
        self._policies = self._cedar.PolicySet.from_str(self.text(rules))
        self._entities = self._cedar.Entities.from_json_str("[]")
        self._primitives = {rule.name: rule.primitive for rule in rules}

    def text(self, rules: Sequence[Rule]) -> str:
        """The policy set in Cedar."""
        return "\n".join(["permit(principal, action, resource);", *map(_forbid, rules)])

    def ready(self, situation: Situation) -> dict[str, str]:
        """The request, with its context as the text that cedarpy would make of it."""
        context = {name: _json(fact) for name, fact in situation.facts.items()}
        return {
            "principal": f'Agent::"{situation.facts["agent"]}"',
            "action": f'Action::"{situation.request.operation}"',
            "resource": f'Robot::"{OBJECT}"',
            "context": json.dumps(context, separators=(",", ":")),
        }

    def ask(self, question: dict[str, str]) -> Any:
        """Cedar's answer."""
        return self._cedar.is_authorized(question, self._policies, self._entities)

    def read(self, answer: Any) -> Said:
        """Effect of the rules that answered."""
        if answer.allowed:
            return Said(Effect.PERMIT, ())
        names = set(answer.diagnostics.id_annotations_by_reason.values())
        asked = names and all(name.startswith("defer ") for name in names) and not answer.diagnostics.errors
        return Said(Effect.DEFER if asked else Effect.DENY, self.blamed(names))

    def blamed(self, names: Iterable[str]) -> tuple[str, ...] | None:
        """The primitives of these rules."""
        return tuple(sorted(self._primitives[name] for name in names))


class GroupedCedar(Cedar):
    """Two `forbid`s alone, one for everything denied and one for everything asked.

    It is quicker, and cannot say why.
    """

    name = GROUPED
    checks = "effect alone; facts as JSON text made beforehand; no reason, detail, obligation or digest"

    def text(self, rules: Sequence[Rule]) -> str:
        """Three policies."""
        told = ["permit(principal, action, resource);"]
        for effect in (Effect.DENY, Effect.DEFER):
            said = sorted((rule for rule in rules if rule.effect is effect), key=_guard_text)
            alternatives = (
                f"(!({guard}) || ({_all(clause for rule in same for clause in rule.holds)}))"
                for guard, same in groupby(said, key=_guard_text)
            )
            told.append(_policy(f"{effect.lower()} all", "true", " && ".join(alternatives)))
        return "\n".join(told)

    def blamed(self, names: Iterable[str]) -> tuple[str, ...] | None:
        """None: grouped policies cannot name a primitive."""
        del names
        return None


def _json(fact: Fact) -> object:
    return sorted(fact) if isinstance(fact, frozenset) else fact


def _guard_text(rule: Rule) -> str:
    return " && ".join(map(_atom, rule.guard)) or "true"


def _forbid(rule: Rule) -> str:
    return _policy(rule.name, _guard_text(rule), _all(rule.holds))


def _policy(name: str, when: str, unless: str) -> str:
    return f'@id("{name}") forbid(principal, action, resource) when {{ {when} }} unless {{ {unless} }};'


def _all(clauses: Iterable[Clause]) -> str:
    """Each clause once, in the order in which they come."""
    return " && ".join(dict.fromkeys(f"({' || '.join(map(_atom, clause))})" for clause in clauses))


def _atom(atom: Atom) -> str:
    left, against = f"context.{atom.fact}", atom.against
    right = f"context.{against.name}" if isinstance(against, OtherFact) else json.dumps(against)
    if atom.fact == "operation":
        # the one fact that Cedar has a place of its own for
        names = [against] if isinstance(against, str) else list(against)  # type: ignore[arg-type]  # texts, by `Op`
        same = " || ".join(f'action == Action::"{name}"' for name in names)
        return f"!({same})" if atom.op is Op.UNEQUAL else f"({same})"
    match atom.op:
        case Op.ONE_OF:
            return f"{right}.contains({left})"
        case Op.WITHIN:
            return f"{right}.containsAll({left})"
        case Op.HAS:
            return f"{left}.contains({right})"
        case Op.EMPTY:
            return f"{left}.isEmpty()"
        case _:
            return f"{left} {atom.op} {right}"
