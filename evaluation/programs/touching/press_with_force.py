"""Press down with ten newtons for a second, as for gluing, and let go."""

import sys
import time

from rtde_control import RTDEControlInterface
from rtde_receive import RTDEReceiveInterface

HOST = sys.argv[1]
FRAME = [0.0] * 6
DOWN = [0, 0, 1, 0, 0, 0]
WRENCH = [0.0, 0.0, -10.0, 0.0, 0.0, 0.0]
LIMITS = [0.05, 0.05, 0.02, 0.1, 0.1, 0.1]

control = RTDEControlInterface(HOST)
receive = RTDEReceiveInterface(HOST)
control.moveJ([0.0, -1.62, 1.25, -1.2, -1.57, 0.0], 0.8, 1.2)
low = receive.getActualTCPPose()
low[2] = 0.01
if not control.moveL(low, 0.05, 0.3):
    sys.exit("not near the surface")
until, pressing = time.monotonic() + 40.0, 0
while pressing < 500 and time.monotonic() < until:
    start = control.initPeriod()
    if not control.forceMode(FRAME, DOWN, WRENCH, 2, LIMITS):
        sys.exit("no force")
    pressing = pressing + 1 if receive.getActualTCPForce()[2] > 8.0 else 0
    control.waitPeriod(start)
pressed = receive.getActualTCPForce()[2]
depth = receive.getActualTCPPose()[2]
control.forceModeStop()
low[2] = depth + 0.05
if not control.moveL(low, 0.05, 0.3):
    sys.exit("not up again")
control.stopScript()
sys.exit(pressing < 500 or depth > 0.0 or not 8.0 < pressed < 12.0)
