"""The claims about straight joint motions, tried in full: `python -m tests.pit.campaign`; the figures last.

Each trial draws a motion and a scene, asks `assess`, and holds the answer against MuJoCo at a few hundred instants
(`tests.pit.dense`): no index below a sampled one, no violation unmentioned, the index at most 0.02 above; the certified
clearance, where one is asked for, at most 0.2 mm below the sampled one and never above; the certificate verified by the
checker; every tenth one corrupted and refused. A trial is named by seed and number, a failure is told with both. What is
done is kept in a ledger, by which a run that was ended goes on.
"""

import argparse
import hashlib
import json
import time
from collections import Counter
from concurrent.futures import FIRST_COMPLETED, ProcessPoolExecutor, wait
from dataclasses import dataclass, field, replace
from multiprocessing import get_context
from pathlib import Path

import numpy as np

from evaluation.bench.pit.ruler import REACH_M, Ruler
from pep.pit import Scene, assess
from pep.pit.checker import Code, Refused, Verified, verify
from pep.pit.engine import chosen
from pep.pit.errors import ProofError
from pep.pit.pairs import pairs_of
from pep.pit.proof import document
from pep.pit.question import as_run, view_around
from policies.evidence import ImpactFault
from tests.pit.bracket import CLOSE, CLOSE_M, closed
from tests.pit.corruption import corrupted
from tests.pit.dense import POSITION_LIMITS, World
from tests.pit.timing import driven
from tests.pit.questions import drawn
from tests.pit.scenes import SEED

COUNT = 100_000
CORRUPTIONS = 1_000
SHARE = 100
"""Trials of one piece of work."""
CORRUPT_EACH = 10
CONTROL, CONTROL_EACH = 1001, 50
"""Even samples of every fiftieth trial."""
UNDER = 1e-6
"""What two ways of computing an index may differ by; a law with a band of 20 mm turns 20 nm into it."""
EXCESS = 0.02
CLEARANCE_M = 2e-4
ROUNDING_M = 1e-6
RATIOS = {"joint_speed", "acceleration", "tcp_speed", "elbow_speed", "momentum", "torque", "payload"}
OWN = (
    "between", "bracket", "campaign", "corruption", "dense", "laws", "questions", "scenes", "stage", "test_checker", "timing", "twin",
)  # fmt: skip


@dataclass
class Figures:
    """What trials showed: counts, highest and lowest values, and what must not be."""

    counts: Counter = field(default_factory=Counter)
    most: dict = field(default_factory=dict)
    failed: list = field(default_factory=list)

    def reach(self, name, value):
        self.most[name] = max(self.most.get(name, float("-inf")), float(value))

    def add(self, other):
        self.counts.update(other.counts)
        for name, value in other.most.items():
            self.reach(name, value)
        self.failed += other.failed


def trial(seed, number):
    """One trial."""
    found = Figures(counts=Counter(trials=1))

    def fail(what):
        found.failed.append(f"seed {seed}, trial {number}: {what}")

    question = drawn(seed, number)
    answer = assess(**question, seed=SEED)
    if isinstance(answer, ImpactFault):
        fail(f"a fault: {answer}")
        return found
    found.counts[f"tier {int(answer.tier)}"] += 1
    found.counts["index is no whole number"] += bool(answer.index % 1)
    found.counts.update(f"violation {kind}" for kind in answer.violations)
    sampled(question, answer, found, fail, control=number % CONTROL_EACH == 0)
    try:
        certified(question, answer, np.random.default_rng([seed, number, 1]), number, found, fail)
    except ProofError as error:
        fail(f"no certificate: {error.detail}")
    return found


# ---- against MuJoCo


