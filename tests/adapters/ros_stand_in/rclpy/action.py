"""Action servers."""


class CancelResponse:
    """Answers to a wish to cancel."""

    ACCEPT, REJECT = "accept", "reject"


class ActionServer:
    """The one action of a node."""

    def __init__(self, node, action_type, action_name, execute_callback, *, cancel_callback, callback_group):
        assert action_type.__name__ == "FollowJointTrajectory"
        assert type(callback_group).__name__ == "ReentrantCallbackGroup"
        self.name, self.execute_callback, self.cancel_callback = action_name, execute_callback, cancel_callback
        node.server = self
