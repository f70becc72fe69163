"""Errors of the store, as one small tree."""

from __future__ import annotations


class StoreError(Exception):
    """Root of the tree."""


class StoreUnavailableError(StoreError):
    """The database cannot be read or cannot commit.

    Nothing of the command holds, or nobody may be told that it does.
    """


class OnceOnlyError(StoreError):
    """Something that happens once has happened already, in another transaction."""


class ConflictError(StoreError):
    """A unique constraint refused what another transaction made first."""
