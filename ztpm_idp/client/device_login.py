"""Logging a command line in: a fresh key of its own, which its person confirms in a browser."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from ztpm_idp.client.caller import Caller, ClientError

if TYPE_CHECKING:
    from typing import Any


@dataclass(frozen=True, slots=True)
class Waiting:
    """A command line that waits for its person.

    Attributes:
        device_code: by which it asks again; worth nothing without its key.
        user_code: for the person to enter.
        url: of the page where it is entered.
        expires_in_s: seconds until it is over.
        interval_s: least seconds between two questions.
    """

    device_code: str
    user_code: str
    url: str
    expires_in_s: int
    interval_s: int


@dataclass(frozen=True, slots=True)
class Confirmed:
    """A key that signs for a person.

    Attributes:
        person: its id.
        roles: those that the key carries.
        expires_at: its end, seconds since the epoch.
        method: the way in which the person was authenticated.
        authenticated_at: when, seconds since the epoch.
    """

    person: str
    roles: tuple[str, ...]
    expires_at: int
    method: str
    authenticated_at: int


class DeviceLogin(Caller):
    """Requests of a command line that nobody knows yet, by its own fresh key."""

    def ask(self, name: str) -> Waiting:
        """The command line waits for its person, who reads this name of it.

        Raises:
            ClientError: `TOO_MANY_LOGINS`, `KEY_IN_USE`; `ANSWER_MALFORMED` for a page that is not the provider's.
        """
        answer = self._post("/login/devices", {"name": name})
        try:
            found = Waiting(
                str(answer["device_code"]),
                str(answer["user_code"]),
                str(answer["verification_uri"]),
                int(answer["expires_in"]),
                int(answer["interval"]),
            )
        except (KeyError, ValueError, TypeError):
            raise ClientError("ANSWER_MALFORMED", 201) from None
        if found.url != f"{self.issuer}/login/device":
            raise ClientError("ANSWER_MALFORMED", 201)
        return found

    def poll(self, device_code: str) -> Confirmed | int:
        """The confirmed key; or the seconds after which to ask again.

        Raises:
            ClientError: `LOGIN_DECLINED`, `LOGIN_OVER`.
        """
        answer: dict[str, Any] = self._post("/login/devices/poll", {"device_code": device_code})
        try:
            if answer["state"] != "confirmed":
                return int(answer["interval"])
            return Confirmed(
                str(answer["person"]),
                tuple(map(str, answer["roles"])),
                int(answer["expires_at"]),
                str(answer["method"]),
                int(answer["authenticated_at"]),
            )
        except (KeyError, ValueError, TypeError):
            raise ClientError("ANSWER_MALFORMED", 200) from None
