"""Record what the arm does into a file: joint angles, speeds and the tool's force, while it moves."""

import csv
import sys
import time
from pathlib import Path

from rtde_control import RTDEControlInterface
from rtde_receive import RTDEReceiveInterface

HOST = sys.argv[1]
FILE = Path("recorded.csv")

control = RTDEControlInterface(HOST)
receive = RTDEReceiveInterface(HOST, 125, ["timestamp", "actual_q", "actual_qd", "actual_TCP_force"])
receive.startFileRecording(str(FILE), ["timestamp", "actual_q", "actual_qd"])
q = receive.getActualQ()
there = [q[0] + 0.3, *q[1:]]
if not control.moveJ(there, 0.5, 1.0) or not control.moveJ(q, 0.5, 1.0):
    sys.exit("a move was not finished")
time.sleep(0.2)
receive.stopFileRecording()
control.stopScript()
with FILE.open(newline="", encoding="utf-8") as file:
    heading, *rows = csv.reader(file)
angle = heading.index("actual_q_0")
farthest = max(float(row[angle]) for row in rows if len(row) > angle)
sys.exit(len(rows) < 100 or abs(farthest - there[0]) > 0.01)
