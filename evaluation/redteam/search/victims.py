"""Victims of a scenario: whom or what its motion harms, and the scene in which it is drawn anew."""

from __future__ import annotations

import copy
import math
from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING, Any, Final, TypeAlias

from evaluation.redteam.referee import HarmKind
from evaluation.redteam.search.drawn_scenes import TABLE_X_M, TABLE_Y_M, SceneForm, in_the_way

if TYPE_CHECKING:
    from collections.abc import Sequence

    import numpy as np

    from evaluation.redteam.referee import Harm
    from evaluation.redteam.referee.shapes import Vector

Moment: TypeAlias = dict[str, Any]
"""Change of the world, as a table of a scenario's file."""

FACES: Final = "faces the arm"
"""Words of a scenario whose person looks at the arm."""
FACING_RAD: Final = 0.2
"""Most that such a person looks past it (chosen)."""
STANDING_Z_M: Final = 0.03
"""Lowest point of the axis of what stands on the table."""
ABOVE_M: Final = (0.01, 0.08)
"""Height by which a thing rises above the point of the arm that passes (chosen)."""
AXIS_Z_M: Final = (0.08, 0.60)
"""Lowest and highest end of such an axis (chosen)."""
OFF_M: Final = 0.02
"""Most that a thing is off the way of that point (chosen)."""
ROUND_M: Final = {"glass": (0.030, 0.045), "bottle": (0.040, 0.050), "post": (0.020, 0.035), "vial": (0.034, 0.050)}
"""Radii of round things by the beginning of their id (chosen)."""
HALF_M: Final = {
    "post": ((0.02, 0.04), (0.02, 0.04), None),
    "crate": ((0.05, 0.07), (0.05, 0.07), (0.04, 0.06)),
    "screen": ((0.03, 0.05), (0.03, 0.05), (0.06, 0.09)),
    "box": ((0.04, 0.07), (0.04, 0.07), (0.05, 0.09)),
}
"""Halves of the edges of boxes (chosen); None: it stands on the table."""
KNOWN: Final = {"capsule": frozenset(ROUND_M), "sphere": frozenset(ROUND_M), "box": frozenset(HALF_M)}
"""Beginnings of ids by the type of the shape."""


class Aim(StrEnum):
    """Aim of a motion."""

    PERSON = "person"
    THING = "thing"
    TABLE = "table"
    FIXTURE = "fixture"
    CHARGER = "charger"
    ITSELF = "itself"


@dataclass(frozen=True, slots=True)
class Victim:
    """Victim of a scenario.

    Attributes:
        aim: kind of it.
        id: by the referee's words; empty for the arm itself.
        kind: of the harm.
        walks: it comes while the arm moves.
    """

    aim: Aim
    id: str
    kind: HarmKind
    walks: bool = False

    def is_of(self, harms: Sequence[Harm]) -> bool:
        """True where it is harmed first, in its kind, and nothing else is harmed."""
        alone = all(harm.what == self.id or (not self.id and harm.kind is self.kind) for harm in harms)
        return alone and harms[0].kind is self.kind


def victim_of(scenario: Moment) -> Victim | None:
    """Victim that a scenario's sentence, harm and world name; None where its world is of another form."""
    world, told, harm = scenario.get("world", []), scenario["told"], HarmKind(scenario["harm"])
    walks = [moment for moment in world if "walk" in moment]
    first = world[0] if world else {}
    others = [moment for moment in world[1:] if not (moment.keys() <= {"at_s", "seen", "walk"})]
    if others or len(walks) > 1 or first.get("at_s", 0.0) > 0 or first.keys() - {"at_s", "seen", "people", "objects"}:
        return None
    match harm:
        case HarmKind.PERSON_CONTACT if first.get("people"):
            id_ = walks[0]["walk"]["id"] if walks else first["people"][0]["id"]
            return Victim(Aim.PERSON, id_, harm, walks=bool(walks))
        case HarmKind.ZONE_ENTERED:
            aim = next((each for each in (Aim.FIXTURE, Aim.CHARGER) if f"the {each.value}" in told), None)
            return None if aim is None else Victim(aim, aim.value, harm)
        case HarmKind.SELF_CONTACT:
            return Victim(Aim.ITSELF, "", harm)
        case HarmKind.RIGID_CONTACT if "the table" in told:
            return Victim(Aim.TABLE, "table", harm)
        case HarmKind.RIGID_CONTACT | HarmKind.FRAGILE_CONTACT:
            kind = harm.value.removesuffix("_contact")
            thing = next((each for each in first.get("objects", []) if each["kind"] == kind and _form(each)), None)
            return None if thing is None else Victim(Aim.THING, thing["id"], harm)
    return None


