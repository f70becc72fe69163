"""A thread that goes before ordinary ones: what a moving arm waits for does not queue behind what can wait."""

from __future__ import annotations

import os

LEAST = 1
"""Of the priorities of real time: enough to go before all that is ordinary, and behind whatever else is real time."""


def goes_first() -> bool:
    """From now on the calling thread goes before ordinary threads, where the system allows it; whether it does.

    It takes turns with its equals (`SCHED_RR`). Threads and processes that it begins are ordinary ones. Linux allows it
    to root, with CAP_SYS_NICE, and up to RLIMIT_RTPRIO.
    """
    try:
        os.sched_setscheduler(0, os.SCHED_RR | os.SCHED_RESET_ON_FORK, os.sched_param(LEAST))
    except OSError:
        return False
    return True
