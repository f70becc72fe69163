"""A change detector over hits and misses: a one-sided CUSUM on integers, with a stated false-alarm rate.

Page 1954 (Biometrika 41, 100-115). It walks up for a hit and down for a miss, never below 0, and alarms at a limit. The
limits are computed, not guessed: `evaluation.conduct.thresholds` solves the Markov chain of Brook and Evans 1972 for
each, and a test compares. They hold for a stream whose trials are independent and hit with at most the share that the
row is of. One-sided, since fewer hits than usual are never bad.
"""

from __future__ import annotations

from bisect import bisect_left
from math import comb
from typing import Final, NamedTuple


class Slope(NamedTuple):
    """Steps of a detector: `up` for a hit, `down` for a miss, and the limit for each of `RUNS`."""

    up: int
    down: int
    limits: tuple[int, ...]


# fmt: off
RUNS: Final = (
    *(250, 500, 1_000, 2_500, 5_000, 10_000, 20_000, 50_000, 100_000, 200_000, 500_000),
    *(1_000_000, 2_000_000, 5_000_000),
)
"""Mean number of trials until a false alarm, at least: the wanted one is rounded up to one of these."""

TABLE: Final = {
    10: Slope(46, 1, (47, 66, 88, 114, 135, 158, 181, 212, 235, 259, 290, 313, 337, 368)),
    15: Slope(30, 1, (32, 53, 62, 83, 97, 112, 127, 146, 162, 177, 197, 212, 227, 247)),
    20: Slope(23, 1, (34, 45, 55, 69, 81, 93, 105, 121, 133, 145, 161, 173, 185, 201)),
    25: Slope(18, 1, (30, 37, 46, 57, 66, 75, 85, 97, 106, 116, 128, 138, 147, 159)),
    30: Slope(15, 1, (27, 32, 41, 50, 58, 66, 74, 84, 92, 100, 110, 118, 126, 137)),
    35: Slope(13, 1, (25, 30, 37, 46, 53, 60, 67, 76, 83, 90, 99, 107, 114, 123)),
    40: Slope(11, 1, (22, 27, 32, 40, 45, 51, 57, 65, 70, 76, 84, 90, 96, 103)),
    50: Slope(9, 1, (19, 24, 29, 35, 40, 45, 50, 57, 62, 67, 74, 79, 84, 90)),
    60: Slope(15, 2, (34, 42, 50, 61, 70, 78, 87, 98, 107, 116, 127, 136, 145, 156)),
    70: Slope(19, 3, (46, 56, 66, 81, 91, 102, 113, 128, 139, 150, 165, 176, 187, 202)),
    80: Slope(11, 2, (28, 34, 41, 49, 55, 62, 68, 77, 84, 90, 99, 106, 112, 121)),
    100: Slope(13, 3, (37, 44, 51, 62, 70, 78, 86, 97, 105, 113, 124, 132, 140, 151)),
    120: Slope(7, 2, (22, 25, 30, 36, 40, 44, 49, 55, 59, 64, 70, 74, 79, 85)),
    150: Slope(8, 3, (26, 32, 37, 43, 49, 54, 59, 66, 72, 77, 84, 89, 95, 102)),
    200: Slope(2, 1, (8, 10, 11, 13, 15, 16, 18, 20, 22, 23, 25, 27, 28, 30)),
    250: Slope(3, 2, (14, 16, 19, 22, 24, 27, 30, 33, 35, 38, 41, 44, 46, 50)),
    300: Slope(7, 6, (34, 40, 46, 55, 62, 68, 75, 83, 90, 97, 105, 112, 118, 127)),
    350: Slope(10, 11, (51, 61, 71, 87, 97, 107, 117, 129, 139, 150, 163, 173, 184, 197)),
    400: Slope(3, 4, (19, 22, 25, 30, 33, 37, 40, 45, 48, 52, 56, 60, 63, 68)),
    450: Slope(5, 8, (35, 41, 47, 56, 62, 68, 75, 84, 90, 97, 105, 112, 118, 127)),
    500: Slope(1, 2, (8, 10, 11, 13, 14, 16, 17, 19, 21, 22, 24, 25, 27, 29)),
    550: Slope(3, 7, (27, 31, 36, 43, 48, 53, 58, 65, 70, 75, 82, 87, 92, 99)),
    600: Slope(6, 17, (61, 70, 81, 98, 109, 121, 133, 148, 160, 172, 188, 200, 211, 227)),
    650: Slope(2, 7, (23, 27, 32, 38, 43, 47, 52, 58, 62, 67, 73, 78, 82, 88)),
    700: Slope(2, 9, (27, 31, 37, 44, 49, 54, 60, 67, 72, 78, 85, 90, 95, 103)),
    750: Slope(3, 17, (46, 56, 65, 79, 88, 98, 108, 121, 131, 142, 155, 165, 175, 188)),
    800: Slope(2, 15, (38, 46, 54, 65, 73, 82, 90, 102, 110, 119, 130, 139, 147, 158)),
}
"""Slopes by the baseline's share of hits in permille, for a change to four times its odds."""
# fmt: on

SHARES: Final = tuple(TABLE)
DOUBT_PERMILLE: Final = 25
"""Greatest probability that the true share is above the assumed one: a bound of 97.5 %."""


class Watched(NamedTuple):
    """A detector that is given its row: the walk, and where it alarms."""

    up: int
    down: int
    limit: int

    def step(self, level: int, *, hit: bool) -> int:
        """The level after one trial; the alarm is at `limit` and above."""
        return level + self.up if hit else max(0, level - self.down)


def watched(share_permille: int, run: int) -> Watched:
    """The detector for a baseline's share of hits.

    Args:
        share_permille: one of `SHARES`.
        run: wanted mean number of trials between false alarms, at most the last of `RUNS`.
    """
    slope = TABLE[share_permille]
    return Watched(slope.up, slope.down, slope.limits[bisect_left(RUNS, run)])


def rounded_up(share_permille: int) -> int | None:
    """Least share of the table that is not below, or None when there is none: nothing can be detected then."""
    place = bisect_left(SHARES, share_permille)
    return SHARES[place] if place < len(SHARES) else None


def share_above(hits: int, trials: int) -> int | None:
    """Least share of the table that is an upper bound of the true one at 97.5 %, or None.

    The upper bound of Clopper and Pearson 1934, in exact integers: so many hits or fewer come with a probability of at
    most `DOUBT_PERMILLE` from the share that is returned.
    """
    for share in SHARES:
        rest = 1000 - share
        fewer = sum(comb(trials, k) * share**k * rest ** (trials - k) for k in range(hits + 1))
        if fewer * 1000 <= DOUBT_PERMILLE * 1000**trials:
            return share
    return None
