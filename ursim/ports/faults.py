"""Faults on request: interference by a person, a cable, a field bus or the safety system."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, TypeAlias

from pep.rtde.wire.variables import INPUTS
from ursim.motion.arm import AXES
from ursim.motion.drive import SLIDER_CHANGE_PER_S
from ursim.motion.led import Surface
from ursim.motion.robot import SafetyMode

if TYPE_CHECKING:
    from collections.abc import Callable

    from ursim.ports.controller import Controller
    from ursim.ports.server import Simulator

    Deed: TypeAlias = Callable[[Simulator], None]

LONGEST_DELAY_S: Final = 60.0
LATEST_S: Final = 86_400.0
FARTHEST_M: Final = 10.0
TURN_RAD: Final = 2 * math.pi


class FaultError(ValueError):
    """Request for an unknown fault; the message says why."""


@dataclass(frozen=True, slots=True)
class PlannedFault:
    """A fault of the command line.

    Attributes:
        at_s: seconds after the controller has said that it is ready.
        deed: does it, in a simulator that ticks.
    """

    at_s: float
    deed: Deed

    @classmethod
    def parse(cls, text: str) -> PlannedFault:
        """`NAME`, `NAME=VALUE`, either with `@SECONDS` behind it.

        Raises:
            FaultError: no such fault, or not this value or time for it.
        """
        asked, at, when = text.partition("@")
        name, equals, value = asked.partition("=")
        if bool(equals) is not (name in _VALUES):
            what = "takes a value: " + _VALUES[name][2] if name in _VALUES else "is no fault, or takes no value"
            raise FaultError(f"{name} {what}; faults are {USAGE}")
        try:
            seconds = float(when) if at else 0.0
            keys = {_VALUES[name][0]: _VALUES[name][1](value)} if equals else {}
        except ValueError as error:
            raise FaultError(f"{text} holds what is no number") from error
        if not 0.0 <= seconds <= LATEST_S:
            raise FaultError(f"a fault comes 0 to {LATEST_S:.0f} s after the start")
        return cls(seconds, _deed({"fault": name, **keys}))


class Faults:
    """The faults of one simulator, each by its name."""

    def __init__(self, simulator: Simulator) -> None:
        self._simulator = simulator

    def inject(self, line: str) -> None:
        """Makes the fault of one JSON object: `fault` is its name, other keys say more.

        Raises:
            FaultError: no such fault, or not these keys and values for it.
        """
        try:
            told = json.loads(line)
        except ValueError as error:
            raise FaultError("a fault is one JSON object") from error
        _deed(told)(self._simulator)


def _deed(told: dict[str, Any]) -> Deed:
    try:
        keys = dict(told)
        return _KNOWN[keys.pop("fault")](**keys)
    except FaultError:
        raise
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise FaultError(f"no such fault; known: {USAGE}") from error


def _act(deed: Callable[[Controller], object]) -> Callable[[], Deed]:
    def act(simulator: Simulator) -> None:
        simulator.controller.ask(lambda: deed(simulator.controller))

    return lambda: act


def _drop() -> Deed:
    return lambda simulator: simulator.drop()


def _delay(*, seconds: float) -> Deed:
    if not 0.0 <= seconds <= LONGEST_DELAY_S:
        raise FaultError(f"a delay is 0 to {LONGEST_DELAY_S:.0f} s")

    def act(simulator: Simulator) -> None:
        simulator.delivery.touched, simulator.delivery.delay_s = True, seconds

    return act


def _tear() -> Deed:
    def act(simulator: Simulator) -> None:
        simulator.delivery.touched = simulator.delivery.torn = True

    return act


def _starve(*, bytes_per_tick: int) -> Deed:
    if type(bytes_per_tick) is not int or bytes_per_tick < 1:
        raise FaultError("at least one byte a tick")

    def act(simulator: Simulator) -> None:
        simulator.delivery.touched, simulator.delivery.bytes_per_tick = True, bytes_per_tick

    return act


def _mend() -> Deed:
    """Ends all faults of delivery from now on; messages on their way still come as they were sent."""

    def act(simulator: Simulator) -> None:
        delivery = simulator.delivery
        delivery.delay_s, delivery.torn, delivery.bytes_per_tick = 0.0, False, None

    return act


def _place(*, joints_rad: list[float]) -> Deed:
    q = tuple(map(float, joints_rad))
    if len(q) != AXES or not all(abs(angle) <= TURN_RAD for angle in q):
        raise FaultError(f"an arm stands at {AXES} angles within a turn to either side")
    return _act(lambda controller: controller.robot.drive.place(q))()


def _push(*, joints_rad_s: list[float]) -> Deed:
    qd = tuple(map(float, joints_rad_s))
    if len(qd) != AXES or not all(abs(speed) <= math.pi for speed in qd):
        raise FaultError(f"a hand pushes at {AXES} joint speeds of at most pi rad/s")
    return _act(lambda controller: setattr(controller.robot, "hand", qd))()


def _surface(*, z_m: float) -> Deed:
    if not abs(z_m) <= FARTHEST_M:
        raise FaultError(f"a surface is at most {FARTHEST_M} m above or below the base")
    flat = Surface((0.0, 0.0, z_m), (0.0, 0.0, 1.0))
    return _act(lambda controller: controller.robot.surfaces.append(flat))()


def _occupy(*, inputs: list[str]) -> Deed:
    if not set(inputs) <= set(INPUTS):
        raise FaultError("there is no such input")
    return lambda simulator: simulator.rtde.occupy(inputs)


def _vacate() -> Deed:
    return lambda simulator: simulator.rtde.vacate()


def _protective_stop(controller: Controller) -> None:
    controller.robot.alarm = "asked for"


_KNOWN: Final[dict[str, Callable[..., Deed]]] = {
    # the arm and its people
    "stop": _act(lambda c: c.stop()),
    "protective_stop": _act(_protective_stop),
    "protective_stop_ages": _act(lambda c: c.ages()),
    "safeguard_stop": _act(lambda c: c.safeguard_stop()),
    "release_safeguard_stop": _act(lambda c: c.release_safeguard_stop()),
    "emergency_stop": _act(lambda c: c.emergency_stop()),
    "system_emergency_stop": _act(lambda c: c.emergency_stop(SafetyMode.SYSTEM_EMERGENCY_STOP)),
    "release_emergency_stop": _act(lambda c: c.release_emergency_stop()),
    "violation": _act(lambda c: c.emergency_stop(SafetyMode.VIOLATION)),
    "fault": _act(lambda c: c.emergency_stop(SafetyMode.FAULT)),
    "reduced_mode": _act(lambda c: c.reduced_mode(on=True)),
    "normal_mode": _act(lambda c: c.reduced_mode(on=False)),
    "local_control": _act(lambda c: setattr(c, "remote", False)),
    "remote_control": _act(lambda c: setattr(c, "remote", True)),
    "touch": _act(lambda c: setattr(c.robot, "touched_at", c.robot.step)),
    "release_touch": _act(lambda c: setattr(c.robot, "touched_at", None)),
    "placed": _place,
    "push": _push,
    "surface": _surface,
    "no_surface": _act(lambda c: c.robot.surfaces.clear()),
    "slider_stuck": _act(lambda c: setattr(c.robot.drive, "slider_change_per_s", 0.0)),
    "slider_free": _act(lambda c: setattr(c.robot.drive, "slider_change_per_s", SLIDER_CHANGE_PER_S)),
    # the network
    "drop_connections": _drop,
    "delay": _delay,
    "torn_frames": _tear,
    "slow_frames": _starve,
    "sound_network": _mend,
    # a field bus
    "in_use": _occupy,
    "inputs_free": _vacate,
}

# On the command line: the key that a value is for, how it is read, and how that is written.
_VALUES: Final[dict[str, tuple[str, Callable[[str], object], str]]] = {
    "delay": ("seconds", float, "delay=SECONDS"),
    "placed": ("joints_rad", lambda text: list(map(float, text.split(","))), "placed=RAD,.."),
    "push": ("joints_rad_s", lambda text: list(map(float, text.split(","))), "push=RAD_S,.."),
    "surface": ("z_m", float, "surface=Z_M"),
    "slow_frames": ("bytes_per_tick", int, "slow_frames=BYTES_A_TICK"),
    "in_use": ("inputs", lambda text: text.split(","), "in_use=INPUT,.."),
}
USAGE: Final = ", ".join(_VALUES[name][2] if name in _VALUES else name for name in _KNOWN)
