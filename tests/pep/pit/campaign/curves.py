"""Motions that are no straight joint motion, as a controller would do them: lines, paths, held tool speeds, servo targets.

The tool is followed with pinocchio's kinematics (`lines`), instant by instant; what that does to the scene is MuJoCo's to
say, as of straight motions. Of what a motion may do, one or a few ways of doing it are drawn. Joint speeds in the laws
are those that were met, not proven ones: an answer may be a little above what is sampled, never below.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import pinocchio
from pep.base.stop_model import patience_s
from tests.pep.pit.campaign.dense import World
from tests.pep.pit.campaign.facts import MODEL as FACTS
from tests.pep.pit.campaign.timetables import random_trajectory, served
from tests.pep.pit.campaign.timing import Timing
from tests.pep.pit.checker.test_checker import asked
from tests.pep.pit.lines import (
    MODEL,
    followed,
    marched,
    placed,
    pose_of,
    random_hold,
    random_line,
    random_servo,
    random_start,
    random_way,
    tool_jacobian,
)
from tests.pep.pit.scenes import CELL, random_move, random_scene

from pep.pit import JointLeg, JointPath, JointTrajectory, LineLeg, LinePath, MoveJ, MoveL, ServoJ, SpeedJ, SpeedL

TURN_LEVER_M = 0.1
"""Lever, metre, by which a turn of the tool counts as way where that exceeds the line (PHY-18)."""
STEP_S = 0.001
"""Time between two samples of a motion."""
LEGS_MOST = 4
VALUES, EACH = 5, 25
"""Values of a stream in one question: of so many values of the stream one."""
PERIOD_S, LOOKAHEAD_S = 0.002, 0.1
SPEED_LIMITS = np.array([joint["speed_limit_rad_s"] for joint in FACTS["joints"]])


@dataclass(frozen=True)
class _Peak:
    """Timing of a motion as a world needs it."""

    peak: float
    duration_s: float


class Played:
    """Joint angles and speeds one after the other."""

    def __init__(self, q, qd):
        """Shapes (n, 6); their numbers are their times."""
        self.q, self.qd = np.array(q), np.array(qd)
        self.timing = _Peak(float(np.abs(self.qd).max()), len(self.q) - 1.0)

    @property
    def times(self):
        """All instants there are."""
        return np.arange(len(self.q), dtype=float)

    def at(self, times):
        """Joint angles and speeds there."""
        which = times.astype(int)
        return self.q[which], self.qd[which]

    def fastest_m_s(self, stage):
        """No body goes faster than this."""
        speed = np.abs(self.qd).max(axis=0)
        return float((stage.levers @ speed + stage.radius * speed.sum()).max())


class CurvedWorld(World):
    """One way of doing a motion that is no straight one, sampled in MuJoCo."""

    def ratios(self, fastest=None):
        """Those that the instants show."""
        fastest = self.shots.points.max(axis=0) if fastest is None else fastest
        return {
            "joint_speed": float((np.abs(self.run.qd) / SPEED_LIMITS).max()),
            "payload": (self.tool["mass_kg"] + self.carried_kg()) / FACTS["payload_limit_kg"],
        } | self.speed_ratios(fastest)


# ---- questions


def curved_question(rng, *, only=None):
    """A question of any of these forms, or of one."""
    scene = random_scene(rng, things=2, regions=2)
    forms = (random_line, random_hold, random_servo, random_joint_path, random_line_path, random_trajectory)
    form = forms[int(rng.integers(0, len(forms)))] if only is None else only
    return asked(scene, form(rng))


def random_stream(rng):
    """Values of a program's stream, one after the other: what the arm does with one is where the next begins."""
    served = bool(rng.integers(0, 2))
    q, qd = np.array(random_start(rng)), rng.uniform(-0.6, 0.6, 6) * rng.choice([0.1, 0.5, 1.0])
    for _ in range(VALUES):
        q, qd = q + PERIOD_S * EACH * qd, qd + rng.uniform(-0.05, 0.05, 6)
        start, now = tuple(q.tolist()), tuple(qd.tolist())
        if served:
            target = q + LOOKAHEAD_S * (qd + rng.uniform(-0.1, 0.1, 6))
            yield ServoJ(start, now, tuple(target.tolist()), PERIOD_S, LOOKAHEAD_S)
        else:
            yield SpeedJ(start, now, float(rng.uniform(0.5, 8)), float(rng.uniform(PERIOD_S, 0.2)))


def random_joint_path(rng):
    """Legs as random moves are, one after the other."""
    first = random_move(rng, 0.6)
    targets = [np.array(first.target)]
    for _ in range(int(rng.integers(0, LEGS_MOST))):
        targets.append(targets[-1] + rng.uniform(-0.4, 0.4, 6))
    legs = (JointLeg(tuple(each.tolist()), float(rng.uniform(0.1, 2)), float(rng.uniform(0.5, 5))) for each in targets)
    return JointPath(first.start, tuple(legs))


