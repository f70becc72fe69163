"""Tools that go until a contact, and servo targets that are poses: `python -m tests.pep.pit.campaign.contacts`.

Every second trial is a way until a contact: the arm goes at the commanded speed with pinocchio's kinematics, until it
touches something at a time that is drawn, stops as ur_rtde's control script does and goes back, or until the gateway
stops it as late as it may. The others are poses of a stream, each as the joint angles that the room finds for it, whose
envelope is tried at drawn speeds. Of no millisecond may index, speed or a violation be above the answer.
"""

from __future__ import annotations

import numpy as np
from pep.base.stop_model import patience_s
from pep.pit.base.errors import MotionError, UnprovenError
from pep.pit.robot.inverse_kinematics import followed
from pep.pit.search.contact_way import contact_speed, until_contact
from policies.evidence.evidence import ImpactFault
from tests.pep.pit.campaign.blends import AGE_S, PATIENT, STEP_S, judged, main
from tests.pep.pit.campaign.curves import _servo
from tests.pep.pit.lines import marched, pose_of, random_servo, random_start
from tests.pep.pit.scenes import CELL, NOTHING, ROBOT, SEED, random_scene

from pep.pit import ServoJ, assess

PATIENCE_S = patience_s(CELL.stop_deceleration_rad_s2)
MANNERS = ("soon", "later", "never")


def ways(start, twist, speeds):
    """Joint angles each millisecond at these speeds of the tool along a line, one for each millisecond."""
    made = np.cumsum(speeds) * STEP_S
    line = np.array(twist[:3]) / np.linalg.norm(twist[:3])
    track = marched(start, line, np.zeros(3), made)
    if track is None:
        raise LookupError("lost")
    return np.array([q for q, _ in track])


def touched(start, twist, acceleration, held_s, share):
    """A contact after a share of the time, with the stop and the way back of ur_rtde's script."""
    speed = float(np.linalg.norm(twist[:3]))
    until = int(share * held_s / STEP_S)
    going = np.minimum(speed, acceleration * STEP_S * np.arange(1, until + 1))
    last = float(going[-1]) if until else 0.0
    noticed = np.full(40, last)  # cycles between the contact and its notice, 40 ms
    braking = np.arange(last, 0, -3.0 * STEP_S)
    back_m = float(noticed.sum() + braking.sum()) * STEP_S
    peak = min(0.25, np.sqrt(1.2 * back_m))
    ramp = np.arange(0, peak, 1.2 * STEP_S)
    return [ways(start, twist, np.concatenate([going, noticed, braking, -ramp, -ramp[::-1]]))]


def late(start, twist, acceleration, held_s, share):
    """No contact: the tool is stopped as late as it may be, by the joints along their tangent."""
    speed = float(np.linalg.norm(twist[:3]))
    steps = int((held_s + PATIENCE_S + share * CELL.stop_delay_s) / STEP_S)
    q = ways(start, twist, np.minimum(speed, acceleration * STEP_S * np.arange(1, steps + 1)))
    qd = (q[-1] - q[-2]) / STEP_S
    lead = float(np.abs(qd).max())
    times = np.arange(0, lead / CELL.stop_deceleration_rad_s2, STEP_S)[:, None]
    gone = times - 0.5 * CELL.stop_deceleration_rad_s2 / max(lead, 1e-9) * times**2
    return [np.concatenate([q, q[-1] + gone * qd])]


def contact(rng, number):
    """A way until a contact in a random direction."""
    scene, start = random_scene(rng, things=2, regions=2), random_start(rng)
    direction = rng.standard_normal(3)
    speed, acceleration = float(rng.uniform(0.01, 0.2)), float(rng.uniform(0.2, 2))
    twist = (*(direction / np.linalg.norm(direction) * speed).tolist(), 0.0, 0.0, 0.0)
    touch = frozenset({"thing0"}) if rng.random() < 0.5 else NOTHING
    try:
        motion = contact_speed(start, twist, acceleration, float(rng.uniform(0.02, 0.15)))
        motion, held_s = until_contact(
            ROBOT, motion, scene, PATIENT, touch=touch, speed_m_s=speed, patience_s=PATIENCE_S
        )
    except (MotionError, UnprovenError) as refused:
        return "refused", refused.detail
    answer = assess(ROBOT, scene, motion, PATIENT, perception_age_s=AGE_S, touch=touch, seed=SEED)
    if isinstance(answer, ImpactFault):
        return "refused", answer.detail
    shares = dict(zip(MANNERS, rng.random(3), strict=True))

    def move(manner):
        how = late if manner == "never" else touched
        return how(start, twist, acceleration, held_s, float(shares[manner]))

    return judged(scene, motion, answer, number, move, MANNERS, touch=touch)


def servo(rng, number):
    """A pose of a stream, as the joint angles that are found for it."""
    scene, drawn = random_scene(rng, things=2, regions=2), random_servo(rng)
    try:
        target = followed(ROBOT, pose_of(drawn.target), drawn.start)
    except UnprovenError as refused:
        return "refused", refused.detail
    motion = ServoJ(drawn.start, drawn.qd_rad_s, target, drawn.period_s, drawn.lookahead_s)
    answer = assess(ROBOT, scene, motion, PATIENT, perception_age_s=AGE_S, touch=NOTHING, seed=SEED)
    if isinstance(answer, ImpactFault):
        return "refused", answer.detail
    shares = rng.random((2, 6))
    return judged(scene, motion, answer, number, lambda at: [np.array(_servo(motion, shares[at]).q)], (0, 1))


def trial(seed, number):
    """Result of one trial, as of `blends.trial`."""
    rng = np.random.default_rng((seed, number))
    return (servo if number % 2 else contact)(rng, number)


if __name__ == "__main__":
    raise SystemExit(main("contacts and poses of streams", trial))
