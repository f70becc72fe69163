"""Deaths, losses and revocations on a whole cell of real processes, seen by a receive connection at 500 Hz.

t0 is the end of the arm's right to move: its program or gateway is gone, its token is revoked, its time is over. t1 is
the first sample with commanded deceleration, t2 the first with every joint under 1 mrad/s (DESIGN, stop times).
"""

import contextlib
import os
import random
import signal
import time
from dataclasses import replace

from pep.base.operations import MOVE_LINEAR, SERVO_JOINT, SPEED_JOINT
from pep.base.thread_priority import LEAST
from pep.rtde.command.limits import widest
from pep.rtde.line.script_terms import WATCHDOG_HZ
from pep.rtde.robot.connections import PORTS
from policies.words.parameters import Parameters
from tests.e2e.test_gateway import House, Run
from tests.pep.rtde.campaign.figures import Figures, share
from tests.pep.rtde.relay import relay
from ztpm.base.layout import write_private
from ztpm.stage.lending import sweep_scope
from ztpm.stage.samples import StateRecorder
from ztpm.stage.stage import StageError, until
from ztpm.stage.stopping import BAR_S, model_rad, read_stop

GRIPPER_PORT = 63352
SIDE_RAD = 0.6
RAMP_RAD_S2 = 1.4
UNDER_WAY_RAD = 0.05
GOES_RAD_S = 0.1
"""Slower than this it is about to end, or has ended, before anything is done to it."""
TRIALS = 4
WATCHED_S = 0.5
"""After standstill: nothing moves again."""
EXPIRES_S = 9
"""Lifetime of a token that ends on the way, seconds.

Its program has to start and to get to its side before.
"""
PULL_S = 0.3
"""Greatest age of the answer before the last, seconds; a moving arm asks the feed each tenth of a second."""
DEAD_MAN_S = 1 / WATCHDOG_HZ
"""The gateway writes when it hears the controller; without that the controller's own watchdog ends the program."""
EARLY_S = {"provider": PULL_S, "feed": DEAD_MAN_S, "expiry": 0.0}
"""Seconds before t0 from which the arm may brake: the view's age, or the watchdog's last word.

All the others may from when it is done: a revocation takes effect before it is acknowledged.
"""
OWN = {"provider": "REVOCATION_VIEW_STALE", "servo-revoked": "REVOKED", "move-revoked": "REVOKED"}
"""Reasons of a stop before t0; a busy machine ends motions that it can no longer watch for other reasons."""
HEAD = """
import os, math
say("pid", os.getpid())
side = math.copysign({side}, q[0] or 1.0)
if abs(q[0] - side) > 1e-3:
    assert control.moveJ([side, *q[1:]], 0.8, 1.4)
    settled()
"""
MOVE = """
{wait}
say("begins")
control.moveJ([-side, *q[1:]], {speed}, 1.4)
"""
SERVO = """
say("begins")
at = [side, *q[1:]]
for _ in range(2000):
    start = control.initPeriod()
    at[0] -= math.copysign({speed} * 0.002, side)
    if not control.servoJ(at, 0.0, 0.0, 0.002, 0.2, 300):
        break
    control.waitPeriod(start)
"""
TRIES = """
say("over")
for _ in range(200):
    control.moveJ([-side, *q[1:]], {speed}, 1.4)
    time.sleep(0.005)
"""


def go_first(pid):
    """That process's threads go before ordinary ones, where that is allowed: a controller is a machine of its own.

    Here it shares two cores with all that loads its libraries anew in each trial.
    """
    with contextlib.suppress(PermissionError):
        for thread in os.listdir(f"/proc/{pid}/task"):
            os.sched_setscheduler(int(thread), os.SCHED_RR, os.sched_param(LEAST))


