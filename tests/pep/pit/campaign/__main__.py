"""The claims about motions, tried in full: `python -m tests.pep.pit.campaign`; the figures last.

Each trial draws a motion and a scene, asks `assess`, and holds the answer against MuJoCo, which samples until nothing
that counts is hidden between its samples (`bracket`): no index below a sampled one, no violation unmentioned,
the index at most 0.02 above; the certified clearance, where one is asked for, at most 0.2 mm below the sampled one and
never above; the certificate verified by the checker; every tenth one corrupted and refused. Every fiftieth trial is
sampled every millisecond as well. Half of all motions are none that are straight in the joints: lines, paths, held tool speeds
and streams, sampled every millisecond, whose index is below no sample and whose certificate holds. A trial is named by seed and number, a failure is told with both. What is done is
kept in a ledger, by which a run that was ended goes on.
"""

import argparse
import hashlib
import json
import time
from collections import Counter
from concurrent.futures import FIRST_COMPLETED, ProcessPoolExecutor, wait
from multiprocessing import get_context
from pathlib import Path

import numpy as np
from pep.pit.assessment.readiness import compile_all
from tests.pep.pit.campaign.trials import CORRUPT_EACH, TRAJECTORIES, Figures, piece

COUNT = 20_000
CORRUPTIONS = 1_000
SHARE = 100
"""Trials of one piece of work."""
CURVED = 0.5
"""Share of trials that are no straight joint motion."""
OWN = (
    "between", "bracket", "__main__", "corruption", "corruption_courses", "courses", "curves", "dense", "facts", "laws", "lines", "questions", "scenes", "stage", "test_checker", "timetables", "timing", "trials", "twin",
)  # fmt: skip


def path_of(name):
    """The file of a module that trials are made of: here, or in a room of the tests of physics."""
    (path,) = Path(__file__).parents[1].rglob(f"{name}.py")
    return path


def sources():
    """SHA-256 (hex) of all that an answer or trial depends on: trials with other sources do not count."""
    top = Path(__file__).parents[4]
    own = [path_of(name) for name in OWN]
    parts = (*(top / "pep" / "pit").rglob("*"), *own, top / "evaluation" / "pit" / "ruler.py")
    texts = [part.read_bytes() for part in sorted(parts) if part.suffix in (".py", ".toml")]
    return hashlib.sha256(b"".join(hashlib.sha256(text).digest() for text in texts)).hexdigest()


def known(ledger, seed, share, of):
    """Figures in the ledger of this seed and share with these sources, by their first trial."""
    if ledger is None or not ledger.exists():
        return {}
    rows = [row for row in map(read, ledger.read_text().splitlines()) if row is not None]
    return {
        row["first"]: Figures(Counter(row["counts"]), row["most"], row["failed"], row.get("excess", []))
        for row in rows
        if (row["seed"], row.get("share"), row["of"]) == (seed, share, of)
    }


def read(line):
    """One row of a ledger, or nothing where a run was ended while it wrote."""
    try:
        return json.loads(line)
    except ValueError:
        return None


def run(seed, first, count, *, share, ledger, until, workers, told):
    """The figures of all pieces of the range that are in the ledger or were done before `until`."""
    of = sources()
    done = known(ledger, seed, share, of)
    open_ = [at for at in range(first, first + count, SHARE) if at not in done]
    whole = Figures()
    for at, figures in done.items():
        if first <= at < first + count:
            whole.add(figures)
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
        running = {}
        while running or (open_ and time.monotonic() < until):
            while open_ and len(running) < workers and time.monotonic() < until:
                at = open_.pop(0)
                running[pool.submit(piece, seed, at, min(SHARE, first + count - at), share)] = at
            for ended in wait(running, return_when=FIRST_COMPLETED).done:
                at, figures = running.pop(ended), ended.result()
                whole.add(figures)
                if ledger is not None:
                    row = {
                        "seed": seed,
                        "share": share,
                        "of": of,
                        "first": at,
                        "counts": figures.counts,
                        "most": figures.most,
                    }
                    with ledger.open("a") as book:
                        book.write("\n" + json.dumps(row | {"failed": figures.failed, "excess": figures.excess}) + "\n")
                told(whole)
    return whole


def main():
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seed", type=int, default=2026)
    parser.add_argument("--first", type=int, default=0, help="number of the first trial")
    parser.add_argument("--count", type=int, default=COUNT)
    parser.add_argument(
        "--curved", type=float, default=CURVED, help="share of lines, paths, held tool speeds and streams"
    )
    parser.add_argument("--minutes", type=float, default=float("inf"), help="no new trials after so long")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--ledger", type=Path, help="a file that keeps what is done; a run with it goes on")
    parser.add_argument("--trajectories", action="store_true", help="timed trajectories alone")
    given = parser.parse_args()
    began = time.monotonic()
    compile_all()  # compiled once, before the others read it
    told = lambda whole: print(f"\r{whole.counts['trials']} trials, {len(whole.failed)} failed", end="", flush=True)  # noqa: E731
    whole = run(
        given.seed, given.first, given.count, share=TRAJECTORIES if given.trajectories else given.curved, ledger=given.ledger, until=began + 60 * given.minutes,
        workers=given.workers, told=told,
    )  # fmt: skip
    print()
    for name, value in sorted(whole.most.items()):
        print(f"most: {name}: {value:.3g}")
    for name, value in sorted(whole.counts.items()):
        print(f"{name}: {value}")
    if whole.excess:
        p50, p99 = np.quantile(whole.excess, [0.5, 0.99])
        print(f"index of trajectories above the samples: p50 {p50:.3f}, p99 {p99:.3f}, most {max(whole.excess):.3f}")
    for what in whole.failed[:100]:
        print(what)
    trials, corruptions = whole.counts["trials"], whole.counts["corrupted"]
    short = trials < given.count or corruptions < min(CORRUPTIONS, given.count // CORRUPT_EACH // 2)
    verdict = "missed" if whole.failed else "not all of it was tried" if short else "met"
    print(
        f"seed {given.seed}, trials {given.first} to {given.first + given.count - 1}: {trials} done, "
        f"{corruptions} corrupted certificates, {len(whole.failed)} failed: {verdict}; {time.monotonic() - began:.0f} s"
    )
    return 1 if whole.failed or short else 0


if __name__ == "__main__":
    raise SystemExit(main())
