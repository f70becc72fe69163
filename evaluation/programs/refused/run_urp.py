"""Start a program that lies on the controller, by the dashboard."""

import sys

from dashboard_client import DashboardClient

HOST = sys.argv[1]

dashboard = DashboardClient(HOST)
dashboard.connect()
dashboard.loadURP("pick.urp")
dashboard.play()
running = dashboard.running()
dashboard.disconnect()
sys.exit(not running)
