"""The thresholds of `policies.conduct.cusum`, computed: `python -m evaluation.conduct.thresholds` prints the table.

A detector walks over the integers: `up` for a hit, `down` for none, never below 0, and it alarms at `limit`. So it is a
finite Markov chain, and the mean number of trials until an alarm (the average run length) is the solution of one linear
system, exactly (Brook and Evans 1972, Biometrika 59, 539-549; for hits and misses Reynolds and Stoumbos 1999, Journal
of Quality Technology 31, 87-108). Nothing is simulated or guessed here.

The slope `down`/`up` is that of the log likelihood ratio (Page 1954; Lorden 1971: such a walk is the quickest for its
run length) between the baseline's share of hits and one with `ODDS` times its odds.
"""

from __future__ import annotations

from math import log
from typing import Final

import numpy as np

ODDS: Final = 4
"""Factor of the odds in the wanted change, e.g. 5 % to 17 %, 20 % to 50 %."""
SHARES: Final = (
    *(10, 15, 20, 25, 30, 35, 40, 50, 60, 70, 80, 100, 120, 150),
    *(200, 250, 300, 350, 400, 450, 500, 550, 600, 650, 700, 750, 800),
)
"""Shares of hits for which there are thresholds, permille: a baseline's share is rounded up to one of them."""
RUNS: Final = (
    *(250, 500, 1_000, 2_500, 5_000, 10_000, 20_000, 50_000, 100_000, 200_000, 500_000),
    *(1_000_000, 2_000_000, 5_000_000),
)
"""Average run lengths, in trials: the wanted one is rounded up to one of them."""


def slope(share_permille: int) -> tuple[int, int]:
    """`up` and `down`, the smallest pair within 3 % of the likelihood ratio's slope."""
    before = share_permille / 1000
    after = ODDS * before / (1 - before + ODDS * before)
    hit, miss = log(after / before), log((1 - before) / (1 - after))
    for down in range(1, 20):
        up = max(1, round(down * hit / miss))
        if abs(up / down * miss / hit - 1) < 0.03:
            return up, down
    raise ValueError(share_permille)


def run_length(share: float, *, up: int, down: int, limit: int) -> float:
    """Mean number of trials until the alarm, from 0, when each trial hits with probability `share`."""
    system = np.eye(limit)
    for level in range(limit):
        system[level, max(0, level - down)] -= 1 - share
        if level + up < limit:
            system[level, level + up] -= share
    return float(np.linalg.solve(system, np.ones(limit))[0])


def threshold(share_permille: int, run: int) -> int:
    """The lowest limit whose run length at this share is at least `run`."""
    up, down = slope(share_permille)
    share = share_permille / 1000
    low, high = 0, up
    while run_length(share, up=up, down=down, limit=high) < run:
        low, high = high, high * 2
    while high - low > 1:
        middle = (low + high) // 2
        if run_length(share, up=up, down=down, limit=middle) < run:
            low = middle
        else:
            high = middle
    return high


def row(share_permille: int) -> tuple[int, int, tuple[int, ...]]:
    """One row of the table: `up`, `down`, and the limit for each run length."""
    return (*slope(share_permille), tuple(threshold(share_permille, run) for run in RUNS))


def table() -> str:
    """The table as it stands in `policies.conduct.cusum`."""
    lines = (f"    {share}: Slope{row(share)!r}," for share in SHARES)
    return "\n".join(lines)


if __name__ == "__main__":
    print(table())  # noqa: T201 - the command is for printing
