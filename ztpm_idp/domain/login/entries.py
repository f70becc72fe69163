"""Ledger entries of logging in: who, how, when; never what a cookie or a link holds."""

from __future__ import annotations

from typing import TYPE_CHECKING, assert_never

from capabilities.keys.keys import thumbprint
from ztpm_idp.domain.login.events import (
    AccessEnded,
    CodeWrong,
    DeviceAnswered,
    DeviceAsked,
    DevicePolled,
    LoginAdded,
    LoginEnded,
    LoginOffered,
    SessionBegun,
    SessionEnded,
    SessionKeyAdded,
    SessionKeyEnded,
)

if TYPE_CHECKING:
    from ztpm_idp.domain.login.events import LoginEvent
    from ztpm_idp.domain.login.records import Authentication

Json = dict[str, object]


def login_entry(event: LoginEvent) -> tuple[str, Json] | None:
    """Kind and body of the event's ledger entry; None for an event that other entries imply."""
    match event:
        case LoginOffered() | DeviceAsked() | DevicePolled() | CodeWrong():
            return None
        case DeviceAnswered(person=person, confirmed=confirmed):
            return "device-confirmed" if confirmed else "device-declined", {"person": person}
        case SessionKeyAdded(session_key=made):
            return "session-key-added", {
                "key": thumbprint(made.key),
                "person": made.person,
                "name": made.name,
                "roles": sorted(role.value for role in made.roles),
                "ends_ms": made.ends_ms,
                "authentication": _how(made.how),
            }
        case SessionKeyEnded(key=key, person=person):
            return "session-key-ended", {"key": thumbprint(key), "person": person}
        case SessionBegun(session=session):
            return "session-begun", {
                "session_id": session.session_id,
                "person": session.person,
                "roles": sorted(role.value for role in session.roles),
                "authentication": _how(session.how),
            }
        case SessionEnded(session_id=session_id, person=person):
            return "session-ended", {"session_id": session_id, "person": person}
        case LoginAdded(person=person, login=login):
            return "login-added", {"person": person, "login": login}
        case LoginEnded(person=person, login=login):
            return "login-ended", {"person": person, "login": login}
        case AccessEnded(person=person):
            return "access-ended", {"person": person}
        case _:
            assert_never(event)


def _how(how: Authentication) -> Json:
    return {
        "method": how.method.value,
        "at_ms": how.at_ms,
        "acr": how.acr,
        "amr": list(how.amr),
        "key": how.key,
        "login": how.login,
    }
