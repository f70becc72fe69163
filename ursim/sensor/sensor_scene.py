"""Scene of a simulated sensor, told by commands: people who stand or walk, objects that lie, move or are held.

Every motion is straight, at a steady speed, and begins with the first frame after its command, by the sensor's own
clock. A command that is wrong in any part changes nothing.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, Final

from msgspec import structs

from capabilities.statements import observation as wire
from capabilities.values.errors import CapabilityError
from capabilities.values.form import plain
from pep.pit import observed, standing_adult

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

MICRO: Final = 1e6
UPRIGHT: Final = (1_000_000, 0, 0, 0)


class SceneCommandError(ValueError):
    """A command line that is none."""


@dataclass(frozen=True, slots=True)
class Way:
    """Straight way, metres; that of a standing person has no length."""

    start_m: tuple[float, ...]
    end_m: tuple[float, ...]
    speed_m_s: float = 0.0
    begun_s: float | None = None

    def begun(self, now_s: float) -> Way:
        """Way that has begun by now."""
        return self if self.begun_s is not None else replace(self, begun_s=now_s)

    def at(self, now_s: float) -> tuple[float, ...]:
        """Point of the way that is reached by now."""
        whole_m = math.dist(self.start_m, self.end_m)
        gone_m = self.speed_m_s * max(0.0, now_s - (now_s if self.begun_s is None else self.begun_s))
        share = min(1.0, gone_m / whole_m) if whole_m > 0 else 1.0
        return tuple(a + share * (b - a) for a, b in zip(self.start_m, self.end_m, strict=True))


@dataclass(frozen=True, slots=True)
class _Walker:
    way: Way
    facing_rad: float


@dataclass(frozen=True, slots=True)
class _Thing:
    """An object; its shape is that at the origin of its way."""

    kind: str
    shape: wire.Shape
    way: Way
    held: bool = False


@dataclass(frozen=True, slots=True)
class Seen:
    """Scene and state of a sensor. Frozen: a command gives a new one.

    Attributes:
        people, objects: by id.
        complete: whether its frames claim to cover the watched volume.
        paused: it sends nothing.
    """

    people: dict[str, _Walker]
    objects: dict[str, _Thing]
    complete: bool = True
    paused: bool = False

    @classmethod
    def nothing(cls) -> Seen:
        """An empty cell, seen whole."""
        return cls({}, {})

    def at(self, now_s: float) -> tuple[Seen, tuple[wire.ObservedPerson, ...], tuple[wire.ObservedObject, ...]]:
        """Scene now, with every motion begun; people and objects as a frame tells them."""
        people = {name: replace(one, way=one.way.begun(now_s)) for name, one in self.people.items()}
        objects = {name: replace(one, way=one.way.begun(now_s)) for name, one in self.objects.items()}
        return (
            replace(self, people=people, objects=objects),
            tuple(_adult(name, one, now_s) for name, one in people.items()),
            tuple(
                wire.ObservedObject(name, one.kind, _shifted(one.shape, one.way.at(now_s)))
                for name, one in objects.items()
                if not one.held
            ),
        )

    def told(self, command: object, *, now_s: float) -> Seen:
        """Scene after a command.

        Args:
            command: one of those that `python -m ursim.sensor.sensor --help` lists, parsed.
            now_s: the sensor's clock; it places those who move.

        Raises:
            SceneCommandError: it is none.
        """
        try:
            if not isinstance(command, dict) or not command:
                raise SceneCommandError("not an object")
            if command.keys() <= {"people", "objects"}:
                return replace(
                    self,
                    people=_each(command.get("people", []), _person),
                    objects=_each(command.get("objects", []), _object),
                )
            ((verb, given),) = command.items()
            return _VERBS[verb](self, given, now_s)
        except (ValueError, KeyError, TypeError, AttributeError, OverflowError) as error:
            raise SceneCommandError(f"{type(error).__name__}: {error}") from error


# --- commands --------------------------------------------------------------------------------------------------------


def _pause(seen: Seen, given: Any, _now_s: float) -> Seen:
    return replace(seen, paused=_flag(given))


def _complete(seen: Seen, given: Any, _now_s: float) -> Seen:
    return replace(seen, complete=_flag(given))


def _walk(seen: Seen, given: Any, now_s: float) -> Seen:
    name, end = _only(given, "id", "from", "to", "speed_m_s", "facing_rad")["id"], _place(given["to"], 2)
    known = seen.people.get(str(name))
    if "from" not in given and known is None:
        raise SceneCommandError("nobody of that id stands there")
    start = _place(given["from"], 2) if known is None or "from" in given else known.way.at(now_s)
    heading = math.atan2(end[1] - start[1], end[0] - start[0])
    walker = _Walker(Way(start, end, _speed(given)), _number(given.get("facing_rad", heading)))
    return replace(seen, people={**seen.people, str(name): walker})


def _move(seen: Seen, given: Any, now_s: float) -> Seen:
    name = str(_only(given, "id", "to_m", "speed_m_s")["id"])
    thing = seen.objects[name]
    way = Way(thing.way.at(now_s), _place(given["to_m"], 3), _speed(given))
    return replace(seen, objects={**seen.objects, name: replace(thing, way=way)})


def _hold(seen: Seen, given: Any, _now_s: float) -> Seen:
    name = str(_only(given, "id")["id"])
    return replace(seen, objects={**seen.objects, name: replace(seen.objects[name], held=True)})


def _put(seen: Seen, given: Any, _now_s: float) -> Seen:
    name, place = str(_only(given, "id", "at_m")["id"]), _place(given["at_m"], 3)
    placed = replace(seen.objects[name], way=Way(place, place), held=False)
    return replace(seen, objects={**seen.objects, name: placed})


_VERBS: Final[dict[str, Callable[[Seen, Any, float], Seen]]] = {
    "pause": _pause,
    "complete": _complete,
    "walk": _walk,
    "move": _move,
    "hold": _hold,
    "place": _put,
}


# --- reading ---------------------------------------------------------------------------------------------------------


def _each(entries: Any, read: Callable[[Any], tuple[str, Any]]) -> dict[str, Any]:
    if not isinstance(entries, list):
        raise SceneCommandError("not a list")
    found = [read(entry) for entry in entries]
    if len({name for name, _ in found}) != len(found):
        raise SceneCommandError("an id twice")
    return dict(found)


def _person(entry: Any) -> tuple[str, _Walker]:
    _only(entry, "id", "x_m", "y_m", "facing_rad")
    place = (_number(entry["x_m"]), _number(entry["y_m"]))
    return str(entry.get("id", "person")), _Walker(Way(place, place), _number(entry.get("facing_rad", 0.0)))


def _object(entry: Any) -> tuple[str, _Thing]:
    _only(entry, "id", "kind", "shape")
    if entry["kind"] not in wire.OBJECT_KINDS:
        raise SceneCommandError("a kind that is none")
    shape, place = _SHAPES[entry["shape"]["type"]](entry["shape"])
    return str(entry.get("id", "object")), _Thing(str(entry["kind"]), shape, Way(place, place))


def _sphere(entry: Any) -> tuple[wire.Shape, tuple[float, ...]]:
    return wire.Sphere((0, 0, 0), _length(entry["radius_m"])), _place(entry["center_m"], 3)


def _box(entry: Any) -> tuple[wire.Shape, tuple[float, ...]]:
    x, y, z = (_length(half) for half in entry["half_m"])
    return wire.Box((0, 0, 0), (x, y, z), UPRIGHT), _place(entry["center_m"], 3)


def _capsule(entry: Any) -> tuple[wire.Shape, tuple[float, ...]]:
    a, b = _place(entry["a_m"], 3), _place(entry["b_m"], 3)
    middle = tuple((p + q) / 2 for p, q in zip(a, b, strict=True))
    ends = [_um(tuple(p - m for p, m in zip(end, middle, strict=True))) for end in (a, b)]
    return wire.Capsule(ends[0], ends[1], _length(entry["radius_m"])), middle


def _convex(entry: Any) -> tuple[wire.Shape, tuple[float, ...]]:
    corners = [_place(vertex, 3) for vertex in entry["vertices_m"]]
    middle = tuple(sum(numbers) / len(corners) for numbers in zip(*corners, strict=True))
    about = [_um(tuple(p - m for p, m in zip(corner, middle, strict=True))) for corner in corners]
    radius = entry.get("radius_m", 0)
    shape = wire.Convex(tuple(about), _length(radius) if radius else 0)
    try:
        return wire.shape(plain(shape)), middle
    except CapabilityError as error:
        raise SceneCommandError("a convex shape that no frame can show") from error


_SHAPES: Final = {"sphere": _sphere, "box": _box, "capsule": _capsule, "convex": _convex}


def _only(entry: Any, *names: str) -> dict[str, Any]:
    if not isinstance(entry, dict) or not entry.keys() <= set(names):
        raise SceneCommandError(f"not of {', '.join(names)}")
    return entry


def _number(value: Any) -> float:
    if isinstance(value, bool) or not math.isfinite(number := float(value)):
        raise SceneCommandError("not finite")
    return number


def _speed(given: dict[str, Any]) -> float:
    speed = _number(given["speed_m_s"])
    if not speed > 0:
        raise SceneCommandError("a speed is above 0")
    return speed


def _length(value: Any) -> int:
    length = round(_number(value) * MICRO)
    if not length > 0:
        raise SceneCommandError("a size is above 0")
    return length


def _place(numbers: Sequence[Any], count: int) -> tuple[float, ...]:
    place = tuple(_number(number) for number in numbers)
    if len(place) != count:
        raise SceneCommandError(f"not {count} numbers")
    return place


def _flag(given: Any) -> bool:
    if not isinstance(given, bool):
        raise SceneCommandError("neither true nor false")
    return given


# --- telling ---------------------------------------------------------------------------------------------------------


def _adult(name: str, one: _Walker, now_s: float) -> wire.ObservedPerson:
    x_m, y_m = one.way.at(now_s)
    return observed(standing_adult(x_m, y_m, facing_rad=one.facing_rad, name=name))


def _um(place_m: tuple[float, ...]) -> wire.Point:
    x, y, z = (round(number * MICRO) for number in place_m)
    return (x, y, z)


def _shifted(shape: wire.Shape, place_m: tuple[float, ...]) -> wire.Shape:
    by = _um(place_m)

    def there(point: wire.Point) -> wire.Point:
        x, y, z = (a + b for a, b in zip(point, by, strict=True))
        return (x, y, z)

    if isinstance(shape, wire.Capsule):
        return structs.replace(shape, a_um=there(shape.a_um), b_um=there(shape.b_um))
    if isinstance(shape, wire.Convex):
        return structs.replace(shape, vertices_um=tuple(map(there, shape.vertices_um)))
    return structs.replace(shape, center_um=there(shape.center_um))


def parse(line: str) -> object:
    """The command on one line.

    Raises:
        SceneCommandError: the line is not JSON.
    """
    try:
        return json.loads(line)
    except (ValueError, RecursionError) as error:
        raise SceneCommandError("not JSON") from error
