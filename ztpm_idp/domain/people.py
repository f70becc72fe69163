"""People: two of them make and change approvers and administrators, and the root key recovers an administrator.

A person's keys are one person's: words and votes count by person. Nothing here can tell two people from one who
keeps two names; that takes the second person, who looks before confirming.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from capabilities.keys.keys import thumbprint
from capabilities.statements import registry as snapshot
from ztpm_idp.domain.asking.envelope_acts import EnvelopeRevoked, ended_with
from ztpm_idp.domain.changes import CHANGES_OF_ONE, Change, ChangeKind, ChangeState, Word
from ztpm_idp.domain.codes import IdpCode, Refusal
from ztpm_idp.domain.events import (
    ChangeAnswered,
    ChangeEnded,
    ChangeProposed,
    KeyAdded,
    OpeningClosed,
    RevocationKind,
    Revoked,
    RolesChanged,
)
from ztpm_idp.domain.login.events import AccessEnded, LoginAdded
from ztpm_idp.domain.parties import PersonRole, RegisteredPerson, Standing
from ztpm_idp.domain.registry import active_person, full, new_party
from ztpm_idp.domain.signed import AssertedAct

if TYPE_CHECKING:
    from collections.abc import Iterator

    from ztpm_idp.domain.commands import AnswerChange, CompleteRecovery, ProposeChange, Recover, RegisterPerson
    from ztpm_idp.domain.events import Event
    from ztpm_idp.domain.parties import Party
    from ztpm_idp.domain.registry import Outcome
    from ztpm_idp.domain.rules import Rules
    from ztpm_idp.domain.state import State

RECOVERED = "the root key recovered an administrator"
"""Reason of all that a recovery ends."""
ROLE_GONE = "its person has the role for it no longer"
"""Reason of all that a change of roles ends."""


def register_person(rules: Rules, state: State, command: RegisterPerson) -> Outcome:
    """Registers a person who only lends or only reads, for an administrator."""
    if active_person(state, command.by, PersonRole.ADMIN) is None:
        return Refusal(IdpCode.NOT_PERMITTED, "an administrator registers people")
    person = _person(command.id, command.key, command.name, command.roles)
    if person.privileged:
        return Refusal(IdpCode.TWO_PEOPLE_NEEDED, "approvers and administrators are proposed, and another confirms")
    return new_party(rules, state, person)


def end_refused(state: State, by: str, person: RegisteredPerson, *, wholly: bool) -> Refusal | None:
    """Refusal to end this person, or else one of its several keys, on the word of `by` alone."""
    if person.standing is Standing.REVOKED:
        return None
    if by != person.id and person.privileged:
        return Refusal(IdpCode.TWO_PEOPLE_NEEDED, "the end of an approver or administrator is proposed")
    return _last(state, person) if wholly else None


def propose(rules: Rules, state: State, command: ProposeChange, at_ms: int) -> Outcome:
    """A change that waits for another person; it would be possible now."""
    change = command.change
    if change.kind is ChangeKind.KEY:
        if not isinstance(state.parties.get(change.by), RegisteredPerson) or change.by != change.person:
            return Refusal(IdpCode.NOT_PERMITTED, "a person asks for a further key of its own")
    elif active_person(state, change.by, PersonRole.ADMIN) is None and not _own_login(state, change):
        return Refusal(IdpCode.NOT_PERMITTED, "an administrator proposes changes of people")
    return _proposed(rules, state, command, at_ms)


def _own_login(state: State, change: Change) -> bool:
    own = change.kind is ChangeKind.LOGIN and change.by == change.person
    return own and isinstance(state.parties.get(change.by), RegisteredPerson)


def recover(rules: Rules, state: State, command: Recover, at_ms: int) -> Outcome:
    """A recovery that waits, for the holder of the provider's root key."""
    if command.key != rules.root_key:
        return Refusal(IdpCode.NOT_PERMITTED, "the root key recovers")
    return _proposed(rules, state, command, at_ms)


def _proposed(rules: Rules, state: State, command: ProposeChange | Recover, at_ms: int) -> Outcome:
    change = command.change
    if not sum(1 for other in _open(state, at_ms) if other.by == change.by) < CHANGES_OF_ONE:
        return Refusal(IdpCode.TOO_MANY_CHANGES, f"{CHANGES_OF_ONE} changes of one proposer wait for an answer")
    if isinstance(possible := _effects(rules, state, change, at_ms), Refusal):
        return possible
    return (ChangeProposed(change, tuple(sorted(state.administrators)), command.signed),)


