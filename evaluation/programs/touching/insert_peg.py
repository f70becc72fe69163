"""Insert a peg: a soft force down, compliant to both sides, until the peg is deep enough or stands still."""

import sys
import time

from rtde_control import RTDEControlInterface
from rtde_receive import RTDEReceiveInterface

HOST = sys.argv[1]
DEPTH, LONGEST_S = 0.01, 40.0
SOFT = [1, 1, 1, 0, 0, 0]
LIMITS = [0.02, 0.02, 0.02, 0.05, 0.05, 0.05]

control = RTDEControlInterface(HOST)
receive = RTDEReceiveInterface(HOST)
control.moveJ([0.0, -1.62, 1.25, -1.2, -1.57, 0.0], 0.8, 1.2)
if not control.zeroFtSensor():
    sys.exit("the sensor was not set to zero")
begin = receive.getActualTCPPose()
control.forceModeSetDamping(0.05)
if not control.forceMode([0.0] * 6, SOFT, [0.0, 0.0, -5.0, 0.0, 0.0, 0.0], 2, LIMITS):
    sys.exit("no force")
until = time.monotonic() + LONGEST_S
while begin[2] - receive.getActualTCPPose()[2] < DEPTH and time.monotonic() < until:
    time.sleep(0.02)
control.forceModeStop()
deep = begin[2] - receive.getActualTCPPose()[2]
if not control.moveL(begin, 0.05, 0.3):
    sys.exit("not out again")
control.stopScript()
sys.exit(deep < DEPTH)
