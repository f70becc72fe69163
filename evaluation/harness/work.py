"""Work of a campaign, shared among processes, each with a seed of its own; and the sum of its results."""

from __future__ import annotations

from concurrent.futures import ProcessPoolExecutor
from dataclasses import fields
from multiprocessing import get_context
from typing import TYPE_CHECKING, Any, Final, TypeVar

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

_T = TypeVar("_T")
KEPT: Final = 20
"""Most failures of a kind that a process keeps whole; the others are counted."""


def shares(count: int, processes: int) -> tuple[int, ...]:
    """`count` in nearly equal parts."""
    return tuple(count // processes + (n < count % processes) for n in range(processes))


def seeds_of(seed: int, processes: int) -> tuple[int, ...]:
    """One seed for each process; different campaigns may have different ones."""
    return tuple(seed + n for n in range(processes))


def together(work: Callable[..., _T], arguments: Sequence[tuple[Any, ...]]) -> list[_T]:
    """The results of `work` for each of the arguments, in order: in new processes, or here for one alone."""
    if len(arguments) == 1:
        return [work(*arguments[0])]
    with ProcessPoolExecutor(len(arguments), mp_context=get_context("spawn")) as pool:
        return [task.result() for task in [pool.submit(work, *each) for each in arguments]]


def total(tallies: Sequence[_T]) -> _T:
    """One tally, a dataclass, out of at least one: counts and lists are added, of floats the greatest stands."""
    added = {}
    for each in fields(tallies[0]):  # type: ignore[arg-type]
        first, *others = (getattr(tally, each.name) for tally in tallies)
        for other in others:
            first = max(first, other) if isinstance(first, float) else first + other
        added[each.name] = first
    return type(tallies[0])(**added)


def keep(into: list[str], what: str) -> None:
    """Count a failure; the first ones whole."""
    into.append(what if len(into) < KEPT else "")
