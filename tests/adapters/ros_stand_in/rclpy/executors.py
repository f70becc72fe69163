"""Executors: timers each on a thread, goals read from standard input."""

import json
import sys
import threading
import time
from types import SimpleNamespace

from rclpy.node import say


def message(value):
    """A message of a JSON value; floats stay as the planner wrote them."""
    if isinstance(value, dict):
        return SimpleNamespace(**{name: message(each) for name, each in value.items()})
    return [message(each) for each in value] if isinstance(value, list) else value


class Handle:
    """Members of rclpy's `ServerGoalHandle`."""

    def __init__(self, number, request):
        self.number, self.request, self.is_cancel_requested = number, request, False

    def succeed(self):
        say("status", goal=self.number, status="succeeded")

    def abort(self):
        say("status", goal=self.number, status="aborted")

    def canceled(self):
        say("status", goal=self.number, status="canceled")

    def publish_feedback(self, told):
        say("feedback", goal=self.number, actual=list(told.actual.positions), desired=list(told.desired.positions))


class MultiThreadedExecutor:
    """Spins nodes until standard input ends."""

    def __init__(self):
        self.nodes = []

    def add_node(self, node):
        self.nodes.append(node)

    def spin(self):
        (node,) = self.nodes
        for period_s, call in node.timers:
            threading.Thread(target=self._ticks, args=(period_s, call), daemon=True).start()
        goals = {}
        say("ready", action=node.server.name)
        for line in sys.stdin:
            asked = json.loads(line)
            if "cancel" in asked:
                handle = goals[asked["cancel"]]
                handle.is_cancel_requested = node.server.cancel_callback(handle) == "accept"
                continue
            handle = goals[asked["goal"]] = Handle(asked["goal"], message(asked["request"]))
            threading.Thread(target=self._executed, args=(node.server, handle), daemon=True).start()

    @staticmethod
    def _ticks(period_s, call):
        while True:
            call()
            time.sleep(period_s)

    @staticmethod
    def _executed(server, handle):
        result = server.execute_callback(handle)
        say("result", goal=handle.number, code=result.error_code, told=result.error_string)
