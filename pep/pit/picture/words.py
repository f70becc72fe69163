"""Words of a picture: what decides an answer, in the sentence that an ask about it has."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from capabilities.statements.people.ask_words import cause_sentence
from capabilities.values.characters import shown

if TYPE_CHECKING:
    from pep.pit.assessment.assessment import Assessment
    from policies.evidence.evidence import Contribution

MICRO_PER_MILLI: Final = 1_000  # micro units of a thousandth
MILLI: Final = 1_000  # thousandths of one
VIOLATIONS: Final = {
    "person": "the way leads through a person",
    "fragile": "the way leads through a fragile object",
    "rigid": "the way leads through an object",
    "joint_limit": "a joint would leave its limits",
    "workspace": "the arm would leave the workspace",
    "zone": "the arm would enter a closed zone",
    "self": "the arm would meet itself",
}


def headline(assessment: Assessment) -> str:
    """Tier, index and what decides, in one line."""
    return f"Tier {int(assessment.tier)}, index {assessment.index:.2f}: {sentence(assessment)}"


def sentence(assessment: Assessment) -> str:
    """Sentence about the deciding cause, without its end."""
    if assessment.violations:
        said = (VIOLATIONS.get(str(word), shown(str(word))) for word in assessment.violations)
        return f"refused at any speed, since {' and '.join(said)}"
    if not assessment.contributions:
        return "nothing raises it"
    return told(assessment.contributions[0])


def told(cause: Contribution) -> str:
    """One contribution in the words of an ask, without their end; and when it is."""
    thing, figures = shown(cause.object), {"clearance_um": cause.clearance_um, "speed_um_s": cause.speed_um_s}
    said = cause_sentence(cause.kind, shown(cause.link), thing, **figures).removesuffix(".")
    after = f", {cause.at_ms / MILLI:.2f} s after it begins" if cause.link else ""
    return f"{said[:1].lower()}{said[1:]}{after}"
