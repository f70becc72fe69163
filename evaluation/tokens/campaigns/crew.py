"""Work that is shared among processes, each with a seed of its own."""

from __future__ import annotations

from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from typing import TYPE_CHECKING, Any, TypeVar

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

_T = TypeVar("_T")


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
    with ProcessPoolExecutor(len(arguments), mp_context=get_context("spawn")) as crew:
        return [task.result() for task in [crew.submit(work, *each) for each in arguments]]
