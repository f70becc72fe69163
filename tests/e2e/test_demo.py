"""The story as a user runs it: the real command, its JSON, its exit status."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

STEPS = [
    "init", "register", "attest", "issue", "delegate", "move-empty", "widen-refused", "unattested-refused", "scope-refused",
    "limit-refused", "replay-refused", "stolen-refused", "tampered-refused", "not-finite-refused", "fragile-trusted", "fragile-untrusted", "trust-fell",
    "human-deferred", "deferral-expires", "ceiling-refused", "through-person-denied", "revoked-refused", "sponsor-disabled",
    "stale-feed-refused", "audit-verifies", "approved-moves", "approval-used-up", "approval-changed-world",
    "agent-approval-refused", "zone-denied", "one-of-two-refused", "dual-authorised", "stale-world-deferred",
    "forged-frame-refused", "place-on-table", "human-enters-stops", "revoke-in-motion", "idp-killed-in-motion", "restart-keeps",
    "rtde-raw-denied", "rtde-leased-moves", "rtde-hijack-refused", "gateway-killed-stops",
]  # fmt: skip
MOVING = {
    "move-empty", "fragile-trusted", "approved-moves", "dual-authorised", "place-on-table", "human-enters-stops",
    "revoke-in-motion", "idp-killed-in-motion", "restart-keeps", "rtde-leased-moves", "gateway-killed-stops",
}  # fmt: skip


@pytest.mark.campaign
@pytest.mark.e2e
@pytest.mark.timeout(400)
def test_demo_is_as_told() -> None:
    command = [str(Path(sys.executable).with_name("ztpm")), "demo", "--json"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=390)
    story = json.loads(done.stdout)
    assert [(step["id"], step["ok"]) for step in story["steps"]] == [(step, True) for step in STEPS], (
        done.stdout + done.stderr
    )
    assert story["ok"] is True
    told = story["figures"]
    assert (told["attacks"], told["refused"], told["stops"], told["motions"], told["unrecorded"]) == (
        16,
        16,
        3,
        len(MOVING),
        0,
    )
    assert 0 < told["refusal_ms_median"]
    assert told["stop_ms_slowest"] == max(step["stop_ms"] or 0 for step in story["steps"])
    assert done.returncode == 0
    for step in story["steps"]:
        assert step.keys() == {
            "id",
            "told",
            "decision",
            "reason",
            "tier",
            "latency_ms",
            "moved_rad",
            "recorded",
            "attack",
            "stop_ms",
            "ok",
        }
        assert (step["moved_rad"] > 0.01) == (step["id"] in MOVING)


def test_middle_of_the_sweep_is_where_the_story_says() -> None:
    import numpy as np
    from pep.pit import Robot
    from pep.pit.robot.kinematics import link_frames
    from ztpm.stage.scene import MIDDLE_M
    from ztpm.stage.stage import LEFT

    robot = Robot.load("ur3e")
    rotations, origins = link_frames(robot, np.array([[0.0, *LEFT[1:]]]))
    tool = origins[0, -1] + rotations[0, -1] @ np.array([0.0, 0.0, 0.177])
    assert np.allclose(tool[:2], MIDDLE_M, atol=1e-3)
