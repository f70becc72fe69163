"""People over time: who is the same from frame to frame, and who was there a moment ago."""

from __future__ import annotations

import math
from collections import Counter
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Final

from capabilities.statements.observation import ObservedPerson
from pep.sensor.sensor_error import SensorError, SensorFault

if TYPE_CHECKING:
    from collections.abc import Collection, Mapping, Sequence

    from pep.sensor.metres import PersonSight

SAME_M: Final = 0.5
"""Two sights nearer than this, horizontally, may be one person: a shoulder's width and a detector's error. Ours."""
WALK_M_S: Final = 1.6
"""Walking speed of a person (ISO 13855, docs/physics.md PHY-3)."""
KEEP_S: Final = 0.4
"""Time for which a person whom a frame lost is told on, with their age.

Ours: a view of up to 0.5 s counts (PHY-8).
"""


@dataclass(frozen=True, slots=True)
class _Known:
    sight: PersonSight
    seen_s: float


@dataclass(frozen=True, slots=True)
class FollowedPeople:
    """People who were seen lately, under ids that last.

    Frozen: a frame gives a new one, and a refused frame changes nothing.

    Attributes:
        keep_s: time for which a person whom no frame shows is told on; 0 for not at all.
        given: names that were made so far.
    """

    keep_s: float = KEEP_S
    given: int = 0
    _known: Mapping[str, _Known] = field(default_factory=dict)

    def after(self, sights: Sequence[PersonSight], *, at_s: float) -> FollowedPeople:
        """Everybody of a frame, then everybody of the last moments whom it does not show.

        Args:
            sights: of the frame.
            at_s: time of its capture; never before that of the last call.

        Raises:
            SensorError: `SIGHT_MALFORMED` for an id that stands twice.
        """
        twice = [name for name, count in Counter(sight.id for sight in sights if sight.id).items() if count > 1]
        if twice:
            raise SensorError(SensorFault.SIGHT_MALFORMED, f"{twice[0][:64]!r} is there twice", "Give each an id.")
        given, named = self.given, {sight.id: sight for sight in sights if sight.id}
        nameless = [sight for sight in sights if not sight.id]
        again = self._pairs(nameless, frozenset(named), at_s)
        for number, sight in enumerate(nameless):
            name = again.get(number, "")
            while not name or name in named or (number not in again and name in self._known):
                given += 1
                name = f"person-{given}"
            named[name] = replace(sight, id=name)
        fresh = {name: _Known(sight, at_s - sight.age_s) for name, sight in named.items()}
        lost = {
            name: known
            for name, known in self._known.items()
            if name not in fresh and at_s - known.seen_s <= self.keep_s
        }
        return replace(self, given=given, _known={**fresh, **lost})

    def told(self, *, at_s: float) -> tuple[ObservedPerson, ...]:
        """Everybody as a frame of that time has them."""
        return tuple(
            ObservedPerson(name, known.sight.regions, max(0, round((at_s - known.seen_s) * 1000)))
            for name, known in self._known.items()
        )

    @property
    def unseen(self) -> dict[str, tuple[str, ...]]:
        """Parts of each that were assumed and not seen."""
        return {name: known.sight.unseen for name, known in self._known.items() if known.sight.unseen}

    def _pairs(self, sights: Sequence[PersonSight], taken: Collection[str], at_s: float) -> dict[int, str]:
        """Names of nameless sights, by their numbers: the nearest whom we know, each once."""
        near = sorted(
            (math.dist(sight.middle_m, known.sight.middle_m), number, name)
            for number, sight in enumerate(sights)
            for name, known in self._known.items()
            if math.dist(sight.middle_m, known.sight.middle_m) <= SAME_M + WALK_M_S * (at_s - known.seen_s)
        )
        pairs: dict[int, str] = {}
        for _, number, name in near:
            if number not in pairs and name not in pairs.values() and name not in taken:
                pairs[number] = name
        return pairs
