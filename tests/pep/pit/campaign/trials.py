"""The trials of the campaign: one question each, its answer held against MuJoCo, its certificate against the checker."""

import time
from collections import Counter
from dataclasses import dataclass, field, replace

import numpy as np
from evaluation.pit.ruler import REACH_M, Ruler
from pep.pit.assessment.stream import Bounded, Stream
from pep.pit.base.errors import ProofError
from pep.pit.proof.proof_document import document
from pep.pit.scene.pairs import pairs_of
from pep.pit.search.engine import chosen
from pep.pit.search.question import as_run, view_around
from policies.evidence.evidence import ImpactFault
from tests.pep.pit.campaign.bracket import CLOSE, CLOSE_M, closed
from tests.pep.pit.campaign.curves import CurvedWorld, curved_question, instants, played, random_stream, straight_legs
from tests.pep.pit.campaign.dense import POSITION_LIMITS, World
from tests.pep.pit.campaign.questions import drawn, patient
from tests.pep.pit.campaign.timetables import random_trajectory
from tests.pep.pit.campaign.timing import driven
from tests.pep.pit.checker.corruption_courses import corrupted as corrupted_course
from tests.pep.pit.checker.test_checker import asked
from tests.pep.pit.corruption import corrupted as corrupted_move
from tests.pep.pit.scenes import SEED, random_scene

from pep.pit import JointPath, JointTrajectory, assess
from pep.pit.checker import Code, Unverified, Verified, verify

CORRUPT_EACH = 10
CONTROL_EACH = 50
"""Of so many trials one is sampled every millisecond as well."""
STREAMS = 0.25
"""Share of streams among what is no straight joint motion."""
TRAJECTORIES = 2.0
"""In place of a share: timed trajectories alone."""
CERTIFY_EACH = 5
"""Of so many trajectories alone one has its certificate written and checked: it has some dozen legs."""
OTHER_ROWS = ("coarser_rows", "rows_elsewhere", "rows_joined")
UNDER = 1e-6
"""Greatest difference of two ways of computing an index.

A law with a band of 20 mm turns 20 nm into it.
"""
EXCESS = 0.02
RATIO_EXCESS = 0.02
"""The same for an index that a ratio of PHY-7 decides: another search proves it."""
CLEARANCE_M = 2e-4
ROUNDING_M = 1e-6
RATIOS = {"joint_speed", "acceleration", "tcp_speed", "elbow_speed", "momentum", "torque", "payload"}


@dataclass
class Figures:
    """Figures of trials: counts, highest and lowest values, and failures."""

    counts: Counter = field(default_factory=Counter)
    most: dict = field(default_factory=dict)
    failed: list = field(default_factory=list)
    excess: list = field(default_factory=list)

    def reach(self, name, value):
        self.most[name] = max(self.most.get(name, float("-inf")), float(value))

    def add(self, other):
        self.counts.update(other.counts)
        for name, value in other.most.items():
            self.reach(name, value)
        self.failed += other.failed
        self.excess += other.excess


def piece(seed, first, count, share):
    """Some trials in a row; what breaks in one is a failure of that one.

    It is here since another process finds nothing in a `__main__`.
    """
    found = Figures()
    for number in range(first, first + count):
        try:
            found.add(trial(seed, number, share))
        except Exception as error:  # noqa: BLE001 - told with its number, and the others go on
            found.failed.append(f"seed {seed}, trial {number}: {type(error).__name__}: {error}")
    return found


def trial(seed, number, share=0.0):
    """One trial; of a motion that is no straight joint motion in so large a share of them."""
    found = Figures(counts=Counter(trials=1))

    def fail(what):
        found.failed.append(f"seed {seed}, trial {number}: {what}")

    rng = np.random.default_rng([seed, number, 2])
    if share == TRAJECTORIES:
        curved_trial(rng, number, found, fail, only=random_trajectory)
        return found
    if rng.random() < share:
        if rng.random() < STREAMS:
            stream_trial(rng, found, fail)
        else:
            curved_trial(rng, number, found, fail)
        return found
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
        certified(question, answer, np.random.default_rng([seed, number, 1]), number, found, fail, corrupted_move)
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
        cell.surveyed if unseen else scene,
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
    if excess > (RATIO_EXCESS if by_ratio else EXCESS):
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
    world.look(instants(world.run.timing.duration_s), at_least_m=at_least_m)
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
    """Findings of the world, with the answer's torque, which is sampled on both sides and never proven."""
    seen = world.seen()
    torque = max((c.index_milli / 1000 for c in answer.contributions if c.kind == "torque"), default=0.0)
    seen.high = max(seen.high, torque)
    return seen


def beside(seen, answer):
    """By how much the index is above what was sampled."""
    return answer.index - seen.high


def near_enough(seen, least):
    """True where the certified clearance is near enough to the sampled one, or there is none."""
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


# ---- motions that are no straight joint motion


