"""The robot's connections. `GuardedControl` is its public name; importing the package alone loads nothing else."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from pep.rtde.guarded import GuardedControl

__all__ = ["GuardedControl"]


def __getattr__(name: str) -> Any:
    if name in __all__:
        from pep.rtde import guarded

        return getattr(guarded, name)
    raise AttributeError(f"module {__name__} has no attribute {name}")
