"""Tolerances in the proof of the highest speeds of a robot's points on a straight path."""

from __future__ import annotations

from typing import Final

from pep.pit.base.tier import BUSY_BAND

FINER: Final = 2  # halves of the first cut to begin with: a quarter of the slack
INDEX_WITHIN: Final = 0.005  # PHY-7: of the index of a ratio, between the proven and the attained one
RATIO_WITHIN: Final = (
    0.5 * INDEX_WITHIN * BUSY_BAND
)  # the same of one ratio where its index is steepest, and half of it
CUTS_MOST: Final = 1024  # intervals of one path; with more the bound stays as it is, which is still one
