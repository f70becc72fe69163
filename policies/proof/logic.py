"""Logic: and, or, not and choice over values of one of two kinds, Python's own or z3's terms.

Everything in this package that says what a decision is, is written once, over a `Logic`. With `PLAIN` it is a function
that answers for one real case, and a test compares it with `policies.decide`; with the solver's logic the same lines
make the formula that is proven. Comparing numbers needs no word here: `<=` and `==` mean the same of both kinds.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final, Protocol, TypeAlias

if TYPE_CHECKING:
    from collections.abc import Callable

Truth: TypeAlias = Any
"""A bool, or a z3 term that is one."""
Number: TypeAlias = Any
"""An int or float, or a z3 term that is one."""


class Logic(Protocol):
    """The four words in which a decision is described."""

    def every(self, *parts: Truth) -> Truth:
        """True when all parts are; true of nothing."""
        ...

    def some(self, *parts: Truth) -> Truth:
        """True when a part is; false of nothing."""
        ...

    def no(self, part: Truth) -> Truth:
        """True when the part is not."""
        ...

    def choose(self, condition: Truth, then: Number, otherwise: Number) -> Number:
        """The one number or the other."""
        ...


class Plain:
    """Python's own truth."""

    def every(self, *parts: Truth) -> Truth:
        """See `Logic`."""
        return all(parts)

    def some(self, *parts: Truth) -> Truth:
        """See `Logic`."""
        return any(parts)

    def no(self, part: Truth) -> Truth:
        """See `Logic`."""
        return not part

    def choose(self, condition: Truth, then: Number, otherwise: Number) -> Number:
        """See `Logic`."""
        return then if condition else otherwise


PLAIN: Final[Logic] = Plain()


def implies(logic: Logic, condition: Truth, then: Truth) -> Truth:
    """True unless the condition is and `then` is not."""
    return logic.some(logic.no(condition), then)


def highest(logic: Logic, first: Number, *others: Number) -> Number:
    """The greatest of the numbers."""
    top = first
    for other in others:
        top = logic.choose(top <= other, other, top)
    return top


def fold(parts: tuple[Truth, ...], *, neutral: bool, joined: Callable[[list[Truth]], Truth]) -> Truth:
    """Terms joined, once Python's own truths among them are settled: a formula never holds a constant.

    Args:
        parts: bools and terms, mixed.
        neutral: the truth that adds nothing; the other one settles the whole.
        joined: makes one term of several.
    """
    terms = [part for part in parts if not isinstance(part, bool)]
    if any(isinstance(part, bool) and part is not neutral for part in parts):
        return not neutral
    return joined(terms) if terms else neutral
