"""Values past the checks of their own types and readers, as only an attacker or a broken program makes them."""

from __future__ import annotations

from copy import copy
from types import FunctionType, SimpleNamespace
from typing import TypeVar

from capabilities.statements import statement_form

_T = TypeVar("_T")

_UNREAD = SimpleNamespace(
    **{**vars(statement_form), "seal": lambda kind, claims, key, reader, **_: statement_form.sign(kind, claims, key)}
)


def unread(module, value, key) -> str:
    """Statement of a module's kind, signed without a check by its own reader.

    The module's `sign` runs on names of its own: threads share the module, and a patch of it that two make at the same
    time stays for ever.
    """
    return FunctionType(module.sign.__code__, {**vars(module), "statement_form": _UNREAD})(value, key)


def unchecked(value: _T, **changes: object) -> _T:
    """Copy of a frozen value with these changes, which its own type would refuse."""
    changed = copy(value)
    for name, change in changes.items():
        object.__setattr__(changed, name, change)
    return changed
