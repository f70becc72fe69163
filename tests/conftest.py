"""One profile for all property tests, since machines are shared and noisy; and who computes makes room for who must not wait."""

import os

import pytest
from hypothesis import HealthCheck, settings

settings.register_profile(
    "shared-machine", deadline=None, suppress_health_check=[HealthCheck.too_slow], print_blob=True
)
settings.load_profile("shared-machine")


@pytest.fixture(autouse=True)
def polite(request):
    """Tests that only compute leave the processor to those in which real time passes.

    Several run at once on few cores, and a cell is stopped when its watch comes too late. What they start computes as
    they do. Where the system does not let a thread come back from idle scheduling, batch scheduling is what there is.
    """
    if request.node.get_closest_marker("e2e") is not None or not hasattr(os, "sched_setscheduler"):
        yield
        return
    before = os.sched_getscheduler(0)
    policy = os.SCHED_IDLE if os.geteuid() == 0 else os.SCHED_BATCH
    os.sched_setscheduler(0, policy, os.sched_param(0))
    try:
        yield
    finally:
        os.sched_setscheduler(0, before, os.sched_param(0))
