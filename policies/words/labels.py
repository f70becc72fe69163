"""Labels: the origin of a value and its voucher, and the rules by which labels spread.

As in FIDES and CaMeL, the label on an argument is the control; a text's claims about itself count for nothing. Labels
only get worse: a value made of several has the least integrity of them, the greatest age, and their taint. Nothing here
raises one; a new signature over the value itself is a new value.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum, StrEnum
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Iterable


class Source(StrEnum):
    """Kind of source that a value came from."""

    OPERATOR = "operator"
    SENSOR = "sensor"
    RETRIEVAL = "retrieval"
    MEMORY = "memory"
    TOOL = "tool"
    AGENT = "agent"
    TEXT = "text"
    """A text that nobody vouches for."""


class Integrity(IntEnum):
    """Voucher for a value, in order: each kind is believed for at least as much as the one before."""

    NONE = 0
    """No voucher."""
    AGENT = 1
    """An authenticated agent says so: its own choice, or its message to another."""
    RECORDED = 2
    """A pinned tool answered so to a recorded request, or an agent wrote it to memory under its token."""
    CURATED = 3
    """A curator signed it and the audited manifest lists it."""
    SENSED = 4
    """A registered, calibrated sensor signed it."""
    PRINCIPAL = 5
    """An authenticated person signed it."""


@dataclass(frozen=True, slots=True)
class Label:
    """Label of one value.

    Attributes:
        sources: kinds of everything that it derives from, at least one.
        signers: ids of all who signed any of that; empty when nobody did.
        integrity: the least of it.
        age_ms: of the oldest part, at least 0.
        tainted: some part of it is text in which instructions or hidden characters were found.
    """

    sources: frozenset[Source]
    signers: frozenset[str]
    integrity: Integrity
    age_ms: int
    tainted: bool = False


NOBODY: Final = Label(frozenset({Source.TEXT}), frozenset(), Integrity.NONE, 0)
"""Label of a value without sources."""


def joined(labels: Iterable[Label]) -> Label:
    """Label of a value that derives from all of these; of nothing at all it is `NOBODY`.

    A model's output derives from everything in its context, even from parts that it claims not to have used.
    """
    parts = tuple(labels)
    if not parts:
        return NOBODY
    return Label(
        sources=frozenset().union(*(part.sources for part in parts)),
        signers=frozenset().union(*(part.signers for part in parts)),
        integrity=min(part.integrity for part in parts),
        age_ms=max(part.age_ms for part in parts),
        tainted=any(part.tainted for part in parts),
    )


def aged(label: Label, by_ms: int) -> Label:
    """Label `by_ms` milliseconds later; time never goes back, so a negative wait is none."""
    return Label(label.sources, label.signers, label.integrity, label.age_ms + max(0, by_ms), label.tainted)


def tainted(label: Label) -> Label:
    """Label after instructions or hidden characters were found in the text."""
    return Label(label.sources, label.signers, label.integrity, label.age_ms, tainted=True)