class Cell:
    """A cell and one agent, its controller behind a relay where the feed is to be lost."""

    def __init__(self, death, folder, ends):
        self.house = House(folder)
        ends.callback(self.house.cell.stop)
        ends.callback(self.house.stage.close)
        self.relay = None
        if death == "feed":
            host = self.house.cell.addresses.host
            self.relay = ends.enter_context(relay(host, folder / "relay", (*PORTS, GRIPPER_PORT)))
        self.start_gateway(again=self.relay is not None)
        self.house.agent("mover", SPEED_JOINT, SERVO_JOINT, MOVE_LINEAR)
        self.eyes = ends.enter_context(StateRecorder(self.house.cell.addresses.host))
        go_first(self.house.cell.robot.popen.pid)

    def start_gateway(self, *, again=True):
        if again:
            self.house.cell.start_gateway(*(() if self.relay is None else ("--robot", self.relay.host)))

    def issue(self, lifetime_s):
        """A token of its own for the next trial; when it ends, by CLOCK_MONOTONIC."""
        house = self.house
        house.stage.agents["mover"].attest()
        now = int(time.time())
        scope = sweep_scope(house.cell.addresses.audience, delegates=frozenset(), now=now, lifetime_s=lifetime_s)
        grants = (*scope.grants, *map(widest, (SPEED_JOINT, SERVO_JOINT, MOVE_LINEAR)))
        scope = replace(scope, grants=tuple(sorted(grants, key=lambda grant: (grant.object, grant.operation))))
        house.issued["mover"] = house.stage.person("alice").issue(
            house.stage.agents["mover"], scope, purpose="campaign"
        )
        house.tokens["mover"].unlink()
        write_private(house.tokens["mover"], house.issued["mover"].token.encode())
        return scope.not_after - time.time() + time.monotonic()

    def recorded(self, kind):
        """Bodies of the records of that kind since the trial began."""
        return [row["body"] for row in self.house.stage.journal() if row["kind"] == kind]

    def permitted(self, after_s):
        """Number of the trial's PERMIT decisions after that instant by CLOCK_MONOTONIC."""
        after_ms = 1000 * (after_s - time.monotonic() + time.time())
        rows = [row for row in self.house.stage.journal() if row["kind"] == "decision" and row["at_ms"] > after_ms]
        return sum(row["body"]["decision"]["reason"] == "PERMITTED" for row in rows)


# ---- each does one thing to the motion that is under way, and says when t0 was


def client_dies(cell, run, pid, ends_s):
    t0 = time.monotonic()
    os.kill(pid, signal.SIGKILL)
    return t0


def gateway_dies(cell, run, pid, ends_s):
    t0 = time.monotonic()
    cell.house.cell.gateway.kill()
    return t0


def provider_dies(cell, run, pid, ends_s):
    cell.house.cell.idp.kill()
    return time.monotonic() + Parameters().lease_motion_ms / 1000


def feed_is_lost(cell, run, pid, ends_s):
    cell.relay.tell("mute")
    return time.monotonic() + DEAD_MAN_S


def time_is_over(cell, run, pid, ends_s):
    return ends_s


def token_is_revoked(cell, run, pid, ends_s):
    cell.house.stage.person("alice").revoke("hop", cell.house.issued["mover"].hop_id, reason="campaign")
    return time.monotonic()


DEATHS = {
    "client": (client_dies, MOVE),
    "gateway": (gateway_dies, MOVE),
    "provider": (provider_dies, MOVE),
    "feed": (feed_is_lost, MOVE),
    "expiry": (time_is_over, MOVE),
    "servo-revoked": (token_is_revoked, SERVO),
    "move-revoked": (token_is_revoked, MOVE),
}


def mended(death, cell):
    """The cell is as it was before."""
    match death:
        case "gateway":
            cell.start_gateway()
        case "provider":
            cell.house.cell.start_idp()
        case "feed":
            cell.relay.tell("sound")


def piece(death, seed, first, count, folder):
    """Some trials in a row, on one cell."""
    found = Figures()
    with contextlib.ExitStack() as ends:
        cell = Cell(death, folder, ends)
        for number in range(first, first + count):
            rng, name = random.Random(f"{seed} {death} {number}"), f"seed {seed}, {death} {number}"
            try:
                begun(death, rng, cell, found, name)
            except Exception as error:  # noqa: BLE001 - told with its number, and the others go on
                found.failed.append(f"{name}: {type(error).__name__}: {error}")
        complaints = [
            line for child in cell.house.cell.children.values() for line in child.output if "Traceback" in line
        ]
        found.failed += complaints
    return found


class NotBegunError(RuntimeError):
    """Trial in which nothing moved, so nothing could be ended, as on a busy machine."""


def begun(death, rng, cell, found, name):
    """One motion that has begun and was ended; tried again where it did not begin.

    The cell is whole afterwards.
    """
    for tries in range(TRIALS):
        try:
            one(death, rng, cell, found, name)
        except NotBegunError:
            found.counts["motions that did not begin"] += 1
            if tries == TRIALS - 1:
                raise
        else:
            return
        finally:
            mended(death, cell)


