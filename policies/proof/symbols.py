"""Facts of any case at all, as z3 terms. With `policies.proof.search` the only module that imports z3."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import z3

from policies.proof.facts import FACTS, Facts, PrimitiveVerdict
from policies.proof.logic import Logic, Number, Truth, fold

if TYPE_CHECKING:
    from collections.abc import Iterable

    from policies.primitives.base import Primitive


class Symbolic:
    """Truth of terms (policies.proof.logic)."""

    def every(self, *parts: Truth) -> Truth:
        """See `Logic`."""
        return fold(parts, neutral=True, joined=z3.And)

    def some(self, *parts: Truth) -> Truth:
        """See `Logic`."""
        return fold(parts, neutral=False, joined=z3.Or)

    def no(self, part: Truth) -> Truth:
        """See `Logic`."""
        return not part if isinstance(part, bool) else z3.Not(part)

    def choose(self, condition: Truth, then: Number, otherwise: Number) -> Number:
        """See `Logic`."""
        if isinstance(condition, bool):
            return then if condition else otherwise
        return z3.If(condition, then, otherwise)


SYMBOLIC: Final[Logic] = Symbolic()


def any_facts(primitives: Iterable[Primitive]) -> Facts:
    """Facts of which nothing is known."""
    made = {row.name: any_fact(row.name) for row in FACTS}
    return Facts(**made, unknown={primitive: any_verdict(repr(primitive)) for primitive in primitives})


def any_fact(name: str, mark: str = "") -> Any:
    """One fact of which nothing is known; the mark tells it from the same fact of another case."""
    row = next(row for row in FACTS if row.name == name)
    if isinstance(row.metadata["ordinary"], bool):
        return z3.Bool(name + mark)
    return (z3.Real if row.metadata.get("real") else z3.Int)(name + mark)


def any_verdict(name: str) -> PrimitiveVerdict:
    """A verdict of which nothing is known."""
    return PrimitiveVerdict(*(z3.Bool(f"{name} {part}") for part in ("holds", "fails", "raises")))
