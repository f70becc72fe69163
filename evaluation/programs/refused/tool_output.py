"""Close a gripper on the outputs of the tool's own plug."""

import sys
import time

from rtde_io import RTDEIOInterface
from rtde_receive import RTDEReceiveInterface

HOST = sys.argv[1]
FIRST = 16

io = RTDEIOInterface(HOST)
receive = RTDEReceiveInterface(HOST)
io.setToolDigitalOut(0, True)
time.sleep(0.5)
closed = receive.getDigitalOutState(FIRST)
receive.disconnect()
sys.exit(not closed)
