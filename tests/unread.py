"""Statements that nobody read before they were signed, as only an attacker or a broken program sends them."""

from __future__ import annotations

from unittest.mock import patch

from capabilities.statements import statement_form


def unread(module, value, key) -> str:
    """Statement of a module's kind, signed without a check by its own reader."""
    with patch.object(
        statement_form, "seal", lambda kind, claims, key, reader, **_: statement_form.sign(kind, claims, key)
    ):
        return module.sign(value, key)
