"""Twin of the gateway, slow and obvious: the moves that a client's writes and the recorded permits allow.

Nothing here is the gateway's: registers are a dictionary, a command is read out of it anew after every package.
"""

import math

from tests.pep.rtde.campaign.rule import (
    ACCELERATION_RAD_S2,
    BOX_RAD,
    HOME,
    LOOKAHEAD_S,
    SERVO_RAD,
    SPEED_RAD_S,
    STREAM_RAD_S,
)
from ztpm.stage.stopping import model_rad

GRID = 1.5e-6
"""A move is taken to whole microradians before it is judged."""
STANDS_RAD = 1e-4
SPEED_SLACK_RAD_S = 1e-3
LOOK_S = 0.004
"""Two packages: a speed that was given then may have been carried out until now."""


class Twin:
    """The registers of one connection, and every command that they have held since the sequence began.

    Args:
        offset: where its registers begin.
    """

    def __init__(self, offset):
        self.offset, self.registers, self.held, self.before = offset, {}, [], []

    def begin(self):
        """A sequence begins: what stands now, or was asked for in the one before, may still be permitted."""
        self.before = self.held
        self.held = [reading] if (reading := self.reading()) else []

    def wrote(self, values):
        """A package with these variables was sent."""
        self.registers.update(values)
        reading = self.reading()
        if reading is not None:
            self.held.append(reading)

    def command(self):
        return self.registers.get(f"input_int_register_{self.offset}", 0)

    def reading(self):
        """The command that the registers hold, where it is one that may move anything: its id and numbers."""
        d = [self.registers.get(f"input_double_register_{self.offset + i}", 0.0) for i in range(11)]
        q = d[:6]
        if not all(map(math.isfinite, q)):
            return None
        match self.command():
            case 1 if (
                inside(q, BOX_RAD) and 0 <= d[6] <= SPEED_RAD_S + GRID and 0 <= d[7] <= ACCELERATION_RAD_S2 + GRID
            ):
                return 1, (*q, d[6], d[7])
            case 9 if max(map(abs, q)) <= STREAM_RAD_S and 0 <= d[6] <= ACCELERATION_RAD_S2:
                return 9, (*q, d[6])
            case 11 if inside(q, SERVO_RAD) and d[9] >= LOOKAHEAD_S:
                return 11, tuple(q)
            case _:
                return None

    def knows(self, permit):
        """True where the registers have held the recorded command."""
        return any(
            permit["id"] == number and all(abs(a - b) <= GRID for a, b in zip(permit["numbers"], numbers, strict=True))
            for number, numbers in (*self.held, *self.before)
        )


def inside(q_rad, box_rad):
    return max(abs(q_rad[i] - HOME[i]) for i in range(6)) <= box_rad + GRID


def astray(samples, permits):
    """The first sample that nothing on record lets the arm be at, in words; None where there is none.

    Args:
        samples: of a sequence that began and ended with a standing arm, in order.
        permits: of that sequence, as the judge wrote them down.
    """
    start = samples[0].q_rad
    fastest = 0.0
    for sample in samples:
        fastest = max(fastest, sample.commanded_rad_s, *map(abs, sample.qd_rad_s))
        so_far = [permit for permit in permits if permit["at_s"] <= sample.arrived_s]
        for joint in range(6):
            low, high = reach(joint, start[joint], so_far, sample.arrived_s, fastest)
            if not low <= sample.q_rad[joint] <= high:
                what = f"joint {joint} at {sample.q_rad[joint]:.6f}, may be at {low:.6f} to {high:.6f}"
                return f"{what} ({len(so_far)} permits)"
            most = fastest_of(joint, so_far)
            if abs(sample.target_qd_rad_s[joint]) > most:
                return f"joint {joint} commanded at {sample.target_qd_rad_s[joint]:.4f}, may be at {most:.4f}"
    return None


def reach(joint, start, permits, now_s, fastest):
    """Between which angles a joint may be that began at `start`."""
    low = high = start
    for permit in permits:
        if permit["id"] in (1, 11):
            low, high = min(low, permit["numbers"][joint]), max(high, permit["numbers"][joint])
    speeds = [permit for permit in permits if permit["id"] == 9]
    if speeds:
        lasted = now_s - speeds[0]["at_s"] + LOOK_S
        low += lasted * min(0.0, *(permit["numbers"][joint] for permit in speeds))
        high += lasted * max(0.0, *(permit["numbers"][joint] for permit in speeds))
    # Only what follows a target or holds a speed overshoots when it is stopped: a move brakes on its own way.
    over = model_rad(fastest) if any(permit["id"] != 1 for permit in permits) else 0.0
    return low - over - STANDS_RAD, high + over + STANDS_RAD


def fastest_of(joint, permits):
    """Highest speed that may be commanded of a joint."""
    most = 0.0
    for permit in permits:
        if permit["id"] == 1:
            most = max(most, permit["numbers"][6])
        elif permit["id"] == 9:
            most = max(most, abs(permit["numbers"][joint]))
        else:  # a lag of first order: the whole way that there can be, in the shortest lookahead
            most = max(most, (2 * BOX_RAD + SERVO_RAD + 0.1) / LOOKAHEAD_S)
    return most + SPEED_SLACK_RAD_S
