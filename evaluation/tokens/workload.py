"""Scope that the benchmark lends, as plain integers that every peer restates in its own form.

Both sides of a comparison get the same operations, parameters and bounds, in the same integers. A serial number is
subtracted from every upper bound, so that no two tokens of a run share a block or a scope.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Final

from capabilities.values import strict_json
from capabilities.values.units import Quantity, Unit

OBJECT: Final = "ur3e"
STEP: Final = 100
"""Units by which each hop moves both ends of a limit that it tightens."""
SERIALS: Final = 50_000
"""Serial numbers are below this, so that every bound keeps room for the request."""


@dataclass(frozen=True, slots=True)
class Limit:
    """One parameter: its name, unit (as `capabilities.values.units.Unit` spells it) and bounds, both included."""

    name: str
    unit: str
    low: int
    high: int


@dataclass(frozen=True, slots=True)
class Workload:
    """One scope and one request under it.

    Attributes:
        name: as the rows spell it.
        operations: name and limits of each, sorted by name, as the root lends them.
        kept: the operations that the first hop keeps, and every later one.
        tightened: (operation, parameter) pairs; each hop moves both bounds of each by `STEP`.
        operation: the requested one; it is among `kept`.
        values: of the request, one for each limit of `operation`, inside the bounds of every hop.
        outside: the same with one value above every bound.
    """

    name: str
    operations: tuple[tuple[str, tuple[Limit, ...]], ...]
    kept: frozenset[str]
    tightened: frozenset[tuple[str, str]]
    operation: str
    values: tuple[int, ...]
    outside: tuple[int, ...]

    @property
    def limits(self) -> int:
        """Number of limits that the root lends."""
        return sum(len(limits) for _, limits in self.operations)

    def lent(self, hop: int, serial: int) -> tuple[tuple[str, tuple[Limit, ...]], ...]:
        """Operations and limits that hold from hop `hop` on (0 is the root), in the token of this serial number."""
        return tuple(
            (operation, tuple(self._bounded(operation, limit, hop, serial) for limit in limits))
            for operation, limits in self.operations
            if hop == 0 or operation in self.kept
        )

    def _bounded(self, operation: str, limit: Limit, hop: int, serial: int) -> Limit:
        by = hop * STEP if (operation, limit.name) in self.tightened else 0
        return Limit(limit.name, limit.unit, limit.low + by, limit.high - serial - by)

    def named(self, values: tuple[int, ...]) -> dict[str, int]:
        """The values by parameter."""
        limits = dict(self.operations)[self.operation]
        return {limit.name: value for limit, value in zip(limits, values, strict=True)}


def _joints(unit: str, most: int) -> tuple[Limit, ...]:
    return tuple(Limit(f"q{axis}", unit, -most, most) for axis in range(6))


_MOVE_JOINT: Final = (
    *_joints("urad", 3_141_592),
    Limit("speed", "urad_s", 1, 1_047_197),
    Limit("acceleration", "urad_s2", 1, 1_396_263),
)
_MOVE_LINEAR: Final = (
    Limit("x", "um", -500_000, 500_000),
    Limit("y", "um", -500_000, 500_000),
    Limit("z", "um", -50_000, 700_000),
    Limit("rx", "urad", -3_141_592, 3_141_592),
    Limit("ry", "urad", -3_141_592, 3_141_592),
    Limit("rz", "urad", -3_141_592, 3_141_592),
    Limit("speed", "um_s", 1, 250_000),
    Limit("acceleration", "um_s2", 1, 1_200_000),
)
_SPEED_JOINT: Final = (
    *_joints("urad_s", 1_047_197),
    Limit("acceleration", "urad_s2", 1, 1_396_263),
    Limit("time", "ms", 0, 100_000),
)
_GRIPPER_MOVE: Final = (
    Limit("width", "um", 0, 85_000),
    Limit("force", "mN", 0, 125_000),
    Limit("speed", "um_s", 0, 150_000),
)
_SET_PAYLOAD: Final = (Limit("mass", "g", 0, 60_000), Limit("cog_z", "um", 0, 100_000))
_JOINTS_AT: Final = (100_000, -1_200_000, 900_000, -400_000, 1_500_000, 0)

REALISTIC: Final = Workload(
    name="realistic",
    operations=(
        ("gripper_move", _GRIPPER_MOVE),
        ("move_joint", _MOVE_JOINT),
        ("move_linear", _MOVE_LINEAR),
        ("read_state", ()),
        ("servo_stop", ()),
        ("set_payload", _SET_PAYLOAD),
        ("speed_joint", _SPEED_JOINT),
        ("stop", ()),
    ),
    kept=frozenset({"gripper_move", "move_joint", "move_linear", "stop"}),
    tightened=frozenset({("gripper_move", "force"), ("move_joint", "speed"), ("move_linear", "speed")}),
    operation="move_joint",
    values=(*_JOINTS_AT, 500_000, 800_000),
    outside=(*_JOINTS_AT, 1_047_198, 800_000),
)
"""Eight operations of a cobot cell with 29 limits; the first hop drops four, and each hop tightens three limits."""

SMALL: Final = Workload(
    name="small",
    operations=(("gripper_move", _GRIPPER_MOVE[:2]),),
    kept=frozenset({"gripper_move"}),
    tightened=frozenset({("gripper_move", "force")}),
    operation="gripper_move",
    values=(20_000, 10_000),
    outside=(20_000, 125_001),
)
"""One operation with two limits; each hop tightens one."""

WORKLOADS: Final = (REALISTIC, SMALL)
DEPTHS: Final = (0, 1, 3, 8)
"""Hops after the first holder."""


def quantities(workload: Workload, values: tuple[int, ...]) -> tuple[Quantity, ...]:
    """The values of a request as ours takes them."""
    limits = dict(workload.operations)[workload.operation]
    return tuple(Quantity(limit.name, Unit(limit.unit), value) for limit, value in zip(limits, values, strict=True))


def body(workload: Workload, values: tuple[int, ...]) -> bytes:
    """The body of an MCP `tools/call` for a request."""
    arguments = dict(workload.named(values))
    params = {"name": workload.operation, "arguments": arguments}
    return strict_json.canonical({"jsonrpc": "2.0", "id": 1, "method": "tools/call", "params": params})
