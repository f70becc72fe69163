"""Rights to revoke.

A holder may revoke its own hops and those below, a sponsor its own trees, an administrator anything, a PEP nothing.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, assert_never

from ztpm_idp.domain.codes import IdpCode, Refusal
from ztpm_idp.domain.events import RevocationKind, Revoked
from ztpm_idp.domain.parties import PersonRole, RegisteredAgent, RegisteredPerson, Standing

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
        case RegisteredAgent(standing=Standing.REGISTERED | Standing.ACTIVE) if _held_by(state, command, caller):
            pass
        case _:
            return Refusal(IdpCode.NOT_PERMITTED, "not the caller's to revoke")
    first = Revoked(command.kind, command.id, command.reason, _party_concerned(state, command))
    # With a person end that person's agents, wherever they stand: in trees of other people only their own names stop
    # them. An id that is in the index already is not there twice, so ending a person again ends only the rest.
    agents = (Revoked(RevocationKind.AGENT, agent, command.reason, agent) for agent in state.agents_of)
    return (*(() if state.revoked_at_epoch is not None else (first,)), *agents)


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
        case RevocationKind.TOKEN | RevocationKind.HOP | RevocationKind.AUDIENCE:
            return None
        case _:
            assert_never(command.kind)
