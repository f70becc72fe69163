"""The mutation score of the policies: `python -m tests.mutation --help`. Needs mutmut 3.8 (`make mutants` brings it).

Mutants are made, and die, in a copy of the working tree. The figure comes last. It fails while a survivor has no reason in
survivors.toml, or the score is below the bar.
"""

import argparse
import json
import os
import random
import subprocess
import sys
import tempfile
import tomllib
from collections import Counter
from pathlib import Path

from tests.mutation import tables
from tests.mutation.sources import BAR, BESIDE, ROUNDS, copied, path_of

THRESHOLD = 0.9
"""Least part of the mutants of the bar's modules that the tests kill (B5)."""
DEAD = {"killed", "timeout", "segfault"}
KNOWN = tomllib.loads((Path(__file__).parent / "survivors.toml").read_text("utf-8"))["survivor"]


def arguments():
    parser = argparse.ArgumentParser(prog="python -m tests.mutation", description=__doc__)
    parser.add_argument("--count", type=int, default=250, help="mutants in functions; 0 for all of them")
    parser.add_argument("--tables", type=int, default=40, help="mutants outside functions; 0 for all of them")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument(
        "--modules", nargs="+", choices=BAR + BESIDE, default=BAR, metavar="MODULE", help=f"of {BAR + BESIDE}"
    )
    parser.add_argument("--beside", action="store_true", help=f"the modules that have no threshold: {BESIDE}")
    return parser.parse_args()


def in_functions(tree, count, seed):
    """Results of a sample of mutmut's mutants, and the number of all."""
    command = [sys.executable, "-m", "tests.mutation.engine", str(count), str(seed)]
    subprocess.run(command, cwd=tree, env=os.environ | ROUNDS, check=True)
    told = json.loads((tree / "mutants.json").read_text("utf-8"))
    return told["mutants"], told["of"]


def outside(tree, modules, count, seed):
    """Results of a sample of the mutants of tables, constants and classes, and the number of all."""
    os.environ.update(ROUNDS)
    first = path_of(modules[0])
    if tables.tried(tree, modules[0], (tree / first).read_text("utf-8")) != "survived":
        raise SystemExit("the tests fail without a mutant")
    every = [
        (module, said, source)
        for module in modules
        for said, source in tables.mutants((tree / path_of(module)).read_text("utf-8"))
    ]
    chosen = every if count == 0 else random.Random(seed).sample(every, min(count, len(every)))
    told = []
    for module, said, source in chosen:
        end = tables.tried(tree, module, source)
        print(end, path_of(module), said, flush=True)
        told.append({"path": path_of(module), "end": end, "was": [], "becomes": [said]})
    return told, len(every)


def reason(mutant):
    """Reason for which it may survive, or None."""
    for known in KNOWN:
        same = known.get("was", "") == " ".join(mutant["was"])
        if same and known["path"] == mutant["path"] and " ".join(mutant["becomes"]) in known["becomes"]:
            return known["why"]
    return None


def main():
    asked = arguments()
    modules = BESIDE if asked.beside else tuple(asked.modules)
    with tempfile.TemporaryDirectory(prefix="mutants-") as folder:
        tree = Path(folder)
        copied(tree, modules)
        inner, of_inner = in_functions(tree, asked.count, asked.seed)
        outer, of_outer = outside(tree, modules, asked.tables, asked.seed)
    told = inner + outer
    alive = [mutant for mutant in told if mutant["end"] not in DEAD]
    unexplained = [mutant for mutant in alive if reason(mutant) is None]
    print()
    for mutant in alive:
        print(mutant["path"], mutant.get("name", ""))
        for sign, member in (("-", "was"), ("+", "becomes")):
            print(*(f"  {sign} {line}" for line in mutant[member]), sep="\n")
        print("  ", reason(mutant) or "UNEXPLAINED")
    print(f"\n{'module':32}{'mutants':>9}{'killed':>9}{'survived':>9}{'score':>8}")
    made, left = (Counter(mutant["path"] for mutant in some) for some in (told, alive))
    for path in sorted(made):
        print(f"{path:32}{made[path]:9}{made[path] - left[path]:9}{left[path]:9}{1 - left[path] / made[path]:8.1%}")
    score = 1 - len(alive) / len(told)
    print(
        f"seed {asked.seed}: {len(inner)} of {of_inner} mutants in functions and {len(outer)} of {of_outer} outside; "
        f"{len(told) - len(alive)} killed, {len(alive)} survived ({len(unexplained)} unexplained), score {score:.1%}"
    )
    return 0 if not unexplained and (asked.beside or score >= THRESHOLD) else 1


if __name__ == "__main__":
    sys.exit(main())
