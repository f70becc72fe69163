"""Set down on a pallet of two by two places: near each by its joints, then straight down and up."""

import sys

from rtde_control import RTDEControlInterface
from rtde_receive import RTDEReceiveInterface

HOST = sys.argv[1]
ROWS, COLUMNS, PITCH = 2, 2, 0.08
CORNER = [-0.30, -0.20, 0.07]
DOWN = [2.2206, 2.2206, 0.0]

control = RTDEControlInterface(HOST)
receive = RTDEReceiveInterface(HOST)
control.moveJ([0.0, -1.62, 1.25, -1.2, -1.57, 0.0], 0.8, 1.2)
placed = 0
for row in range(ROWS):
    for column in range(COLUMNS):
        x, y, z = CORNER[0] + row * PITCH, CORNER[1] + column * PITCH, CORNER[2]
        over, on = [x, y, z + 0.10, *DOWN], [x, y, z, *DOWN]
        if not control.moveJ_IK(over, 0.6, 1.0):
            sys.exit("not over the place")
        if not control.moveL(on, 0.08, 0.3):
            sys.exit("not down")
        pose = receive.getActualTCPPose()
        placed += abs(pose[0] - x) < 0.002 and abs(pose[1] - y) < 0.002 and abs(pose[2] - z) < 0.002
        if not control.moveL(over, 0.15, 0.4):
            sys.exit("not up")
control.stopScript()
sys.exit(placed != ROWS * COLUMNS)