def random_line_path(rng):
    """Lines there and somewhere else, where the arm can follow."""
    while True:
        start = here = random_start(rng)
        legs = []
        for _ in range(int(rng.integers(1, LEGS_MOST))):
            line, turn = random_way(rng, longest=0.15, turn=0.5)
            track = marched(here, line, turn, np.linspace(0, 1, 31))
            if track is None or not all(np.abs(dq).max() < 8 and np.abs(q[2]) < 3.1 for q, dq in track):
                break
            here = tuple(track[-1][0].tolist())
            legs.append(LineLeg(pose_of(here), float(rng.uniform(0.02, 0.4)), float(rng.uniform(0.2, 3))))
        if legs:
            return LinePath(start, tuple(legs))


# ---- what they do


def straight_legs(path):
    """The legs of a joint path as joint moves."""
    start = path.start
    for leg in path.legs:
        yield MoveJ(start, leg.target, leg.speed_rad_s, leg.acceleration_rad_s2)
        start = leg.target


def played(motion, rng):
    """Ways of doing it: (which leg, what is done); None when the arm cannot follow."""
    match motion:
        case MoveL(start, target, speed, acceleration):
            ways = [_line(start, target, speed, acceleration)]
        case LinePath(start, legs):
            ways = []
            for leg in legs:
                ways.append(_line(start, leg.target, leg.speed_m_s, leg.acceleration_m_s2))
                if ways[-1] is None:
                    break
                start = ways[-1].q[-1]
        case SpeedL():
            ways = [_held(motion, motion.duration_s + share * CELL.stop_delay_s) for share in (0.0, rng.random(), 1.0)]
        case ServoJ():
            ways = [_servo(motion, rng.random(6)) for _ in range(4)]
        case SpeedJ():
            ways = [_sped(motion)]
        case JointTrajectory():
            ways = [Played(q, qd) for q, qd in served(motion, rng)]
    return None if any(way is None for way in ways) else ways


def instants(until_s):
    """Instants from 0 to the end, both among them, no farther apart than `STEP_S`."""
    return np.linspace(0, until_s, max(2, int(np.ceil(until_s / STEP_S)) + 1))


def _line(start, target, speed, acceleration):
    position, rotation = placed(start)
    line = np.array(target[:3]) - position
    turn = pinocchio.log3(pinocchio.exp3(np.array(target[3:])) @ rotation.T)
    way = max(float(np.linalg.norm(line)), TURN_LEVER_M * float(np.linalg.norm(turn)))
    peak = min(speed, (acceleration * way) ** 0.5)
    timing = Timing(acceleration, acceleration, peak, way / peak - peak / acceleration)
    made, rate = timing.lead(instants(timing.duration_s))
    track = marched(start, line, turn, made / way)
    if track is None:
        return None
    return Played([q for q, _ in track], [dq * at / way for (_, dq), at in zip(track, rate, strict=True)])


def _held(motion, until_s):
    """A tool speed step by step: ramp, hold until the stop takes hold, then the joints' own stop."""
    scratch = MODEL.createData()
    q, full = np.array(motion.start), np.array(motion.twist)
    position, rotation = placed(q, scratch)
    ramp = np.abs(full).max() / motion.acceleration_m_s2
    places, speeds, share, qd = [q], [np.zeros(6)], 0.0, np.zeros(6)
    times = instants(until_s)
    step = times[1]
    for t in times[1:]:
        before, share = share, min(1.0, t / ramp)
        position = position + (before + share) / 2 * step * full[:3]
        rotation = pinocchio.exp3((before + share) / 2 * step * full[3:]) @ rotation
        q = followed(q, position, rotation, scratch)
        if q is None:
            return None
        qd = np.linalg.solve(tool_jacobian(q, scratch), share * full)
        places.append(q)
        speeds.append(qd)
    return _stopped(places, speeds, q, qd)


def _servo(motion, share):
    """Joints at speeds between the measured ones and those towards the target, and the stop."""
    start, now = np.array(motion.start), np.array(motion.qd_rad_s)
    wanted = (np.array(motion.target) - start) / max(motion.lookahead_s, 0.03)  # U12: the least lookahead
    qd = now + share * (wanted - now)
    held = CELL.watch_age_limit_s + CELL.reaction_s + motion.period_s + CELL.stop_delay_s
    return _driven_on(start, qd, held)


def _sped(motion):
    """Joint speeds through their time, the controller's patience, and the stop."""
    held = motion.duration_s + patience_s(CELL.stop_deceleration_rad_s2) + CELL.stop_delay_s
    return _driven_on(np.array(motion.start), np.array(motion.qd_rad_s), held)


def _driven_on(start, qd, held_s):
    """These speeds for so long, and the stop."""
    times = instants(held_s)
    places = start + times[:, None] * qd
    return _stopped(list(places), [qd] * len(times), places[-1], qd)


def _stopped(places, speeds, q, qd):
    """The same, and after it the joints' own stop."""
    lead = float(np.abs(qd).max())
    stop_s = lead / CELL.stop_deceleration_rad_s2
    for left in 1 - instants(stop_s) / stop_s if lead else ():
        gone = lead * (1 - left * left) / (2 * CELL.stop_deceleration_rad_s2)
        places, speeds = [*places, q + qd * gone], [*speeds, qd * left]
    return Played(places, speeds)
