"""Paths with cut corners, each cut in several ways by an independent arm: `python -m tests.pep.pit.campaign.blends`.

A trial draws a path of joint moves and lines with blends, asks `assess`, and moves the arm with pinocchio's kinematics,
instant by instant: straight through each waypoint, along a parabola in the joints, along their chord, and, where a leg
is a line, along a parabola of the tool's pose. Of no instant may index, speed or a violation be above the answer, as
MuJoCo and laws written down once more find them (`dense`); a path that is refused is counted. A trial is named by seed and number; both are told of a failure.
"""

from __future__ import annotations

import argparse
import time
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from functools import lru_cache, partial
from multiprocessing import get_context

import numpy as np
import pinocchio
from pep.pit.assessment.readiness import compile_all
from pep.pit.base.tier import HIGHEST
from policies.evidence.evidence import ImpactFault
from tests.pep.pit.campaign.curves import CurvedWorld, Played
from tests.pep.pit.lines import MODEL, followed, placed, pose_of, random_start, tool_jacobian
from tests.pep.pit.scenes import CELL, NOTHING, ROBOT, SEED, random_scene

from pep.pit import BlendedPath, JointLeg, LineLeg, assess

STEP_S = 0.001
AGE_S = 0.1
SLACK = 1e-9
STILL_RAD_S = 1e-9
"""Speed of a joint that does not move, with the rounding of its angles."""
LEGS = (2, 2)
REFUSED = {"OUT_OF_RANGE", "UNPROVEN"}
PATIENT = replace(CELL, time_limit_s=60.0)
PLACES = 32
"""Pieces of a line at whose ends it is solved first."""
SHARE = 5
"""Trials of one piece of work."""


class Leg:
    """One leg as an arm does it, with pinocchio's kinematics alone."""

    def __init__(self, start, leg):
        self.start, self.leg, self.scratch = np.array(start), leg, MODEL.createData()
        self.line, self.grid = isinstance(leg, LineLeg), None
        if self.line:
            self.position, self.rotation = placed(start, self.scratch)
            self.way = np.array(leg.target[:3]) - self.position
            self.turn = pinocchio.log3(pinocchio.exp3(np.array(leg.target[3:])) @ self.rotation.T)
            length = max(float(np.linalg.norm(self.way)), 0.1 * float(np.linalg.norm(self.turn)))
            self.fastest, self.gain = leg.speed_m_s / length, leg.acceleration_m_s2 / length
            self.known, self.last, grid = {}, (self.start, np.zeros(6), 0.0), []
            for s in np.linspace(0, 1, PLACES + 1).tolist():
                self.solved(s)
                grid.append(self.last)
            self.grid = grid
        else:
            self.way = np.array(leg.target) - self.start
            length = float(np.abs(self.way).max())
            self.fastest, self.gain = leg.speed_rad_s / length, leg.acceleration_rad_s2 / length

    def solved(self, s):
        """Joint angles in this share, found once: from the nearest known ones, and how these go on."""
        if (known := self.known.get(s)) is not None:
            return known
        near, dq, at = self.last
        if self.grid is not None:
            near, dq, at = min(self.last, self.grid[round(PLACES * s)], key=lambda known: abs(known[2] - s))
        near = near + (s - at) * dq
        q = followed(near, self.position + s * self.way, pinocchio.exp3(s * self.turn) @ self.rotation, self.scratch)
        if q is None:
            raise LookupError("lost")
        dq = np.linalg.solve(tool_jacobian(q, self.scratch), np.concatenate([self.way, self.turn]))
        self.known[s], self.last = q, (q, dq, s)
        return q

    def at(self, s):
        return self.solved(s) if self.line else self.start + s * self.way

    def share(self, radius_m, *, arriving):
        """Share in which the tool is within the radius of the waypoint, by halving."""
        goal = placed(self.at(1.0 if arriving else 0.0), self.scratch)[0]
        near, far = 0.0, 1.0
        while far - near > 1e-6:
            middle = 0.5 * (near + far)
            tool = placed(self.at(1 - middle if arriving else middle), self.scratch)[0]
            near, far = (near, middle) if np.linalg.norm(tool - goal) > radius_m else (middle, far)
        return near

    def rate(self, s, *, from_rest, to_rest):
        """Shares a second."""
        up = np.sqrt(2 * self.gain * max(s, 1e-9)) if from_rest else np.inf
        down = np.sqrt(2 * self.gain * max(1 - s, 1e-9)) if to_rest else np.inf
        return float(min(self.fastest, up, down))

    def moved(self, since, until, **rests):
        """Joint angles each millisecond between two shares."""
        s, found = since, []
        while s < until:
            found.append(self.at(s))
            s += max(self.rate(s, **rests), 1e-3 * self.fastest) * STEP_S
        return [*found, self.at(until)]


