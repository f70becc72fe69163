"""Restoring: a store that is an old copy takes back what it lost before it lends authority again.

It waits for the enforcement points, each of which tells once what it knows to be revoked, and for an administrator, who
names those that were not heard. An agent that could have been revoked meanwhile waits until one vouches for it.
"""

from __future__ import annotations

import hashlib
from typing import TYPE_CHECKING, Final

from capabilities.keys.keys import thumbprint
from capabilities.statements import mark
from capabilities.values.errors import FaultCode, StatementError
from ztpm_idp.domain.codes import IdpCode, Refusal
from ztpm_idp.domain.commands import Lost
from ztpm_idp.domain.events import (
    AgentsHeld,
    AgentSuspended,
    AgentVouched,
    LineBegun,
    PointHeard,
    RevocationKind,
    Revoked,
    StoreRestored,
    StoreResumed,
)
from ztpm_idp.domain.parties import (
    PersonRole,
    RegisteredAgent,
    RegisteredPep,
    RegisteredPerson,
    RegisteredSensor,
    Standing,
)
from ztpm_idp.domain.registry import active_person
from ztpm_idp.domain.upkeep.acts import PartSuspended
from ztpm_idp.domain.upkeep.upkeep import audiences_of, kind_of_part

if TYPE_CHECKING:
    from collections.abc import Iterable

    from ztpm_idp.domain.commands import RestoreStore, ResumeStore, TakeMark, VouchAgent
    from ztpm_idp.domain.events import Event
    from ztpm_idp.domain.parties import Party
    from ztpm_idp.domain.registry import Outcome
    from ztpm_idp.domain.rules import Rules
    from ztpm_idp.domain.state import State

LINES_AHEAD: Final = 256
"""Most lines by which a mark may be ahead of the store: nobody restores so often from one copy."""
AGENTS_OF_ENTRY: Final = 1_000
"""Most agents of one ledger entry: with ids of 64 bytes far below the longest line of a ledger."""
REASON: Final = 512
"""Longest reason, as everywhere (`wire.TEXT_BYTES`)."""
_TAKEN_BACK: Final = "taken back: it was suspended before the restore"


def waiting(state: State) -> Refusal:
    """Refusal of a command that restoring does not need; it names what is awaited."""
    return Refusal(IdpCode.RESTORING, f"it waits for {', '.join((*unheard(state), 'an administrator'))}")


def unheard(state: State) -> tuple[str, ...]:
    """Active enforcement points that have not told what they know, by id."""
    return tuple(sorted(point.id for point in state.points if not point.heard))


def restore(state: State, command: RestoreStore) -> Outcome:
    """A new line, above every one that a ledger names; agents that ledgers name after the copy wait."""
    points = tuple(sorted(point.id for point in state.points))
    restored = StoreRestored(max(state.line, command.line) + 1, state.epoch, points, command.sources)
    held = sorted(id_ for id_ in command.doubted if _living(state, id_))
    pages = (tuple(held[at : at + AGENTS_OF_ENTRY]) for at in range(0, len(held), AGENTS_OF_ENTRY))
    lost = [event for id_ in sorted(command.suspended) if (event := _suspended_again(state.parties.get(id_)))]
    return (restored, *map(AgentsHeld, pages), *lost)


def _suspended_again(party: Party | None) -> AgentSuspended | PartSuspended | None:
    """Suspension that the store lost of a party that has not ended."""
    match party:
        case RegisteredAgent(standing=Standing.REGISTERED | Standing.ACTIVE):
            return AgentSuspended(party.id, _TAKEN_BACK)
        case RegisteredPep(standing=Standing.ACTIVE) | RegisteredSensor(standing=Standing.ACTIVE):
            return PartSuspended(kind_of_part(party), party.id, _TAKEN_BACK, audiences_of(party))
        case _:
            return None


def _living(state: State, id_: str) -> bool:
    agent = state.parties.get(id_)
    return isinstance(agent, RegisteredAgent) and agent.standing is not Standing.REVOKED


