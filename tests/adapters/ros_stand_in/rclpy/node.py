"""Nodes: parameters, publishers, timers, a clock."""

import json
import os
import sys
import threading
import time
from types import SimpleNamespace

LOCK = threading.Lock()


def say(kind, **members):
    """One line of standard output."""
    with LOCK:
        sys.stdout.write(json.dumps({"kind": kind, **members}) + "\n")
        sys.stdout.flush()


class Node:
    """A node, whose timers run when an executor spins it."""

    def __init__(self, name):
        self.name, self.parameters, self.timers = name, {}, []
        self.given = json.loads(os.environ["ROS_PARAMETERS"])

    def declare_parameter(self, name, default):
        self.parameters[name] = self.given.get(name, default)

    def get_parameter(self, name):
        return SimpleNamespace(value=self.parameters[name])

    def create_publisher(self, message_type, topic, depth):
        assert (message_type.__name__, depth) == ("JointState", 10)
        return SimpleNamespace(publish=lambda message: say(topic, name=message.name, position=list(message.position)))

    def create_timer(self, period_s, call):
        self.timers.append((period_s, call))

    def get_clock(self):
        stamp = SimpleNamespace(nanoseconds=time.time_ns(), to_msg=lambda: SimpleNamespace(sec=0, nanosec=0))
        return SimpleNamespace(now=lambda: stamp)

    def destroy_node(self):
        """Nothing to destroy."""