def bezier(a, b, c, at):
    return (1 - at) ** 2 * a + 2 * at * (1 - at) * b + at**2 * c


def cut(one, two, shares, times, manner):
    """Joint angles each millisecond in a corner, or nothing where the arm goes through the waypoint."""
    into, out = one.at(1 - shares[0]), two.at(shares[1])
    waypoint = two.start
    at, found = 0.0, []
    scratch = MODEL.createData()
    poses = [placed(q, scratch) for q in (into, waypoint, out)]
    turns = [pinocchio.log3(rotation @ poses[1][1].T) for _, rotation in poses]
    while at < 1:
        if manner == "chord":
            q = into + at * (out - into)
            at += STEP_S / sum(times)
        else:
            q = bezier(into, waypoint, out, at)
            if manner == "tool":
                turn = bezier(turns[0], turns[1], turns[2], at)
                where = bezier(*(position for position, _ in poses), at)
                q = followed(q, where, pinocchio.exp3(turn) @ poses[1][1], scratch)
                if q is None:
                    raise LookupError("lost")
            at += STEP_S / (2 * ((1 - at) * times[0] + at * times[1]))
        found.append(q)
    return found


@lru_cache(maxsize=1)
def legs_of(path):
    """The legs of a path, each from the end of the one before."""
    legs, start = [], path.start
    for each in path.legs:
        legs.append(Leg(start, each))
        start = tuple(legs[-1].at(1.0).tolist())
    return legs


def moved(path, manner):
    """Joint angles each millisecond, leg by leg and corner by corner.

    Raises:
        LookupError: a pose was not reached.
    """
    legs, found, since = legs_of(path), [], 0.0
    for number, leg in enumerate(legs):
        blend = leg.leg.blend_m
        rests = {"from_rest": not (number > 0 and legs[number - 1].leg.blend_m > 0), "to_rest": not blend > 0}
        cutting = blend > 0 and manner != "through"
        share = leg.share(blend, arriving=True) if cutting else 0.0
        found.append(leg.moved(since, 1 - share, **rests))
        since = 0.0
        if cutting:
            behind = legs[number + 1]
            since = behind.share(blend, arriving=False)
            stops = behind.leg.blend_m == 0
            times = share / leg.rate(1.0, **rests), since / behind.rate(0.0, from_rest=False, to_rest=stops)
            how = manner if manner != "tool" or leg.line or legs[number + 1].line else "parabola"
            found.append(cut(leg, behind, (share, since), times, how))
    return [np.array(each) for each in found]


def random_path(rng):
    """A path whose blends are mostly less than half of its legs."""
    start = np.array(random_start(rng, 0.5))
    here, legs = start, []
    count = int(rng.integers(*LEGS, endpoint=True))
    for number in range(count):
        here = here + rng.uniform(-0.3, 0.3, 6) * (rng.random(6) < 0.7)
        blend = float(rng.uniform(0.003, 0.03)) if number < count - 1 else 0.0
        if rng.random() < 0.5:
            legs.append(LineLeg(pose_of(here), float(rng.uniform(0.2, 0.8)), float(rng.uniform(1, 5)), blend))
        else:
            legs.append(JointLeg(tuple(here.tolist()), float(rng.uniform(0.6, 2.0)), float(rng.uniform(2, 8)), blend))
    return BlendedPath(tuple(start.tolist()), tuple(legs))


