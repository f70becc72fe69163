"""Values past the checks of their own types and readers, as only an attacker or a broken program makes them."""

from __future__ import annotations

from copy import copy
from typing import TypeVar
from unittest.mock import patch

from capabilities.statements import statement_form

_T = TypeVar("_T")


def unread(module, value, key) -> str:
    """Statement of a module's kind, signed without a check by its own reader."""
    with patch.object(
        statement_form, "seal", lambda kind, claims, key, reader, **_: statement_form.sign(kind, claims, key)
    ):
        return module.sign(value, key)


def unchecked(value: _T, **changes: object) -> _T:
    """Copy of a frozen value with these changes, which its own type would refuse."""
    changed = copy(value)
    for name, change in changes.items():
        object.__setattr__(changed, name, change)
    return changed
