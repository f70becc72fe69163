"""Forms of people's and agents' words in a scenario, with the operations that each asks for."""

from __future__ import annotations

from typing import Final

from pydantic import Field

from capabilities.values.units import Quantity, Unit
from pep.context.forms import Form, FormBody, Forms, RequestedOperation, asks_nothing

REQUEST: Final = "request/1"
TASK: Final = "task/1"
REPORT: Final = "report/1"
TEXT_LENGTH: Final = 4_000
"""Most characters of a text: a page of prose."""


class RequestBody(FormBody):
    """A person's wish, in natural language."""

    text: str = Field(min_length=1, max_length=TEXT_LENGTH)


class MoveWords(FormBody):
    """Joint move that a task asks for, in the units of tokens."""

    q_urad: tuple[int, int, int, int, int, int]
    speed_urad_s: int
    acceleration_urad_s2: int


class TaskBody(FormBody):
    """Task for another agent, with the operations that it needs, each as `object/operation`, and at most one move."""

    text: str = Field(min_length=1, max_length=TEXT_LENGTH)
    needs: tuple[str, ...] = Field(max_length=16)
    move: MoveWords | None = None


class ReportBody(FormBody):
    """Result of a task."""

    done: bool
    text: str = Field(max_length=TEXT_LENGTH)


def _asked(task: TaskBody) -> tuple[RequestedOperation, ...]:
    pairs = (need.split("/", 1) for need in task.needs)
    named = tuple(RequestedOperation(object_, operation) for object_, operation in pairs)
    return named if task.move is None else (*named, RequestedOperation("ur3e", "move_joint", quantities(task.move)))


def quantities(move: MoveWords) -> tuple[Quantity, ...]:
    """Parameters of the move as a request has them."""
    angles = tuple(Quantity(f"q{i}", Unit.MICRORADIAN, angle) for i, angle in enumerate(move.q_urad))
    speed = Quantity("speed", Unit.MICRORADIAN_PER_SECOND, move.speed_urad_s)
    return (*angles, speed, Quantity("acceleration", Unit.MICRORADIAN_PER_SECOND2, move.acceleration_urad_s2))


FORMS: Final = Forms(
    (
        Form(REQUEST, RequestBody, asks_nothing),
        Form(TASK, TaskBody, _asked),
        Form(REPORT, ReportBody, asks_nothing),
    )
)
