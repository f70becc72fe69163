"""Begin a move in the background and stop it half way, as when a camera has seen enough."""

import sys
import time

from rtde_control import RTDEControlInterface
from rtde_receive import RTDEReceiveInterface

HOST = sys.argv[1]
LEFT = [-0.6, -1.62, 1.25, -1.2, -1.57, 0.0]

control = RTDEControlInterface(HOST)
receive = RTDEReceiveInterface(HOST)
if not control.moveJ([0.6, *LEFT[1:]], 0.5, 1.0, True):
    sys.exit("the move did not begin")
deadline = time.monotonic() + 10
while receive.getActualQ()[0] < -0.2:
    if time.monotonic() > deadline:
        sys.exit("the arm did not come half way")
    time.sleep(0.01)
control.stopJ(2.0)
stopped = receive.getActualQ()[0]
if not -0.2 <= stopped < 0.3 or max(map(abs, receive.getActualQd())) > 1e-2:
    sys.exit("the arm did not stop there")
if not control.moveJ(LEFT, 0.8, 1.2):
    sys.exit("the arm did not go back")
control.stopScript()
sys.exit(abs(receive.getActualQ()[0] - LEFT[0]) > 1e-3)
