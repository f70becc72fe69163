"""Help in boxes without what it never draws: Markdown and tracebacks, half of what Typer's drawing of help loads."""

from __future__ import annotations

import sys
from types import ModuleType
from typing import Any, Final

UNDRAWN: Final = {"rich.markdown": "Markdown", "rich.traceback": "Traceback"}
"""Modules of Rich that `typer.rich_utils` imports, and the one name that it takes from each.

Our help is of the markup mode `rich`, and tracebacks of ours are Python's own, so neither is ever made.
"""


def load_help() -> None:
    """Loads `typer.rich_utils` with stand-ins for what help never draws; what is loaded already stays."""
    if "typer.rich_utils" in sys.modules:
        return
    standing_in = {name: _stand_in(name, taken) for name, taken in UNDRAWN.items() if name not in sys.modules}
    sys.modules.update(standing_in)
    try:
        import typer.rich_utils  # noqa: F401 - loaded for the library itself, which looks it up by name
    finally:
        for name in standing_in:
            del sys.modules[name]


def _stand_in(name: str, taken: str) -> ModuleType:
    """A module with one class, which becomes the real one when an object of it is made."""

    def real(_: type, *arguments: Any, **named: Any) -> Any:
        from importlib import import_module

        return getattr(import_module(name), taken)(*arguments, **named)

    module = ModuleType(name)
    setattr(module, taken, type(taken, (), {"__new__": real}))
    return module
