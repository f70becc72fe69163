"""Take pictures for a hand-eye calibration: several poses, still at each, and the pose of the tool written down."""

import json
import sys
import time
from pathlib import Path

from rtde_control import RTDEControlInterface
from rtde_receive import RTDEReceiveInterface

HOST = sys.argv[1]
MIDDLE = [-0.3, -1.62, 1.25, -1.2, -1.57, 0.0]
TURNS = [(0.0, 0.0, 0.0), (0.2, 0.15, 0.0), (-0.2, 0.15, 0.3), (0.0, -0.2, -0.3), (0.15, -0.1, 0.6)]

control = RTDEControlInterface(HOST)
receive = RTDEReceiveInterface(HOST)
poses = []
for base, wrist, last in TURNS:
    q = list(MIDDLE)
    q[0] += base
    q[3] += wrist
    q[5] += last
    if not control.moveJ(q, 0.7, 1.2):
        sys.exit("a pose was not reached")
    while not control.isSteady():
        time.sleep(0.01)
    reached = receive.getActualQ()
    if max(abs(a - b) for a, b in zip(reached, q)) > 1e-3:
        sys.exit("another pose was reached")
    poses.append({"tool": receive.getActualTCPPose(), "joints": reached})
Path("poses.json").write_text(json.dumps(poses), encoding="utf-8")
control.stopScript()
sys.exit(len(poses) != len(TURNS))
