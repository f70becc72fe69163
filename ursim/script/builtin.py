"""The form of a built-in function: how URScript calls it, and how Python does."""

from __future__ import annotations

import inspect
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from collections.abc import Callable


@dataclass(frozen=True, slots=True)
class Parameter:
    """A parameter as URScript names it, and as the Python function does."""

    name: str
    local: str


@dataclass(frozen=True, slots=True)
class Function:
    """One built-in. `call` takes the execution first; one that takes time is a generator that yields once a tick."""

    name: str
    parameters: tuple[Parameter, ...]
    required: tuple[str, ...]
    call: Callable[..., Any]
    takes_time: bool


def plain(call: Callable[..., Any]) -> Callable[..., Any]:
    """A function of its arguments alone, in the form of a built-in's."""

    def wrapped(run: object, *arguments: Any) -> Any:
        del run
        return call(*arguments)

    return wrapped


def row(name: str, parameters: str, call: Callable[..., Any]) -> Function:
    """A row from URScript's own signature; a parameter in brackets may be left out."""
    words = parameters.split()
    names = [word.strip("[]") for word in words]
    local = list(inspect.signature(call).parameters)[1 : 1 + len(names)]
    pairs = names if len(local) != len(names) else local
    return Function(
        name=name,
        parameters=tuple(Parameter(a, b) for a, b in zip(names, pairs, strict=True)),
        required=tuple(word for word in words if not word.startswith("[")),
        call=call,
        takes_time=inspect.isgeneratorfunction(call),
    )
