"""Runs mutmut on a sample, inside the copy that `tests.mutation` made: `python -m tests.mutation.engine COUNT SEED`.

mutmut brings the trampolines, the choice of tests and the workers; its operators are joined by ours. What came of each
mutant is written to `mutants.json`.
"""

import json
import random
import sys
from pathlib import Path

from mutmut.__main__ import _run
from mutmut.mutation import file_mutation
from mutmut.mutation.data import SourceFileMutationData
from mutmut.mutation.diff_apply import get_diff_for_mutant
from mutmut.runners.harness import PytestRunner
from mutmut.state import state
from mutmut.stats import status_by_exit_code
from mutmut.utils.file_utils import walk_mutatable_files
from mutmut.utils.format_utils import get_mutant_name
from mutmut.workers.isolation import ForkServerRunner
from tests.mutation.operators import OPERATORS


def fastest_first(self, tests):
    """Arguments for one run: the cheapest tests first, since most mutants die of any of them."""
    chosen = sorted(tests, key=lambda test: (state().duration_by_test.get(test, 0.0), test))
    return ["-x", "-q", *(chosen or self._pytest_add_cli_args_test_selection)]


def lines(diff, sign):
    """Lines that a diff takes away or puts in, without its header and its indentation."""
    return [line[1:].strip() for line in diff.splitlines() if line.startswith(sign) and not line.startswith(sign * 3)]


def main(count, seed):
    file_mutation.mutation_operators.extend(OPERATORS)
    PytestRunner._pytest_args_regular_run = fastest_first
    # every test has passed once already, while it was found out which functions it reaches
    ForkServerRunner.run_clean_tests = lambda self, tests: 0
    paths = sorted(walk_mutatable_files())
    names = {}
    for path in paths:
        made = file_mutation.mutate_file_contents(str(path), path.read_text("utf-8")).mutant_names
        names |= {get_mutant_name(path, name): path for name in made}
    chosen = sorted(names) if count == 0 else random.Random(seed).sample(sorted(names), min(count, len(names)))
    _run(tuple(chosen), 1)
    told = []
    for path in paths:
        seen = SourceFileMutationData(path=path)
        seen.load()
        for name in (name for name in chosen if names[name] == path):
            diff = get_diff_for_mutant(name)
            end = status_by_exit_code[seen.exit_code_by_key[name]]
            told.append(
                {"name": name, "path": str(path), "end": end, "was": lines(diff, "-"), "becomes": lines(diff, "+")}
            )
    Path("mutants.json").write_text(json.dumps({"of": len(names), "mutants": told}, indent=1), "utf-8")


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]))
