"""Device logins in the shape of RFC 8628: a person confirms a command line's key; nothing is a bearer.

A session-bound key signs for its person as an operator key does, with less: it lends and takes back what was lent,
reads what people read, and nothing else. It never votes, administers or changes keys, and carries the time and the way
of the login behind it into every token that it has issued.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Final, assert_never

from capabilities.keys.keys import thumbprint
from ztpm_idp.domain.codes import IdpCode, Refusal
from ztpm_idp.domain.commands import (
    Issue,
    RegisterAgent,
    Revoke,
    StateTrust,
    SuspendAgent,
)
from ztpm_idp.domain.events import RevocationKind
from ztpm_idp.domain.login.commands import AnswerDevice, AskDevice, EndSessionKey, EnterCode, PollDevice
from ztpm_idp.domain.login.events import (
    CodeWrong,
    DeviceAnswered,
    DeviceAsked,
    DevicePolled,
    SessionEnded,
    SessionKeyAdded,
    SessionKeyEnded,
)
from ztpm_idp.domain.login.records import (
    DEVICE_INTERVAL_S,
    DEVICES,
    DEVICES_OF_ONE,
    ENROL_FRESH_S,
    KEYS_OF_ONE,
    SESSION_KEY_MS,
    WRONG_CODES,
    Device,
    DeviceState,
    Session,
    SessionKey,
)
from ztpm_idp.domain.parties import PersonRole, RegisteredPerson, Standing

if TYPE_CHECKING:
    from ztpm_idp.domain.commands import Command
    from ztpm_idp.domain.events import Event
    from ztpm_idp.domain.login.commands import DeviceCommand
    from ztpm_idp.domain.registry import Outcome
    from ztpm_idp.domain.rules import Rules
    from ztpm_idp.domain.state import State

CARRIED: Final = frozenset({PersonRole.SPONSOR, PersonRole.AUDITOR})
"""Roles that a session-bound key may carry: votes and administration want the person anew, each time."""
BY_SESSION_KEY: Final = Issue | RegisterAgent | StateTrust | SuspendAgent | Revoke
"""Commands that a session-bound key may sign."""
REVOKES: Final = frozenset({RevocationKind.TOKEN, RevocationKind.HOP, RevocationKind.AGENT, RevocationKind.MANDATE})
"""Kinds of subjects that it may revoke: what its person lent, and never a person or a key."""


def within(state: State, command: Command, held: SessionKey | None, at_ms: int) -> State | Refusal:
    """The state with the key's roles alone for its person, as the command may see it; or a refusal.

    Args:
        state: as loaded for the command.
        command: signed by the key.
        held: the key as it stands now; None: it is gone.
        at_ms: now.
    """
    if held is None or held.over(at_ms):
        return Refusal(IdpCode.CALLER_UNKNOWN, "the session-bound key is over")
    if not isinstance(command, BY_SESSION_KEY) or command.by != held.person:
        return Refusal(IdpCode.SESSION_KEY_TOO_WEAK, "an operator key does this")
    if isinstance(command, Revoke) and command.kind not in REVOKES:
        return Refusal(IdpCode.SESSION_KEY_TOO_WEAK, "an operator key revokes people, keys and audiences")
    person = state.parties.get(held.person)
    if not isinstance(person, RegisteredPerson):
        return Refusal(IdpCode.CALLER_UNKNOWN, "not registered")
    return replace(state, parties={**state.parties, person.id: carried(person, held)}, session_key=held)


def carried(person: RegisteredPerson, held: SessionKey) -> RegisteredPerson:
    """The person with the roles that the key carries."""
    return replace(person, roles=person.roles & held.roles & CARRIED)


def device(rules: Rules, state: State, command: DeviceCommand, at_ms: int) -> Outcome:
    """The events of a command about devices."""
    match command:
        case AskDevice(device=asked):
            return _asked(rules, state, asked, at_ms)
        case PollDevice():
            return _polled(state, command, at_ms)
        case EnterCode():
            session = _session(state, command.session_id, at_ms)
            if isinstance(session, Refusal) or _waiting(state, command.user_code, at_ms) is not None:
                return session if isinstance(session, Refusal) else ()
            return _wrong(session)
        case AnswerDevice():
            return _answered(rules, state, command, at_ms)
        case EndSessionKey(by=by, thumbprint=named):
            own = [each for each in state.session_keys if thumbprint(each.key) == named]
            return tuple(SessionKeyEnded(each.key, by) for each in own)
        case _:
            assert_never(command)


def _asked(rules: Rules, state: State, asked: Device, at_ms: int) -> Outcome:
    open_ = [each for each in state.devices if not each.over(at_ms)]
    if len(open_) >= DEVICES or sum(each.address == asked.address for each in open_) >= DEVICES_OF_ONE:
        return Refusal(IdpCode.TOO_MANY_LOGINS, "too many command lines wait for their person")
    if (taken := _taken(rules, state, asked.key)) is not None:
        return taken
    return (DeviceAsked(asked),)


def _polled(state: State, command: PollDevice, at_ms: int) -> Outcome:
    """An answer to the device: a refusal once it is over, else the interval after which it may ask again."""
    found = next((each for each in state.devices if each.digest == command.digest), None)
    if found is None or found.key != command.key or found.over(at_ms):
        return Refusal(IdpCode.LOGIN_OVER, "nobody confirmed it in time, or another key asked")
    if found.state is DeviceState.DECLINED:
        return Refusal(IdpCode.LOGIN_DECLINED, "the person declined it")
    early = at_ms - found.polled_ms < found.interval_s * 1_000
    return (DevicePolled(found.digest, found.interval_s + DEVICE_INTERVAL_S * early),)


def _answered(rules: Rules, state: State, command: AnswerDevice, at_ms: int) -> Outcome:
    # 1. The person is logged in, and was authenticated recently.
    session = _session(state, command.session_id, at_ms)
    person = state.parties.get(command.by)
    if isinstance(session, Refusal) or not isinstance(person, RegisteredPerson):
        return session if isinstance(session, Refusal) else Refusal(IdpCode.NOT_LOGGED_IN, "")
    # 2. A device waits under the code.
    found = _waiting(state, command.user_code, at_ms)
    if found is None:
        return _wrong(session)
    answered = DeviceAnswered(found.digest, person.id, command.confirmed)
    if not command.confirmed:
        return (answered,)
    if not at_ms - session.how.at_ms <= ENROL_FRESH_S * 1_000:
        return Refusal(IdpCode.LOGIN_OLD, "who confirms a key logged in within the last ten minutes")
    # 3. The key is nobody's, and has less than the session.
    if (taken := _taken(rules, state, found.key)) is not None:
        return taken
    roles = person.roles & session.roles & CARRIED
    if not roles:
        return Refusal(IdpCode.NOT_PERMITTED, "sponsors and auditors log in from a command line")
    made = SessionKey(
        found.key, person.id, found.name, session.how, roles,
        made_ms=at_ms, ends_ms=session.how.at_ms + SESSION_KEY_MS,
    )  # fmt: skip
    living = sorted((each for each in state.session_keys if not each.over(at_ms)), key=lambda each: each.made_ms)
    ends: tuple[Event, ...] = tuple(
        SessionKeyEnded(each.key, person.id) for each in living[: max(0, len(living) + 1 - KEYS_OF_ONE)]
    )
    return (*ends, answered, SessionKeyAdded(made))


def _session(state: State, session_id: str, at_ms: int) -> Session | Refusal:
    for each in state.sessions:
        person = state.parties.get(each.person)
        active = isinstance(person, RegisteredPerson) and person.standing is Standing.ACTIVE
        if each.session_id == session_id and active and not each.over(at_ms):
            return each
    return Refusal(IdpCode.NOT_LOGGED_IN, "the session is over")


def _waiting(state: State, user_code: str, at_ms: int) -> Device | None:
    return next(
        (
            each
            for each in state.devices
            if each.user_code == user_code and each.state is DeviceState.WAITING and not each.over(at_ms)
        ),
        None,
    )


def _wrong(session: Session) -> Outcome:
    wrong = session.wrong + 1
    ends = (SessionEnded(session.session_id, session.person),) if wrong >= WRONG_CODES else ()
    return (CodeWrong(session.session_id, wrong), *ends)


def _taken(rules: Rules, state: State, key: bytes) -> Refusal | None:
    if key in rules.own_keys or key in state.key_owners:
        return Refusal(IdpCode.KEY_IN_USE, "one key has one owner and one role")
    return None