def trial(seed, number):
    """Result of one trial as words and figures: ("refused", reason), ("held", room) or ("failed", what)."""
    rng = np.random.default_rng((seed, number))
    scene, path = random_scene(rng, things=2, regions=2), random_path(rng)
    answer = assess(ROBOT, scene, path, PATIENT, perception_age_s=AGE_S, touch=NOTHING, seed=SEED)
    if isinstance(answer, ImpactFault):
        return ("refused", answer.detail) if answer.reason in REFUSED else ("failed", f"{number}: {answer}")
    if "joint_limit" in answer.violations:
        return "refused", "joint_limit"
    return judged(scene, path, answer, number, partial(moved, path), ("through", "parabola", "chord", "tool"))


def judged(scene, motion, answer, number, move, manners, *, touch=NOTHING):
    """The answer against every manner of moving."""
    worst, samples = 1.0, 0
    for manner in manners:
        try:
            parts = [q for q in move(manner) if len(q) > 1]
        except LookupError:
            continue
        for q in parts:
            qd = np.gradient(q[:-1], STEP_S, axis=0) if len(q) > 2 else np.diff(q, axis=0) / STEP_S
            run = Played(q[: len(qd)], np.where(np.abs(qd) < STILL_RAD_S, 0.0, qd))
            world = CurvedWorld(ROBOT, scene, motion, CELL, AGE_S, touch, run)
            world.look(run.times)
            seen = world.seen()
            above = seen.low - answer.index
            fast = float(world.shots.speed[:, : len(world.stage.moving)].max()) - answer.speed_m_s
            # Of a path with the highest index nothing behind the leg that has it is assessed.
            if (
                above > SLACK
                or (fast > SLACK and answer.index < HIGHEST)
                or not seen.violated <= set(answer.violations)
            ):
                return "failed", f"{number} {manner}: index {above:+.4f}, speed {fast:+.4f}, {seen.violated}"
            worst = max(worst, seen.low)
            samples += seen.samples
    return "held", (answer.index - worst, samples)


def piece(seed, first, count, ask=trial):
    """Results of some trials."""
    return [ask(seed, number) for number in range(first, first + count)]


def run(ask, *, seed, first, count, minutes, workers):
    """All results, told as they come."""
    began, results = time.monotonic(), []
    with ProcessPoolExecutor(workers, mp_context=get_context("spawn")) as pool:
        pieces = iter(range(first, first + count, SHARE))
        running = [pool.submit(piece, seed, at, SHARE, ask) for at, _ in zip(pieces, range(2 * workers), strict=False)]
        while running:
            done = running.pop(0).result()
            results += done
            for detail in [detail for word, detail in done if word == "failed"]:
                print(f"\nseed {seed}, trial {detail}")
            if time.monotonic() - began < 60 * minutes:
                running += [pool.submit(piece, seed, at, SHARE, ask) for at in [next(pieces, None)] if at is not None]
            failed = sum(word == "failed" for word, _ in results)
            print(f"\r{len(results)} trials, {failed} failed", end="", flush=True)
    print()
    return results


def told(what, results, seed, took_s):
    """The figures; true where nothing failed."""
    words = Counter(word for word, _ in results)
    reasons = Counter(detail for word, detail in results if word == "refused")
    room = np.array([detail[0] for word, detail in results if word == "held"] or [0.0])
    samples = sum(detail[1] for word, detail in results if word == "held")
    print(f"refused: {dict(reasons)}")
    print(f"above the samples: median {np.median(room):.3f}, p99 {np.quantile(room, 0.99):.3f}")
    print(
        f"{what}, seed {seed}: {len(results)} trials, {words['held']} held against {samples} samples, "
        f"{words['failed']} under-estimates; {took_s:.0f} s"
    )
    return not words["failed"]


def main(what, ask):
    """The command line of a campaign of trials."""
    parser = argparse.ArgumentParser(description=what)
    parser.add_argument("--seed", type=int, default=2026)
    parser.add_argument("--first", type=int, default=0, help="number of the first trial")
    parser.add_argument("--count", type=int, default=10_000)
    parser.add_argument("--minutes", type=float, default=float("inf"), help="no new trials after so long")
    parser.add_argument("--workers", type=int, default=2)
    given = parser.parse_args()
    began = time.monotonic()
    compile_all()  # compiled once, before the others read it
    results = run(
        ask, seed=given.seed, first=given.first, count=given.count, minutes=given.minutes, workers=given.workers
    )
    return 0 if told(what, results, given.seed, time.monotonic() - began) else 1


if __name__ == "__main__":
    raise SystemExit(main("blends", trial))
