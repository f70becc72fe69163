"""Packages of the controller, and its ports with a receiver of their own."""

from pep.base.clock import SystemClock
from pep.base.stop_model import STOP_DECELERATION_RAD_S2
from pep.rtde.line.controller_ports import LeasedPorts
from pep.rtde.robot.state_receiver import Package, StateReceiver
from pep.rtde.script.control_script import allow_list, installed_body

POSE = (0.0,) * 6


def package(state, *, stamp_s=0.0, arrived_ms=0, runtime_state=2, tool_pose=POSE, tcp_offset=POSE, payload_kg=1.0,
            output_bits=0, registers=None):  # fmt: skip
    """A package with that state of the joints."""
    return Package(
        stamp_s, arrived_ms, state, tool_pose, tcp_offset, payload_kg, runtime_state, output_bits, registers or {}
    )


def received(host):
    """The receiver of that controller's state."""
    return StateReceiver(host, SystemClock())


class ByHand(StateReceiver):
    """A receiver that hears what a test puts into `heard`.

    Args:
        heard: the first package.
    """

    def __init__(self, heard):
        self.heard, self.version, self.told, self._clock = heard, None, None, SystemClock()

    @property
    def _newest(self):
        return self.heard

    def close(self):
        pass


class Ports(LeasedPorts):
    """The ports as the gateway has them; their receiver ends with them.

    Args:
        host: of the controller.
        judge: of the holder's commands.
        closed: is told of a lease whose control connection has ended.
    """

    def __init__(self, host, judge, *, closed=lambda *_: None):
        super().__init__(
            host, received(host), judge, scripts=allow_list(installed_body), clock=SystemClock(), closed=closed,
            stop_deceleration_rad_s2=STOP_DECELERATION_RAD_S2,
        )  # fmt: skip

    def close(self):
        super().close()
        self.state.close()
