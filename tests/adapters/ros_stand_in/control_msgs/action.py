"""The action's types."""

from types import SimpleNamespace


def _point():
    return SimpleNamespace(positions=[], velocities=[])


class FollowJointTrajectory:
    """`control_msgs/action/FollowJointTrajectory`."""

    class Feedback:
        """Feedback of a goal."""

        def __init__(self, *, joint_names):
            self.joint_names = joint_names
            self.desired, self.actual, self.error = _point(), _point(), _point()

    class Result:
        """Result of a goal."""

        def __init__(self, *, error_code, error_string):
            assert type(error_code) is int
            self.error_code, self.error_string = error_code, error_string
