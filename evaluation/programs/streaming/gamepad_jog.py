"""Jog with a gamepad: its sticks with a dead band become a tool speed, by speedL at 100 Hz."""

import sys
import time

from rtde_control import RTDEControlInterface
from rtde_receive import RTDEReceiveInterface

HOST = sys.argv[1]
FULL_M_S, DEAD, PERIOD_S = 0.04, 0.1, 0.01
STICKS = [((0.05, 0.02, 0.0), 0.3), ((1.0, 0.0, 0.0), 1.0), ((0.0, 0.0, 0.0), 0.4), ((-1.0, 0.05, 0.0), 1.0)]

control = RTDEControlInterface(HOST)
receive = RTDEReceiveInterface(HOST)
control.moveJ([0.0, -1.62, 1.25, -1.2, -1.57, 0.0], 0.8, 1.2)
begin, farthest = receive.getActualTCPPose(), 0.0
for sticks, seconds in STICKS:
    speed = [FULL_M_S * s if abs(s) > DEAD else 0.0 for s in sticks]
    until = time.monotonic() + seconds
    while time.monotonic() < until:
        if any(speed):
            if not control.speedL([*speed, 0.0, 0.0, 0.0], 0.3, 0.1):
                sys.exit("a speed was not taken")
        else:
            control.speedStop(2.0)
        farthest = max(farthest, receive.getActualTCPPose()[0] - begin[0])
        time.sleep(PERIOD_S)
    control.speedStop(2.0)
control.stopScript()
sys.exit(farthest < 0.02 or abs(receive.getActualTCPPose()[0] - begin[0]) > 0.02)
