"""Calls of several ways to one act, in turns."""

from __future__ import annotations

import asyncio
import time
from typing import TYPE_CHECKING, Any, Final, TypeVar

from evaluation.tools.bench import NotMeasuredError, row_of
from pep import NotPermittedError
from ztpm_idp.client import Denied

if TYPE_CHECKING:
    import random
    from collections.abc import Awaitable, Callable, Coroutine, Mapping

    from evaluation.tools.bench import ActRow

    Act = Callable[[], Awaitable[object]]

T = TypeVar("T")
WARM_UP: Final = 20
"""Calls of each way before the timed ones."""


async def in_turns(
    ways: Mapping[str, Act], answer: object, calls: int, order: random.Random, told: Callable[[str], None] | None = None
) -> list[ActRow]:
    """Rows of the ways, called once each in a new random order, again and again.

    Args:
        ways: by name.
        answer: that each of them gives.
        calls: timed ones of each.
        order: draws the orders.
        told: receives a word after each tenth of the calls.

    Raises:
        NotMeasuredError: one answered otherwise, or too many calls were refused.
    """
    took: dict[str, list[int]] = {way: [] for way in ways}
    refused = dict.fromkeys(ways, 0)
    each_one = list(ways.items())
    for call in range(-WARM_UP, calls):
        order.shuffle(each_one)
        for way, once in each_one:
            began = time.perf_counter_ns()
            try:
                found: Any = await once()
            except (Denied, NotPermittedError):
                found = answer
                refused[way] += call >= 0
            ended = time.perf_counter_ns()
            if found != answer:
                raise NotMeasuredError(f"{way}: another answer")
            if call >= 0:
                took[way].append(ended - began)
        if told is not None and call > 0 and call % max(1, calls // 10) == 0:
            told(f"{call} of {calls} calls of each")
    return [row_of(way, took[way], refused[way]) for way in ways]


async def check_refused(once: Act) -> None:
    """Checks that the guard stands there at all.

    Raises:
        NotMeasuredError: it does not.
    """
    try:
        await once()
    except (Denied, NotPermittedError):
        return
    raise NotMeasuredError("what the token does not permit was permitted")


def finished(work: Coroutine[Any, Any, T]) -> T:
    """Result of the work, or its error without the groups that the SDK's client puts it in."""
    try:
        return asyncio.run(work)
    except ExceptionGroup as group:
        error: Exception = group
    while isinstance(error, ExceptionGroup):
        error = error.exceptions[0]
    raise error
