"""The whole campaign against the store, on both databases; the figures last.

`make store-faults`: kill -9 at every boundary of seven commands and at random instants, and double use, 64 at a time. A
run that was ended goes on by its ledger.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import sys
import time
import warnings
from collections import Counter
from pathlib import Path
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
    parser.add_argument("--ledger", type=Path, help="a file that keeps what is done; a run with it goes on")
    asked = parser.parse_args()
    warnings.simplefilter("ignore", DeprecationWarning)  # of fork beside threads: there are none by then
    book = Book(asked.ledger)
    clean, ended, lines = True, False, [f"seed {asked.seed}"]
    for database in asked.databases:
        found, rounds = book.of(database)
        with TemporaryDirectory(dir=_memory()) as folder:
            print(f"{database}: a provider is furnished", file=sys.stderr)
            scene = Scene(Path(folder), database, many=MANY)
            try:
                if "points" in asked.parts:
                    names = asked.commands and frozenset(asked.commands)
                    crashes.at_every_point(scene, found, names=names, keep=book.keep)
                if "instants" in asked.parts:
                    crashes.at_random_instants(scene, found, number=asked.instants, seed=asked.seed, keep=book.keep)
                if "once" in asked.parts:
                    once.play(scene, asked.rounds, rounds, keep=book.keep)
            except KeyboardInterrupt:
                ended = True
                lines.append(f"{database}: ended early; its figures are of what was done")
            finally:
                scene.close()
        enough = found.points >= POINTS or asked.commands is not None or "points" not in asked.parts
        clean = clean and enough and found.clean and not rounds.wrong
        for wrong in (*found.lost, *found.half, *found.twice, *rounds.wrong):
            sys.stderr.write(f"{wrong}\n")
        lines += _figures(database, found, rounds, frozenset(asked.parts))
        if ended:
            break
    sys.stdout.write("\n".join(lines) + "\n")
    return 0 if clean and not ended else 1


def _figures(database: str, found: crashes.Found, rounds: once.Rounds, parts: frozenset[str]) -> list[str]:
    lines = []
    if {"points", "instants"} & parts:
        lines.append(
            f"C3 {database}: killed at {found.points} boundaries and {found.instants} instants; "
            f"{found.acknowledged} acknowledged effects, {len(found.lost)} lost, {len(found.half)} half effects, "
            f"{len(found.twice)} done twice; slowest start {found.slowest_s:.2f} s"
        )
    if "once" in parts:
        lines.append(
            f"D1 {database}: {rounds.played.total()} rounds of {once.USES} uses by {once.WORKERS} processes "
            f"({', '.join(f'{n} of a {kind}' for kind, n in rounds.played.items())}); "
            f"{len(rounds.wrong)} with other than one winner; {rounds.unavailable} uses answered STORE_UNAVAILABLE"
        )
    return lines


class Book:
    """File by which a run goes on where an earlier one was ended; of other sources nothing is taken.

    Args:
        path: of the file; None: nothing is kept.
    """

    def __init__(self, path: Path | None) -> None:
        self._path, self._sources = path, _sources()
        self._found: dict[str, tuple[crashes.Found, once.Rounds]] = {}
        kept = json.loads(path.read_bytes()) if path is not None and path.exists() else {}
        if kept.get("sources") == self._sources:
            for database, (found, rounds) in kept["found"].items():
                played = once.Rounds(**rounds | {"played": Counter(rounds["played"])})
                self._found[database] = crashes.Found(**found), played

    def of(self, database: str) -> tuple[crashes.Found, once.Rounds]:
        """Figures of a database so far, to which its run adds."""
        return self._found.setdefault(database, (crashes.Found(), once.Rounds()))

    def keep(self) -> None:
        if self._path is None:
            return
        found = {database: [vars(one) for one in pair] for database, pair in self._found.items()}
        beside = self._path.with_name(f"{self._path.name}.new")
        beside.write_text(json.dumps({"sources": self._sources, "found": found}))
        beside.replace(self._path)


def _sources() -> str:
    """Digest of the provider's sources and the campaign's: figures of others are others' figures."""
    digest, top = hashlib.sha256(), Path(__file__).parents[4]
    for folder in ("ztpm_idp", "capabilities", "tests/ztpm_idp/store/campaign"):
        for path in sorted((top / folder).rglob("*.py")):
            digest.update(path.read_bytes())
    return digest.hexdigest()


def _memory() -> str | None:
    return "/dev/shm" if Path("/dev/shm").is_dir() else None  # noqa: S108 - a directory of our own in it


if __name__ == "__main__":
    sys.exit(main())
