"""Registry: the rights to register parties, each with one key and one role, to state trust, to suspend and restore."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Final

from capabilities.keys.keys import thumbprint
from capabilities.statements import registry as snapshot
from policies.conduct import behaviour
from policies.conduct.behaviour import RestoreError
from ztpm_idp.domain import conduct
from ztpm_idp.domain.codes import IdpCode, Refusal
from ztpm_idp.domain.events import (
    AgentRestored,
    AgentSuspended,
    PartyRegistered,
    SuspensionEnded,
    ToolRegistered,
    TrustStated,
)
from ztpm_idp.domain.lending import allowances
from ztpm_idp.domain.parties import (
    PersonRole,
    RegisteredAgent,
    RegisteredPep,
    RegisteredPerson,
    RegisteredSensor,
    Standing,
)

if TYPE_CHECKING:
    from ztpm_idp.domain.commands import (
        Initialise,
        RegisterAgent,
        RegisterPep,
        RegisterSensor,
        RegisterTool,
        RestoreAgent,
        StateTrust,
        SuspendAgent,
    )
    from ztpm_idp.domain.events import Event
    from ztpm_idp.domain.parties import Party
    from ztpm_idp.domain.rules import Rules
    from ztpm_idp.domain.state import State

Outcome = tuple["Event", ...] | Refusal

AGENTS_OF_ONE: Final = 256
"""Most living agents of one sponsor.

They end with it in one transaction, while no heartbeat is sent: 256 took 80 ms on two loaded cores
(`tests/ztpm_idp/domain/test_bounds.py` prints it), and a moving arm may go 2 s without.
"""
TRUSTED_OF_ONE: Final = 128
"""Most agents for which one sponsor's trust is stated.

It is an eighth of a snapshot's number, so that no sponsor can fill one alone.
"""
SUSPENDED_OF_ONE: Final = 16
"""Most suspended agents of one sponsor: an eighth of a snapshot's number, as of trust."""


def active_person(state: State, id_: str, role: PersonRole) -> RegisteredPerson | None:
    """The person, when registered, active and holding `role`."""
    match state.parties.get(id_):
        case RegisteredPerson(standing=Standing.ACTIVE, roles=roles) as person if role in roles:
            return person
        case _:
            return None


def initialise(state: State, command: Initialise) -> Outcome:
    """The first people, into an empty store only; one of them must be an administrator."""
    if not state.empty:
        return Refusal(IdpCode.STORE_NOT_EMPTY, "the first people are registered once")
    if not any(PersonRole.ADMIN in person.roles for person in command.people):
        return Refusal(IdpCode.NO_ADMINISTRATOR, "nobody could register anyone")
    if len({person.id for person in command.people}) != len(command.people):
        return Refusal(IdpCode.ALREADY_REGISTERED, "an id occurs twice")
    if sum(PersonRole.APPROVER in person.roles for person in command.people) > snapshot.APPROVERS:
        return full(f"{snapshot.APPROVERS} approvers")
    keys = {person.key for person in command.people}
    if len(keys) != len(command.people):
        return Refusal(IdpCode.KEY_IN_USE, "one key has one owner and one role")
    return tuple(PartyRegistered(person) for person in command.people)


def register_agent(rules: Rules, state: State, command: RegisterAgent) -> Outcome:
    """Registers an agent, for the named sponsor, or for an administrator on behalf of an active one."""
    if command.by != command.sponsor and active_person(state, command.by, PersonRole.ADMIN) is None:
        return Refusal(IdpCode.NOT_PERMITTED, "the sponsor or an administrator registers an agent")
    if active_person(state, command.sponsor, PersonRole.SPONSOR) is None:
        if command.by == command.sponsor:
            return Refusal(IdpCode.NOT_PERMITTED, "the caller is not a sponsor")
        return Refusal(IdpCode.SPONSOR_INACTIVE, "the person named is not an active sponsor")
    if command.workload and rules.platform_of(command.workload) is None:
        return Refusal(IdpCode.WORKLOAD_UNKNOWN, "the workload is of no platform that this provider trusts")
    if not state.crowd < AGENTS_OF_ONE:
        return full(f"{AGENTS_OF_ONE} agents of one sponsor")
    if (spent := allowances.of_agent(rules, state, command.sponsor)) is not None:
        return spent
    agent = RegisteredAgent(
        id=command.id,
        key=command.key,
        thumbprint=thumbprint(command.key),
        standing=Standing.REGISTERED,
        software_digest=command.software_digest,
        model=command.model,
        role=command.role,
        sponsor=command.sponsor,
        trust_permille=None,
        workload=command.workload,
    )
    return new_party(rules, state, agent)


def register_pep(rules: Rules, state: State, command: RegisterPep) -> Outcome:
    """Registers an enforcement point, for an administrator."""
    if active_person(state, command.by, PersonRole.ADMIN) is None:
        return Refusal(IdpCode.NOT_PERMITTED, "an administrator registers enforcement points")
    if not state.crowd < snapshot.PEPS:
        return full(f"{snapshot.PEPS} enforcement points of one audience")
    return new_party(
        rules,
        state,
        RegisteredPep(command.id, command.key, thumbprint(command.key), Standing.ACTIVE, command.audiences),
    )


