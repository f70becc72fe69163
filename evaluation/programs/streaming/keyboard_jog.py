"""Jog joints with keys: each key held for a while turns one joint, by speedJ."""

import sys

from rtde_control import RTDEControlInterface
from rtde_receive import RTDEReceiveInterface

HOST = sys.argv[1]
SPEED, HELD = 0.15, 250
KEYS = "qwas"
JOINTS = {"q": (0, 1), "w": (0, -1), "a": (5, 1), "s": (5, -1)}

control = RTDEControlInterface(HOST)
receive = RTDEReceiveInterface(HOST)
turned = {}
for key in KEYS:
    joint, sign = JOINTS[key]
    speed = [0.0] * 6
    speed[joint] = sign * SPEED
    before = receive.getActualQ()[joint]
    for _ in range(HELD):
        start = control.initPeriod()
        if not control.speedJ(speed, 0.5, 0.05):
            sys.exit("a speed was not taken")
        control.waitPeriod(start)
    control.speedStop(5.0)
    turned[key] = sign * (receive.getActualQ()[joint] - before)
control.stopScript()
sys.exit(min(turned.values()) < 0.02)
