"""Drive a screw: turn the last joint while the tool goes down by the thread's pitch."""

import math
import sys

from rtde_control import RTDEControlInterface
from rtde_receive import RTDEReceiveInterface

HOST = sys.argv[1]
PITCH_M, TURNS = 0.001, 2

control = RTDEControlInterface(HOST)
receive = RTDEReceiveInterface(HOST)
if not control.moveJ([0.0, -1.62, 1.25, -1.2, -1.57, 0.0], 0.8, 1.2):
    sys.exit("not over the screw")
screw = receive.getActualTCPPose()
screw[2] -= 0.08
if not control.moveL(screw, 0.05, 0.3):
    sys.exit("not at the screw")
for _ in range(TURNS):
    q = receive.getActualQ()
    q[5] += math.pi / 2
    if not control.moveJ(q, 1.0, 1.5):
        sys.exit("not turned")
    deeper = receive.getActualTCPPose()
    deeper[2] -= PITCH_M
    if not control.moveL(deeper, 0.02, 0.2):
        sys.exit("not deeper")
    torque = receive.getActualTCPForce()[5]
    if abs(torque) > 2.0:
        break
down = screw[2] - receive.getActualTCPPose()[2]
turned = receive.getActualQ()[5]
control.stopScript()
sys.exit(abs(down - TURNS * PITCH_M) > 5e-4 or abs(turned - TURNS * math.pi / 2) > 0.01)
