"""Send a URScript function of its own, as drivers of grippers do."""

import sys

from rtde_control import RTDEControlInterface

HOST = sys.argv[1]
SCRIPT = """
socket_open("127.0.0.1", 63352, "gripper")
socket_set_var("POS", 200, "gripper")
socket_close("gripper")
"""

control = RTDEControlInterface(HOST)
sent = control.sendCustomScriptFunction("close_gripper", SCRIPT)
control.stopScript()
sys.exit(not sent)
