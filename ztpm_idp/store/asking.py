"""Questions that wait at once are asked together: one transaction for all of them."""

from __future__ import annotations

import asyncio
from typing import TYPE_CHECKING, Final, Generic, TypeVar

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable, Sequence, Sized

Q = TypeVar("Q")
A = TypeVar("A")

TOGETHER: Final = 32
"""Questions that are asked together: the first of them waits for the last."""
TURNS: Final = 32
"""Most turns of the loop for which the first one waits for others that arrive just now."""
QUIET: Final = 2
"""Turns without a new one after which none is awaited: between a request's first byte and its question lie two."""


async def gathered(waiting: Sized) -> None:
    """Returns when nothing has been added for some turns of the loop."""
    before, quiet = len(waiting), 0
    for _ in range(TURNS):
        await asyncio.sleep(0)
        quiet = quiet + 1 if len(waiting) == before else 0
        before = len(waiting)
        if quiet == QUIET:
            return


class AskedTogether(Generic[Q, A]):
    """Questions of one sort.

    Args:
        answer: answers several, in their order.
    """

    def __init__(self, answer: Callable[[Sequence[Q]], Awaitable[Sequence[A]]]) -> None:
        self._answer = answer
        self._waiting = list[tuple[Q, asyncio.Future[A]]]()
        self._task: asyncio.Task[None] | None = None

    async def ask(self, question: Q) -> A:
        """The answer.

        Raises: what answering raises, for all who asked together.
        """
        answered: asyncio.Future[A] = asyncio.get_running_loop().create_future()
        self._waiting.append((question, answered))
        if self._task is None:
            self._task = asyncio.create_task(self._work())
        return await answered

    async def _work(self) -> None:
        try:
            while self._waiting:
                await gathered(self._waiting)
                asked, self._waiting = self._waiting[:TOGETHER], self._waiting[TOGETHER:]
                try:
                    answers = await self._answer([question for question, _ in asked])
                    answered = list(zip(asked, answers, strict=True))
                except BaseException as error:
                    for _, waits in asked:
                        if not waits.done():
                            waits.set_exception(error)
                    if not isinstance(error, Exception):
                        raise
                else:
                    for (_, waits), answer in answered:
                        if not waits.done():  # nobody waits for an answer any more whose request was given up
                            waits.set_result(answer)
        finally:
            self._task = None
