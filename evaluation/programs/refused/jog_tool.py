"""Jog the tool by the controller's own jog mode for half a second."""

import sys
import time

from rtde_control import RTDEControlInterface
from rtde_receive import RTDEReceiveInterface

HOST = sys.argv[1]

control = RTDEControlInterface(HOST)
receive = RTDEReceiveInterface(HOST)
begin = receive.getActualTCPPose()
if not control.jogStart([0.0, 0.0, 20.0, 0.0, 0.0, 0.0], RTDEControlInterface.FEATURE_BASE):
    sys.exit("no jog")
time.sleep(0.5)
control.jogStop()
control.stopScript()
sys.exit(receive.getActualTCPPose()[2] - begin[2] < 0.002)
