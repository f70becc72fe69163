"""Readings of facts: signed numbers of sensors on which rows of an operation depend."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, slots=True)
class FactReading:
    """One fact of a registered sensor, as it was used ([FCT-2]).

    Attributes:
        fact: sensor and name, such as "zone-a/people".
        state: "fresh", "stale", "missing" or "invalid".
        fault: why there is nothing to be believed, a code; "" where there is, and where nothing was said.
        value: in integers of the unit that the row declares, the newest that was believed; None when there is none.
        unit: as `capabilities.values.units` spells it.
        age_ms: of the sensor's newest believed frame, transit included, or None.
    """

    fact: str
    state: str
    fault: str
    value: int | None
    unit: str
    age_ms: int | None
