"""Follow an arc by circular servoing."""

import math
import sys
import time

from rtde_control import RTDEControlInterface
from rtde_receive import RTDEReceiveInterface

HOST = sys.argv[1]
RADIUS = 0.03

control = RTDEControlInterface(HOST)
receive = RTDEReceiveInterface(HOST)
begin = receive.getActualTCPPose()
for step in range(20):
    angle = math.pi * step / 20
    pose = [begin[0] + RADIUS * (1 - math.cos(angle)), begin[1] + RADIUS * math.sin(angle), *begin[2:]]
    if not control.servoC(pose, 0.05, 0.3, 0.0):
        sys.exit("no arc")
    time.sleep(0.1)
control.servoStop()
control.stopScript()
sys.exit(abs(receive.getActualTCPPose()[0] - begin[0]) < 0.03)
