"""Open and close a Robotiq gripper over its own socket, between two moves of the arm."""

import socket
import sys
import time

from rtde_control import RTDEControlInterface

HOST = sys.argv[1]
GRIPPER_PORT = 63352
HOME = [-0.6, -1.62, 1.25, -1.2, -1.57, 0.0]

gripper = socket.create_connection((HOST, GRIPPER_PORT), timeout=5)


def ask(line: str) -> str:
    gripper.sendall(line.encode() + b"\n")
    return gripper.recv(1024).decode().strip()


def move(position: int) -> None:
    if ask(f"SET POS {position} SPE 128 FOR 30 GTO 1") != "ack":
        sys.exit("the gripper took no position")
    deadline = time.monotonic() + 5
    while abs(int(ask("GET POS").split()[1]) - position) > 3:
        if time.monotonic() > deadline:
            sys.exit("the gripper did not get there")
        time.sleep(0.05)


control = RTDEControlInterface(HOST)
ask("SET ACT 1")
deadline = time.monotonic() + 10
while ask("GET STA") != "STA 3":
    if time.monotonic() > deadline:
        sys.exit("the gripper did not become active")
    time.sleep(0.1)
move(0)
if not control.moveJ([-0.3, *HOME[1:]], 0.8, 1.2):
    sys.exit("not at the part")
move(200)
if not control.moveJ(HOME, 0.8, 1.2):
    sys.exit("not back")
move(0)
gripper.close()
control.stopScript()
