"""Command line and embedded cell of ZTPM.

By `leased` a program takes the motion lease; as a `Sensor` it tells the cell what it sees.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any, Final

if TYPE_CHECKING:
    from pep.sensor.sensor import Sensor
    from ztpm.lease_process import leased
    from ztpm.program.program_lease import LeaseError

__all__ = ["LeaseError", "Sensor", "leased"]
_HOMES: Final = {
    "LeaseError": "ztpm.program.program_lease",
    "Sensor": "pep.sensor.sensor",
    "leased": "ztpm.lease_process",
}


def __getattr__(name: str) -> Any:
    """Public names, loaded at their first use: most of this package needs no robot's interface."""
    if name not in _HOMES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(import_module(_HOMES[name]), name)
