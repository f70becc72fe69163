"""Records of logging in: authentications of people, sessions, and links that begin one."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from ztpm_idp.domain.parties import PersonRole

IDLE_MS: Final = 1_800_000
"""Milliseconds without a request after which a session is over (NIST SP 800-63B section 4.2.3, AAL2)."""
ABSOLUTE_MS: Final = 43_200_000
"""Milliseconds after which a session is over in any case (NIST SP 800-63B section 4.2.3, AAL2)."""
OFFER_MS: Final = 120_000
"""Milliseconds for which a login link may be opened: to copy it to another machine, not to keep it."""
SESSIONS_OF_ONE: Final = 16
"""Most sessions of one person; the next one ends the oldest."""


class Method(StrEnum):
    """Way in which a person was authenticated."""

    OPERATOR_KEY = "operator-key"
    PASSKEY = "passkey"
    OIDC = "oidc"


@dataclass(frozen=True, slots=True)
class Authentication:
    """Authentication of a person, as a token's first block and a session state it.

    Attributes:
        method: the way.
        at_ms: when the person was there, wall clock.
        acr: authentication context class, as the login provider said it; else "".
        amr: authentication methods (RFC 8176), as the login provider said them; of our own ways, ours.
        key: thumbprint of the operator key that showed it; else "".
        login: issuer and subject at a login provider, with a space between; else "".
    """

    method: Method
    at_ms: int
    acr: str = ""
    amr: tuple[str, ...] = ()
    key: str = ""
    login: str = ""


@dataclass(frozen=True, slots=True)
class Session:
    """Session of a person in a browser.

    Attributes:
        session_id: SHA-256 (hex) of the id that the browser's cookie holds.
        person: whose it is.
        how: the authentication that began it.
        roles: most that the person has in it.
        made_ms, seen_ms, ends_ms: wall clock; `ends_ms` is its end in any case.
        wrong: device codes that were entered in it and not known.
    """

    session_id: str
    person: str
    how: Authentication
    roles: frozenset[PersonRole]
    made_ms: int
    seen_ms: int
    ends_ms: int
    wrong: int = 0

    def over(self, at_ms: int) -> bool:
        """True where its time has ended, or nothing was heard in it for too long."""
        return not self.made_ms <= at_ms < min(self.ends_ms, self.seen_ms + IDLE_MS)


@dataclass(frozen=True, slots=True)
class Offer:
    """Login link that a person asked for by a signed request.

    Attributes:
        digest: SHA-256 of the link's secret.
        person: who asked.
        key: thumbprint of the key that signed.
        made_ms: wall clock.
    """

    digest: bytes
    person: str
    key: str
    made_ms: int

    def over(self, at_ms: int) -> bool:
        """True where it may not be opened any more."""
        return not self.made_ms <= at_ms < self.made_ms + OFFER_MS


DEVICE_MS: Final = 600_000
"""Milliseconds for which a device waits to be confirmed."""
DEVICE_INTERVAL_S: Final = 5
"""Seconds between two questions of a device (RFC 8628 section 3.2); as many more after each one that comes early."""
DEVICES: Final = 256
"""Most devices that wait at a time: strangers ask, and each is a row."""
DEVICES_OF_ONE: Final = 8
"""Most devices of one address that wait at a time."""
WRONG_CODES: Final = 10
"""Codes that a session may enter and that nobody waits under; then it is over (RFC 8628 section 5.1)."""
ENROL_FRESH_S: Final = 600
"""Greatest age of the login with which a device is confirmed, in seconds."""
SESSION_KEY_MS: Final = 43_200_000
"""Longest life of a session-bound key, from the authentication on: a working day."""
KEYS_OF_ONE: Final = 8
"""Most living session-bound keys of one person; the next one ends the oldest."""


class DeviceState(StrEnum):
    """Standing of a device that asked to be logged in."""

    WAITING = "waiting"
    CONFIRMED = "confirmed"
    DECLINED = "declined"


@dataclass(frozen=True, slots=True)
class Device:
    """Command line that asks for its key to be confirmed.

    Attributes:
        digest: SHA-256 of the code by which it asks again.
        user_code: eight letters that the person enters.
        key: raw public key, whose possession it proved.
        name: what it calls itself.
        address: from which it asked, as this provider saw it.
        made_ms, polled_ms: when it asked first and last, wall clock.
        interval_s: least seconds between two questions.
        state: how it stands.
        person: who confirmed it, or None.
    """

    digest: bytes
    user_code: str
    key: bytes
    name: str
    address: str
    made_ms: int
    polled_ms: int
    interval_s: int = DEVICE_INTERVAL_S
    state: DeviceState = DeviceState.WAITING
    person: str | None = None

    def over(self, at_ms: int) -> bool:
        """True where nobody may confirm it any more."""
        return not self.made_ms <= at_ms < self.made_ms + DEVICE_MS


@dataclass(frozen=True, slots=True)
class SessionKey:
    """Key of a command line that a person confirmed: it signs for the person for some hours, within some roles.

    Attributes:
        key: raw public key.
        person: whose it is.
        name: what the command line called itself.
        how: the authentication of the session in which it was confirmed.
        roles: most that it carries.
        made_ms, ends_ms: wall clock.
    """

    key: bytes
    person: str
    name: str
    how: Authentication
    roles: frozenset[PersonRole]
    made_ms: int
    ends_ms: int

    def over(self, at_ms: int) -> bool:
        """True where it signs for nobody any more."""
        return not self.made_ms <= at_ms < self.ends_ms
