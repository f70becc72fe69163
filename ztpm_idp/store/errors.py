"""Errors of the store, as one small tree."""

from __future__ import annotations


class StoreError(Exception):
    """Root of the tree."""


class StoreUnavailableError(StoreError):
    """The database cannot be read or cannot commit.

    Nothing of the command holds, or nobody may be told that it does.
    """


class AgainError(StoreUnavailableError):
    """Another transaction was in the way: nothing holds, and the same may be tried again."""


class LocksTooFewError(StoreError):
    """A command would change more than it has locked: nothing holds, and it is to be decided again alone."""


class NewerDatabaseError(StoreError):
    """A schema that this release does not know."""


class UnsafeDatabaseError(StoreError):
    """A server that may forget what it has acknowledged, or that cannot be told from another one."""


class StoreNotOpenedError(StoreUnavailableError):
    """The database cannot be had at the start.

    Attributes:
        code: its cause.
        sentence: place and cause, for a person.
    """

    def __init__(self, code: str, sentence: str) -> None:
        super().__init__(f"{code}: {sentence}")
        self.code = code
        self.sentence = sentence


class OnceOnlyError(StoreError):
    """Something that happens once has happened already, in another transaction."""


class ProofUsedError(StoreError):
    """A proof was used before: nothing of the command that came with it holds."""


class ConflictError(StoreError):
    """Conflict of a unique constraint with a row that another transaction made first."""


class RestoreError(StoreError):
    """A copy that cannot be made or put back; the store is as it was.

    Attributes:
        code: its cause.
        sentence: place and cause, for a person.
    """

    def __init__(self, code: str, sentence: str) -> None:
        super().__init__(f"{code}: {sentence}")
        self.code = code
        self.sentence = sentence
