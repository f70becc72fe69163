"""Questions that physics has just answered, kept so that people can be shown what was computed."""

from __future__ import annotations

import threading
from collections import OrderedDict
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from capabilities.statements.claims import malformed
from pep.pit.base.errors import PitError
from pep.pit.picture.shown_form import shown_text

if TYPE_CHECKING:
    from pep.pit import Assessment, Motion, Robot
    from pep.pit.files.scene_file import Situation

KEPT: Final = 16
"""Ours: people are asked right after the answer, or not at all; one motion at a time is asked about."""


@dataclass(frozen=True, slots=True)
class AssessedQuestion:
    """A question to physics with its answer; None for an arm that is led."""

    robot: Robot
    situation: Situation
    motion: Motion
    assessment: Assessment | None


class AssessedQuestions:
    """The newest questions by their requests: the `Pictures` port. Any thread."""

    def __init__(self) -> None:
        self._lock = threading.Lock()
        self._kept: OrderedDict[str, AssessedQuestion] = OrderedDict()

    def keep(
        self, request_id: str, robot: Robot, situation: Situation, motion: Motion, assessment: Assessment | None
    ) -> None:
        """Keeps a question with its answer; None for an arm that is led."""
        with self._lock:
            self._kept[request_id] = AssessedQuestion(robot, situation, motion, assessment)
            while len(self._kept) > KEPT:
                self._kept.popitem(last=False)

    def forget(self, request_id: str) -> None:
        """Keeps nothing of that request: what it was assessed by is not what it is decided on."""
        with self._lock:
            self._kept.pop(request_id, None)

    def question(self, request_id: str) -> AssessedQuestion | None:
        """The question of that request with its answer; None where nothing was assessed, or others came since."""
        with self._lock:
            return self._kept.get(request_id)

    def shown(self, request_id: str) -> str | None:
        """Text of the picture of that request's motion; None for an act without the arm.

        Raises:
            StatementError: `STATEMENT_MALFORMED`: it has no picture, so nobody can be asked.
        """
        kept = self.question(request_id)
        if kept is None:
            raise malformed("nothing was assessed that could be shown")
        try:
            return shown_text(kept.robot, kept.situation, kept.motion, kept.assessment)
        except PitError as error:
            raise malformed(f"no picture: {error.reason}") from None
