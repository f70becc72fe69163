"""Weigh what the gripper holds: the sensor set to zero, the tool's own payload stated, a force read at rest."""

import sys
import time

from rtde_control import RTDEControlInterface
from rtde_receive import RTDEReceiveInterface

HOST = sys.argv[1]

control = RTDEControlInterface(HOST)
receive = RTDEReceiveInterface(HOST)
if not control.setTcp([0.0, 0.0, 0.1767, 0.0, 0.0, 0.0]):
    sys.exit("another tool centre point")
if not control.setPayload(1.0, [0.0, 0.0, 0.058]):
    sys.exit("another payload")
if not control.moveJ([0.0, -1.62, 1.25, -1.2, -1.57, 0.0], 0.8, 1.2):
    sys.exit("not over the scales")
if not control.zeroFtSensor():
    sys.exit("the sensor was not set to zero")
time.sleep(0.2)
samples = []
for _ in range(100):
    samples.append(receive.getActualTCPForce()[2])
    time.sleep(0.005)
kilograms = sum(samples) / len(samples) / 9.81
tcp = control.getTCPOffset()
payload = receive.getPayload()
control.stopScript()
sys.exit(abs(kilograms) > 0.2 or abs(tcp[2] - 0.1767) > 1e-4 or abs(payload - 1.0) > 1e-3)