def sampled(question, answer, found, fail, *, control=False):
    """The answer against the samples."""
    cell, motion, scene, age = (question[name] for name in ("cell", "motion", "scene", "perception_age_s"))
    run = driven(motion, cell)
    if run is None:
        if answer.index != 0:
            fail("an index of a motion that is none")
        return
    over = np.maximum(np.abs([run.start, run.end]) - POSITION_LIMITS, 0)
    if (over[1] > over[0] + UNDER).any():
        found.counts["beyond a joint limit"] += 1
        if answer.index != 4 or "joint_limit" not in answer.violations:
            fail("through a joint limit")
        return
    unseen = scene is None or age is None
    world = World(
        question["robot"],
        Scene.of_cell(cell) if unseen else scene,
        motion,
        cell,
        0.0 if unseen else age,
        question["touch"],
    )
    if unseen:
        world.floor = cell.unknown_floor
    least = asked_clearance(question)
    farthest = min(least.attained, REACH_M) + 0.01
    if not closed(world, at_least_m=farthest):
        fail(f"{len(world.times)} samples leave something between them")
    seen = judged(world, answer)
    if control:
        controlled(world, seen, found, fail, at_least_m=farthest)
    found.counts["samples"] += seen.samples
    found.counts["compared"] += 1
    under, excess = seen.low - answer.index, beside(seen, answer)
    found.reach("index below a sample", under)
    if under > UNDER:
        fail(f"index {answer.index}, sampled {seen.low}")
    if not seen.violated <= {str(kind) for kind in answer.violations}:
        fail(f"violations {seen.violated}, told {answer.violations}")
    # A ratio is a bound on a speed or mass times speed, and has a slack of its own.
    by_ratio = bool(answer.contributions) and answer.contributions[0].kind in RATIOS
    found.counts["decided by a ratio" if by_ratio else "decided by a pair or the view"] += 1
    found.reach("index above the samples, by a ratio" if by_ratio else "index above the samples", excess)
    if not by_ratio and excess > EXCESS:
        fail(f"index {answer.index}, sampled no more than {seen.high}")
    if np.isfinite(least.attained) and np.isfinite(seen.nearest):
        found.counts["clearances"] += 1
        found.reach("clearance above a sample, mm", 1000 * (least.proven - seen.nearest))
        found.reach("clearance below the samples, mm", 1000 * (seen.nearest - least.proven))
    if least.proven > seen.nearest + ROUNDING_M:
        fail(f"clearance {least.proven}, sampled {seen.nearest}")
    if not near_enough(seen, least):
        fail(f"clearance {least.proven}, sampled no less than {seen.nearest}")


def controlled(world, seen, found, fail, *, at_least_m):
    """Evenly dense samples find nothing that those before them left out."""
    world.forget()
    world.look(np.linspace(0, world.run.timing.duration_s, CONTROL), at_least_m=at_least_m)
    even = world.seen()
    found.counts["controls"] += 1
    found.reach("index of a control above the samples", max(even.high - seen.high, even.low - seen.low))
    found.reach("clearance of a control below the samples, mm", 1000 * max(0.0, seen.nearest - even.nearest))
    if max(even.high - seen.high, even.low - seen.low) > CLOSE:
        fail(f"control: index {even.high}, {even.low}, sampled before {seen.high}, {seen.low}")
    if min(seen.nearest, at_least_m) - even.nearest > CLOSE_M:
        fail(f"control: clearance {even.nearest}, sampled before {seen.nearest}")
    if not even.violated <= seen.violated:
        fail(f"control: violations {even.violated}, sampled before {seen.violated}")


def judged(world, answer):
    """What was seen; torque, which is sampled on both sides and of which nothing is proven, as the answer says it."""
    seen = world.seen()
    torque = max((c.index_milli / 1000 for c in answer.contributions if c.kind == "torque"), default=0.0)
    seen.high = max(seen.high, torque)
    return seen


def beside(seen, answer):
    """By how much the index is above what was sampled."""
    return answer.index - seen.high


def near_enough(seen, least):
    """Whether the certified clearance is near enough to the sampled one, or there is none to speak of."""
    beyond = not np.isfinite(least.attained) or not np.isfinite(seen.nearest)
    return beyond or seen.nearest - least.proven <= CLEARANCE_M + ROUNDING_M


def asked_clearance(question):
    """The certified clearance of all the arm to all that stands around it."""
    robot, cell, motion = (question[name] for name in ("robot", "cell", "motion"))
    view = view_around(robot, question["scene"], question["perception_age_s"], motion.start, cell)
    pairs = pairs_of(robot, view.scene, cell, grown_m=0.0)
    things = sum(len(p.regions) for p in view.scene.people) + len(view.scene.solid_shapes)
    rows = np.arange(things * robot.world_bodies)
    return Ruler(chosen(), robot, cell, pairs, rows).least(as_run(motion, cell))


# ---- the certificate


