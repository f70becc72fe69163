"""Priority of a thread over ordinary ones: a moving arm does not wait for less urgent work."""

from __future__ import annotations

import os

LEAST = 1
"""Lowest real-time priority: before all ordinary threads, behind every other real-time thread."""


def goes_first(*, with_all_it_begins: bool = False) -> bool:
    """Puts the calling thread before ordinary ones where the system allows it; true where it did.

    It takes turns with its equals (`SCHED_RR`). Linux allows it to root, with CAP_SYS_NICE, and up to RLIMIT_RTPRIO.

    Args:
        with_all_it_begins: its threads and processes go first too; otherwise they are ordinary ones.
    """
    policy = os.SCHED_RR if with_all_it_begins else os.SCHED_RR | os.SCHED_RESET_ON_FORK
    try:
        os.sched_setscheduler(0, policy, os.sched_param(LEAST))
    except OSError:
        return False
    return True
