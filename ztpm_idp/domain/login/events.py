"""Events of logging in."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from ztpm_idp.domain.login.records import Device, Offer, Session, SessionKey


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


@dataclass(frozen=True, slots=True)
class DeviceAsked:
    """A device waits. Not in the ledger: strangers ask."""

    device: Device


@dataclass(frozen=True, slots=True)
class DevicePolled:
    """A device asked again, and may ask once more after so long. Not in the ledger."""

    digest: bytes
    interval_s: int


@dataclass(frozen=True, slots=True)
class CodeWrong:
    """A code was entered under which nobody waits. Not in the ledger, but for the end of a session."""

    session_id: str
    wrong: int


@dataclass(frozen=True, slots=True)
class DeviceAnswered:
    """A person confirmed a device, or declined it; its code is spent."""

    digest: bytes
    person: str
    confirmed: bool


@dataclass(frozen=True, slots=True)
class SessionKeyAdded:
    """A command line's key signs for a person from now on."""

    session_key: SessionKey


@dataclass(frozen=True, slots=True)
class SessionKeyEnded:
    """A session-bound key is over before its time."""

    key: bytes
    person: str


DeviceEvent = DeviceAsked | DevicePolled | CodeWrong | DeviceAnswered | SessionKeyAdded | SessionKeyEnded
SessionEvent = LoginOffered | SessionBegun | SessionEnded | LoginAdded | LoginEnded | AccessEnded
LoginEvent = SessionEvent | DeviceEvent
