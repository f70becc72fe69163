"""Give way to a hand, as a spring and a damper would, by servoL."""

import sys

from rtde_control import RTDEControlInterface
from rtde_receive import RTDEReceiveInterface

HOST = sys.argv[1]
MASS, DAMPING, STIFFNESS, DT = 4.0, 80.0, 200.0, 0.008

control = RTDEControlInterface(HOST, 125)
receive = RTDEReceiveInterface(HOST, 125)
control.moveJ([0.0, -1.62, 1.25, -1.2, -1.57, 0.0], 0.8, 1.2)
if not control.zeroFtSensor():
    sys.exit("the sensor was not set to zero")
rest = receive.getActualTCPPose()
offset, velocity = [0.0] * 3, [0.0] * 3
for cycle in range(250):
    start = control.initPeriod()
    push = [2.0 if cycle < 60 else 0.0, 0.0, 0.0]  # a hand beside what the sensor feels
    force = [f + p for f, p in zip(receive.getActualTCPForce()[:3], push)]
    for axis in range(3):
        pull = force[axis] - DAMPING * velocity[axis] - STIFFNESS * offset[axis]
        velocity[axis] += pull / MASS * DT
        offset[axis] = max(-0.02, min(0.02, offset[axis] + velocity[axis] * DT))
    pose = [r + o for r, o in zip(rest[:3], offset)] + rest[3:]
    if not control.servoL(pose, 0.25, 0.5, DT, 0.1, 300):
        sys.exit("a pose was not taken")
    control.waitPeriod(start)
control.servoStop()
control.stopScript()
end = receive.getActualTCPPose()
sys.exit(max(abs(a - b) for a, b in zip(end[:3], rest[:3])) > 0.02)