def answer(rules: Rules, state: State, command: AnswerChange, at_ms: int) -> Outcome:
    """An administrator's word on a change: once, never on one of its own, and what follows from it."""
    change, by = state.change, command.by
    admin = active_person(state, by, PersonRole.ADMIN) is not None
    # 1. The caller is an administrator, now, or takes its own proposal back.
    if not admin and not (change is not None and change.by == by and command.word is Word.DECLINE):
        return Refusal(IdpCode.NOT_PERMITTED, "administrators answer changes")
    # 2. The change waits.
    if change is None:
        return Refusal(IdpCode.CHANGE_UNKNOWN, "no such change")
    if change.state(at_ms) is not ChangeState.OPEN:
        return Refusal(IdpCode.CHANGE_OVER, f"it is {change.state(at_ms)}")
    # 3. It is another person's: whom it is about has no say in it, and its proposer may only take it back.
    if by == change.by and command.word is Word.CONFIRM:
        return Refusal(IdpCode.CHANGE_YOURS, "another administrator confirms")
    if by == change.person and by != change.by:
        return Refusal(IdpCode.CHANGE_YOURS, "whom it is about has no say in it")
    if by in change.confirmed | change.declined:
        return Refusal(IdpCode.VOTED_BEFORE, "one word of each person")
    # 4. One of the words that make a change is signed with an operator key ([CON-13]).
    if command.word is Word.CONFIRM and isinstance(command.signed, AssertedAct) and change.at_terminal:
        return Refusal(IdpCode.OPERATOR_KEY_NEEDED, "of two people one signs with an operator key")
    # 5. Enough people, who are administrators still, have said the same.
    said = ChangeAnswered(change.change_id, by, command.word, command.reason, command.signed)
    before = change.confirmed if command.word is Word.CONFIRM else change.declined
    if by != change.by and len((before & state.administrators) | {by}) < change.people:
        return (said,)
    if command.word is Word.DECLINE:
        return (said, ChangeEnded(change.change_id, ChangeState.DECLINED))
    if change.kind is not ChangeKind.RECOVERY and not _stands(state, change):
        return Refusal(IdpCode.CHANGE_OVER, "its proposer may not propose it any more")
    effects = _effects(rules, state, change, at_ms)
    return effects if isinstance(effects, Refusal) else (said, *effects)


def complete(rules: Rules, state: State, command: CompleteRecovery, at_ms: int) -> Outcome:
    """A recovery takes effect that nobody declined in time; nothing happens for any other."""
    change = state.change
    if change is None or change.change_id != command.change_id or not change.due(at_ms):
        return ()
    return _effects(rules, state, change, at_ms)


def _effects(rules: Rules, state: State, change: Change, at_ms: int) -> Outcome:
    """Events that the change amounts to when it takes effect on this state."""
    person, done = state.parties.get(change.person), ChangeEnded(change.change_id, ChangeState.DONE)
    match change.kind, change.key:
        case ChangeKind.PERSON, bytes(key):
            if (too_many := _no_room(state, change.roles)) is not None:
                return too_many
            made = new_party(rules, state, _person(change.person, key, change.name, change.roles))
            return made if isinstance(made, Refusal) else (*made, done)
        case ChangeKind.KEY, bytes(key):
            if not isinstance(person, RegisteredPerson) or person.standing is Standing.REVOKED:
                return Refusal(IdpCode.NOT_FOUND, "no such person")
            added = KeyAdded(person.id, key, change.credential)
            return _no_room(state, person.roles) or _taken(rules, state, key) or (added, done)
        case ChangeKind.LOGIN, None:
            if not isinstance(person, RegisteredPerson) or person.standing is Standing.REVOKED:
                return Refusal(IdpCode.NOT_FOUND, "no such person")
            if state.login_owner is not None:
                return Refusal(IdpCode.LOGIN_IN_USE, "the login is a person's")
            return (LoginAdded(person.id, change.login), done)
        case ChangeKind.ROLES, None:
            return _with_roles(state, change, person) or (
                RolesChanged(change.person, change.roles), *_without_roles(state, change), done
            )  # fmt: skip
        case ChangeKind.END, None:
            if not isinstance(person, RegisteredPerson):
                return Refusal(IdpCode.NOT_FOUND, "no such person")
            first = Revoked(RevocationKind.SPONSOR, person.id, change.reason, person.id)
            return _last(state, person) or (*ended(state, first), done)
        case ChangeKind.RECOVERY, bytes(key):
            made = _recovered(rules, state, change, key)
            if isinstance(made, Refusal):
                return made
            # All that was begun and left open ends, and with it every other way in.
            others = (other.change_id for other in _open(state, at_ms) if other.change_id != change.change_id)
            opened = (
                OpeningClosed(opening.opening_id, RECOVERED) for opening in state.openings if not opening.over(at_ms)
            )
            enveloped = (
                EnvelopeRevoked(envelope.envelope_id, RECOVERED)
                for envelope in state.envelopes
                if not envelope.over(at_ms)
            )
            ends = (ChangeEnded(other, ChangeState.ENDED) for other in others)
            accesses = () if person is None else (AccessEnded(change.person),)
            return (*made, *accesses, done, *ends, *opened, *enveloped)
        case _:
            raise AssertionError(change.kind)


