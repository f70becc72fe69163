"""Approver of the stage: a person who says yes to every open question while something runs."""

from __future__ import annotations

import threading
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, Final

from ztpm_idp.client import ClientError

if TYPE_CHECKING:
    from collections.abc import Iterator

    from ztpm_idp.client import Operator

LOOKS_S: Final = 0.2
"""Pause between two looks at the open questions."""


@contextmanager
def approving(person: Operator) -> Iterator[set[str]]:
    """The person approves every open question meanwhile, and attests to seeing the cell clear.

    Yields:
        Ids of the questions that were answered so far; it grows.
    """
    over, answered = threading.Event(), set[str]()

    def answer() -> None:
        while not over.wait(LOOKS_S):
            for ask_id in {str(row["ask_id"]) for row in person.approvals()} - answered:
                answered.add(ask_id)
                with suppress(ClientError):  # one that has ended meanwhile
                    person.approve(ask_id, sees_clear=True)

    thread = threading.Thread(target=answer, name="approver")
    thread.start()
    try:
        yield answered
    finally:
        over.set()
        thread.join()
