"""Find a surface by touch: down until contact, the height written down, and up again."""

import sys

from rtde_control import RTDEControlInterface
from rtde_receive import RTDEReceiveInterface

HOST = sys.argv[1]

control = RTDEControlInterface(HOST)
receive = RTDEReceiveInterface(HOST)
control.moveJ([0.0, -1.62, 1.25, -1.2, -1.57, 0.0], 0.8, 1.2)
low = receive.getActualTCPPose()
low[2] = 0.03
if not control.moveL(low, 0.1, 0.3):
    sys.exit("not near the surface")
if not control.moveUntilContact([0.0, 0.0, -0.02, 0.0, 0.0, 0.0]):
    sys.exit("no contact")
height = receive.getActualTCPPose()[2]
low[2] = height + 0.05
if not control.moveL(low, 0.05, 0.3):
    sys.exit("not up again")
control.stopScript()
sys.exit(not -0.02 < height < 0.02)
