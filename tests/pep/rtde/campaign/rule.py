"""Rule of the campaign's judge, and its gateway: near home, slow, and written down before it is sent.

`python -m tests.pep.rtde.campaign.rule LISTEN ROBOT FILE` is a gateway (`tests.pep.rtde.leased_gateway`) with this judge. FILE
gets one JSON line for each command and each value of a stream that is permitted: number, CLOCK_MONOTONIC in seconds,
command id and numbers in SI units; and one for each that was taken back before it was sent.
"""

import asyncio
import itertools
import json
import sys
import time

from policies.words.reason_table import Reason
from tests.pep.rtde.leased_gateway import serve
from tests.pep.rtde.whole_commands import WholeCommands

from pep.rtde.command import command_values as v

HOME = (0.0, -1.5708, 1.5708, -1.5708, -1.5708, 0.0)
BOX_RAD = 0.06
"""So far from home a move may lead."""
SERVO_RAD = 0.02
SPEED_RAD_S, ACCELERATION_RAD_S2 = 0.5, 2.0
STREAM_RAD_S = 0.2
LOOKAHEAD_S = 0.1
LATER_S = (0.0, 0.0, 0.0, 0.003, 0.006, 0.012)
"""Some answers take longer: there is time to swap what is asked for."""


def near(q_rad, box_rad):
    return all(abs(a - b) <= box_rad for a, b in zip(q_rad, HOME, strict=True))


class Rule(WholeCommands):
    """The judge."""

    def __init__(self, out):
        self.out, self.numbers, self.asked = out, itertools.count(), itertools.count()

    def judge(self, held):
        if permitted(held.command) is None:
            held.deny(Reason.ABOVE_CEILING, "not by this rule")
            return
        later_s = LATER_S[next(self.asked) % len(LATER_S)]
        if later_s:
            asyncio.get_running_loop().call_later(later_s, self.forward, held)
        else:
            self.forward(held)

    def withdrawn(self, held):
        pass

    def refused(self, holder, refused, what):
        pass

    def forward(self, held):
        number = self.note(held.command)
        if not held.forward(self):
            self.out.write(json.dumps({"unsent": number}) + "\n")

    def judged(self, command):
        if permitted(command) is None:
            return Reason.LIMIT_EXCEEDED_BY_REQUEST
        self.note(command)
        return None

    def ended(self):
        pass

    def note(self, command):
        number, (command_id, numbers) = next(self.numbers), permitted(command)
        row = {"number": number, "at_s": time.monotonic(), "id": command_id, "numbers": numbers}
        self.out.write(json.dumps(row) + "\n")
        return number


def permitted(command):
    """Its id and its numbers, or nothing for what this rule does not permit."""
    match command:
        case v.MoveJ(q, speed, acceleration, _) if (
            near(q, BOX_RAD) and speed <= SPEED_RAD_S and acceleration <= ACCELERATION_RAD_S2
        ):
            return 1, (*q, speed, acceleration)
        case v.SpeedJ(qd, acceleration, _) if max(map(abs, qd)) <= STREAM_RAD_S and acceleration <= ACCELERATION_RAD_S2:
            return 9, (*qd, acceleration)
        case v.ServoJ(q, _, lookahead_s, _) if near(q, SERVO_RAD) and lookahead_s >= LOOKAHEAD_S:
            return 11, q
        case _:
            return None


if __name__ == "__main__":
    asyncio.run(serve(*sys.argv[1:], judged=Rule))
