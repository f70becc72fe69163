"""Verdict on a proof document: verified, or refused with a code and a place."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum


class Code(StrEnum):
    """Reason why a document is refused, beside its place."""

    TOO_LARGE = "TOO_LARGE"  # more bytes, rows or pairs than any question has
    NOT_JSON = "NOT_JSON"  # not UTF-8, not JSON, nested too deeply, or a number that is none
    KEY_REPEATS = "KEY_REPEATS"
    NOT_CANONICAL = "NOT_CANONICAL"  # another spelling of a document that has exactly one
    VERSION_UNKNOWN = "VERSION_UNKNOWN"
    MEMBER_WRONG = "MEMBER_WRONG"  # missing, of another type, out of range, or not of the declared form
    DIGEST_WRONG = "DIGEST_WRONG"  # the document, the robot or the scene has another digest
    FORM_UNKNOWN = "FORM_UNKNOWN"  # a path that this checker cannot recompute
    TIER_WRONG = "TIER_WRONG"  # not the tier of the index
    ANSWER_WRONG = "ANSWER_WRONG"  # a question whose answer is fixed has another one
    FLOOR_EXCEEDS = "FLOOR_EXCEEDS"  # motion, view, retreat or a ratio to a limit has a higher index than is claimed
    COVER_WRONG = "COVER_WRONG"  # the intervals of a pair do not cover the path, or a pair has none
    ROW_EXCEEDS = "ROW_EXCEEDS"  # a row's recomputed index is above the claimed one
    MEANT_UNPROVEN = "MEANT_UNPROVEN"  # a contact that may not be meant, or is not gentle
    RETREAT_UNPROVEN = "RETREAT_UNPROVEN"  # a pair left out as a retreat that is none
    VIOLATION_HIDDEN = "VIOLATION_HIDDEN"  # a violation that is not claimed is not excluded
    VIOLATION_UNFOUNDED = "VIOLATION_UNFOUNDED"  # a claimed violation is not met where the document says
    LEGS_WRONG = "LEGS_WRONG"  # a leg of a path is missing or one too many, or the answer is not that of the worst
    NODE_OFF = "NODE_OFF"  # a recorded configuration is not where the motion has the arm, or of another branch
    NODE_MISSING = "NODE_MISSING"  # a row stands on a place for which nothing is recorded
    CELL_UNPROVEN = "CELL_UNPROVEN"  # the pieces do not tile the course, or the bounds of one do not hold
    LIMIT_UNFOUNDED = "LIMIT_UNFOUNDED"  # a motion is said to go beyond a joint's limit, and does not
    UNPROVEN = "UNPROVEN"  # a motion of which nothing can be proven: it has no answer
    CHECKER_FAILED = "CHECKER_FAILED"  # the checker itself broke: nothing is verified


@dataclass(frozen=True, slots=True)
class Verified:
    """Verdict that every row holds: no more than `index` can happen, as far as the question goes.

    Attributes:
        index: proven upper bound of the impact index, 0 to 4.
        tier: of the index.
        rows: number of recomputed rows.
        question: SHA-256 (hex) of the question in its canonical form; compare it with that of what was asked.
        model: SHA-256 (hex) that names the robot, its tool and what it holds.
        scene: SHA-256 (hex) that names the scene.
    """

    index: float
    tier: int
    rows: int
    question: str
    model: str
    scene: str


@dataclass(frozen=True, slots=True)
class Unverified:
    """Verdict that nothing is verified.

    Attributes:
        code: the reason.
        place: place in the document, for a person; short, and never a text of the document itself.
    """

    code: Code
    place: str


class Refusal(Exception):  # noqa: N818 - no error of the program: it carries a verdict to the one place that gives it
    """Exception that ends the check."""

    def __init__(self, code: Code, place: str) -> None:
        """Carries the verdict of the refusal."""
        super().__init__(f"{code}: {place}")
        self.verdict = Unverified(code, place)


def need(holds: bool, code: Code, place: str) -> None:  # noqa: FBT001 - an assertion with a verdict of its own
    """Refuses unless this holds."""
    if not holds:
        raise Refusal(code, place)
