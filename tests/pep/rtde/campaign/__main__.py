"""The claims about the RTDE boundary, tried in full: `python -m tests.pep.rtde.campaign`; the figures last.

    fuzz    sequences of a hostile program in a lease: the arm is only where what is on record lets it be
    race    clears against the watchdog's keep-alive: no second motion
    kills-*  deaths, losses and revocations on a whole cell: how soon the arm brakes, how far it goes, and that it stays

A trial is named by seed and number, a failure is told with both. What is done is kept in a ledger, by which a run that
was ended goes on.
"""

import argparse
import tempfile
import time
from functools import partial
from pathlib import Path

from tests.pep.rtde.campaign import fuzz, kills, race
from tests.pep.rtde.campaign.figures import Figures, keep, known, sources

PARTS = {
    "fuzz": (fuzz.piece, 20_000, 250),
    "race": (race.piece, 10_000, 250),
    **{f"kills-{death}": (partial(kills.piece, death), 200, 25) for death in kills.DEATHS},
}
"""By name: some trials in a row, how many there are, and how many are one piece of work."""


def run(name, seed, count, *, ledger, until, told):
    """Figures of that part's trials that are in the ledger or done before `until`, and their number."""
    piece, _, share = PARTS[name]
    of = sources(name.partition("-")[0])
    done, whole, tried = known(ledger, name, seed, of), Figures(), 0
    for first in range(0, count, share):
        number = min(share, count - first)
        figures = done.get((first, number))
        if figures is None:
            if time.monotonic() >= until:
                continue
            with tempfile.TemporaryDirectory() as folder:
                try:
                    figures = piece(seed, first, number, Path(folder))
                except Exception as error:  # noqa: BLE001 - told with its number, and the others go on
                    figures = Figures(failed=[f"seed {seed}, {name} from {first}: {type(error).__name__}: {error}"])
            keep(ledger, name, seed, of, first, number, figures)
        whole.add(figures)
        tried += number
        told(name, tried, whole)
    return whole, tried


def main(given=None):
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seed", type=int, default=2026)
    parser.add_argument("--only", action="append", choices=PARTS, help="this part alone; may be given again")
    parser.add_argument("--count", type=int, help="trials of each part, in place of all that it has")
    parser.add_argument("--minutes", type=float, default=float("inf"), help="no new piece of work after so long")
    parser.add_argument("--ledger", type=Path, help="a file that keeps what is done; a run with it goes on")
    given = parser.parse_args(given)
    began = time.monotonic()
    print(f"seed {given.seed}")
    told = lambda name, tried, whole: print(f"\r{name}: {tried}, {len(whole.failed)} failed", end="", flush=True)  # noqa: E731
    verdicts = []
    for name in given.only or PARTS:
        count = PARTS[name][1] if given.count is None else given.count
        whole, tried = run(
            name, given.seed, count, ledger=given.ledger, until=began + 60 * given.minutes, told=told
        )  # fmt: skip
        print(f"\r{name}: {tried} of {count}")
        for line in (*kills.judged(whole), *whole.lines(), *whole.failed[:100]):
            print(f"  {line}")
        verdict = "missed" if whole.failed else "not all of it was tried" if tried < count else "met"
        verdicts.append((name, f"{tried} of {count}, {len(whole.failed)} failed: {verdict}"))
    for name, verdict in verdicts:
        print(f"{name}: {verdict}")
    print(f"{time.monotonic() - began:.0f} s")
    return 0 if all(verdict.endswith(": met") for _, verdict in verdicts) else 1


if __name__ == "__main__":
    raise SystemExit(main())
