"""Changes at every await point: of the suspensions of a call's tasks, one has a change.

A call's tasks are the one that makes it and all that are begun inside of it: they inherit its context.
"""

from __future__ import annotations

import asyncio
from contextlib import contextmanager
from contextvars import ContextVar
from enum import Enum

_COUNTED = ContextVar("counted", default=None)


class Moment(Enum):
    """Side of a suspension: before it waits, or after."""

    SUSPENDED = "suspended"
    RESUMED = "resumed"


class Points:
    """Suspensions of one call, in order.

    Args:
        at: number of the suspension at which to change, from 1; 0 for none.
        moment: side of it.
        change: what is done there, once.

    Attributes:
        passed: number of suspensions so far.
        changed: it was done.
    """

    def __init__(self, at=0, moment=Moment.SUSPENDED, change=lambda: None):
        self._at, self._moment, self._change = at, moment, change
        self.passed, self.changed = 0, False

    def suspended(self):
        self.passed += 1
        number = self.passed
        self._do(number, Moment.SUSPENDED)
        return number

    def resumed(self, number):
        self._do(number, Moment.RESUMED)

    def _do(self, number, moment):
        if number == self._at and moment is self._moment and not self.changed:
            self.changed = True
            self._change()


class _Driven:
    """Awaitable that runs a coroutine and tells its points."""

    def __init__(self, coroutine):
        self._coroutine = coroutine

    def __await__(self):
        coroutine, send, value = self._coroutine, True, None
        while True:
            try:
                waits_for = coroutine.send(value) if send else coroutine.throw(value)
            except StopIteration as end:
                return end.value
            points = _COUNTED.get()
            number = points.suspended() if points is not None else 0
            try:
                send, value = True, (yield waits_for)
            except BaseException as error:  # noqa: BLE001 - whatever is thrown in goes in
                send, value = False, error
            if points is not None:
                points.resumed(number)


async def _through(coroutine):
    return await _Driven(coroutine)


def factory(loop, coroutine, **options):
    """Task factory of a loop in which points are told."""
    return asyncio.Task(_through(coroutine), loop=loop, **options)


@contextmanager
def counted(points):
    """Suspensions of what is called inside are these."""
    token = _COUNTED.set(points)
    try:
        yield points
    finally:
        _COUNTED.reset(token)
