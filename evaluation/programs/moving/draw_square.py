"""Draw a square with rounded corners: one linear path with blends, pen down before it and up behind it."""

import sys

from rtde_control import RTDEControlInterface
from rtde_receive import RTDEReceiveInterface

HOST = sys.argv[1]
SIDE, SPEED, ACCELERATION, BLEND = 0.08, 0.08, 0.3, 0.01

control = RTDEControlInterface(HOST)
receive = RTDEReceiveInterface(HOST)
control.moveJ([0.0, -1.62, 1.25, -1.2, -1.57, 0.0], 0.8, 1.2)
start = receive.getActualTCPPose()
start[2] -= 0.06
if not control.moveL(start, 0.08, 0.3):
    sys.exit("the pen is not down")
path = []
for x, y in ((SIDE, 0.0), (SIDE, -SIDE), (0.0, -SIDE), (0.0, 0.0)):
    corner = [start[0] + x, start[1] + y, *start[2:]]
    path.append([*corner, SPEED, ACCELERATION, BLEND])
path[-1][-1] = 0.0
if not control.moveL(path):
    sys.exit("the square was not finished")
end = receive.getActualTCPPose()
up = [*end[:2], end[2] + 0.06, *end[3:]]
lifted = control.moveL(up, 0.1, 0.3)
control.stopScript()
sys.exit(not lifted or max(abs(a - b) for a, b in zip(end[:3], start[:3])) > 0.002)
