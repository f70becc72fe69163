"""Rows that raise the tier of an act: values of a parameter, and values of a sensor's fact."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from capabilities.values.scope import Range, Tier
from policies.evidence.fact_reading import FactReading
from policies.evidence.tiers import FRESH, UNSEEN_FLOOR

if TYPE_CHECKING:
    from capabilities.values.units import Unit


@dataclass(frozen=True, slots=True)
class TierRow:
    """Values of one parameter that raise the tier of an act."""

    values: Range
    tier: Tier


@dataclass(frozen=True, slots=True)
class FactRow:
    """Fact of a registered sensor that an operation's tier depends on ([FCT-3]).

    Attributes:
        sensor: its registered id.
        name: of the fact.
        unit: of its values.
        fresh_ms: greatest age at which it says something about now.
        tiers: values that raise the tier; at least one.
    """

    sensor: str
    name: str
    unit: Unit
    fresh_ms: int
    tiers: tuple[TierRow, ...]

    @property
    def fact(self) -> str:
        """Sensor and name as one word."""
        return f"{self.sensor}/{self.name}"

    def unheard(self, fault: str = "") -> FactReading:
        """Reading of the fact where its sensor said nothing that is believed."""
        return FactReading(self.fact, "missing", fault, None, str(self.unit), None)

    def tier_of(self, reading: FactReading | None) -> Tier:
        """Tier that this row gives: the highest that it has, and at least 3, while the fact is not fresh."""
        if reading is None or reading.state != FRESH or reading.value is None:
            return max(UNSEEN_FLOOR, *(row.tier for row in self.tiers))
        value = reading.value
        given = (row.tier for row in self.tiers if row.values.low <= value <= row.values.high)
        return max(given, default=Tier.NO_EFFECT)
