"""Words of a picture: what decides an answer, in one sentence that a person reads."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from capabilities.values.characters import shown

if TYPE_CHECKING:
    from pep.pit.assessment.assessment import Assessment
    from policies.evidence.evidence import Contribution

MICRO_PER_MILLI: Final = 1_000  # micro units of a thousandth
MICRO: Final = 1_000_000  # micro units of one
MILLI: Final = 1_000  # thousandths of one
NAME_LIMIT: Final = 40  # ours, as below
"""Characters of another's name that a sentence has; the numbers after it are never pushed out."""
VIOLATIONS: Final = {
    "person": "the way leads through a person",
    "fragile": "the way leads through a fragile object",
    "rigid": "the way leads through an object",
    "joint_limit": "a joint would leave its limits",
    "workspace": "the arm would leave the workspace",
    "zone": "the arm would enter a closed zone",
    "self": "the arm would meet itself",
}
LIMITS: Final = {
    "joint_speed": "a joint is fast, for its limit",
    "acceleration": "a joint speeds up fast, for its limit",
    "tcp_speed": "the tool is fast, for its limit",
    "elbow_speed": "the elbow is fast, for its limit",
    "momentum": "the arm has much momentum, for its limit",
    "torque": "a joint needs much torque, for its limit",
    "payload": "the load is heavy, for its limit",
}
PERCEPTION: Final = {
    "stale": "the sensors' last view is too old",
    "missing": "no sensor shows the cell",
    "incomplete": "the sensors do not see all of the cell",
}
TOOLS: Final = ("gripper", "hande")
"""First words of the names of capsules that are the tool's."""


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
    """One contribution in words."""
    thing, part = name_of(cause.object), part_of(cause.link)
    near = cause.clearance_um / MICRO_PER_MILLI
    passing = f"{part} {'passes' if near > 0 else 'meets'} {{}}{_when(cause)}"
    match cause.kind:
        case "person":
            person, _, region = cause.object.partition("/")
            whose = f"person {name_of(person)}" + (f"'s {region.replace('_', ' ')}" if region else "")
            return passing.format(whose)
        case "fragile":
            return passing.format(f"the fragile object {thing}")
        case "rigid":
            return passing.format(f"the object {thing}")
        case "self":
            return passing.format(f"the arm's own {part_of(cause.object).removeprefix('the ')}")
        case "workspace":
            return passing.format("the edge of the workspace")
        case "zone":
            return passing.format(f"the closed zone {thing}")
        case "tiered_zone":
            return passing.format(f"the zone {thing}")
        case "meant_contact":
            return f"{part} touches {thing}, as it may{_when(cause)}"
        case "retreat":
            return f"the arm backs away from {thing}"
        case "perception":
            return PERCEPTION.get(cause.object, f"the view of the cell is {thing}")
        case "output":
            return f"the output {thing} is switched"
        case "undeclared_output":
            return f"the output {thing} is not in the cell file"
        case _:
            return LIMITS.get(cause.kind, f"{cause.kind.replace('_', ' ')} {thing}".strip())


def part_of(link: str) -> str:
    """A part of the robot in words."""
    if link.startswith(TOOLS):
        return "the gripper"
    if link == "payload":
        return "the held object"
    for whole in ("upper_arm", "forearm", "shoulder", "base"):
        if link.startswith(whole):
            return f"the {whole.replace('_', ' ')}"
    return f"the {name_of(link).replace('_', ' ')}" if link else "the arm"


def name_of(other: str) -> str:
    """Another's name as people are shown it, not longer than `NAME_LIMIT`."""
    spelled = shown(other)
    return spelled if len(spelled) <= NAME_LIMIT else f"{spelled[: NAME_LIMIT - 1]}…"


def _when(cause: Contribution) -> str:
    near, after = cause.clearance_um / MICRO_PER_MILLI, cause.at_ms / MILLI
    far = f" at {near:.0f} mm" if near > 0 else ""
    fast = f", at up to {cause.speed_um_s / MICRO:.2f} m/s" if cause.speed_um_s else ""
    return f"{far}, {after:.2f} s after it begins{fast}" if cause.link else ""
