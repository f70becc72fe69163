"""Path of several legs, each from rest to rest, as one answer: the worst of them.

Its times are those of the whole path.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from capabilities.values.units import Unit
from pep.pit.assessment.assessment import LISTED, Assessment, Certificate
from pep.pit.base.tier import HIGHEST
from policies.evidence.evidence import Contribution, ImpactFault

if TYPE_CHECKING:
    from collections.abc import Iterable

    from pep.pit.base.motion import Joints


@dataclass(frozen=True, slots=True, eq=False)
class AssessedLeg:
    """One leg's answer and how long it takes."""

    answer: Assessment
    duration_s: float


@dataclass(frozen=True, eq=False)
class LegsCertificate(Certificate):
    """Proofs of all legs, in order, each with its answer; it has no rows of its own.

    Attributes:
        asked: the legs of the path.
        answers: fewer where one of them has the highest index, which none behind it can raise.
    """

    asked: int
    answers: tuple[Assessment, ...]

    def proves(self, index: float) -> bool:
        """As `Certificate.proves`: each leg's own proof does, of at most that."""
        whole = len(self.answers) == self.asked or index >= HIGHEST
        return whole and bool(self.answers) and all(answer.index <= index for answer in self.answers)

    @property
    def legs(self) -> tuple[Certificate, ...]:
        """The proofs alone."""
        return tuple(answer.certificate for answer in self.answers)


def as_one(start: Joints, asked: int, legs: Iterable[AssessedLeg | ImpactFault]) -> Assessment | ImpactFault:
    """Answer for all `asked` legs, at least one.

    An appended leg never lowers it. A leg that is a fault makes it one. Legs are asked for one by one, and none after a
    fault.
    """
    answers: list[Assessment] = []
    told: list[Contribution] = []
    after_s = 0.0
    for leg in legs:
        if isinstance(leg, ImpactFault):
            return leg
        answers.append(leg.answer)
        after_ms = round(after_s * Unit.MILLISECOND.per_si)
        told += [replace(cause, at_ms=cause.at_ms + after_ms) for cause in leg.answer.contributions]
        after_s += leg.duration_s
    worst = max(answers, key=lambda answer: answer.index)
    return replace(
        worst,
        speed_m_s=max(answer.speed_m_s for answer in answers),
        tcp_speed_m_s=max(answer.tcp_speed_m_s for answer in answers),
        contact_ratio=max(answer.contact_ratio for answer in answers),
        contributions=tuple(sorted(_once(told), key=lambda cause: -cause.index_milli)[:LISTED]),
        violations=tuple(sorted({word for answer in answers for word in answer.violations})),
        lower_tier_speed=None,  # each leg has a speed of its own
        start=start,
        certificate=LegsCertificate(asked, tuple(answers)),
    )


def _once(told: list[Contribution]) -> list[Contribution]:
    """Highest contribution about each thing, and of equal ones the first."""
    highest: dict[tuple[str, str], Contribution] = {}
    for cause in told:
        known = highest.get((cause.kind, cause.object))
        if known is None or cause.index_milli > known.index_milli:
            highest[cause.kind, cause.object] = cause
    return list(highest.values())