def _recovered(rules: Rules, state: State, change: Change, key: bytes) -> Outcome:
    """The administrator whom a recovery makes, or to whom it gives this key in place of all others."""
    match state.parties.get(change.person):
        case None:
            return new_party(
                rules, state, _person(change.person, key, change.name, frozenset({PersonRole.ADMIN}))
            )  # fmt: skip
        case RegisteredPerson(standing=Standing.ACTIVE, roles=roles) as person if PersonRole.ADMIN in roles:
            olds = sorted(person.keys | person.passkey_keys)
            ended = (Revoked(RevocationKind.KEY, thumbprint(old), RECOVERED, None) for old in olds)
            promised = (
                Revoked(RevocationKind.MANDATE, mandate.mandate_id, RECOVERED, None)
                for mandate in state.mandates
                if mandate.sponsor == person.id
            )
            return _taken(rules, state, key) or (KeyAdded(person.id, key), *ended, *promised)
        case _:
            return Refusal(IdpCode.ALREADY_REGISTERED, "the id is another party's, not an active administrator's")


def _with_roles(state: State, change: Change, person: Party | None) -> Refusal | None:
    """Refusal to give a person these roles, and no others."""
    if not isinstance(person, RegisteredPerson) or person.standing is Standing.REVOKED:
        return Refusal(IdpCode.NOT_FOUND, "no such person")
    if change.roles == person.roles:
        return Refusal(IdpCode.ALREADY_REGISTERED, "the person has exactly these roles")
    if PersonRole.ADMIN not in change.roles and (last := _last(state, person)) is not None:
        return last
    new = len(person.keys | person.passkey_keys) if PersonRole.APPROVER not in person.roles else 0
    return _no_room(state, change.roles, new) if new else None


def ended(state: State, first: Revoked) -> tuple[Event, ...]:
    """The revocation, with a person's also all that stands on it; what is in the index already is left out.

    With a person end that person's agents, wherever they stand: in trees of other people only their own names stop
    them. Its openings and envelopes end too. Ending a person again ends only the rest.
    """
    agents = (Revoked(RevocationKind.AGENT, agent, first.reason, agent) for agent in state.agents_of)
    left = _left_behind(state, first.id, first.reason) if first.kind is RevocationKind.SPONSOR else ()
    return (*(() if state.revoked_at_epoch is not None else (first,)), *agents, *left)


def _left_behind(state: State, person: str, reason: str) -> Iterator[Event]:
    """Ends of what this person opened and enveloped. Its mandates and asks have ended with its own name."""
    for opening in state.openings:
        if opening.opener == person:
            yield OpeningClosed(opening.opening_id, reason)
    yield from ended_with(state.envelopes, person, frozenset(state.agents_of), reason)


def _without_roles(state: State, change: Change) -> Iterator[Event]:
    """Ends of what a person may lend, or may have opened, no longer: its role for it is gone."""
    if PersonRole.SPONSOR not in change.roles:
        for token in state.tokens_from:
            yield Revoked(RevocationKind.TOKEN, token, ROLE_GONE, None)
        for mandate in state.mandates:
            yield Revoked(RevocationKind.MANDATE, mandate.mandate_id, ROLE_GONE, None)
    if PersonRole.APPROVER not in change.roles:
        for opening in state.openings:
            if opening.opener == change.person:
                yield OpeningClosed(opening.opening_id, ROLE_GONE)
        yield from ended_with(state.envelopes, change.person, frozenset(), ROLE_GONE)


def _open(state: State, at_ms: int) -> list[Change]:
    return [change for change in state.open_changes if change.state(at_ms) is ChangeState.OPEN]


def _person(id_: str, key: bytes, name: str, roles: frozenset[PersonRole]) -> RegisteredPerson:
    return RegisteredPerson(id_, key, thumbprint(key), Standing.ACTIVE, name, roles)


def _last(state: State, person: RegisteredPerson) -> Refusal | None:
    if PersonRole.ADMIN in person.roles and not state.administrators - {person.id}:
        return Refusal(IdpCode.LAST_ADMINISTRATOR, "nobody could register anyone")
    return None


def _stands(state: State, change: Change) -> bool:
    """True where its proposer may still propose it."""
    if change.kind is not ChangeKind.KEY and not _own_login(state, change):
        return active_person(state, change.by, PersonRole.ADMIN) is not None
    proposer = state.parties.get(change.by)
    return isinstance(proposer, RegisteredPerson) and proposer.standing is Standing.ACTIVE


def _no_room(state: State, roles: frozenset[PersonRole], new: int = 1) -> Refusal | None:
    if PersonRole.APPROVER in roles and not state.crowd + new <= snapshot.APPROVERS:
        return full(f"{snapshot.APPROVERS} keys of approvers")
    return None


def _taken(rules: Rules, state: State, key: bytes) -> Refusal | None:
    if key in rules.own_keys or key in state.key_owners:
        return Refusal(IdpCode.KEY_IN_USE, "one key has one owner and one role")
    return None
