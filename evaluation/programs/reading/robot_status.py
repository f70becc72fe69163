"""Show how the robot is: the dashboard's modes, temperatures, currents, the safety status, and its version."""

import sys

from dashboard_client import DashboardClient
from rtde_receive import RTDEReceiveInterface

HOST = sys.argv[1]

dashboard = DashboardClient(HOST)
dashboard.connect()
receive = RTDEReceiveInterface(HOST)
modes = (dashboard.robotmode(), dashboard.safetymode(), dashboard.programState(), dashboard.polyscopeVersion())
for line in (*modes, dashboard.getRobotModel(), dashboard.isInRemoteControl()):
    print(line)
print([round(value, 3) for value in receive.getActualQ()])
print(receive.getJointTemperatures(), receive.getActualCurrent(), receive.getActualMainVoltage())
well = "RUNNING" in modes[0] and "NORMAL" in modes[1] and receive.getSafetyMode() == 1 and receive.getRobotMode() == 7
dashboard.disconnect()
receive.disconnect()
sys.exit(not well)
