"""Commands about logging in."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from ztpm_idp.domain.login.records import Authentication, Device
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
        former: id of the session that this browser had until now, of whichever person; it ends with this.
    """

    by: str
    session_id: str
    how: Authentication | None = None
    offer: bytes | None = None
    roles: frozenset[PersonRole] | None = None
    former: str | None = None


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


@dataclass(frozen=True, slots=True)
class AskDevice:
    """A command line asks for its key to be confirmed; nobody registered is behind it yet."""

    device: Device


@dataclass(frozen=True, slots=True)
class PollDevice:
    """A command line asks again; `key` is the one whose possession it proved."""

    key: bytes
    digest: bytes


@dataclass(frozen=True, slots=True)
class EnterCode:
    """A person entered a code in a session; one under which no device waits is counted."""

    by: str
    session_id: str
    user_code: str


@dataclass(frozen=True, slots=True)
class AnswerDevice:
    """A person confirms the device of a code in a session, or declines it."""

    by: str
    session_id: str
    user_code: str
    confirmed: bool


@dataclass(frozen=True, slots=True)
class EndSessionKey:
    """A person ends a session-bound key of its own; `thumbprint` names it."""

    by: str
    thumbprint: str


DeviceCommand = AskDevice | PollDevice | EnterCode | AnswerDevice | EndSessionKey
LoginCommand = OfferLogin | LogIn | LogOut | EndLogin | DeviceCommand
