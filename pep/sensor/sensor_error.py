"""Refusals of a sensor program's input: each with its reason and the next step; nothing of the input is used."""

from __future__ import annotations

from enum import StrEnum


class SensorFault(StrEnum):
    """Reasons why a sight is refused before anything is signed."""

    SIGHT_MALFORMED = "SIGHT_MALFORMED"
    NOT_FINITE = "NOT_FINITE"
    NO_DEPTH = "NO_DEPTH"
    NOT_METRES = "NOT_METRES"
    NO_BODY = "NO_BODY"
    TOO_LARGE = "TOO_LARGE"
    OUT_OF_TIME = "OUT_OF_TIME"
    NOT_NEWER = "NOT_NEWER"


class SensorError(ValueError):
    """A sight that is refused; nothing was signed or sent.

    Attributes:
        code: the reason.
        detail: the place in the input, and the fault there.
        step: the next step.
    """

    def __init__(self, code: SensorFault, detail: str, step: str) -> None:
        super().__init__(f"{code}: {detail}. {step}")
        self.code = code
        self.detail = detail
        self.step = step
