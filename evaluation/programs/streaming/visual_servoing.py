"""Servo on a seen target: a tool speed proportional to what is left, until the tool is there, by speedL."""

import sys
import time

from rtde_control import RTDEControlInterface
from rtde_receive import RTDEReceiveInterface

HOST = sys.argv[1]
GAIN, MOST_M_S, NEAR_M = 1.5, 0.06, 0.003

control = RTDEControlInterface(HOST)
receive = RTDEReceiveInterface(HOST)
control.moveJ([0.0, -1.62, 1.25, -1.2, -1.57, 0.0], 0.8, 1.2)
x, y, z = receive.getActualTCPPose()[:3]
target = (x - 0.03, y - 0.05, z - 0.02)
deadline = time.monotonic() + 15
while True:
    left = [t - p for t, p in zip(target, receive.getActualTCPPose())]
    if max(map(abs, left)) < NEAR_M:
        break
    if time.monotonic() > deadline:
        sys.exit(f"the target was not reached: {left}")
    speed = [max(-MOST_M_S, min(MOST_M_S, GAIN * e)) for e in left]
    if not control.speedL([*speed, 0.0, 0.0, 0.0], 0.25, 0.1):
        sys.exit("a speed was not taken")
    time.sleep(0.02)
control.speedStop(2.0)
control.stopScript()
end = receive.getActualTCPPose()
sys.exit(max(abs(a - b) for a, b in zip(end, target)) > 0.01)
