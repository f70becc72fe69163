"""Process that makes pictures of assessed motions, beside an enforcement point and after all that moves.

    python -m pep.point.picture_drawer

It reads questions from its standard input, and writes a picture for each, or the reason why there is none, to its
standard output. It ends with its input, and so with the process that started it, however that ends. The two frame what
they say by a kind and a length.
"""

from __future__ import annotations

import io
import os
import pickle
import signal
import struct
import sys
from typing import TYPE_CHECKING, Any, BinaryIO, Final

from capabilities.values.errors import StatementError
from pep.base.errors import PepFault
from pep.pit.assessment.assessment import Certificate
from pep.pit.base.errors import PitError
from pep.pit.picture.shown_form import shown_text

if TYPE_CHECKING:
    from pep.pit import Robot
    from pep.world.questions import AssessedQuestion

HEAD: Final = struct.Struct(">cI")
TEXT, NONE, REASON = b"T", b"N", b"R"
"""Kinds of an answer: a picture, an act without the arm, and a code."""
GIVES_WAY: Final = 10  # nice: a tenth of a processor that others want, by the weights of Linux


def _unproven() -> None:
    """Stands for a proof."""


class _Pickler(pickle.Pickler):
    """Leaves out proofs: they are most of an answer, and no picture shows one."""

    def reducer_override(self, value: object) -> Any:
        """See `pickle.Pickler.reducer_override`."""
        return (_unproven, ()) if isinstance(value, Certificate) else NotImplemented


def _packed(value: object) -> bytes:
    into = io.BytesIO()
    _Pickler(into, pickle.HIGHEST_PROTOCOL).dump(value)
    return into.getvalue()


class Packing:
    """Packing of questions. The robot's model, which rarely changes, is packed once."""

    def __init__(self) -> None:
        self._robot: tuple[Robot, bytes] | None = None

    def packed(self, question: AssessedQuestion) -> bytes:
        """The question for the process."""
        if self._robot is None or self._robot[0] is not question.robot:
            self._robot = question.robot, _packed(question.robot)
        rest = _packed((question.situation, question.motion, question.assessment))
        return b"".join(HEAD.pack(TEXT, len(part)) + part for part in (self._robot[1], rest))


def drawn(robot: Any, situation: Any, motion: Any, assessment: Any) -> tuple[bytes, bytes]:
    """Kind and content of the answer to a question."""
    try:
        text = shown_text(robot, situation, motion, assessment)
    except (PitError, StatementError):
        return REASON, PepFault.PICTURE_IMPOSSIBLE.encode()
    return (NONE, b"") if text is None else (TEXT, text.encode("ascii"))


def answer_all(asked: BinaryIO, told: BinaryIO) -> None:
    """Answers every question until there are no more."""
    while (robot := _read(asked)) is not None and (rest := _read(asked)) is not None:
        # Of the process that started this one, and of nobody else.
        kind, content = drawn(pickle.loads(robot), *pickle.loads(rest))  # noqa: S301
        told.write(HEAD.pack(kind, len(content)) + content)
        told.flush()


def _read(asked: BinaryIO) -> bytes | None:
    head = asked.read(HEAD.size)
    if len(head) < HEAD.size:
        return None
    _, length = HEAD.unpack(head)
    part = asked.read(length)
    return part if len(part) == length else None


def main() -> None:
    """Answers on the standard output, which nothing else writes to."""
    os.nice(GIVES_WAY)
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # of a terminal: its parent ends it
    told = os.fdopen(os.dup(sys.stdout.fileno()), "wb")
    os.dup2(sys.stderr.fileno(), sys.stdout.fileno())
    try:
        answer_all(sys.stdin.buffer, told)
    except BrokenPipeError:
        os._exit(0)  # the parent is gone, and with it whoever would read


if __name__ == "__main__":
    main()
