"""Enforcement: one gate for any tool, and what stands before tools, robots and functions.

    from pep import Within, guard, operation

guards the tools of a server (docs/guard.md). They are loaded when they are asked for: who wants physics alone loads no
server. `Sensor` is for programs that see (docs/sensors.md).
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from pep.base.declaration import grant, operation
    from pep.base.fact_declaration import Fact
    from pep.base.stated_values import Free, Length, Within, Word
    from pep.point.carriage import acting
    from pep.point.guard_config import GuardConfig
    from pep.point.guarded_functions import GuardedFunctions, NotPermittedError, function_pins, permitted
    from pep.point.tool_server import guard, pins
    from pep.sensor.sensor import Sensor

__all__ = [
    "Fact",
    "Free",
    "GuardConfig",
    "GuardedFunctions",
    "Length",
    "NotPermittedError",
    "Sensor",
    "Within",
    "Word",
    "acting",
    "function_pins",
    "grant",
    "guard",
    "operation",
    "permitted",
    "pins",
]
_HOMES: Final = {
    "GuardConfig": "pep.point.guard_config",
    "GuardedFunctions": "pep.point.guarded_functions",
    "NotPermittedError": "pep.point.guarded_functions",
    "Sensor": "pep.sensor.sensor",
    "acting": "pep.point.carriage",
    "function_pins": "pep.point.guarded_functions",
    "permitted": "pep.point.guarded_functions",
    "Fact": "pep.base.fact_declaration",
    "Free": "pep.base.stated_values",
    "Length": "pep.base.stated_values",
    "Within": "pep.base.stated_values",
    "Word": "pep.base.stated_values",
    "grant": "pep.base.declaration",
    "guard": "pep.point.tool_server",
    "operation": "pep.base.declaration",
    "pins": "pep.point.tool_server",
}


def __getattr__(name: str) -> Any:
    if name not in _HOMES:
        raise AttributeError(name)
    return getattr(import_module(_HOMES[name]), name)
