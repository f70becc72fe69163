"""Sessions: begun by people who were authenticated just now, ended by them, by time, or with the person."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final, assert_never

from ztpm_idp.domain.codes import IdpCode, Refusal
from ztpm_idp.domain.login.commands import EndLogin, LogIn, LogOut, OfferLogin
from ztpm_idp.domain.login.events import LoginEnded, LoginOffered, SessionBegun, SessionEnded
from ztpm_idp.domain.login.records import (
    ABSOLUTE_MS,
    SESSIONS_OF_ONE,
    Authentication,
    Method,
    Offer,
    Session,
)
from ztpm_idp.domain.parties import PersonRole, RegisteredPerson, Standing

if TYPE_CHECKING:
    from ztpm_idp.domain.registry import Outcome
    from ztpm_idp.domain.state import State

SOFTWARE_KEY: Final = "swk"
"""Method of an operator key in a file: proof of possession of a software-secured key (RFC 8176 section 2)."""


def login(state: State, command: OfferLogin | LogIn | LogOut | EndLogin, at_ms: int) -> Outcome:
    """The events of a command about logging in."""
    person = state.parties.get(command.by)
    if not isinstance(person, RegisteredPerson) or person.standing is not Standing.ACTIVE:
        return Refusal(IdpCode.NOT_PERMITTED, "people log in")
    match command:
        case OfferLogin(by=by, key=key, digest=digest):
            return (LoginOffered(Offer(digest, by, key, at_ms)),)
        case LogIn():
            return _begun(state, command, person, at_ms)
        case LogOut(by=by, session_id=session_id):
            own = any(session.session_id == session_id for session in state.sessions)
            return (SessionEnded(session_id, by),) if own else ()
        case EndLogin(by=by, login=known):
            if state.login_owner is None:
                return Refusal(IdpCode.NOT_FOUND, "nobody has this login")
            if state.login_owner != by and PersonRole.ADMIN not in person.roles:
                return Refusal(IdpCode.NOT_PERMITTED, "its person or an administrator ends a login")
            return (LoginEnded(state.login_owner, known),)
        case _:
            assert_never(command)


def _begun(state: State, command: LogIn, person: RegisteredPerson, at_ms: int) -> Outcome:
    how = command.how
    if command.offer is not None:
        offer = state.offer
        if offer is None or offer.person != person.id or offer.over(at_ms):
            return Refusal(IdpCode.LOGIN_OVER, "the login link was opened before, or is too old")
        how = Authentication(Method.OPERATOR_KEY, offer.made_ms, amr=(SOFTWARE_KEY,), key=offer.key)
    if how is None or not how.at_ms <= at_ms:
        return Refusal(IdpCode.NOT_PERMITTED, "nothing says how the person was authenticated")
    if how.login and state.login_owner != person.id:
        return Refusal(IdpCode.LOGIN_UNKNOWN, "nobody here has this login")
    roles = person.roles if command.roles is None else person.roles & command.roles
    begun = Session(
        session_id=command.session_id, person=person.id, how=how, roles=roles,
        made_ms=at_ms, seen_ms=at_ms, ends_ms=at_ms + ABSOLUTE_MS,
    )  # fmt: skip
    former = () if state.session is None else (state.session,)
    others = sorted(set(state.sessions).difference(former), key=lambda session: session.made_ms)
    # The oldest of too many ends, too.
    ends = (*former, *others[: max(0, len(others) + 1 - SESSIONS_OF_ONE)])
    return (*(SessionEnded(each.session_id, each.person) for each in ends), SessionBegun(begun, command.offer))
