"""Forms of what people and agents say to each other, as the admission point reads them (docs/context.md)."""

from __future__ import annotations

import textwrap
from typing import Final

from pydantic import Field

from pep.context.forms import Form, FormBody, Forms, RequestedOperation, asks_nothing

REQUEST: Final = "claw-request/1"
TASK: Final = "claw-task/1"
REPORT: Final = "claw-report/1"
PURPOSE_LENGTH: Final = 100
TEXT_LENGTH: Final = 4_000
"""Most characters of a request, task or report: a page of prose."""
COLLECTIONS: Final = {"document": "claw-handbook", "scenario": "claw-scenarios"}
"""Name of each collection of the knowledge base by its kind of content, as its manifest states it."""


def in_short(text: str) -> str:
    """The beginning of a text, as the purpose of a token: a line of at most `PURPOSE_LENGTH` characters."""
    return textwrap.shorten(text, PURPOSE_LENGTH, placeholder=" ...")


class RequestBody(FormBody):
    """A person's request, in natural language."""

    text: str = Field(min_length=1, max_length=TEXT_LENGTH)


class TaskBody(FormBody):
    """A task for another agent, with the operations that it needs, each as `object/operation`."""

    text: str = Field(min_length=1, max_length=TEXT_LENGTH)
    needs: tuple[str, ...] = Field(max_length=16)


class ReportBody(FormBody):
    """Result of a task."""

    done: bool
    text: str = Field(max_length=TEXT_LENGTH)


def _needed(task: TaskBody) -> tuple[RequestedOperation, ...]:
    pairs = (need.split("/", 1) for need in task.needs)
    return tuple(RequestedOperation(object_, operation) for object_, operation in pairs)


FORMS: Final = Forms(
    (
        Form(REQUEST, RequestBody, asks_nothing),
        Form(TASK, TaskBody, _needed),
        Form(REPORT, ReportBody, asks_nothing),
    )
)