def taken_back(state: State, found: Iterable[Lost]) -> tuple[Event, ...]:
    """Revocations that the store lacks, each once, with the parties that end by them. Nobody's rights are asked."""
    lost = {(one.kind, one.id): one for one in found if (one.kind.value, one.id) not in state.revoked}
    gone = {id_ for kind, id_ in lost if kind is RevocationKind.KEY}
    return tuple(
        Revoked(one.kind, one.id, f"taken back: {one.reason}"[:REASON], _ended(state, one, gone))
        for one in lost.values()
    )


def _ended(state: State, lost: Lost, gone: set[str]) -> str | None:
    """The party that ends with this revocation: one of several keys ends alone, the last one with its person."""
    owner = state.parties.get(state.owners.get(lost.id, "") if lost.kind is RevocationKind.KEY else lost.id)
    match lost.kind, owner:
        case RevocationKind.KEY, RegisteredPerson(keys=keys):
            return None if any(thumbprint(key) not in gone for key in keys) else owner.id
        case (
            (RevocationKind.AGENT, RegisteredAgent(id=id_))
            | (RevocationKind.SPONSOR, RegisteredPerson(id=id_))
            | (RevocationKind.KEY, RegisteredAgent(id=id_) | RegisteredPep(id=id_) | RegisteredSensor(id=id_))
        ):
            return id_
        case _:
            return None


def take_mark(rules: Rules, state: State, command: TakeMark) -> Outcome:
    """Takes back what an enforcement point knows to be revoked, and the store does not.

    It counts once after each restore: at any other time no enforcement point revokes anything.
    """
    point = state.parties.get(command.by)
    if not isinstance(point, RegisteredPep) or point.standing is not Standing.ACTIVE:
        return Refusal(IdpCode.NOT_PERMITTED, "enforcement points sign marks")
    # 1. Its own key signed it, about this issuer's feed.
    try:
        told = mark.open(command.text, {point.key}, rules.caps)
    except StatementError as error:
        return Refusal(error.code, error.detail)
    if told.issuer != rules.issuer:
        return Refusal(FaultCode.STATEMENT_UNTRUSTED, "the mark of another issuer's feed")
    if not told.line <= state.line + LINES_AHEAD:
        return Refusal(FaultCode.STATEMENT_MALFORMED, f"more than {LINES_AHEAD} lines ahead")
    # 2. It is awaited.
    if point.heard:
        return ()
    # 3. What it knows holds again, in a line that it has never followed.
    found = (Lost(RevocationKind(entry.kind), entry.id, f"known to {point.id}") for entry in told.entries)
    begun = (LineBegun(told.line + 1),) if state.restoring and told.line >= state.line else ()
    digest = hashlib.sha256(command.text.encode("ascii")).hexdigest()
    heard = () if told.remaining else (PointHeard(point.id, told.line, told.epoch, told.at, digest),)
    return (*taken_back(state, found), *begun, *heard)


def resume(state: State, command: ResumeStore) -> Outcome:
    """The end of a restore, for an administrator who names exactly the enforcement points that were not heard."""
    if active_person(state, command.by, PersonRole.ADMIN) is None:
        return Refusal(IdpCode.NOT_PERMITTED, "an administrator resumes")
    if not state.restoring:
        return Refusal(IdpCode.NOT_RESTORING, "nothing is being restored")
    awaited = unheard(state)
    if command.unheard != frozenset(awaited):
        return Refusal(IdpCode.POINTS_UNHEARD, f"not heard: {', '.join(awaited) or 'none'}")
    return (StoreResumed(awaited, command.signed),)


def vouch(state: State, command: VouchAgent) -> Outcome:
    """An agent that was held may receive and lend authority again, for an administrator."""
    if active_person(state, command.by, PersonRole.ADMIN) is None:
        return Refusal(IdpCode.NOT_PERMITTED, "an administrator vouches for an agent")
    match state.parties.get(command.agent):
        case RegisteredAgent(standing=Standing.REVOKED):
            return Refusal(IdpCode.AGENT_INACTIVE, "the agent is revoked, for ever")
        case RegisteredAgent(held=held):
            return (AgentVouched(command.agent, command.reason),) if held else ()
        case _:
            return Refusal(IdpCode.NOT_FOUND, "no such agent")
