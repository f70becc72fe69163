"""Answers of an enforcement point to the process that started it: reports, and a stop.

A question comes as a line of JSON on standard input: `{"report": true}`, `{"report": "live"}` and others, or
`{"stop": true}`. The answer goes to standard output and names its lane, so that a stop waits for no report. The pipe
belongs to that process alone, so joint angles are told here that the server keeps from strangers on its HTTP port.
"""

from __future__ import annotations

import asyncio
import json
import sys
from typing import TYPE_CHECKING, Final

from capabilities.statements.revocation import NEVER_MS
from ztpm.base.processes import REPORT, STOP

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable, Mapping

    from pep.provider.feed import ProviderFollower

WHOLE: Final = "whole"
"""Report that `{"report": true}` asks for."""


async def serve_reports(answers: Mapping[str, Callable[[], Awaitable[dict[str, object]]]]) -> None:
    """Answers every question on standard input, until the input ends.

    Args:
        answers: makes each answer, plain JSON: by the report's name, and `STOP`. What is not among them is not
            answered.
    """
    reader = asyncio.StreamReader()
    loop = asyncio.get_running_loop()
    try:
        await loop.connect_read_pipe(lambda: asyncio.StreamReaderProtocol(reader), sys.stdin)
    except ValueError:  # a file: there are no questions
        return
    async with asyncio.TaskGroup() as answering:
        while line := await reader.readline():
            lane, asked = _asked(line)
            answer = answers.get(asked)
            if answer is not None:
                answering.create_task(_answer(lane, answer))


def _asked(line: bytes) -> tuple[str, str]:
    """Lane of a question, and the name of its answer; the name is empty where the line asks nothing."""
    try:
        question = json.loads(line)
    except (ValueError, RecursionError):
        return REPORT, ""
    match question:
        case {"stop": True}:
            return STOP, STOP
        case {"report": True}:
            return REPORT, WHOLE
        case {"report": str(name)} if name != STOP:
            return REPORT, name
        case _:
            return REPORT, ""


async def _answer(lane: str, answer: Callable[[], Awaitable[dict[str, object]]]) -> None:
    """Answers; a report that breaks is told as such, and does not take a later stop with it."""
    try:
        said = json.dumps({"answer": await answer(), "lane": lane}, allow_nan=False)
    except Exception as error:  # noqa: BLE001 - a narrower net would end all answers
        said = json.dumps({"answer": {"fault": type(error).__name__}, "lane": lane})
    sys.stdout.write(said + "\n")
    sys.stdout.flush()


def view_of(follower: ProviderFollower) -> dict[str, object]:
    """Epoch and age of the revocation view; None while there is none."""
    view = follower.view()
    return {"epoch": None, "age_ms": None} if view.age_ms >= NEVER_MS else {"epoch": view.epoch, "age_ms": view.age_ms}
