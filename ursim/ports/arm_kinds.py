"""Words and numbers by which a controller tells the kind of its arm."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final


@dataclass(frozen=True, slots=True)
class ArmKind:
    """Kind of an arm of the e-Series.

    Attributes:
        said: answer of the dashboard to `get robot model`; that of the older series is the same.
        number: robot type on the primary interface.
    """

    said: str
    number: int


KINDS: Final = {
    "ur3e": ArmKind("UR3", 4),
    "ur5e": ArmKind("UR5", 1),
    "ur10e": ArmKind("UR10", 2),
    "ur16e": ArmKind("UR16", 3),
}
"""By the name of the shipped model."""
