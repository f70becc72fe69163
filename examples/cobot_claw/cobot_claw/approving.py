"""A second person who is asked what an agent may not do alone: their answers, signed, to open questions."""

from __future__ import annotations

import threading
from typing import TYPE_CHECKING, Any, Final

from ztpm_idp.client import ClientError

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from ztpm_idp.client import Operator

PERIOD_S: Final = 0.5


class Approver:
    """A person who answers while a thread of theirs looks for questions.

    Args:
        person: an approver who lent nothing here.
        answer: told all that the vote binds; whether the person approves. It may take its time.
    """

    def __init__(self, person: Operator, answer: Callable[[Mapping[str, Any]], bool]) -> None:
        self._person = person
        self._answer = answer
        self._ended = threading.Event()
        self._thread = threading.Thread(target=self._look, name="approver", daemon=True)
        self.answered: list[tuple[str, bool]] = []
        """Operation and answer of each question, the oldest first."""

    def start(self) -> None:
        """Questions are looked for from now on."""
        self._thread.start()

    def stop(self) -> None:
        """Nothing is answered any more."""
        self._ended.set()
        if self._thread.is_alive():
            self._thread.join()

    def _look(self) -> None:
        seen: set[str] = set()
        while not self._ended.wait(PERIOD_S):
            try:
                for each in self._person.approvals():
                    if (ask_id := str(each["ask_id"])) not in seen:
                        seen.add(ask_id)
                        self._vote(ask_id)
            except ClientError:  # the provider is gone, or the question is over: silence denies
                continue

    def _vote(self, ask_id: str) -> None:
        asked = self._person.approval(ask_id)
        approves = self._answer(asked["shown"])
        if approves:
            self._person.approve(ask_id, shown=asked["ask_digest"])
        else:
            self._person.deny(ask_id)
        self.answered.append((str(asked["shown"]["operation"]), approves))


def in_words(shown: Mapping[str, Any]) -> str:
    """A question in one line, for the person who is asked.

    Args:
        shown: the members of the signed ask.
    """
    things = ", ".join(sorted({str(each["object"]) for each in shown.get("contributors") or ()}))
    near = f", near {things}" if things else ""
    return f"{shown['agent']} asks for {shown['object']}/{shown['operation']}, tier {shown['tier']}{near}"
