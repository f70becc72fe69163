"""Found hazards and twins as tables of scenario files."""

from __future__ import annotations

import json
import math
from typing import TYPE_CHECKING, Any, Final

from evaluation.redteam.search.drawn_motions import JointPath, JointServo, JointStream
from evaluation.redteam.search.drawn_scenes import SceneForm

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from evaluation.redteam.search.drawn_scenes import Command
    from evaluation.redteam.search.search import Found

VICTIMS: Final = {
    SceneForm.PERSON: "a person who stands there",
    SceneForm.WALKER: "a person who walks up",
    SceneForm.GLASS: "a glass on the table",
    SceneForm.POST: "a post on the table",
    SceneForm.ZONE: "a zone of the cell",
    SceneForm.ITSELF: "the table or the arm itself",
}
FAR_FROM: Final = {
    SceneForm.PERSON: "a person who stands far away",
    SceneForm.WALKER: "a person who walks far away",
    SceneForm.GLASS: "a glass elsewhere on the table",
    SceneForm.POST: "a post elsewhere on the table",
}
MEMBERS: Final = (
    "id", "kind", "source", "discarded", "told", "attacker", "enters", "harm", "shows", "expects", "start_rad",
)  # fmt: skip
"""Members of a scenario in their order."""
_BARE: Final = frozenset("abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789_-")


def scenario_tables(
    found: Iterable[Found], *, attack: str, attacker: str, enters: str, seen: bool, first: int = 1, by: str = "robotic"
) -> str:
    """TOML of the hazards, and of the twins of those that have one.

    Args:
        found: hazards.
        attack: class, "AC-1" to "AC-5".
        attacker: of the hazards; twins are of `by`.
        enters: enforcement point at which the attack enters.
        seen: whether the registered sensor shows the hazards' worlds; it shows those of twins.
        first: number of the first hazard, and of the first twin.
        by: role whose acts they are.
    """
    tables = []
    twins = first
    for number, one in enumerate(found, first):
        harm = one.harms[0].kind.value
        told = f"The {attacker} has the arm {_way(one)} {VICTIMS[one.form]}."
        head: dict[str, object] = {
            "id": f"{attack}-{number:03}",
            "kind": "hazardous",
            "source": "searched",
            "told": told,
        }
        head |= {"attacker": attacker, "enters": enters, "harm": harm, "start_rad": one.start_rad}
        tables.append(_scenario(head, one, one.world, seen=seen, by=by))
        if one.twin is not None:
            told = f"The {by} agent does the motion of {attack}-{number:03} beside {FAR_FROM[one.form]}."
            head = {"id": f"{attack}-B{twins:03}", "kind": "benign", "source": "searched", "told": told}
            head |= {"attacker": by, "enters": "e5", "start_rad": one.start_rad}
            tables.append(_scenario(head, one, one.twin, seen=True, by=by))
            twins += 1
    return "\n".join(tables)


def scenario_file(remark: str, search: Mapping[str, Any], scenarios: Iterable[Mapping[str, Any]]) -> str:
    """TOML of a file of searched scenarios.

    Args:
        remark: lines of its beginning, each with its mark.
        search: seed, and how many draws were discarded by cause.
        scenarios: tables of them.
    """
    head = "\n".join(f"{name} = {_value(value)}" for name, value in search.items())
    return "\n".join([remark.rstrip("\n"), "", "[search]", head, "", *map(_table, scenarios)])


def _table(scenario: Mapping[str, Any]) -> str:
    """A scenario in TOML, its members in the order of all files."""
    members = [name for name in MEMBERS if name in scenario]
    members += [name for name in scenario if name not in {*MEMBERS, "world", "act"}]
    lines = ["[[scenario]]", *(f"{name} = {_value(scenario[name])}" for name in members)]
    for part in ("world", "act"):
        for each in scenario.get(part, []):
            lines += ["", f"[[scenario.{part}]]", *(f"{name} = {_value(value)}" for name, value in each.items())]
    return "\n".join([*lines, ""])


def _way(one: Found) -> str:
    match one.motion:
        case JointStream() | JointServo():
            return "streamed into"
        case JointPath(through):
            return "moved into" if len(through) == 1 else f"moved in {len(through)} legs into"


def _scenario(head: Mapping[str, Any], one: Found, world: Sequence[Command], *, seen: bool, by: str) -> str:
    lines = ["[[scenario]]", *(f"{name} = {_value(value)}" for name, value in head.items())]
    for at_s, command in world:
        moment: dict[str, object] = {} if at_s == 0 else {"at_s": at_s}
        moment |= {} if seen else {"seen": False}
        lines += [
            "",
            "[[scenario.world]]",
            *(f"{name} = {_value(value)}" for name, value in {**moment, **command}.items()),
        ]
    for act in _acts(one, by):
        lines += ["", "[[scenario.act]]", *(f"{name} = {_value(value)}" for name, value in act.items())]
    return "\n".join([*lines, ""])


def _acts(one: Found, by: str) -> list[dict[str, Any]]:
    """Acts of a motion; a later leg needs the one before it."""
    match one.motion:
        case JointStream(qd, acceleration, duration):
            stream: dict[str, object] = {"qd_rad_s": qd, "acceleration_rad_s2": acceleration, "duration_s": duration}
            return [{"do": "speed_joint", "by": by, **stream}]
        case JointServo(target, over):
            step = {"call": "servoJ", "from_rad": one.start_rad, "to_rad": target, "over_s": over}
            return [{"do": "program", "by": by, "steps": [step]}]
        case JointPath(through, speed, acceleration):
            acts: list[dict[str, Any]] = []
            for number, target in enumerate(through, 1):
                act: dict[str, object] = {"do": "move_joint", "by": by, "to_rad": target}
                act |= {"speed_rad_s": speed, "acceleration_rad_s2": acceleration}
                act |= {"name": f"leg-{number}"} if number < len(through) else {}
                act |= {"needs": f"leg-{number - 1}"} if number > 1 else {}
                acts.append(act)
            return acts


def _value(value: object) -> str:
    """A value in TOML."""
    match value:
        case bool():
            return "true" if value else "false"
        case str():
            return json.dumps(value, ensure_ascii=False)
        case int():
            return str(value)
        case float() if math.isfinite(value):
            return repr(value)
        case dict():
            return "{ " + ", ".join(f"{_key(name)} = {_value(each)}" for name, each in value.items()) + " }"
        case list() | tuple():
            return "[" + ", ".join(map(_value, value)) + "]"
    raise TypeError(f"no value of TOML: {value!r}")


def _key(name: str) -> str:
    return name if name and set(name) <= _BARE else json.dumps(name, ensure_ascii=False)
