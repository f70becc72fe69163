"""Instances of frozen dataclasses, made several times as fast as their classes make them.

A frozen dataclass stores each field through `object.__setattr__`, which is most of what the values of a token cost.
Here the fields are stored in an instance of a class of the same layout that nothing freezes, which is then turned into
one of the frozen class. The result is like any other instance: as frozen, and equal, with the same hash.
"""

from __future__ import annotations

from dataclasses import MISSING, fields
from typing import TYPE_CHECKING, Any, ParamSpec, TypeVar, cast

if TYPE_CHECKING:
    from collections.abc import Callable

_P = ParamSpec("_P")
_T = TypeVar("_T")


def maker(kind: Callable[_P, _T]) -> Callable[_P, _T]:
    """A function with the parameters of `kind`, which is a frozen dataclass with slots, that makes its instances.

    Raises:
        TypeError: for a class with a `__post_init__`, or with a field that is no parameter and has no plain default.
    """
    frozen: Any = kind
    if hasattr(frozen, "__post_init__"):
        raise TypeError("a class that checks what it is made of")
    known, parameters, stored = {}, [], []
    for field in fields(frozen):
        default = field.default is not MISSING
        if field.default_factory is not MISSING or not (field.init or default):
            raise TypeError("a field without a plain default")
        if default:
            known[f"_default_{field.name}"] = field.default
        if field.init:
            parameters.append(f"{field.name}=_default_{field.name}" if default else field.name)
        stored.append(f"_made.{field.name} = {field.name if field.init else f'_default_{field.name}'}")
    opened = type(f"_{frozen.__name__}", (), {"__slots__": frozen.__slots__})
    lines = [
        f"def make({', '.join(parameters)}):",
        "_made = _new(_open)",
        *stored,
        "_made.__class__ = _frozen",
        "return _made",
    ]
    known |= {"_new": object.__new__, "_open": opened, "_frozen": frozen}
    exec("\n    ".join(lines), known)  # noqa: S102 - as dataclasses does: nothing but the names of fields is in it
    return cast("Callable[_P, _T]", known["make"])
