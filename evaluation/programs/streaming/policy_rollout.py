"""Roll a learned policy out: poses at 10 Hz, interpolated to 125 Hz, and sent by servoL."""

import sys

from rtde_control import RTDEControlInterface
from rtde_receive import RTDEReceiveInterface

HOST = sys.argv[1]
HZ, POLICY_HZ = 125, 10
LOOKAHEAD_S, GAIN = 0.1, 300
ACTIONS = [(0.004, 0.0, -0.002)] * 8 + [(0.0, -0.004, 0.0)] * 8 + [(-0.004, 0.004, 0.002)] * 8

control = RTDEControlInterface(HOST, HZ)
receive = RTDEReceiveInterface(HOST, HZ)
control.moveJ([0.0, -1.62, 1.25, -1.2, -1.57, 0.0], 0.8, 1.2)
home = pose = receive.getActualTCPPose()
steps, farthest = round(HZ / POLICY_HZ), 0.0
for action in ACTIONS:
    goal = [a + b for a, b in zip(pose[:3], action)]
    for step in range(1, steps + 1):
        start = control.initPeriod()
        between = [a + (b - a) * step / steps for a, b in zip(pose[:3], goal)]
        if not control.servoL([*between, *pose[3:]], 0.5, 0.5, 1 / HZ, LOOKAHEAD_S, GAIN):
            sys.exit("a pose was not taken")
        farthest = max(farthest, abs(receive.getActualTCPPose()[0] - home[0]))
        control.waitPeriod(start)
    pose = [*goal, *pose[3:]]
control.servoStop()
control.stopScript()
end = receive.getActualTCPPose()
sys.exit(farthest < 0.02 or max(abs(a - b) for a, b in zip(end[:3], home[:3])) > 0.01)