def certified(question, answer, rng, number, found, fail):
    """The proof is verified, and refused when it is corrupted."""
    began = time.perf_counter()
    text = document(answer, **question)
    verdict = verify(text)
    found.counts["certificates"] += 1
    found.reach("certificate, bytes", len(text))
    found.reach("certificate written and verified, s", time.perf_counter() - began)
    if not isinstance(verdict, Verified) or (verdict.index, verdict.tier) != (answer.index, answer.tier):
        fail(f"the certificate is not verified: {verdict}")
        return
    if number % CORRUPT_EACH == 0:
        bad = corrupted(text, rng)
        refusal = verify(bad.text)
        # A longer interval may prove the same to within what the checker grants to rounding: then nothing is wrong.
        if bad.kind == "coarser_rows" and refusal == replace(verdict, rows=getattr(refusal, "rows", 0)):
            found.counts["coarser rows that prove it too"] += 1
            return
        found.counts["corrupted"] += 1
        if not isinstance(refusal, Refused) or refusal.code is Code.CHECKER_FAILED:
            fail(f"{bad.kind}: {refusal}")


# ---- all of them


def piece(seed, first, count):
    """Some trials in a row; what breaks in one is a failure of that one."""
    found = Figures()
    for number in range(first, first + count):
        try:
            found.add(trial(seed, number))
        except Exception as error:  # noqa: BLE001 - told with its number, and the others go on
            found.failed.append(f"seed {seed}, trial {number}: {type(error).__name__}: {error}")
    return found


def sources():
    """SHA-256 (hex) of all that an answer or a trial depends on: what was tried with other sources was not tried."""
    top = Path(__file__).parents[2]
    own = [Path(__file__).with_name(f"{name}.py") for name in OWN]
    parts = (*(top / "pep" / "pit").rglob("*"), *own, top / "evaluation" / "bench" / "pit" / "ruler.py")
    texts = [part.read_bytes() for part in sorted(parts) if part.suffix in (".py", ".toml")]
    return hashlib.sha256(b"".join(hashlib.sha256(text).digest() for text in texts)).hexdigest()


def known(ledger, seed, of):
    """What the ledger says of this seed with these sources: figures by their first trial."""
    if ledger is None or not ledger.exists():
        return {}
    rows = [json.loads(line) for line in ledger.read_text().splitlines()]
    return {
        row["first"]: Figures(Counter(row["counts"]), row["most"], row["failed"])
        for row in rows
        if (row["seed"], row["of"]) == (seed, of)
    }


def run(seed, first, count, *, ledger, until, workers, told):
    """The figures of all pieces of the range that are in the ledger or were done before `until`."""
    of = sources()
    done = known(ledger, seed, of)
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
                running[pool.submit(piece, seed, at, min(SHARE, first + count - at))] = at
            for ended in wait(running, return_when=FIRST_COMPLETED).done:
                at, figures = running.pop(ended), ended.result()
                whole.add(figures)
                if ledger is not None:
                    row = {"seed": seed, "of": of, "first": at, "counts": figures.counts, "most": figures.most}
                    with ledger.open("a") as book:
                        book.write(json.dumps(row | {"failed": figures.failed}) + "\n")
                told(whole)
    return whole


def main():
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--seed", type=int, default=2026)
    parser.add_argument("--first", type=int, default=0, help="number of the first trial")
    parser.add_argument("--count", type=int, default=COUNT)
    parser.add_argument("--minutes", type=float, default=float("inf"), help="no new trials after so long")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--ledger", type=Path, help="a file that keeps what is done; a run with it goes on")
    given = parser.parse_args()
    began = time.monotonic()
    chosen()  # compiled once, before the others read it
    told = lambda whole: print(f"\r{whole.counts['trials']} trials, {len(whole.failed)} failed", end="", flush=True)  # noqa: E731
    whole = run(
        given.seed, given.first, given.count, ledger=given.ledger, until=began + 60 * given.minutes,
        workers=given.workers, told=told,
    )  # fmt: skip
    print()
    for name, value in sorted(whole.most.items()):
        print(f"most: {name}: {value:.3g}")
    for name, value in sorted(whole.counts.items()):
        print(f"{name}: {value}")
    for what in whole.failed[:100]:
        print(what)
    trials, corruptions = whole.counts["trials"], whole.counts["corrupted"]
    short = trials < given.count or corruptions < min(CORRUPTIONS, given.count // CORRUPT_EACH)
    verdict = "missed" if whole.failed else "not all of it was tried" if short else "met"
    print(
        f"seed {given.seed}, trials {given.first} to {given.first + given.count - 1}: {trials} done, "
        f"{corruptions} corrupted certificates, {len(whole.failed)} failed: {verdict}; {time.monotonic() - began:.0f} s"
    )
    return 1 if whole.failed or short else 0


if __name__ == "__main__":
    raise SystemExit(main())
