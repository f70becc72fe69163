"""Domain CII, cognition and instruction integrity: what the world, people and documents say, and who vouches for it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, Final, assert_never

from policies.evidence import ImpactReading, NotCollected, PerceptionReading
from policies.primitives.base import Holds, fails, missing
from policies.reasons import Reason
from policies.tiers import FRESH

if TYPE_CHECKING:
    from policies.primitives.base import Case, Verdict

BELIEVED: Final = frozenset({FRESH, "stale", "missing"})
"""States of a sensor of which nothing false was heard. Any other word is a view that must not be believed."""


@dataclass(frozen=True, slots=True)
class SensorProvenance:
    """CII-4: what is known of the world comes from the cell's own sensors, and none says what must not be believed.

    A sensor that is silent or late is no fault: TEA-4 asks a person then.
    """

    id: ClassVar[str] = "CII-4"

    def judge(self, case: Case) -> Verdict:
        """Holds when no sensor's newest frame is invalid, and a view that is called fresh rests on fresh sensors."""
        match case.evidence.perception:
            case NotCollected():
                return missing(self.id, "perception")
            case PerceptionReading() as perception:
                return self._reading(case, perception)
            case _:
                assert_never(case.evidence.perception)

    def _reading(self, case: Case, perception: PerceptionReading) -> Verdict:
        refused = [{"sensor": s.sensor, "fault": s.fault} for s in perception.sensors if s.state not in BELIEVED]
        if refused:
            return fails(self.id, Reason.PERCEPTION_INVALID, sensors=refused)
        impact = case.evidence.impact
        called_fresh = isinstance(impact, ImpactReading) and impact.perception == FRESH
        late = [s.sensor for s in perception.sensors if s.state != FRESH]
        if called_fresh and (late or not perception.sensors):
            return fails(self.id, Reason.PERCEPTION_INVALID, not_fresh=late)
        return Holds()
