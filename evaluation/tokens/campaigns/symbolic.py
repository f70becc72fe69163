"""Running Python with symbols in place of integers: every way that the code can go, each with its condition.

A `Symbol` adds and compares as an integer does. A comparison whose answer is open is answered both ways, one after the
other, and the condition is remembered; z3 says which answers are possible, over all integers. So the formulas are those
of the code that ran, and a test runs the same code with integers and finds the same answers.
"""

from __future__ import annotations

import operator
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Final, Generic, TypeVar

import z3

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

T = TypeVar("T")
INTEGERS: Final = "QF_LIA"
TEXTS: Final = "QF_SLIA"


class UndecidedError(Exception):
    """The solver gave no answer: nothing is proven."""


class Symbol:
    """An integer that can be any. All symbols hash alike, so that sets compare their members."""

    __slots__ = ("_run", "name", "term")

    def __init__(self, term: z3.ArithRef, run: Run) -> None:
        # z3 keeps one object for equal terms; the run keeps it alive, and so its number its own.
        self.term, self.name, self._run = term, term.get_id(), run
        run.terms.append(term)

    def __hash__(self) -> int:
        return 0

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Symbol | int) and self._run.equal(self, other)

    def __lt__(self, other: Symbol | int) -> bool:
        return self._run.less(self, other)

    def __le__(self, other: Symbol | int) -> bool:
        return not self._run.less(other, self)

    def __gt__(self, other: Symbol | int) -> bool:
        return self._run.less(other, self)

    def __ge__(self, other: Symbol | int) -> bool:
        return not self._run.less(self, other)

    def __add__(self, other: Symbol | int) -> Symbol:
        return Symbol(self.term + _term(other), self._run)

    def __sub__(self, other: Symbol | int) -> Symbol:
        return Symbol(self.term - _term(other), self._run)

    def __abs__(self) -> Symbol:
        return self if self >= 0 else Symbol(-self.term, self._run)


class Text:
    """A text that can be any. All of them hash alike, so that sets compare their members."""

    __slots__ = ("_run", "term")

    def __init__(self, term: z3.SeqRef, run: Run) -> None:
        self.term, self._run = term, run

    def __hash__(self) -> int:
        return 0

    def __bool__(self) -> bool:
        return not self._run.says(operator.eq, self.term, z3.StringVal(""))

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Text) and (other is self or self._run.says(operator.eq, self.term, other.term))

    def __add__(self, other: str) -> Text:
        return Text(z3.Concat(self.term, z3.StringVal(other)) if other else self.term, self._run)

    def startswith(self, other: Text) -> bool:
        """True where this begins with the other."""
        return self._run.says(z3.PrefixOf, other.term, self.term)


def _term(value: Symbol | int) -> z3.ArithRef | int:
    return value.term if isinstance(value, Symbol) else value


def _name(value: Symbol | int) -> tuple[bool, int]:
    return (True, value.name) if isinstance(value, Symbol) else (False, value)


Name = tuple[bool, int]


def _pair(one: Name, other: Name) -> tuple[Name, Name]:
    """Pair of names, the same for either order."""
    return (one, other) if one <= other else (other, one)


Answers = tuple[tuple[bool, bool], ...]
"""Answer to each comparison in order, and whether it was open."""


@dataclass
class Run:
    """One way through the code.

    Attributes:
        solver: holds the assumptions, and the conditions of this way.
        replayed: answers that an earlier run has chosen; from there on they are found out.
        answers: to the comparisons so far.
        conditions: of those comparisons whose answer was open.
        open_: further ways: the answers up to a comparison that could also have been answered otherwise.
        terms: of all symbols.
    """

    solver: z3.Solver
    replayed: Answers
    answers: list[tuple[bool, bool]] = field(default_factory=list)
    conditions: list[z3.BoolRef] = field(default_factory=list)
    open_: list[Answers] = field(default_factory=list)
    terms: list[z3.ArithRef] = field(default_factory=list)
    _known: dict[tuple[bool, Name, Name], bool] = field(default_factory=dict)

    def symbol(self, name: str) -> Symbol:
        """Symbol for any integer; the same one for the same name."""
        return Symbol(z3.Int(name), self)

    def assume(self, *conditions: z3.BoolRef) -> None:
        """Assumes these conditions of all integers. To be called before the first comparison."""
        self.solver.add(*conditions)

    def text(self, name: str) -> Text:
        """Symbol for any text; the same one for the same name."""
        return Text(z3.String(name), self)

    def says(self, compare: Callable[[Any, Any], Any], one: Any, other: Any) -> bool:
        """True where a comparison of texts holds."""
        return self._answer(compare, one, other)

    def less(self, one: Symbol | int, other: Symbol | int) -> bool:
        """True where `one` is less than `other`."""
        names = _name(one), _name(other)
        found = self._known.get((False, *names))
        if found is None:
            found = self._answer(operator.lt, _term(one), _term(other))
            self._known[False, *names] = found
            if found:
                self._known[False, names[1], names[0]] = self._known[True, *_pair(*names)] = False
        return found

    def equal(self, one: Symbol | int, other: Symbol | int) -> bool:
        """True where `one` equals `other`."""
        names = _pair(_name(one), _name(other))
        found = True if names[0] == names[1] else self._known.get((True, *names))
        if found is None:
            found = self._answer(operator.eq, _term(one), _term(other))
            self._known[True, *names] = found
            if found:
                self._known[False, *names] = self._known[False, names[1], names[0]] = False
        return found

    def _answer(self, compare: Callable[[Any, Any], Any], one: Any, other: Any) -> bool:
        """The answer to a comparison: the only possible one, or, where both are, one now and the other later."""
        at = len(self.answers)
        if at < len(self.replayed):
            value, was_open = self.replayed[at]
            if was_open:
                self._go(compare(one, other), way=value)
        else:
            condition = compare(one, other)
            # The answers so far are possible together, so one of the two answers is.
            value = self._possible(condition)
            was_open = value and self._possible(z3.Not(condition))
            if was_open:
                self.open_.append((*self.answers, (False, True)))
                self._go(condition, way=True)
        self.answers.append((value, was_open))
        return value

    def _go(self, condition: z3.BoolRef, *, way: bool) -> None:
        held = condition if way else z3.Not(condition)
        self.conditions.append(held)
        self.solver.add(held)

    def _possible(self, condition: z3.BoolRef) -> bool:
        self.solver.push()
        self.solver.add(condition)
        found = self.solver.check()
        self.solver.pop()
        if found == z3.unknown:
            raise UndecidedError(self.solver.reason_unknown())
        return bool(found == z3.sat)


@dataclass(frozen=True, slots=True)
class Way(Generic[T]):
    """One way through the code: its answer, and its conditions."""

    answer: T
    conditions: tuple[z3.BoolRef, ...]


def ways(code: Callable[[Run], T], logic: str = INTEGERS) -> Iterator[Way[T]]:
    """Every way through `code`, which makes its symbols from the run that it is given.

    The conditions of the ways exclude each other, and together cover all assumed cases.

    Args:
        code: that is run.
        logic: of the solver, `INTEGERS` or `TEXTS`.
    """
    waiting: list[Answers] = [()]
    while waiting:
        run = Run(z3.SolverFor(logic), waiting.pop())
        answer = code(run)
        waiting.extend(run.open_)
        yield Way(answer, tuple(run.conditions))
