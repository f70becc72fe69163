"""Stack by own inverse kinematics: ask whether a pose can be reached, take its joints, and move there."""

import sys

from rtde_control import RTDEControlInterface
from rtde_receive import RTDEReceiveInterface

HOST = sys.argv[1]
DOWN = [2.2206, 2.2206, 0.0]

control = RTDEControlInterface(HOST)
receive = RTDEReceiveInterface(HOST)
control.moveJ([0.0, -1.62, 1.25, -1.2, -1.57, 0.0], 0.8, 1.2)
if control.getInverseKinematicsHasSolution([-2.0, 0.0, 0.3, *DOWN]):
    sys.exit("two metres away is said to be in reach")
for layer in range(3):
    pose = [-0.30, -0.16, 0.10 + 0.04 * layer, *DOWN]
    near = receive.getActualQ()
    if not control.getInverseKinematicsHasSolution(pose, near) or not control.isPoseWithinSafetyLimits(pose):
        sys.exit("the layer is not in reach")
    q = control.getInverseKinematics(pose, near)
    if len(q) != 6 or not control.isJointsWithinSafetyLimits(q):
        sys.exit("no joints for the layer")
    if not control.moveJ(q, 0.5, 1.0):
        sys.exit("the layer was not reached")
    here = receive.getActualTCPPose()
    if max(abs(a - b) for a, b in zip(here[:3], pose[:3])) > 0.002:
        sys.exit("the layer is elsewhere")
control.stopScript()