def one(death, rng, cell, found, name):
    """One motion, and how it was ended."""
    deed, text = DEATHS[death]
    ends_s = cell.issue(EXPIRES_S if death == "expiry" else 800)
    # The provider's death takes its lease's time to be noticed: such a motion is a slow one.
    speed = 0.4 if death == "provider" else rng.choice((0.4, 0.6, 0.8)) if text == MOVE else 0.3
    wait = f"while time.monotonic() < {ends_s - rng.uniform(0.6, 1.2)}: time.sleep(0.002)" if death == "expiry" else ""
    program = HEAD.format(side=SIDE_RAD) + text.format(speed=speed, wait=wait) + TRIES.format(speed=speed)
    cell.house.stage.begin()
    with Run(cell.house, program) as run:
        said = run.line().split()
        if said[:1] != ["pid"]:
            raise NotBegunError(f"no program: {run.ended()[2][-300:]}")
        if run.line() != "begins":
            raise NotBegunError(f"no motion: {run.ended()[2][-300:]}")
        began_s, start = time.monotonic(), cell.eyes.now().q_rad[0]
        cell.eyes.since(began_s)
        try:
            until(lambda: abs(cell.eyes.now().q_rad[0] - start) > UNDER_WAY_RAD, "the arm under way")
        except StageError as error:
            raise NotBegunError(name) from error
        if death not in ("provider", "expiry"):
            time.sleep(rng.uniform(0.0, 0.4))
        done_s = time.monotonic()
        t0 = deed(cell, run, int(said[1]), ends_s)
        while time.monotonic() < t0:
            time.sleep(0.002)
        until(lambda: cell.eyes.now().still, "standstill")
        stood_s = time.monotonic()
        while time.monotonic() < stood_s + WATCHED_S:
            time.sleep(0.01)
        samples = cell.eyes.since(began_s)
        outcomes = cell.recorded("outcome")
        why = outcomes[-1].get("result", {}).get("reason") if outcomes else None
        goes, goes_on = (
            [s for s in samples if s.arrived_s < at_s][-1].commanded_rad_s >= GOES_RAD_S for at_s in (done_s, t0)
        )
        if not goes or (not goes_on and why != OWN.get(death, why)):
            raise NotBegunError(f"{name}: it went no longer: {outcomes}")
        found.counts["motions"] += 1
        judge(death, samples, done_s, t0, stood_s, found, name)
        seen = outcomes[-1].get("watch") if outcomes else None
        if seen is not None:
            found.saw("seen by the watch - t0, s", seen["t_seen_ms"] / 1000 - t0)
        accepted = cell.permitted(t0)
        found.claim(accepted == 0, f"{name}: {accepted} commands accepted afterwards")


def judge(death, samples, done_s, t0, stood_s, found, name):
    """t0, t1 and t2, and the claims on them."""
    found.claim(all(s.still for s in samples if s.arrived_s > stood_s), f"{name}: it moved again")
    for begin_s in (t0, done_s):
        stop = read_stop(samples, at_s=begin_s, acceleration_rad_s2=RAMP_RAD_S2)
        if stop is not None:
            break
    else:
        found.failed.append(f"{name}: no stop is to be seen")
        return
    reaction_s, early_s = stop.reaction_s + begin_s - t0, EARLY_S.get(death, t0 - done_s)
    found.saw("t1 - t0, s", reaction_s)
    found.saw("t2 - t1, s", stop.braking_s)
    found.saw("travel from t1 by the model's", stop.braking_rad / model_rad(stop.speed_rad_s))
    found.claim(stop.within_model, f"{name}: outside of the stop model: {stop}")
    if begin_s == t0:
        found.saw(
            "travel from t0 by the model's", stop.travel_rad / (stop.speed_rad_s * BAR_S + model_rad(stop.speed_rad_s))
        )
    found.claim(reaction_s >= -early_s, f"{name}: stopped before its time was over: {stop}")


def judged(whole):
    """The claim on the whole distribution, which is a failure of it where it does not hold."""
    reactions = whole.values.get("t1 - t0, s")
    if reactions:
        late = share(reactions, 0.99)
        whole.claim(late <= BAR_S, f"p99 of t1 - t0 is {late:.3f} s, more than {BAR_S:.3f} s")
    return ()
