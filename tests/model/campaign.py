"""The claims about decisions, tried in full: `python -m tests.model.campaign`; the figures last.

B1 random triples against the slow twin; B3 bad evidence; B4 one input changed at a time. Seeds are printed; a failure is told with its own.
"""

import argparse
import random
import secrets
import time
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

from tests.model import test_bad_evidence, test_fresh_answers, triples
from tests.model.test_twin import disagreement

from policies import ROWS, Effect, decide

SHARE = 5_000
"""Cases of one piece of work."""


def against_the_twin(seed, count):
    pick, effects = random.Random(seed).choice, {}
    for number in range(count):
        case = triples.triple(pick)
        found = disagreement(*case)
        if found:
            return effects, [f"B1 seed {seed}, triple {number}: {found}"]
        effect = decide(*case).effect.value
        effects[effect] = effects.get(effect, 0) + 1
    return effects, []


def bad_evidence(seed, draws):
    chance, cells = random.Random(seed), {}
    for name in ROWS:
        for kind in test_bad_evidence.KINDS:
            for _ in range(draws):
                decision, bad = test_bad_evidence.draw(name, kind, chance)
                if decision.effect is Effect.PERMIT:
                    return cells, [f"B3 seed {seed}: {name}, {kind}, {bad!r:.200}"]
                cells[name, kind] = cells.get((name, kind), 0) + 1
    return cells, []


def fresh_answers(seed, count):
    pick = random.Random(seed).choice
    request, evidence, used = triples.triple(pick)
    for number in range(count):
        if number % 10 == 0:
            request, evidence, drawn = triples.triple(pick)
            used = pick([drawn, test_fresh_answers.SHIPPED])
        request, evidence = test_fresh_answers.changed_once(pick, request, evidence)
        if decide(request, evidence, used) != decide(request, evidence, test_fresh_answers.unused(used)):
            return {"changes": number}, [f"B4 seed {seed}, change {number}"]
    return {"changes": count}, []


def run(pool, work, seed, total, share):
    """The counts of all pieces together, and what failed."""
    pieces = [pool.submit(work, seed * 1_000_003 + n, min(share, total - n * share)) for n in range(-(-total // share))]
    counts, failed = {}, []
    for piece in pieces:
        counted, bad = piece.result()
        failed += bad
        for key, count in counted.items():
            counts[key] = counts.get(key, 0) + count
    return counts, failed


def main():
    parser = argparse.ArgumentParser()
    parser.add_argument("--triples", type=int, default=1_000_000)
    parser.add_argument("--draws", type=int, default=100, help="of each of the 550 cells")
    parser.add_argument("--changes", type=int, default=100_000)
    parser.add_argument("--seed", type=int, default=secrets.randbits(32))
    asked = parser.parse_args()
    print(f"seed {asked.seed}")
    began, failed = time.monotonic(), []
    with ProcessPoolExecutor(2, mp_context=get_context("spawn")) as pool:
        effects, bad = run(pool, against_the_twin, asked.seed, asked.triples, SHARE)
        print(f"B1 {sum(effects.values())} triples against the twin: {len(bad)} disagreements; {effects}")
        failed += bad
        cells, bad = run(pool, bad_evidence, asked.seed, asked.draws, 10)
        fewest = min(cells.values(), default=0)
        print(f"B3 {len(cells)} cells of bad evidence, at least {fewest} draws each: {len(bad)} permits")
        failed += bad
        changes, bad = run(pool, fresh_answers, asked.seed, asked.changes, SHARE)
        print(f"B4 {sum(changes.values())} changes of one input: {len(bad)} stale answers")
        failed += bad
    for what in failed:
        print(what)
    print(f"{'missed' if failed else 'met'}; {time.monotonic() - began:.0f} s")
    return 1 if failed else 0


if __name__ == "__main__":
    raise SystemExit(main())