def curved_trial(rng, number, found, fail, *, only=None):
    """No sample is above the answer, whose certificate holds; of joint paths, which are straight, it is near too."""
    question = patient(curved_question(rng, only=only))
    answer = assess(**question, seed=SEED)
    motion = question["motion"]
    found.counts["curved"] += 1
    found.counts[type(motion).__name__] += 1
    if answer == ImpactFault("UNPROVEN", getattr(answer, "detail", "")):
        found.counts["curved, unproven"] += 1
        return
    if isinstance(answer, ImpactFault):
        fail(f"a fault: {answer}")
        return
    try:
        if only is None or number % CERTIFY_EACH == 0:
            certified(question, answer, rng, number, found, fail, corrupted_course)
    except ProofError as error:
        fail(f"no certificate: {error.detail}")
    if "joint_limit" in answer.violations:
        found.counts["curved, beyond a limit"] += 1
        return
    low, high, violated = curved_seen(question, motion, rng, found, fail)
    if low is None:
        found.counts["curved, not followed"] += 1
        return
    found.reach("index below a sample, curved", low - answer.index)
    if low > answer.index + UNDER:
        fail(f"{type(motion).__name__}: index {answer.index}, sampled {low}")
    if not violated <= {str(kind) for kind in answer.violations}:
        fail(f"{type(motion).__name__}: violations {violated}, told {answer.violations}")
    by_ratio = bool(answer.contributions) and answer.contributions[0].kind in RATIOS
    if isinstance(motion, JointPath) and not by_ratio:
        found.reach("index above the samples, joint paths", answer.index - high)
        if answer.index - high > EXCESS:
            fail(f"index {answer.index}, sampled no more than {high}")
    elif not by_ratio:
        found.reach("index above the samples, curved", answer.index - high)
    if isinstance(motion, JointTrajectory):
        found.excess.append(answer.index - high)


def stream_trial(rng, found, fail):
    """No sample is above what is told of each value of a stream."""
    question = patient(asked(random_scene(rng, things=2, regions=2), None))
    more = question["scene"], question["cell"], question["perception_age_s"], question["touch"]
    stream = Stream(question["robot"], question["cell"], touch=question["touch"], clock=lambda: 0.0)
    seen_at = None
    found.counts["streams"] += 1
    for motion in random_stream(rng):
        if seen_at is None:
            seen_at = motion.start
            stream.see(question["scene"], age_s=question["perception_age_s"], at_rad=seen_at)
        answer = stream.step(motion, authorised_milli=4000, seed=SEED)
        found.counts[f"stream, {type(motion).__name__}"] += 1
        if isinstance(answer, ImpactFault):
            fail(f"a fault: {answer}")
            return
        settled = isinstance(answer, Bounded)
        found.counts["stream, settled at once"] += settled
        if not settled and "joint_limit" in answer.violations:
            found.counts["stream, beyond a limit"] += 1
            continue
        low, _, violated = seen_in(played(motion, rng), question["robot"], motion, more, found)
        found.reach("index below a sample, stream", low - answer.index)
        if low > answer.index + UNDER:
            fail(f"stream of {type(motion).__name__}: index {answer.index}, sampled {low}")
        told = set() if settled else {str(kind) for kind in answer.violations}
        if not violated <= told:
            fail(f"stream of {type(motion).__name__}: violations {violated}, told {told}")


def seen_in(ways, robot, motion, more, found):
    """Highest index with and without allowances, and what is violated, in these ways of doing a motion."""
    worlds = [CurvedWorld(robot, more[0], motion, *more[1:], run=way) for way in ways]
    for world in worlds:
        world.look(world.run.times)
    return worst_of(worlds, found)


def worst_of(worlds, found):
    """The same in these worlds, which were sampled."""
    seen = [world.seen() for world in worlds]
    found.counts["samples, curved"] += sum(s.samples for s in seen)
    return max(s.low for s in seen), max(s.high for s in seen), set().union(*(s.violated for s in seen))


def curved_seen(question, motion, rng, found, fail):
    """Highest index with and without allowances, and what is violated; nothing where the arm cannot follow."""
    more = question["scene"], question["cell"], question["perception_age_s"], question["touch"]
    if not isinstance(motion, JointPath):
        ways = played(motion, rng)
        return (None, None, None) if ways is None else seen_in(ways, question["robot"], motion, more, found)
    worlds = []
    for leg in straight_legs(motion):
        if driven(leg, question["cell"]) is not None:
            worlds.append(World(question["robot"], more[0], leg, *more[1:]))
            if not closed(worlds[-1]):
                fail(f"{len(worlds[-1].times)} samples leave something between them")
    return worst_of(worlds, found)


# ---- the certificate


def certified(question, answer, rng, number, found, fail, corrupted):
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
        if bad.kind in OTHER_ROWS and refusal == replace(verdict, rows=getattr(refusal, "rows", 0)):
            found.counts["other rows that prove it too"] += 1
            return
        found.counts["corrupted"] += 1
        if not isinstance(refusal, Unverified) or refusal.code is Code.CHECKER_FAILED:
            fail(f"{bad.kind}: {refusal}")
