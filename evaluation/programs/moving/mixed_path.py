"""Move along joints and lines in one path, in the background, and watch how far it is."""

import sys
import time

from rtde_control import Path, PathEntry, RTDEControlInterface
from rtde_receive import RTDEReceiveInterface

HOST = sys.argv[1]
HOME = [0.0, -1.62, 1.25, -1.2, -1.57, 0.0]

control = RTDEControlInterface(HOST)
receive = RTDEReceiveInterface(HOST)
control.moveJ(HOME, 0.8, 1.2)
x, y, z, *turn = receive.getActualTCPPose()
path = Path()
path.addEntry(PathEntry(PathEntry.MoveL, PathEntry.PositionTcpPose, [x, y, z - 0.05, *turn, 0.1, 0.4, 0.0]))
path.addEntry(PathEntry(PathEntry.MoveL, PathEntry.PositionTcpPose, [x, y - 0.08, z - 0.05, *turn, 0.1, 0.4, 0.01]))
path.addEntry(PathEntry(PathEntry.MoveJ, PathEntry.PositionJoints, [*HOME, 0.5, 1.0, 0.0]))
if not control.movePath(path, True):
    sys.exit("the path did not begin")
seen, deadline = set(), time.monotonic() + 20
while control.getAsyncOperationProgressEx().isAsyncOperationRunning() and time.monotonic() < deadline:
    seen.add(control.getAsyncOperationProgressEx().progress())
    time.sleep(0.05)
here = receive.getActualQ()
control.stopScript()
if len(seen) < 2:
    sys.exit(f"the progress was not told: {seen}")
sys.exit(max(abs(a - b) for a, b in zip(here, HOME)) > 1e-3)
