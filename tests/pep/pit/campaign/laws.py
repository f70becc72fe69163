"""Laws of the index (docs/physics.md, PHY-2 to PHY-7), written once more, in arrays.

`twin` has them one by one.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

FAR_M = 100.0
"""Clearance of what was not measured because no law reaches so far."""


@dataclass(frozen=True)
class Stop:
    """T_r, T_s and metres of braking travel per m/s."""

    reaction: float
    brake: float
    travel: float

    @staticmethod
    def of(cell, age_s, omega):
        ramp = omega / cell.stop_deceleration_rad_s2
        reaction = max(age_s, cell.watch_age_limit_s) + cell.reaction_s
        return Stop(reaction, cell.stop_delay_s + ramp, cell.stop_delay_s + ramp / 2)


def person_law(d, v, *, z, harm, reach, cell, stop):
    near, hit = d - z, v * (stop.reaction + stop.travel)
    approach = cell.person_speed_m_s * (stop.reaction + stop.brake) + reach
    safe = approach + hit
    with np.errstate(divide="ignore", invalid="ignore"):
        blow = np.where(hit > 0, np.minimum(1, (hit - near) / hit), 0) * np.maximum(0, v / harm - 1)
    met = 3 + np.minimum(1, np.maximum(blow, np.maximum(0, -d) / cell.penetration_band_m))
    far = 1 + np.clip((safe + cell.warn_band_m - near) / cell.warn_band_m, 0, 1)
    index = np.where(near <= hit, met, np.where(near < safe, 2 + (safe - near) / approach, far))
    return np.where(v > 0, index, 0)


def thing_law(d, v, *, z, band, stop):
    near, hit = d - z, v * stop.travel
    with np.errstate(divide="ignore", invalid="ignore"):
        met = 2 + np.minimum(1, np.where(hit > 0, (hit - near) / hit, 1))
    index = np.where(near <= hit, met, 1 + np.clip((hit + band - near) / band, 0, 1))
    return np.where(v > 0, index, 0)


def zone_law(d, v, *, z, band, tier, stop):
    share = np.clip((v * stop.travel + band - (d - z)) / band, 0, 1)
    return np.where(v > 0, 1 + (tier - 1) * share, 0)


def ratio_law(ratio):
    if ratio > 1:
        return 4.0
    return 1 + max(0.0, ratio - 0.75) / 0.15 if ratio <= 0.9 else 2 + (ratio - 0.9) / 0.1


@dataclass(frozen=True)
class Law:
    """One obstacle: what it is, its uncertainty, and what its law needs."""

    kind: str
    z: float
    band: float = 0.0
    harm: float = np.inf
    intrusion: float = 0.0
    tier: int = 0
    touched_by: frozenset = frozenset()
    below: float = -np.inf

    def reaches(self, speed, cell, stop):
        """Clearance (metre) beyond which the law says 1 of what is no faster than this."""
        if self.kind != "person":
            return self.z + self.band + speed * stop.travel
        approach = cell.person_speed_m_s * (stop.reaction + stop.brake) + self.intrusion
        return self.z + approach + cell.warn_band_m + speed * (stop.reaction + stop.travel)


class Columns:
    """The laws of many pairs at once, one column each."""

    def __init__(self, laws, cell, stop):
        """Law k is that of column k."""
        self.cell, self.stop, self.count = cell, stop, len(laws)
        self.below = np.array([law.below for law in laws])
        kinds = np.array([law.kind for law in laws])
        self.people = np.flatnonzero(kinds == "person")
        self.tiered = np.flatnonzero(kinds == "tiered_zone")
        self.things = np.flatnonzero((kinds != "person") & (kinds != "tiered_zone"))
        self.kinds = kinds
        number = {name: np.array([getattr(law, name) for law in laws]) for name in ("z", "band", "harm")}
        self._z, self._band, self._harm = (number[name] for name in ("z", "band", "harm"))
        self._reach = np.array([law.intrusion for law in laws])
        self._tier = np.array([law.tier for law in laws])

    def index(self, d, v):
        """The index of clearances and speeds of shape (..., columns)."""
        found = np.empty(d.shape)
        if len(at := self.people):
            found[..., at] = person_law(
                d[..., at], v[..., at], z=self._z[at], harm=self._harm[at], reach=self._reach[at],
                cell=self.cell, stop=self.stop,
            )  # fmt: skip
        if len(at := self.things):
            found[..., at] = thing_law(d[..., at], v[..., at], z=self._z[at], band=self._band[at], stop=self.stop)
        if len(at := self.tiered):
            found[..., at] = zone_law(
                d[..., at], v[..., at], z=self._z[at], band=self._band[at], tier=self._tier[at], stop=self.stop
            )
        return found
