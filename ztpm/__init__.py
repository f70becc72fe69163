"""Command line and embedded cell of ZTPM, and `leased`, by which a program takes the motion lease."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from ztpm.lease_process import leased
    from ztpm.program.program_lease import LeaseError

__all__ = ["LeaseError", "leased"]


def __getattr__(name: str) -> Any:
    """Public names, loaded at their first use: most of this package needs no robot's interface."""
    if name not in __all__:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from ztpm import lease_process

    return getattr(lease_process, name)
