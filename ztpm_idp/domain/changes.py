"""Changes of people that take two: as proposed, with the words of administrators on them, and how each stands.

How a change stands is worked out from its words and the time, as with asks: no timer has to run.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from ztpm_idp.domain.parties import PersonRole

DAY_MS: Final = 86_400_000
CHANGE_LIFETIME_MS: Final = DAY_MS
"""Milliseconds for which a proposed change waits for another person."""
RECOVERY_WAIT_MS: Final = DAY_MS
"""Milliseconds after which a recovery takes effect that nobody confirmed: time for administrators to decline it."""
RECOVERY_LIFETIME_MS: Final = 7 * DAY_MS
"""Milliseconds after which a recovery is over that its person never used."""
CHANGES_OF_ONE: Final = 8
"""Most open changes of one proposer: all of a cell's administrators can still read the list."""
ROOT: Final = "root key"
"""Proposer of recoveries. The space keeps it apart from every registered id."""


class ChangeKind(StrEnum):
    """Kind of change."""

    PERSON = "person"
    """A person is registered as an approver or administrator."""
    KEY = "key"
    """A person gets a further key, or a passkey."""
    LOGIN = "login"
    """A person may log in with this login at another provider."""
    ROLES = "roles"
    """A person has these roles from then on, and no others."""
    END = "end"
    """A person ends, with its trees of authority."""
    RECOVERY = "recovery"
    """The root key makes an administrator, or gives one a new key in place of all others."""


class Word(StrEnum):
    """Answer of one administrator to a change."""

    CONFIRM = "confirmed"
    DECLINE = "declined"


class ChangeState(StrEnum):
    """State of a change."""

    OPEN = "open"
    DONE = "done"
    DECLINED = "declined"
    ENDED = "ended"
    """A recovery took effect meanwhile."""
    EXPIRED = "expired"


@dataclass(frozen=True, slots=True)
class Change:
    """A proposed change.

    Attributes:
        change_id: 32 hex digits.
        kind: which of its members count.
        person: the id that it is about.
        by: its proposer, or `ROOT`.
        proposed_ms: wall clock.
        name: of a person to register.
        roles: of a person to register, or all that a person has from then on.
        key: raw public key of a person to register, of a further one, or of a recovery.
        credential: of a key that is a passkey, the id by which its authenticator knows it, in base64url; else "".
        reason: of an end.
        login: issuer and subject at a login provider, with a space between.
        by_passkey: its proposer said so with a passkey, not with an operator key.
        end: state in which it ended, or None.
        confirmed, declined: administrators who said so.
    """

    change_id: str
    kind: ChangeKind
    person: str
    by: str
    proposed_ms: int
    name: str = ""
    roles: frozenset[PersonRole] = frozenset()
    key: bytes | None = None
    credential: str = ""
    reason: str = ""
    end: ChangeState | None = None
    confirmed: frozenset[str] = frozenset()
    declined: frozenset[str] = frozenset()
    login: str = ""
    by_passkey: bool = False

    @property
    def until_ms(self) -> int:
        """Wall clock at which it expires; of a recovery, at which it takes effect unless two people decline it."""
        return self.proposed_ms + (RECOVERY_WAIT_MS if self.kind is ChangeKind.RECOVERY else CHANGE_LIFETIME_MS)

    @property
    def at_terminal(self) -> bool:
        """True where only an operator key confirms it: the first word was a passkey's or the root key's ([CON-13])."""
        return self.by_passkey or self.kind is ChangeKind.RECOVERY

    @property
    def people(self) -> int:
        """Number of administrators whose word ends it, beside the proposer."""
        return 2 if self.kind is ChangeKind.RECOVERY else 1

    def state(self, at_ms: int) -> ChangeState:
        """State of the change at this wall-clock time."""
        if self.end is not None:
            return self.end
        lasts = RECOVERY_LIFETIME_MS if self.kind is ChangeKind.RECOVERY else CHANGE_LIFETIME_MS
        return ChangeState.OPEN if at_ms < self.proposed_ms + lasts else ChangeState.EXPIRED

    def due(self, at_ms: int) -> bool:
        """A recovery that takes effect with the next request of its person."""
        return self.kind is ChangeKind.RECOVERY and self.state(at_ms) is ChangeState.OPEN and self.until_ms <= at_ms
