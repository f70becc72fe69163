"""Play a recorded joint trajectory from a file: one row each 2 ms, by servoJ."""

import csv
import math
import sys
from pathlib import Path

from rtde_control import RTDEControlInterface
from rtde_receive import RTDEReceiveInterface

HOST = sys.argv[1]
FILE = Path("trajectory.csv")
ROWS, PERIOD_S = 1000, 0.002

control = RTDEControlInterface(HOST)
receive = RTDEReceiveInterface(HOST)
q = receive.getActualQ()
with FILE.open("w", newline="", encoding="utf-8") as file:
    swing = [0.1 * (1 - math.cos(2 * math.pi * row / ROWS)) for row in range(ROWS)]
    csv.writer(file).writerows([q[0] + s, *q[1:5], q[5] - s] for s in swing)

with FILE.open(newline="", encoding="utf-8") as file:
    rows = [[float(angle) for angle in row] for row in csv.reader(file)]
farthest = q[0]
for row in rows:
    start = control.initPeriod()
    if not control.servoJ(row, 0.0, 0.0, PERIOD_S, 0.1, 300):
        sys.exit("a row was not taken")
    farthest = max(farthest, receive.getActualQ()[0])
    control.waitPeriod(start)
control.servoStop()
control.stopScript()
sys.exit(farthest < q[0] + 0.17 or abs(receive.getActualQ()[0] - q[0]) > 0.02)
