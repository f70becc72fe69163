"""Clearance of a whole interval from its three nodes, in numpy."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from pep.pit.geometry.clearance import ROUNDING_M
from pep.pit.geometry.clearance import _dot as dot
from pep.pit.geometry.clearance import _reach as reach

if TYPE_CHECKING:
    from pep.pit.base.motion import Floats
    from pep.pit.geometry.clearance import Cores


def interval_clearance(ends: Floats, direction: Floats, cores: Cores, *, radii: Floats, sag: Floats) -> Floats:
    """A clearance that holds on the whole interval, row by row, in metres.

    Args:
        ends: body axes (3, n, 2, 3) at the start, the middle and the end of the interval.
        direction: unit vectors (n, 3), from obstacle to body; a zero row proves nothing.
        cores: the obstacles.
        radii: sum of both radii.
        sag: how far an axis can leave the chord between neighbouring ones of the three nodes.

    Every point of the axis stays within `sag` of a convex combination of node points (chord lemma, capsules are
    convex), so its extent along the direction is at least the least of the six projections, less `sag`.
    """
    ahead = dot(ends, direction[None, :, None]).min(axis=(0, 2))
    bound = ahead - _support(cores, direction) - radii - sag - ROUNDING_M
    proven = dot(direction, direction) > 0.5  # a unit vector, or zero
    return np.asarray(np.where(cores.is_plane, bound, np.where(proven, np.maximum(bound, -radii), -radii)))


def _support(cores: Cores, direction: Floats) -> Floats:
    """Largest extent of each core along the direction; for a plane, of the forbidden side."""
    segment = np.maximum(dot(cores.a, direction), dot(cores.b, direction))
    box = dot(cores.a, direction) + dot(np.abs(np.einsum("nij,ni->nj", cores.axes, direction)), cores.half)
    extent = np.where(cores.is_segment, segment, np.where(cores.is_box, box, -cores.offset))
    for hull, rows in cores.polytopes():
        extent[rows] = reach(hull, direction[rows])
    return np.asarray(extent)
