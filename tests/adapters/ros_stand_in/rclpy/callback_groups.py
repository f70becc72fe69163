"""Groups of callbacks."""


class ReentrantCallbackGroup:
    """Callbacks that may run side by side."""
