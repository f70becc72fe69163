"""Pick a part up from the table and put it down beside, with a gripper on a digital output."""

import sys
import time

from rtde_control import RTDEControlInterface
from rtde_io import RTDEIOInterface
from rtde_receive import RTDEReceiveInterface

HOST = sys.argv[1]
GRIPPER = 4
HOME = [-0.6, -1.62, 1.25, -1.2, -1.57, 0.0]
PICK = [-0.27, -0.13, 0.06, 2.2206, 2.2206, 0.0]
PLACE = [-0.27, -0.23, 0.06, 2.2206, 2.2206, 0.0]

control = RTDEControlInterface(HOST)
receive = RTDEReceiveInterface(HOST)
io = RTDEIOInterface(HOST)


def above(pose: list[float]) -> list[float]:
    return [pose[0], pose[1], pose[2] + 0.12, *pose[3:]]


def grip(*, closed: bool) -> None:
    io.setStandardDigitalOut(GRIPPER, closed)
    time.sleep(0.3)
    if receive.getDigitalOutState(GRIPPER) != closed:
        sys.exit("the gripper did not switch")


grip(closed=False)
if not control.moveJ([0.0, *HOME[1:]], 0.8, 1.2):
    sys.exit("not at the table")
for place, closed in ((PICK, True), (PLACE, False)):
    for pose, speed in ((above(place), 0.15), (place, 0.05)):
        if not control.moveL(pose, speed, 0.3):
            sys.exit("a line was not finished")
    if max(abs(a - b) for a, b in zip(receive.getActualTCPPose()[:3], place[:3])) > 0.002:
        sys.exit("not where the part is")
    grip(closed=closed)
    if not control.moveL(above(place), 0.1, 0.3):
        sys.exit("not up again")
if not control.moveJ(HOME, 0.8, 1.2):
    sys.exit("not home")
control.stopScript()
