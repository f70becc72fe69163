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
from pep.pit import Region, observed, standing_adult
from pep.pit.files.scene_file import body_of, shape_in
from pep.pit.files.shown_file import shown_of
from pep.pit.geometry.shape import stated

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from pep.pit.files.world_forms import ShownObject, ShownPerson

MICRO: Final = 1e6


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
                return _shown(self, command)
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


def _shown(seen: Seen, command: dict[str, Any]) -> Seen:
    """Scene of exactly these people and objects, in the words of the world file."""
    view = shown_of(command)
    return replace(
        seen,
        people={each.id: _walker(each) for each in view.people},
        objects={each.id: _thing(each) for each in view.objects},
    )


def _walker(shown: ShownPerson) -> _Walker:
    if shown.standing_adult is not None:
        adult = shown.standing_adult
        return _Walker(Way(place := (adult.x_m, adult.y_m), place), adult.facing_rad)
    away = shown.adult_at_distance
    if away is None:
        raise SceneCommandError("a person without a place")
    torso = next(shape for region, shape in body_of(shown).regions if region is Region.TORSO)
    x_m, y_m, _ = _middle(stated(torso))
    return _Walker(Way((x_m, y_m), (x_m, y_m)), away.bearing_rad + math.pi)


def _thing(shown: ShownObject) -> _Thing:
    """An object about its middle; it is refused where no frame could show it."""
    shape = stated(shape_in(shown))
    middle = _middle(shape)
    about = _shifted(shape, tuple(-each for each in middle))
    try:
        wire.check(wire.shape(plain(about)))
    except CapabilityError as error:
        raise SceneCommandError("a shape that no frame can show") from error
    return _Thing(shown.kind, about, Way(middle, middle))


def _middle(shape: wire.Shape) -> tuple[float, ...]:
    """Middle of a shape, metre."""
    match shape:
        case wire.Capsule(a, b, _):
            points: Sequence[wire.Point] = (a, b)
        case wire.Convex(vertices, _):
            points = vertices
        case _:
            points = (shape.center_um,)
    return tuple(sum(numbers) / len(points) / MICRO for numbers in zip(*points, strict=True))


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
