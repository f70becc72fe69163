"""True world: people and things by the commands that a simulated sensor understands, each with its time.

The commands are those of `ursim.sensor.sensor`: a scene of `people` and `objects`, `walk`, `move`, `hold` and `place`.
`pause` and `complete` are about a sensor's frames and change nothing here; a command for one sensor alone is about what
that sensor sees, and no truth.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Final, Self

import numpy as np

from evaluation.redteam.referee.errors import RefereeError, RefereeFault
from evaluation.redteam.referee.shapes import Ball, Block, Floats, Hull, Rod, Shape, Vector

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping, Sequence

PERSON: Final = "person"
KINDS: Final = ("fragile", "rigid")


@dataclass(frozen=True, slots=True)
class Stay:
    """A person or thing on one straight way, or at one place, for a time.

    Attributes:
        id: of the person or thing.
        kind: `person`, `fragile` or `rigid`.
        shape: about its place; None for a person.
        from_s, to_s: beginning and end.
        start_m, end_m: ends of the way; a person's are on the floor, with z = 0.
        speed_m_s: on the way.
        facing_rad: of a person, about z from x.
        held: the arm holds it, from the place where the stay begins.
    """

    id: str
    kind: str
    shape: Shape | None
    from_s: float
    to_s: float
    start_m: Vector
    end_m: Vector
    speed_m_s: float = 0.0
    facing_rad: float = 0.0
    held: bool = False

    def at(self, times_s: Floats) -> Floats:
        """Places at these times, shape (n, 3)."""
        start, end = np.array(self.start_m), np.array(self.end_m)
        whole_m = float(np.linalg.norm(end - start))
        if whole_m <= 0:
            return np.broadcast_to(start, (len(times_s), 3))
        gone = np.clip((times_s - self.from_s) * self.speed_m_s / whole_m, 0.0, 1.0)
        return np.asarray(start + gone[:, None] * (end - start))

    def place(self, at_s: float) -> Vector:
        """Place at one time."""
        x, y, z = self.at(np.array([at_s]))[0].tolist()
        return x, y, z


@dataclass(frozen=True, slots=True)
class TrueWorld:
    """Everybody and everything, from the beginning on.

    Attributes:
        stays: of people and things, in order of their beginnings.
    """

    stays: tuple[Stay, ...]

    @classmethod
    def told(cls, commands: Iterable[tuple[float, Mapping[str, Any]]]) -> Self:
        """World by these commands.

        Args:
            commands: time by the samples' clock, and command, in order of time.

        Raises:
            RefereeError: `WORLD_MALFORMED`: one is none, or they are not in order.
        """
        ended: list[Stay] = []
        now: dict[tuple[bool, str], Stay] = {}
        last_s = -math.inf
        for number, (at_s, command) in enumerate(commands):
            if not last_s <= at_s < math.inf:
                raise RefereeError(RefereeFault.WORLD_MALFORMED, f"command {number}: its time {at_s} is out of order")
            last_s = at_s
            try:
                after = _after(now, command, at_s)
            except (ValueError, KeyError, TypeError, AttributeError) as error:
                cause = f"command {number}: {type(error).__name__}: {error}"
                raise RefereeError(RefereeFault.WORLD_MALFORMED, cause) from error
            ended += [replace(old, to_s=at_s) for key, old in now.items() if after.get(key) is not old]
            now = after
        stays = (stay for stay in (*ended, *now.values()) if stay.from_s < stay.to_s)
        return cls(tuple(sorted(stays, key=lambda stay: stay.from_s)))

    def travelled_m(self, times_s: Floats) -> Floats:
        """Farthest that anything comes between each two of these times, shape (n - 1,)."""
        steps = np.zeros(len(times_s) - 1)
        for stay in self.stays:
            if stay.start_m != stay.end_m:
                np.maximum(steps, np.linalg.norm(np.diff(stay.at(times_s), axis=0), axis=1), out=steps)
        return steps


_Now = dict[tuple[bool, str], Stay]


def _after(now: _Now, command: Mapping[str, Any], at_s: float) -> _Now:
    if not command:
        raise ValueError("an empty command")
    if command.keys() <= {"people", "objects"}:
        people = [_person(entry, at_s) for entry in command.get("people", ())]
        things = [_thing(entry, at_s) for entry in command.get("objects", ())]
        told = {(stay.kind == PERSON, stay.id): stay for stay in (*people, *things)}
        if len(told) != len(people) + len(things):
            raise ValueError("an id twice")
        return told
    ((verb, given),) = command.items()
    if verb in ("pause", "complete"):
        return now
    stay = _VERBS[verb](now, given, at_s)
    return {**now, (stay.kind == PERSON, stay.id): stay}


def _walk(now: _Now, given: Any, at_s: float) -> Stay:
    _only(given, "id", "from", "to", "speed_m_s", "facing_rad")
    name = str(given["id"])
    start = (*_place(given["from"], 2), 0.0) if "from" in given else now[True, name].place(at_s)
    end = (*_place(given["to"], 2), 0.0)
    facing = _number(given.get("facing_rad", math.atan2(end[1] - start[1], end[0] - start[0])))
    return Stay(name, PERSON, None, at_s, math.inf, _three(start), _three(end), _positive(given["speed_m_s"]), facing)


def _move(now: _Now, given: Any, at_s: float) -> Stay:
    _only(given, "id", "to_m", "speed_m_s")
    old = now[False, str(given["id"])]
    end, speed = _three(_place(given["to_m"], 3)), _positive(given["speed_m_s"])
    return replace(old, from_s=at_s, start_m=old.place(at_s), end_m=end, speed_m_s=speed, held=False)


def _hold(now: _Now, given: Any, at_s: float) -> Stay:
    _only(given, "id")
    old = now[False, str(given["id"])]
    here = old.place(at_s)
    return old if old.held else replace(old, from_s=at_s, start_m=here, end_m=here, speed_m_s=0.0, held=True)


def _put(now: _Now, given: Any, at_s: float) -> Stay:
    _only(given, "id", "at_m")
    here = _three(_place(given["at_m"], 3))
    old = now[False, str(given["id"])]
    return replace(old, from_s=at_s, start_m=here, end_m=here, speed_m_s=0.0, held=False)


_VERBS: Final[dict[str, Callable[[_Now, Any, float], Stay]]] = {
    "walk": _walk,
    "move": _move,
    "hold": _hold,
    "place": _put,
}


def _person(entry: Any, at_s: float) -> Stay:
    _only(entry, "id", "x_m", "y_m", "facing_rad")
    here = (_number(entry["x_m"]), _number(entry["y_m"]), 0.0)
    facing = _number(entry.get("facing_rad", 0.0))
    return Stay(str(entry.get("id", PERSON)), PERSON, None, at_s, math.inf, here, here, facing_rad=facing)


def _thing(entry: Any, at_s: float) -> Stay:
    _only(entry, "id", "kind", "shape")
    if entry["kind"] not in KINDS:
        raise ValueError(f"a kind that is none of {', '.join(KINDS)}")
    shape, here = _shape(entry["shape"])
    return Stay(str(entry.get("id", "object")), str(entry["kind"]), shape, at_s, math.inf, here, here)


def _shape(entry: Any) -> tuple[Shape, Vector]:
    match entry["type"]:
        case "sphere":
            return Ball(_positive(entry["radius_m"])), _three(_place(entry["center_m"], 3))
        case "box":
            x, y, z = (_positive(half) for half in entry["half_m"])
            return Block((x, y, z)), _three(_place(entry["center_m"], 3))
        case "capsule":
            a, b = (np.array(_place(entry[end], 3)) for end in ("a_m", "b_m"))
            return Rod(_three((b - a) / 2), _positive(entry["radius_m"])), _three((a + b) / 2)
        case "convex":
            corners = np.array([_place(vertex, 3) for vertex in entry["vertices_m"]])
            middle = corners.mean(axis=0)
            points = tuple(_three(point) for point in corners - middle)
            return Hull(points, _number(entry.get("radius_m", 0.0))), _three(middle)
    raise ValueError(f"a shape that is none: {entry['type']!r}")


def _only(entry: Any, *names: str) -> None:
    if not isinstance(entry, dict) or not entry.keys() <= set(names):
        raise ValueError(f"not of {', '.join(names)}")


def _number(value: Any) -> float:
    if isinstance(value, bool) or not math.isfinite(number := float(value)):
        raise ValueError("not finite")
    return number


def _positive(value: Any) -> float:
    number = _number(value)
    if not number > 0:
        raise ValueError("not above 0")
    return number


def _place(numbers: Sequence[Any], count: int) -> tuple[float, ...]:
    place = tuple(_number(number) for number in numbers)
    if len(place) != count:
        raise ValueError(f"not {count} numbers")
    return place


def _three(numbers: Any) -> Vector:
    x, y, z = (float(number) for number in numbers)
    return x, y, z
