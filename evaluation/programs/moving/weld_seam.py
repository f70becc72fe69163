"""Follow a seam at one speed: a path of process moves along an arc, each rounded into the next."""

import math
import sys

from rtde_control import Path, PathEntry, RTDEControlInterface
from rtde_receive import RTDEReceiveInterface

HOST = sys.argv[1]
RADIUS, STEPS, SPEED, ACCELERATION = 0.06, 6, 0.03, 0.3

control = RTDEControlInterface(HOST)
receive = RTDEReceiveInterface(HOST)
control.moveJ([0.0, -1.62, 1.25, -1.2, -1.57, 0.0], 0.8, 1.2)
start = receive.getActualTCPPose()
seam = Path()
for step in range(1, STEPS + 1):
    angle = math.pi * step / STEPS
    pose = [start[0] + RADIUS * (1 - math.cos(angle)), start[1] - RADIUS * math.sin(angle), *start[2:]]
    blend = 0.004 if step < STEPS else 0.0
    seam.addEntry(PathEntry(PathEntry.MoveP, PathEntry.PositionTcpPose, [*pose, SPEED, ACCELERATION, blend]))
if not control.movePath(seam):
    sys.exit("the seam was not finished")
end = receive.getActualTCPPose()
control.stopScript()
sys.exit(abs(end[0] - start[0] - 2 * RADIUS) > 0.002 or abs(end[1] - start[1]) > 0.002)
