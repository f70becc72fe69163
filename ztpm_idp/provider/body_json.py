"""`capabilities.values.strict_json` in this package's words: its caps, and its codes for refused bodies."""

from __future__ import annotations

from typing import Final

from capabilities.values.errors import FaultCode
from capabilities.values.strict_json import JsonDefect, JsonError, read
from ztpm_idp.domain.codes import Code, IdpCode

BODY_BYTES: Final = 262_144
"""Largest batch of journal records."""
LARGEST_BYTES: Final = 2 * BODY_BYTES + 4_096
"""Largest body: an ask with its picture. Each route has a bound of its own."""
BODY_DEPTH: Final = 32
"""Deepest nesting; our own bodies need nine."""

_CODES: Final[dict[JsonDefect, Code]] = {
    JsonDefect.TOO_LARGE: IdpCode.BODY_TOO_LARGE,
    JsonDefect.MALFORMED: IdpCode.BODY_MALFORMED,
    JsonDefect.NOT_FINITE: FaultCode.NOT_FINITE,
    JsonDefect.OUT_OF_RANGE: FaultCode.OUT_OF_RANGE,
}


class BodyError(Exception):
    """A body that is refused. `detail` names the place and the kind of fault, never the value."""

    def __init__(self, code: Code, detail: str) -> None:
        super().__init__(f"{code}: {detail}")
        self.code = code
        self.detail = detail


def parse_json(raw: bytes, *, limit_bytes: int = BODY_BYTES, limit_depth: int = BODY_DEPTH) -> object:
    """The value of one strict JSON text.

    Args:
        raw: the body as it came.
        limit_bytes: cap on the size, checked before parsing.
        limit_depth: cap on the nesting, checked before parsing.

    Raises:
        BodyError: `BODY_TOO_LARGE`, `NOT_FINITE` (NaN, infinities, numbers beyond a double), `OUT_OF_RANGE` (integers
            beyond 2^53 - 1), else `BODY_MALFORMED`.
    """
    try:
        return read(raw, limit_bytes=limit_bytes, limit_depth=limit_depth)
    except JsonError as error:
        raise BodyError(_CODES[error.defect], error.detail) from None
