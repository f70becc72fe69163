"""Faults of what the referee is given."""

from __future__ import annotations

from enum import StrEnum


class RefereeFault(StrEnum):
    """Cause for which there is no judgement."""

    MESH_MISSING = "MESH_MISSING"
    MESH_WRONG = "MESH_WRONG"
    SAMPLES_MALFORMED = "SAMPLES_MALFORMED"
    WORLD_MALFORMED = "WORLD_MALFORMED"


class RefereeError(ValueError):
    """Input that cannot be judged. `code` is the reason."""

    def __init__(self, code: RefereeFault, detail: str) -> None:
        super().__init__(f"{code}: {detail}")
        self.code = code
        self.detail = detail
