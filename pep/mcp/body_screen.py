"""First screen of a request: a body is one JSON object with one meaning, or it goes no further."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Final

from capabilities.values.strict_json import JsonDefect, JsonError, read
from policies.words.reason_table import Reason

BODY_BYTES: Final = 32_768
"""Largest body.

A tool call of a cell has some hundred bytes, and reading a strange one takes time from all others.
"""
LINE_BYTES: Final = 2 * BODY_BYTES
"""Longest line over stdio: a body, and as much again for what HTTP has in its headers."""
DEPTH: Final = 32
"""Deepest nesting."""

_REASONS: Final[dict[JsonDefect, Reason]] = {
    JsonDefect.TOO_LARGE: Reason.BODY_TOO_LARGE,
    JsonDefect.MALFORMED: Reason.BODY_MALFORMED,
    JsonDefect.NOT_FINITE: Reason.NOT_FINITE,
    JsonDefect.OUT_OF_RANGE: Reason.OUT_OF_RANGE,
}


@dataclass(frozen=True, slots=True)
class Unfit:
    """Reason why a body goes no further."""

    reason: Reason
    detail: str


def screen(body: bytes, *, limit_bytes: int = BODY_BYTES) -> dict[str, Any] | Unfit:
    """The object that every JSON reader sees in `body`.

    Args:
        body: as it came over the wire.
        limit_bytes: cap on its size.

    Returns:
        The object, or why there is none: `BODY_TOO_LARGE`, `NOT_FINITE`, `OUT_OF_RANGE` or `BODY_MALFORMED`.
    """
    try:
        value = read(body, limit_bytes=limit_bytes, limit_depth=DEPTH)
    except JsonError as error:
        return Unfit(_REASONS[error.defect], error.detail)
    if not isinstance(value, dict):
        return Unfit(Reason.BODY_MALFORMED, "not a JSON object")
    return value