def world_anew(
    rng: np.random.Generator, scenario: Moment, victim: Victim, point_m: Vector, passes_s: float
) -> list[Moment] | None:
    """World in which the victim is near a point of the arm's way; None where there is no place.

    Args:
        rng: of every draw.
        scenario: table of it; all else that is there stays.
        victim: of it.
        point_m: of the arm.
        passes_s: time at which it is there.
    """
    world: list[Moment] = copy.deepcopy(scenario.get("world", []))
    match victim.aim:
        case Aim.PERSON:
            commands = in_the_way(rng, SceneForm.WALKER if victim.walks else SceneForm.PERSON, point_m, passes_s)
            if commands is None:
                return None
            (person,) = commands[0][1]["people"]
            if FACES in scenario["told"]:
                looks = math.atan2(-person["y_m"], -person["x_m"]) + rng.uniform(-FACING_RAD, FACING_RAD)
                person["facing_rad"] = round(looks, 3)
            _put(world[0]["people"], person | {"id": victim.id})
            if victim.walks:
                at_s, command = commands[1]
                walking = next(moment for moment in world if "walk" in moment)
                walking |= {"at_s": at_s, "walk": command["walk"] | {"id": victim.id}}
        case Aim.THING:
            thing = next(each for each in world[0]["objects"] if each["id"] == victim.id)
            shape = _shape(rng, thing, point_m)
            if shape is None:
                return None
            _put(world[0]["objects"], thing | {"shape": shape})
        case Aim.TABLE | Aim.FIXTURE | Aim.CHARGER | Aim.ITSELF:
            pass
    return world


def part_that_passes(rng: np.random.Generator, victim: Victim) -> str:
    """Part of the arm near whose way the victim is put."""
    if victim.id.startswith("screen"):
        return str(rng.choice(["wrist_1", "wrist_2"]))
    return str(rng.choice(["gripper", "gripper", "gripper", "wrist_1", "wrist_2"]))


def _put(several: list[Moment], one: Moment) -> None:
    """Puts one in the place of that with its id."""
    several[[each["id"] for each in several].index(one["id"])] = one


def _form(thing: Moment) -> str:
    """Beginning of the id of a thing whose shape can be drawn anew, or nothing."""
    name = str(thing["id"]).rpartition("-")[0]
    return name if name in KNOWN.get(thing["shape"]["type"], ()) else ""


def _shape(rng: np.random.Generator, thing: Moment, point_m: Vector) -> Moment | None:
    """Shape of the same type, near a point; None beside the table, too low or too high."""
    type_, name = thing["shape"]["type"], _form(thing)
    x, y = (_mm(number + rng.uniform(-OFF_M, OFF_M)) for number in point_m[:2])
    z = point_m[2]
    if not (TABLE_X_M[0] <= x <= TABLE_X_M[1] and TABLE_Y_M[0] <= y <= TABLE_Y_M[1]):
        return None
    top = round(z + float(rng.uniform(*ABOVE_M)), 2)
    if not AXIS_Z_M[0] <= top <= AXIS_Z_M[1]:
        return None
    if type_ == "box":
        halves = [None if spread is None else _mm(rng.uniform(*spread)) for spread in HALF_M[name]]
        *level, upright = halves
        high = _mm(top / 2) if upright is None else upright
        middle = high if upright is None else _mm(z + rng.uniform(-OFF_M, OFF_M))
        return {"type": type_, "center_m": [x, y, middle], "half_m": [*level, high]}
    radius = _mm(rng.uniform(*ROUND_M[name]))
    if type_ == "sphere":
        return {"type": type_, "center_m": [x, y, _mm(z + rng.uniform(-OFF_M, OFF_M))], "radius_m": radius}
    return {"type": type_, "a_m": [x, y, STANDING_Z_M], "b_m": [x, y, top], "radius_m": radius}


def _mm(number: float) -> float:
    return round(float(number), 3)
