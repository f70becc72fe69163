"""Teach by hand: freedrive while a person moves the arm, the joints written down, then freedrive ended."""

import sys
import time

from rtde_control import RTDEControlInterface
from rtde_receive import RTDEReceiveInterface

HOST = sys.argv[1]

control = RTDEControlInterface(HOST)
receive = RTDEReceiveInterface(HOST)
taught = []
if not control.freedriveMode():
    sys.exit("no freedrive")
until = time.monotonic() + 1.5
while time.monotonic() < until:
    taught.append(receive.getActualQ())
    time.sleep(0.1)
if not control.endFreedriveMode():
    sys.exit("freedrive did not end")
if not control.moveJ(taught[0], 0.4, 0.8):
    sys.exit("what was taught was not reached")
control.stopScript()
sys.exit(len(taught) < 10 or max(abs(a - b) for a, b in zip(receive.getActualQ(), taught[0])) > 1e-3)
