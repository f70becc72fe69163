"""Errors in the physics room's input: one tree, each leaf with a code of `policies.words.reason_codes`."""

from __future__ import annotations


class PitError(ValueError):
    """Root of the tree.

    Attributes:
        reason: a `policies.words.reason_table.Reason` code.
        detail: for the record and the holder; never shown to strangers.
    """

    def __init__(self, reason: str, detail: str) -> None:
        """An error with its code."""
        super().__init__(f"{reason}: {detail}")
        self.reason = reason
        self.detail = detail


class ModelError(PitError):
    """A robot model that must not be used."""


class CellError(PitError):
    """A cell file that must not be used."""


class SceneError(PitError):
    """A view of the world that must not be believed."""


class MotionError(PitError):
    """A motion that cannot be assessed because it is not a motion."""


class UnprovenError(PitError):
    """A motion of which no proof reaches the end: it has no index, and no approval stands in for one."""

    def __init__(self, detail: str) -> None:
        """The refusal of such a motion; `detail` is the word for what is not proven."""
        super().__init__("UNPROVEN", detail)


class WorkLimitError(PitError):
    """The answer did not come within its time."""


class ProofError(PitError):
    """An answer that no proof document can be written of."""
