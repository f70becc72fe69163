"""Faults on request: what a controller does when a person, a cable, a field bus or the safety system interferes."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any

from pep.rtde.variables import INPUTS
from pep.sim.drive import SLIDER_CHANGE_PER_S
from pep.sim.robot import SafetyMode

if TYPE_CHECKING:
    from collections.abc import Callable

    from pep.sim.controller import Controller
    from pep.sim.server import Simulator


class FaultError(ValueError):
    """A line that asks for no known fault."""


class Faults:
    """The faults of one simulator, each by its name."""

    def __init__(self, simulator: Simulator) -> None:
        self._simulator = simulator
        self._known: dict[str, Callable[..., None]] = {
            # what the arm and its people do
            "stop": self._act(lambda c: c.stop()),
            "protective_stop": self._act(_protective_stop),
            "safeguard_stop": self._act(lambda c: c.safeguard_stop()),
            "release_safeguard_stop": self._act(lambda c: c.release_safeguard_stop()),
            "emergency_stop": self._act(lambda c: c.emergency_stop()),
            "system_emergency_stop": self._act(lambda c: c.emergency_stop(SafetyMode.SYSTEM_EMERGENCY_STOP)),
            "release_emergency_stop": self._act(lambda c: c.release_emergency_stop()),
            "violation": self._act(lambda c: c.emergency_stop(SafetyMode.VIOLATION)),
            "fault": self._act(lambda c: c.emergency_stop(SafetyMode.FAULT)),
            "reduced_mode": self._act(lambda c: c.reduced_mode(on=True)),
            "normal_mode": self._act(lambda c: c.reduced_mode(on=False)),
            "local_control": self._act(lambda c: setattr(c, "remote", False)),
            "remote_control": self._act(lambda c: setattr(c, "remote", True)),
            "touch": self._act(lambda c: setattr(c.robot, "touched_at", c.robot.step)),
            "release_touch": self._act(lambda c: setattr(c.robot, "touched_at", None)),
            "slider_stuck": self._act(lambda c: setattr(c.robot.drive, "slider_change_per_s", 0.0)),
            "slider_free": self._act(lambda c: setattr(c.robot.drive, "slider_change_per_s", SLIDER_CHANGE_PER_S)),
            # what the network does
            "drop_connections": simulator.drop,
            "delay": self._delay,
            "torn_frames": self._tear,
            "slow_frames": self._starve,
            "sound_network": self._mend,
            # what a field bus does
            "in_use": self._occupy,
            "inputs_free": simulator.rtde.vacate,
        }

    def inject(self, line: str) -> None:
        """Does what one JSON object asks for: `fault` is its name, other keys say more.

        Raises:
            FaultError: no such fault, or not these keys and values for it.
        """
        try:
            told: dict[str, Any] = json.loads(line)
            self._known[told.pop("fault")](**told)
        except (ValueError, KeyError, TypeError, AttributeError) as error:
            raise FaultError(f"no such fault; known: {', '.join(self._known)}") from error

    def _act(self, deed: Callable[[Controller], object]) -> Callable[[], None]:
        controller = self._simulator.controller

        def act() -> None:
            controller.ask(lambda: deed(controller))

        return act

    def _delay(self, *, seconds: float) -> None:
        if not 0.0 <= seconds <= 60.0:
            raise FaultError("a delay is 0 to 60 s")
        self._simulator.delivery.touched, self._simulator.delivery.delay_s = True, seconds

    def _tear(self) -> None:
        self._simulator.delivery.touched = self._simulator.delivery.torn = True

    def _starve(self, *, bytes_per_tick: int) -> None:
        if type(bytes_per_tick) is not int or bytes_per_tick < 1:
            raise FaultError("at least one byte a tick")
        self._simulator.delivery.touched, self._simulator.delivery.bytes_per_tick = True, bytes_per_tick

    def _mend(self) -> None:
        """From now on; what is on its way still comes as it was sent."""
        delivery = self._simulator.delivery
        delivery.delay_s, delivery.torn, delivery.bytes_per_tick = 0.0, False, None

    def _occupy(self, *, inputs: list[str]) -> None:
        if not set(inputs) <= set(INPUTS):
            raise FaultError("there is no such input")
        self._simulator.rtde.occupy(inputs)


def _protective_stop(controller: Controller) -> None:
    controller.robot.alarm = "asked for"
