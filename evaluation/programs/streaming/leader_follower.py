"""Follow a leader arm that a person holds, in bounded steps at 200 Hz, by servoJ."""

import math
import sys

from rtde_control import RTDEControlInterface
from rtde_receive import RTDEReceiveInterface

HOST = sys.argv[1]
PERIOD_S, STEP_RAD, CYCLES = 0.005, 0.0025, 500

control = RTDEControlInterface(HOST, 200)
receive = RTDEReceiveInterface(HOST, 200)
begin = receive.getActualQ()


def leader(cycle: int) -> list[float]:
    """Joint angles of the leader, as its encoders would give them."""
    swing = math.sin(2 * math.pi * cycle / CYCLES)
    return [begin[0] + 0.15 * swing, begin[1] + 0.05 * swing, *begin[2:5], begin[5] + 0.3 * swing]


command, most = list(begin), 0.0
for cycle in range(CYCLES):
    start = control.initPeriod()
    wanted = leader(cycle)
    command = [c + max(-STEP_RAD, min(STEP_RAD, w - c)) for c, w in zip(command, wanted)]
    if not control.servoJ(command, 0.5, 0.5, PERIOD_S, 0.2, 100):
        sys.exit("a step was not taken")
    most = max(most, abs(receive.getActualQ()[0] - begin[0]))
    control.waitPeriod(start)
control.servoStop()
control.stopScript()
sys.exit(most < 0.1)
