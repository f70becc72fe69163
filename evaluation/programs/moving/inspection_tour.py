"""Tour of an inspection: eight views as one joint path that is rounded at each, there and back."""

import sys

from rtde_control import RTDEControlInterface
from rtde_receive import RTDEReceiveInterface

HOST = sys.argv[1]
SPEED, ACCELERATION, BLEND = 0.6, 1.0, 0.01
VIEWS = [
    [-0.5, -1.60, 1.25, -1.2, -1.57, 0.0],
    [-0.3, -1.55, 1.20, -1.2, -1.57, 0.2],
    [-0.1, -1.50, 1.15, -1.2, -1.50, 0.4],
    [0.1, -1.50, 1.15, -1.2, -1.45, 0.4],
    [0.3, -1.55, 1.20, -1.2, -1.50, 0.2],
    [0.5, -1.60, 1.25, -1.2, -1.57, 0.0],
    [0.3, -1.65, 1.30, -1.2, -1.57, -0.2],
    [0.0, -1.70, 1.30, -1.2, -1.57, 0.0],
]

control = RTDEControlInterface(HOST)
receive = RTDEReceiveInterface(HOST)
tour = [[*view, SPEED, ACCELERATION, BLEND] for view in VIEWS]
tour[-1][-1] = 0.0
if not control.moveJ(tour):
    sys.exit("the tour was not finished")
here = receive.getActualQ()
control.stopScript()
sys.exit(max(abs(a - b) for a, b in zip(here, VIEWS[-1])) > 1e-3)
