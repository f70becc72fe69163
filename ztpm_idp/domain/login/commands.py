"""Commands about logging in."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from ztpm_idp.domain.login.records import Authentication
    from ztpm_idp.domain.parties import PersonRole


@dataclass(frozen=True, slots=True)
class OfferLogin:
    """A person asks, with this key, for a link that begins a session; `digest` is that of the link's secret."""

    by: str
    key: str
    digest: bytes


@dataclass(frozen=True, slots=True)
class LogIn:
    """A person who was authenticated begins a session.

    Attributes:
        by: the person.
        session_id: of the new session.
        how: the authentication; None: the offer says it.
        offer: digest of the login link that was opened, if any.
        roles: most that the session may have; None: no limit but the person's own.
    """

    by: str
    session_id: str
    how: Authentication | None = None
    offer: bytes | None = None
    roles: frozenset[PersonRole] | None = None


@dataclass(frozen=True, slots=True)
class LogOut:
    """A person ends a session of its own."""

    by: str
    session_id: str


@dataclass(frozen=True, slots=True)
class EndLogin:
    """A login at another provider ends: on its person's word, or an administrator's."""

    by: str
    login: str


LoginCommand = OfferLogin | LogIn | LogOut | EndLogin
