"""A file for the physics room as one plain value, or refused with a code and a place.

JSON and TOML are read the same way: TOML is spelt as JSON first. A key that occurs twice, a number that is not finite,
a text that is too large or too deep has no value here.
"""

from __future__ import annotations

import json
import tomllib
from typing import TYPE_CHECKING, Any, Final, TypeVar

from pydantic import TypeAdapter, ValidationError

from capabilities.values.strict_json import JsonDefect, JsonError, read, without_mark
from pep.pit.base.errors import PitError

if TYPE_CHECKING:
    from pathlib import PurePath

T = TypeVar("T")

FILE_LIMIT_BYTES: Final = 2**20  # ours: 32 people with 64 regions each are a third of it
DEPTH_LIMIT: Final = 10  # ours: a scene needs eight
TOML: Final = ".toml"
REASONS: Final = {
    JsonDefect.TOO_LARGE: "BODY_TOO_LARGE",
    JsonDefect.MALFORMED: "BODY_MALFORMED",
    JsonDefect.NOT_FINITE: "NOT_FINITE",
    JsonDefect.OUT_OF_RANGE: "OUT_OF_RANGE",
}
WRONG_FRAME: Final = "FRAMES_MISMATCH"


class FileError(PitError):
    """A file that is refused; its detail begins with the place."""

    def __init__(self, reason: str, place: str, what: str) -> None:
        """An error at a place."""
        super().__init__(reason, f"{place}: {what}")
        self.place = place


def value_of(raw: bytes, name: PurePath) -> object:
    """The plain value that the file's bytes spell: TOML where the name ends in `.toml`, else JSON.

    Raises:
        FileError: `BODY_TOO_LARGE`, `BODY_MALFORMED`, `NOT_FINITE` or `OUT_OF_RANGE`.
    """
    if len(raw) > FILE_LIMIT_BYTES:
        raise FileError(REASONS[JsonDefect.TOO_LARGE], name.name, f"at most {FILE_LIMIT_BYTES} bytes")
    raw = without_mark(raw)
    try:
        spelled = _as_json(raw) if name.suffix == TOML else raw
        return read(spelled, limit_bytes=2 * FILE_LIMIT_BYTES, limit_depth=DEPTH_LIMIT)
    except JsonError as error:
        raise FileError(REASONS[error.defect], name.name, error.detail) from error


def _as_json(raw: bytes) -> bytes:
    try:
        table = tomllib.loads(raw.decode("utf-8"))
    except (UnicodeDecodeError, tomllib.TOMLDecodeError, RecursionError) as error:
        raise JsonError(JsonDefect.MALFORMED, "not TOML") from error
    try:
        return json.dumps(table).encode()  # NaN and infinities are refused as JSON's are
    except (TypeError, RecursionError) as error:
        raise JsonError(JsonDefect.MALFORMED, "a date or time, or nested too deeply") from error


def formed(form: TypeAdapter[T], value: object, *, place: str) -> T:
    """The value in its declared form.

    Args:
        form: strict, without further members.
        value: plain.
        place: name of the value in an error.

    Raises:
        FileError: `FRAMES_MISMATCH` for an unknown frame, `NOT_FINITE` for a number that is none, else
            `PARAMETERS_WRONG`.
    """
    try:
        # Over JSON text, where a list is a tuple's only spelling.
        return form.validate_json(json.dumps(value, allow_nan=False))
    except ValidationError as error:
        first: Any = error.errors(include_url=False, include_input=False, include_context=False)[0]
        where = ".".join([place, *(str(part) for part in first["loc"])])
        reason = WRONG_FRAME if first["loc"][-1:] == ("frame",) else "PARAMETERS_WRONG"
        raise FileError(reason, where, first["msg"]) from error
