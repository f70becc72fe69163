"""Events of logging in."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from ztpm_idp.domain.login.records import Offer, Session


@dataclass(frozen=True, slots=True)
class LoginOffered:
    """A login link may be opened. Not in the ledger: the session is."""

    offer: Offer


@dataclass(frozen=True, slots=True)
class SessionBegun:
    """A person is logged in; `offer` is the digest of the link that is spent by it, if any."""

    session: Session
    offer: bytes | None


@dataclass(frozen=True, slots=True)
class SessionEnded:
    """A session is over before its time."""

    session_id: str
    person: str


@dataclass(frozen=True, slots=True)
class LoginAdded:
    """A person may log in with this login at another provider."""

    person: str
    login: str


@dataclass(frozen=True, slots=True)
class LoginEnded:
    """A person may not log in with this login any more; sessions that it began are over."""

    person: str
    login: str


@dataclass(frozen=True, slots=True)
class AccessEnded:
    """Every session, link, session-bound key and login of a person is over."""

    person: str


LoginEvent = LoginOffered | SessionBegun | SessionEnded | LoginAdded | LoginEnded | AccessEnded
