"""The long run against the API: `make hostile-api`; cases and failures last.

Each round has a world of its own, every operation in an order of its own, right and wrong cases, from every role.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections import Counter
from pathlib import Path
from random import Random
from tempfile import TemporaryDirectory

from tests.ztpm_idp.hostile import api
from tests.ztpm_idp.hostile.callers import ROLES, Callers, furnished


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--rounds", type=int, default=4)
    parser.add_argument("--cases", type=int, default=8, help="of each operation, right and wrong, in each round")
    parser.add_argument("--databases", nargs="+", default=["sqlite", "postgres"])
    parser.add_argument("--seed", type=int, default=int(time.time()))
    asked = parser.parse_args()
    sys.stdout.write(f"seed {asked.seed}\n")
    total, failures, statuses = 0, 0, Counter()
    for number in range(asked.rounds):
        for database in asked.databases:
            found = _round(database, asked.seed + number, asked.cases, near=number % 2 == 1)
            total, failures = total + found.sent.total(), failures + len(found.wrong)
            statuses += found.statuses
            for what, where in found.wrong.items():
                sys.stdout.write(f"{database}: {what}\n    {where}\n")
            sys.stdout.write(f"{database}, round {number}: {found.sent.total()} requests, {len(found.codes)} codes\n")
            sys.stdout.flush()
    spread = ", ".join(f"{count} of {status}" for status, count in sorted(statuses.items()))
    sys.stdout.write(f"{total} requests by {len(ROLES)} roles ({spread}); {failures} failures\n")
    return 0 if total and not failures else 1


def _round(database: str, number: int, cases: int, *, near: bool) -> api.Found:
    random, found = Random(number), api.Found()  # noqa: S311
    with TemporaryDirectory() as folder, furnished(Path(folder), database=database) as world:
        callers = Callers(world)
        described = api.document(world)
        every = api.operations(api.near(described, callers) if near else described)
        random.shuffle(every)
        for operation in every:
            for mode in api.MODES:
                seed = random.randrange(2**32)
                api.play(callers, operation, ROLES, found, mode=mode, cases=cases, number=seed, known=seed % 2 == 0)
    return found


if __name__ == "__main__":
    sys.exit(main())