def register_sensor(rules: Rules, state: State, command: RegisterSensor) -> Outcome:
    """Registers a sensor, for an administrator."""
    if active_person(state, command.by, PersonRole.ADMIN) is None:
        return Refusal(IdpCode.NOT_PERMITTED, "an administrator registers sensors")
    if not state.crowd < snapshot.SENSORS:
        return full(f"{snapshot.SENSORS} sensors of one audience")
    sensor = RegisteredSensor(
        id=command.id,
        key=command.key,
        thumbprint=thumbprint(command.key),
        standing=Standing.ACTIVE,
        calibration=command.calibration,
        transit_ms=command.transit_ms,
        audience=command.audience,
    )
    return new_party(rules, state, sensor)


def register_tool(state: State, command: RegisterTool) -> Outcome:
    """Registers a tool, for an administrator. A reviewed new definition replaces the old one so."""
    if active_person(state, command.by, PersonRole.ADMIN) is None:
        return Refusal(IdpCode.NOT_PERMITTED, "an administrator registers tools")
    if not state.crowd < snapshot.TOOLS:
        return full(f"{snapshot.TOOLS} tools of one audience")
    return (ToolRegistered(command.tool),)


def state_trust(state: State, command: StateTrust) -> Outcome:
    """States trust in an agent, for its sponsor or an administrator."""
    agent = state.parties.get(command.agent)
    admin = active_person(state, command.by, PersonRole.ADMIN) is not None
    match agent:
        case RegisteredAgent() if (
            admin or is_sponsor_of(state, command.by, agent)
        ) and not state.crowd < TRUSTED_OF_ONE:
            return full(f"trust in {TRUSTED_OF_ONE} agents of one sponsor")
        case RegisteredAgent() if (
            admin or is_sponsor_of(state, command.by, agent)
        ) and not state.crowd_of_all < snapshot.AGENTS:
            return full(f"trust in {snapshot.AGENTS} agents")
        case RegisteredAgent() if admin or is_sponsor_of(state, command.by, agent):
            return (TrustStated(agent.id, command.permille),)
        case RegisteredAgent() | None if not admin:
            return Refusal(IdpCode.NOT_PERMITTED, "the sponsor or an administrator states trust")
        case _:
            return Refusal(IdpCode.NOT_FOUND, "no such agent")


def suspend_agent(state: State, command: SuspendAgent) -> Outcome:
    """Suspends an agent, for its sponsor or an administrator; nothing happens again to a suspended one."""
    agent = _agent_in_charge(state, command.by, command.agent, "suspends")
    if isinstance(agent, Refusal):
        return agent
    if agent.standing is Standing.SUSPENDED:
        return ()
    if not state.crowd < SUSPENDED_OF_ONE:
        return full(f"{SUSPENDED_OF_ONE} suspended agents of one sponsor")
    if not state.crowd_of_all < snapshot.SUSPENDED:
        return full(f"{snapshot.SUSPENDED} suspended agents")
    return (AgentSuspended(agent.id, command.reason),)


def restore_agent(rules: Rules, state: State, command: RestoreAgent, at_ms: int) -> Outcome:
    """Restores an agent, for those who may suspend it: ends its suspension, and takes its deviations off it."""
    agent = _agent_in_charge(state, command.by, command.agent, "restores")
    if isinstance(agent, Refusal):
        return agent
    suspended = agent.standing is Standing.SUSPENDED
    ended = (SuspensionEnded(agent.id, command.reason),) if suspended else ()
    before, at = conduct.of(state, agent.id), at_ms // 1_000
    again = behaviour.relearn if command.relearn else behaviour.restore
    try:
        after = replace(before, behaviour=again(before.behaviour, agent.id, by=command.by, at=at), restored_at=at)
    except RestoreError:
        return ended or Refusal(IdpCode.NOTHING_TO_RESTORE, "it is not suspended, and nothing was reported of it")
    told = conduct.published(agent.id, after, at=at, parameters=rules.policies.parameters)
    return (*ended, AgentRestored(agent.id, command.reason, command.relearn, after, told))


def _agent_in_charge(state: State, by: str, id_: str, verb: str) -> RegisteredAgent | Refusal:
    """The agent, when it is not revoked and `by` is its sponsor or an administrator."""
    agent = state.parties.get(id_)
    admin = active_person(state, by, PersonRole.ADMIN) is not None
    if not admin and not (isinstance(agent, RegisteredAgent) and is_sponsor_of(state, by, agent)):
        return Refusal(IdpCode.NOT_PERMITTED, f"the sponsor or an administrator {verb} an agent")
    if not isinstance(agent, RegisteredAgent):
        return Refusal(IdpCode.NOT_FOUND, "no such agent")
    if agent.standing is Standing.REVOKED:
        return Refusal(IdpCode.AGENT_INACTIVE, "the agent is revoked, for ever")
    return agent


def full(of_what: str) -> Refusal:
    """Refusal of an entry that would make the registry snapshot too large for one statement."""
    return Refusal(IdpCode.REGISTRY_FULL, f"at most {of_what}")


def is_sponsor_of(state: State, person: str, agent: RegisteredAgent) -> bool:
    """True where the person answers for the agent, now."""
    return agent.sponsor == person and active_person(state, person, PersonRole.SPONSOR) is not None


def new_party(rules: Rules, state: State, party: Party) -> Outcome:
    """The party, when its id was never used and its key has no owner."""
    if party.id in state.parties:
        return Refusal(IdpCode.ALREADY_REGISTERED, "the id is taken, and ids are never used again")
    if party.key in rules.own_keys or party.key in state.key_owners:
        return Refusal(IdpCode.KEY_IN_USE, "one key has one owner and one role")
    return (PartyRegistered(party),)
