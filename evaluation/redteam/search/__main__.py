"""Command that searches every scenario of a file anew.

    python -m evaluation.redteam.search FILE... [--seed N] [--meshes DIRECTORY]

Each file is written again. Without a seed that of the file is taken, and then the file stays as it is, byte by byte,
where neither the referee nor the draws have changed.
"""

from __future__ import annotations

import argparse
import sys
import tomllib
from collections import Counter
from itertools import takewhile
from pathlib import Path
from typing import TYPE_CHECKING

from evaluation.redteam.campaign import MESHES
from evaluation.redteam.judging import EMBEDDED
from evaluation.redteam.referee import Referee, RefereeError
from evaluation.redteam.search.renewal import RenewalError, renewed
from evaluation.redteam.search.search import Discard
from evaluation.redteam.search.tables import scenario_file

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence


def searched_anew(text: str, referee: Referee, *, seed: int | None, told: Callable[[str], None]) -> str:
    """Text of a file after the search of each of its scenarios.

    Args:
        text: of the file.
        referee: of the cell.
        seed: of every draw; that of the file where it is None.
        told: hears of each scenario that is found.

    Raises:
        RenewalError: a scenario cannot be searched anew, or the file has no seed.
    """
    remark = "\n".join(takewhile(lambda line: line.startswith("#"), text.splitlines()))
    tables = tomllib.loads(text)
    used = seed if seed is not None else tables.get("search", {}).get("seed")
    if used is None:
        raise RenewalError("the file has no seed; name one by --seed")
    discarded: Counter[Discard] = Counter()
    scenarios = []
    for scenario in sorted(tables["scenario"], key=lambda one: str(one["id"])):
        found = renewed(referee, scenario, seed=used)
        discarded.update(found.discarded)
        scenarios.append(found.scenario)
        told(f"{found.scenario['id']}: {found.scenario['discarded']} discarded")
    by_cause = {each.value: discarded[each] for each in Discard if discarded[each]}
    return scenario_file(remark, {"seed": used, "discarded": by_cause}, scenarios)


def main(arguments: Sequence[str] | None = None) -> int:
    """Exit status of the command."""
    parser = argparse.ArgumentParser(prog="python -m evaluation.redteam.search", description=__doc__)
    parser.add_argument("files", nargs="+", type=Path, help="files of searched scenarios")
    parser.add_argument("--seed", type=int, help="of every draw; by default that of each file")
    parser.add_argument("--meshes", type=Path, default=MESHES, help="folder of the vendor's description of the arm")
    asked = parser.parse_args(arguments)
    try:
        referee = Referee(asked.meshes, EMBEDDED)
        for file in asked.files:
            text = searched_anew(file.read_text(encoding="utf-8"), referee, seed=asked.seed, told=_say)
            file.write_text(text, encoding="utf-8")
    except (RenewalError, RefereeError, OSError, tomllib.TOMLDecodeError) as error:
        _say(str(error))
        return 2
    return 0


def _say(line: str) -> None:
    sys.stderr.write(f"{line}\n")
    sys.stderr.flush()


if __name__ == "__main__":
    sys.exit(main())
