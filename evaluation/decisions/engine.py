"""Engine that is measured: it makes a question ready, answers it, and tells the meaning of the answer."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Protocol

if TYPE_CHECKING:
    from evaluation.decisions.facts import Situation
    from policies import Effect


@dataclass(frozen=True, slots=True)
class Said:
    """An answer.

    Attributes:
        effect: PERMIT, DENY or DEFER.
        blamed: ids of the primitives whose conditions do not hold, ours leading first; None where the engine
            cannot say.
    """

    effect: Effect
    blamed: tuple[str, ...] | None


class Engine(Protocol):
    """One engine with the rules in its own language, ready to be asked.

    Attributes:
        name, version: of the engine, and of the form in which the rules are given to it.
        checks: the facts behind its answer, and the parts that the answer lacks.
    """

    name: str
    version: str
    checks: str

    def ready(self, situation: Situation) -> Any:
        """The question in the form that the engine takes; not timed."""

    def ask(self, question: Any) -> Any:
        """The engine's answer; timed."""

    def read(self, answer: Any) -> Said:
        """Meaning of the answer; not timed."""
