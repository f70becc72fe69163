"""Rights to revoke.

A holder may revoke its own hops and those below, a sponsor its own trees, a person itself and its keys, a PEP nothing;
an administrator anything but approvers and administrators, whom two people end (`people`).
"""

from __future__ import annotations

from typing import TYPE_CHECKING, assert_never

from capabilities.keys.keys import thumbprint
from ztpm_idp.domain.codes import IdpCode, Refusal
from ztpm_idp.domain.events import RevocationKind, Revoked
from ztpm_idp.domain.parties import PersonRole, RegisteredAgent, RegisteredPerson, Standing
from ztpm_idp.domain.people import end_refused, ended

if TYPE_CHECKING:
    from ztpm_idp.domain.commands import Revoke
    from ztpm_idp.domain.registry import Outcome
    from ztpm_idp.domain.state import State


def revoke(state: State, command: Revoke) -> Outcome:
    """The revocation, with a person's also those of its agents; nothing happens again when it was made before."""
    caller = state.parties.get(command.by)
    match caller:
        case RegisteredPerson(standing=Standing.ACTIVE, roles=roles) if PersonRole.ADMIN in roles:
            missing = _missing_party(state, command)
            if missing is not None:
                return missing
        case RegisteredPerson(standing=Standing.ACTIVE, roles=roles) if PersonRole.SPONSOR in roles and _in_trees_of(
            state, command, caller.id
        ):
            pass
        case RegisteredPerson(standing=Standing.ACTIVE) if _of_oneself(state, command, caller.id):
            pass
        case RegisteredAgent(standing=Standing.REGISTERED | Standing.ACTIVE | Standing.SUSPENDED) if _held_by(
            state, command, caller
        ):
            pass
        case _:
            return Refusal(IdpCode.NOT_PERMITTED, "not the caller's to revoke")
    concerned = _party_concerned(state, command)
    person = None if concerned is None else state.parties.get(concerned)
    if isinstance(person, RegisteredPerson):
        # One of several keys ends alone; the last one ends the person.
        alone = command.kind is RevocationKind.KEY and any(
            thumbprint(key) != command.id for key in person.keys | person.passkey_keys
        )
        if (refused := end_refused(state, command.by, person, wholly=not alone)) is not None:
            return refused
        concerned = None if alone else concerned
    # With a key ends whatever it promised.
    promised = (
        Revoked(RevocationKind.MANDATE, mandate.mandate_id, command.reason, None)
        for mandate in state.mandates
        if command.kind is RevocationKind.KEY and mandate.key == command.id
    )
    return (*ended(state, Revoked(command.kind, command.id, command.reason, concerned)), *promised)


def _of_oneself(state: State, command: Revoke, person: str) -> bool:
    match command.kind:
        case RevocationKind.SPONSOR:
            return command.id == person
        case RevocationKind.KEY:
            return state.owner_of_thumbprint == person
        case _:
            return False


def _missing_party(state: State, command: Revoke) -> Refusal | None:
    """An agent's or a person's id must be registered; any other is a slip that would protect nobody."""
    match command.kind:
        case RevocationKind.AGENT if not isinstance(state.parties.get(command.id), RegisteredAgent):
            return Refusal(IdpCode.NOT_FOUND, "no such agent")
        case RevocationKind.SPONSOR if not isinstance(state.parties.get(command.id), RegisteredPerson):
            return Refusal(IdpCode.NOT_FOUND, "no such person")
        case _:
            return None


def _in_trees_of(state: State, command: Revoke, person: str) -> bool:
    match command.kind:
        case RevocationKind.TOKEN | RevocationKind.HOP:
            return bool(state.hops) and all(hop.sponsor == person for hop in state.hops.values())
        case RevocationKind.AGENT:
            agent = state.parties.get(command.id)
            return isinstance(agent, RegisteredAgent) and agent.sponsor == person
        case RevocationKind.KEY:
            owner = None if state.owner_of_thumbprint is None else state.parties.get(state.owner_of_thumbprint)
            return owner is not None and (
                owner.id == person or (isinstance(owner, RegisteredAgent) and owner.sponsor == person)
            )
        case RevocationKind.SPONSOR:
            return command.id == person
        case RevocationKind.MANDATE:
            return state.mandate is not None and state.mandate.sponsor == person
        case RevocationKind.AUDIENCE:
            return False
        case _:
            assert_never(command.kind)


def _held_by(state: State, command: Revoke, agent: RegisteredAgent) -> bool:
    match command.kind:
        case RevocationKind.TOKEN:
            # Its first holder has the whole token, and so everything below.
            return any(hop.parent is None and hop.agent == agent.id for hop in state.hops.values())
        case RevocationKind.HOP:
            # The state holds the hop and all hops above it: the caller must hold one of them.
            return any(hop.agent == agent.id for hop in state.hops.values())
        case RevocationKind.AGENT:
            return command.id == agent.id
        case RevocationKind.KEY:
            return command.id == agent.thumbprint
        case RevocationKind.MANDATE:
            return state.mandate is not None and state.mandate.agent == agent.id
        case RevocationKind.SPONSOR | RevocationKind.AUDIENCE:
            return False
        case _:
            assert_never(command.kind)


def _party_concerned(state: State, command: Revoke) -> str | None:
    match command.kind:
        case RevocationKind.AGENT | RevocationKind.SPONSOR:
            return command.id
        case RevocationKind.KEY:
            return state.owner_of_thumbprint
        case RevocationKind.TOKEN | RevocationKind.HOP | RevocationKind.AUDIENCE | RevocationKind.MANDATE:
            return None
        case _:
            assert_never(command.kind)
