"""One sentence on what would happen, in a person's words, and one on who asks, and why.

Every figure is the ask's own; a distance is rounded down and a speed up. The script of an ask's page says the same of
the signed text, out of the same words, and takes no vote where the page says otherwise ([PSK-8]).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

from capabilities.statements.people.ask import NO_ROBOT, claims

if TYPE_CHECKING:
    from collections.abc import Mapping

    from capabilities.statements.people.ask import Ask

WORDS: Final[dict[str, Any]] = {
    "links": {
        "base": "base",
        "shoulder": "shoulder",
        "upper_arm": "upper arm",
        "forearm": "forearm",
        "wrist": "wrist",
        "gripper": "gripper",
        "hande": "gripper",
        "payload": "held object",
    },
    "meets": {
        "person": "The {link} meets {object}, {speed} m/s.",
        "fragile": "The {link} meets {object}, which is fragile, {speed} m/s.",
        "rigid": "The {link} meets {object}, {speed} m/s.",
        "self": "The {link} meets the arm's own {object}, {speed} m/s.",
        "workspace": "The {link} leaves the workspace, {speed} m/s.",
        "zone": "The {link} enters the closed zone {object}, {speed} m/s.",
    },
    "kinds": {
        "person": "The {link} passes {object} at {mm} mm, {speed} m/s.",
        "fragile": "The {link} passes {object}, which is fragile, at {mm} mm, {speed} m/s.",
        "rigid": "The {link} passes {object} at {mm} mm, {speed} m/s.",
        "self": "The {link} passes the arm's own {object} at {mm} mm, {speed} m/s.",
        "workspace": "The {link} comes within {mm} mm of the edge of the workspace, {speed} m/s.",
        "zone": "The {link} comes within {mm} mm of the closed zone {object}, {speed} m/s.",
        "tiered_zone": "The {link} enters the zone {object}, {speed} m/s.",
        "meant_contact": "The {link} touches {object}, as is meant, {speed} m/s.",
        "retreat": "The arm leaves {object}, which it is too near to, {speed} m/s.",
        "perception": "The sensors' view of the cell is {object}: nobody knows who is near.",
        "tcp_speed": "Its own speed decides: the arm moves at up to {speed} m/s.",
        "elbow_speed": "The speed of its elbow decides: the arm moves at up to {speed} m/s.",
        "momentum": "Its weight and speed decide: the arm moves at up to {speed} m/s.",
        "torque": "The torque of a joint decides: the arm moves at up to {speed} m/s.",
        "payload": "The weight of what it holds decides: the arm moves at up to {speed} m/s.",
        "joint_speed": "The speed of a joint decides: the arm moves at up to {speed} m/s.",
        "acceleration": "The acceleration of a joint decides: the arm moves at up to {speed} m/s.",
        "hand": "A person leads the arm by hand.",
        "output": "The output {object} is switched.",
        "undeclared_output": "The output {object} is switched, which the cell file does not have.",
    },
    "other": "{kind} decides: {link} {object}, {speed} m/s.",
    "alone": "{operation} of {name}: nothing that is seen is near.",
    "act": "{operation} of {name}: no robot moves.",
    "person": "person {name}'s {region}",
    "who": "Agent {agent}, for {sponsor}. Why you: tier {tier}.",
}
"""All English texts of both sentences; a translation is another table of these names."""
CODE_DIGITS: Final = 8
NAME_LIMIT: Final = 40
"""Characters of another's name that the sentence has, so that figures stay in sight; all of it stands below."""
UM_PER_MM: Final = 1_000
UM_PER_CM: Final = 10_000
CM_PER_M: Final = 100


def code_of(digest: str) -> str:
    """Short code of an ask, on the page and at a terminal: first eight hex digits of its text's digest."""
    return digest[:CODE_DIGITS]


def sentence_of(ask: Ask) -> str:
    """The sentence on what would happen."""
    return sentence_of_claims(claims(ask))


def sentence_of_claims(shown: Mapping[str, Any]) -> str:
    """The same sentence, of the members of an ask as plain JSON."""
    if shown["contributors"]:
        first = shown["contributors"][0]
        figures = {name: first[name] for name in ("clearance_um", "speed_um_s")}
        return cause_sentence(first["kind"], first["link"], first["object"], **figures)
    named = {"operation": _short(shown["operation"]), "name": _short(shown["object"])}
    return str(WORDS["act" if shown["perception"] == NO_ROBOT else "alone"]).format(**named)


def reason_of(ask: Ask) -> str:
    """The sentence on who asks, and why a person is asked."""
    return str(WORDS["who"]).format(agent=_short(ask.agent), sponsor=_short(ask.sponsor), tier=int(ask.tier))


def cause_sentence(kind: str, link: str, thing: str, *, clearance_um: int, speed_um_s: int) -> str:
    """The sentence on one contribution to the index.

    Args:
        kind: of the contribution.
        link: part of the arm, or "".
        thing: object of the contribution, or "".
        clearance_um: from the link to the thing; 0 or less where they meet.
        speed_um_s: greatest speed there.
    """
    hundredths = -(-speed_um_s // UM_PER_CM)
    told = {
        "kind": _short(kind),
        "link": _link(link),
        "object": _object(kind, thing),
        "mm": str(clearance_um // UM_PER_MM),
        "speed": f"{hundredths // CM_PER_M}.{hundredths % CM_PER_M:02d}",
    }
    kinds = WORDS["kinds"] if clearance_um > 0 else WORDS["kinds"] | WORDS["meets"]
    return str(kinds.get(kind, WORDS["other"])).format(**told)


def _link(name: str) -> str:
    return next((word for begins, word in WORDS["links"].items() if name.startswith(begins)), _short(name) or "arm")


def _object(kind: str, thing: str) -> str:
    if kind == "self":
        return _link(thing)
    name, slash, region = thing.partition("/")
    if kind == "person" and slash:
        return str(WORDS["person"]).format(name=_short(name), region=_short(region.replace("_", " ")))
    return _short(thing)


def _short(name: str) -> str:
    return name if len(name) <= NAME_LIMIT else f"{name[: NAME_LIMIT - 1]}…"
