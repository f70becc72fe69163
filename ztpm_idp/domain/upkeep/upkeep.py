"""Rights to keep up what is registered.

An administrator suspends, restores and retires enforcement points, sensors and tools, and replaces any key; a sponsor
replaces those of its agents. A party's former key is in the revocation index, and nobody has it again.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, assert_never

from capabilities.keys.keys import thumbprint
from ztpm_idp.domain.codes import IdpCode, Refusal
from ztpm_idp.domain.events import RevocationKind, Revoked
from ztpm_idp.domain.oauth.registering import ROLE as CLIENT_ROLE
from ztpm_idp.domain.parties import (
    PersonRole,
    RegisteredAgent,
    RegisteredPep,
    RegisteredSensor,
    Standing,
    kind_of,
)
from ztpm_idp.domain.registry import active_person, is_sponsor_of
from ztpm_idp.domain.upkeep.acts import (
    ChangeTool,
    KeyReplaced,
    PartKind,
    PartRestored,
    PartSuspended,
    ReplaceKey,
    RestorePart,
    RetirePart,
    SuspendPart,
    ToolAct,
    ToolChanged,
)

if TYPE_CHECKING:
    from ztpm_idp.domain.registry import Outcome
    from ztpm_idp.domain.rules import Rules
    from ztpm_idp.domain.state import State
    from ztpm_idp.domain.upkeep.acts import UpkeepCommand

Part = RegisteredPep | RegisteredSensor


def decide(rules: Rules, state: State, command: UpkeepCommand) -> Outcome:
    """The events of a command of upkeep, or why it is refused."""
    match command:
        case SuspendPart():
            part = _part_in_charge(state, command, "suspends")
            if isinstance(part, Refusal) or part.standing is Standing.SUSPENDED:
                return part if isinstance(part, Refusal) else ()
            return (PartSuspended(command.kind, part.id, command.reason, audiences_of(part)),)
        case RestorePart():
            part = _part_in_charge(state, command, "restores")
            if isinstance(part, Refusal):
                return part
            if part.standing is not Standing.SUSPENDED:
                return Refusal(IdpCode.NOTHING_TO_RESTORE, "it is not suspended")
            return (PartRestored(command.kind, part.id, command.reason, audiences_of(part)),)
        case RetirePart():
            part = _part_in_charge(state, command, "retires", ended=True)
            if isinstance(part, Refusal) or part.standing is Standing.REVOKED:
                return part if isinstance(part, Refusal) else ()
            return (Revoked(RevocationKind.KEY, thumbprint(part.key), command.reason, part.id),)
        case ReplaceKey():
            return replace_key(rules, state, command)
        case ChangeTool():
            return change_tool(state, command)
        case _:
            assert_never(command)


def replace_key(rules: Rules, state: State, command: ReplaceKey) -> Outcome:
    """The party has the new key; the one before is revoked, with the mandates that were for it.

    An agent must be attested anew.
    """
    party = state.parties.get(command.id)
    admin = active_person(state, command.by, PersonRole.ADMIN) is not None
    if not admin and not (isinstance(party, RegisteredAgent) and is_sponsor_of(state, command.by, party)):
        return Refusal(IdpCode.NOT_PERMITTED, "an administrator, or an agent's sponsor, replaces a key")
    if not isinstance(party, RegisteredAgent | RegisteredPep | RegisteredSensor) or kind_of(party) != command.kind:
        return Refusal(IdpCode.NOT_FOUND, f"no such {command.kind}")
    if party.standing is Standing.REVOKED:
        return Refusal(IdpCode.PARTY_ENDED, "it has ended, for ever: register another")
    if isinstance(party, RegisteredAgent) and party.role == CLIENT_ROLE:
        return Refusal(IdpCode.NOT_PERMITTED, "an OAuth client's agent has no key that anybody may hold")
    if command.key == party.key:
        return ()  # it was replaced before, and the answer was lost
    if command.key in rules.own_keys or command.key in state.key_owners:
        return Refusal(IdpCode.KEY_IN_USE, "one key has one owner and one role, also after it was replaced")
    promised = (
        Revoked(RevocationKind.MANDATE, mandate.mandate_id, command.reason, None)
        for mandate in state.mandates
        if mandate.agent == party.id
    )
    return (
        KeyReplaced(command.kind, party.id, command.key, party.key, command.reason, audiences_of(party)),
        Revoked(RevocationKind.KEY, thumbprint(party.key), command.reason, None),
        *promised,
    )


def change_tool(state: State, command: ChangeTool) -> Outcome:
    """The tool is suspended, restored or retired, for an administrator; nothing happens again."""
    if active_person(state, command.by, PersonRole.ADMIN) is None:
        return Refusal(IdpCode.NOT_PERMITTED, "an administrator keeps up tools")
    if state.tool is None:
        return Refusal(IdpCode.NOT_FOUND, "no such tool of this audience")
    suspended = state.tool is Standing.SUSPENDED
    if command.act is ToolAct.RESTORE and not suspended:
        return Refusal(IdpCode.NOTHING_TO_RESTORE, "it is not suspended")
    if command.act is ToolAct.SUSPEND and suspended:
        return ()
    return (ToolChanged(command.audience, command.name, command.act, command.reason),)


def audiences_of(party: RegisteredAgent | Part) -> frozenset[str]:
    """Audiences whose registry has the party's key."""
    match party:
        case RegisteredPep(audiences=audiences):
            return audiences
        case RegisteredSensor(audience=audience):
            return frozenset({audience})
        case RegisteredAgent():
            return frozenset()


def kind_of_part(part: Part) -> PartKind:
    """The kind of a part."""
    return PartKind.PEP if isinstance(part, RegisteredPep) else PartKind.SENSOR


def _part_in_charge(
    state: State, command: SuspendPart | RestorePart | RetirePart, verb: str, *, ended: bool = False
) -> Part | Refusal:
    """The part, when the caller is an administrator and it has not ended, or may have."""
    if active_person(state, command.by, PersonRole.ADMIN) is None:
        return Refusal(IdpCode.NOT_PERMITTED, f"an administrator {verb} enforcement points and sensors")
    part = state.parties.get(command.id)
    if not isinstance(part, Part) or kind_of_part(part) is not command.kind:
        return Refusal(IdpCode.NOT_FOUND, f"no such {command.kind.value}")
    if part.standing is Standing.REVOKED and not ended:
        return Refusal(IdpCode.PARTY_ENDED, "it has ended, for ever: register another")
    return part
