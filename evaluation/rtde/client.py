"""An unmodified ur_rtde program: a stream of joint angles at 500 Hz, each of which says when it was sent.

    python evaluation/rtde/client.py HOST SECONDS FILE

It imports nothing of ours. The file has `[[ns, value], ...]` afterwards: the first joint angle of each call and when
the call was made, by CLOCK_MONOTONIC.
"""

import json
import os
import sys
import time
from contextlib import suppress
from pathlib import Path

from rtde_control import RTDEControlInterface
from rtde_receive import RTDEReceiveInterface

HZ = 500
STEP_RAD = 1e-5


def first_of_all() -> None:
    """All threads of this process that begin from now on go before ordinary ones, where the system allows it."""
    with suppress(OSError):
        os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(1))


def main() -> None:
    """Streams, and stops."""
    first_of_all()
    host, seconds, file = sys.argv[1:]
    control, receive = RTDEControlInterface(host), RTDEReceiveInterface(host)
    target, sent = receive.getActualQ(), []
    for _ in range(int(float(seconds) * HZ)):
        start = control.initPeriod()
        target[0] += STEP_RAD
        now = time.monotonic_ns()
        if not control.servoJ(target, 0.0, 0.0, 1 / HZ, 0.1, 300):
            break
        sent.append((now, target[0]))
        control.waitPeriod(start)
    control.servoStop()
    control.stopScript()
    Path(file).write_text(json.dumps(sent), encoding="utf-8")


if __name__ == "__main__":
    main()
