"""Messages."""

from types import SimpleNamespace


class JointState:
    """`sensor_msgs/msg/JointState`."""

    def __init__(self, *, name, position, velocity):
        self.header = SimpleNamespace(stamp=None)
        self.name, self.position, self.velocity = name, position, velocity
