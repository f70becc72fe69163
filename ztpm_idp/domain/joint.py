"""Joint commands: several that are decided at once and share one transaction.

Each is decided on what holds before all of them. That is right where none of them changes what another one reads, which
is what their locks say (`domain.locks`). Commands that come often are named here; every other one has a transaction of
its own.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from ztpm_idp.domain.commands import Delegate, GiveNonce, Issue, Revoke
from ztpm_idp.domain.events import RevocationKind
from ztpm_idp.domain.locks import REVOCATIONS, Lock, Locks, Part

if TYPE_CHECKING:
    from collections.abc import Iterable

    from ztpm_idp.domain.commands import Command

MOST: Final = 32
"""Commands of one transaction: the first of them waits for the last."""


def claim(command: Command, locks: Locks) -> Locks | None:
    """Locks by which a command is told apart from others of its sort; None for one that is never joint.

    Args:
        command: revocations are joint with revocations alone, and other commands with others.
        locks: those that it takes.
    """
    match command:
        case GiveNonce() | Issue() | Delegate(resource=None, names=frozenset()):
            return locks
        case Revoke(kind=RevocationKind.TOKEN | RevocationKind.HOP as kind, id=id_):
            # Who lent it never changes, so that two of them meet only where they revoke the same.
            own = Lock(Part.REVOCATIONS, f"{kind.value} {id_}")
            return Locks(locks.shared, locks.alone - {REVOCATIONS} | {own})
        case _:
            return None


def apart(claims: Iterable[Locks]) -> list[int]:
    """Places of at most `MOST` claims that may be joint, in order: each is apart from all before.

    One that meets an earlier one waits, also where that one waits itself: nobody is overtaken by whom it meets.
    """
    shared, alone, found = set[Lock](), set[Lock](), list[int]()
    for place, each in enumerate(claims):
        if not (each.alone & alone or each.alone & shared or each.shared & alone):
            found.append(place)
        if len(found) == MOST:
            break
        shared |= each.shared
        alone |= each.alone
    return found


def union(locks: Iterable[Locks]) -> Locks:
    """Locks of all of them."""
    every = tuple(locks)
    alone = frozenset[Lock]().union(*(each.alone for each in every))
    return Locks(frozenset[Lock]().union(*(each.shared for each in every)) - alone, alone)
