"""Words of the command line that need no reading: an option that is not given, and plain text.

Typer reads every value with pydantic, also the one that is absent; loading pydantic costs more than most commands.
"""

from __future__ import annotations

from typing import Any

from typer import core


class PlainValue:
    """Takes nothing as nothing and text as text; every other value is read as Typer reads it."""

    __slots__ = ("_annotation", "_descriptor", "_parsed")

    def __init__(self, descriptor: Any) -> None:
        """The reading of one parameter.

        Args:
            descriptor: of its type, as Typer resolved it.
        """
        self._descriptor = descriptor
        self._parsed = descriptor.parameter_info.parser is not None
        self._annotation = descriptor.annotation

    def coerce(self, value: Any, param: Any, ctx: Any) -> Any:
        """The value as the command gets it."""
        several = param.multiple or param.nargs == -1
        if value is None:
            return () if several else None
        if self._annotation is str and type(value) is str and not (several or self._parsed):
            return value
        from typer._coercion import build_runtime_param

        return build_runtime_param(self._descriptor).coerce(value, param=param, ctx=ctx)


def read_plainly() -> None:
    """Lets Typer take plain words as they are, in the releases that read values with pydantic."""
    if hasattr(core, "build_runtime_param"):
        core.build_runtime_param = PlainValue
