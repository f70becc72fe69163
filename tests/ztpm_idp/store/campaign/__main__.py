"""The whole campaign against the store, on both databases; the figures last.

`make store-faults`: kill -9 at every boundary of seven commands and at random instants, and double use, 64 at a time.
"""

from __future__ import annotations

import argparse
import sys
import time
import warnings
from pathlib import Path
from random import Random
from tempfile import TemporaryDirectory

from tests.ztpm_idp.store.campaign import crashes, once
from tests.ztpm_idp.store.campaign.scene import Scene

POINTS, INSTANTS, ROUNDS = 200, 300, 1_000
"""Least boundaries, instants and rounds (reliability.md, C3 and D1)."""

MANY = 3
"""Tokens, hops and revocations that a process makes until it is killed at some instant."""


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--databases", nargs="+", default=["sqlite", "postgres"])
    parser.add_argument("--instants", type=int, default=INSTANTS)
    parser.add_argument("--rounds", type=int, default=ROUNDS)
    parser.add_argument("--parts", nargs="+", default=["points", "instants", "once"])
    parser.add_argument("--commands", nargs="+", help="those that are killed at each boundary (default: all seven)")
    parser.add_argument("--seed", type=int, default=int(time.time()))
    asked = parser.parse_args()
    warnings.simplefilter("ignore", DeprecationWarning)  # of fork beside threads: there are none by then
    clean, lines = True, [f"seed {asked.seed}"]
    for database in asked.databases:
        with TemporaryDirectory(dir=_memory()) as folder:
            scene, found, rounds = Scene(Path(folder), database, many=MANY), crashes.Found(), once.Rounds()
            try:
                if "points" in asked.parts:
                    crashes.at_every_point(scene, found, names=asked.commands and frozenset(asked.commands))
                if "instants" in asked.parts:
                    crashes.at_random_instants(scene, found, number=asked.instants, random=Random(asked.seed))  # noqa: S311
                if "once" in asked.parts:
                    once.play(scene, asked.rounds, rounds)
            except KeyboardInterrupt:
                lines.append(f"{database}: ended early; its figures are of what was done")
            finally:
                scene.close()
        enough = found.points >= POINTS or asked.commands is not None or "points" not in asked.parts
        clean = clean and enough and found.clean and not rounds.wrong
        for wrong in (*found.lost, *found.half, *found.twice, *rounds.wrong):
            sys.stderr.write(f"{wrong}\n")
        if {"points", "instants"} & set(asked.parts):
            lines.append(
                f"C3 {database}: killed at {found.points} boundaries and {found.instants} instants; "
                f"{found.acknowledged} acknowledged effects, {len(found.lost)} lost, {len(found.half)} half effects, "
                f"{len(found.twice)} done twice; slowest start {found.slowest_s:.2f} s"
            )
        if "once" in asked.parts:
            lines.append(
                f"D1 {database}: {rounds.played.total()} rounds of {once.USES} uses by {once.WORKERS} processes "
                f"({', '.join(f'{n} of a {kind}' for kind, n in rounds.played.items())}); "
                f"{len(rounds.wrong)} with other than one winner; {rounds.unavailable} uses answered STORE_UNAVAILABLE"
            )
    sys.stdout.write("\n".join(lines) + "\n")
    return 0 if clean else 1


def _memory() -> str | None:
    return "/dev/shm" if Path("/dev/shm").is_dir() else None  # noqa: S108 - a directory of our own in it


if __name__ == "__main__":
    sys.exit(main())
