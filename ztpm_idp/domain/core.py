"""Core of the provider: one pure function from a command and its state to events or a refusal."""

from __future__ import annotations

from typing import TYPE_CHECKING, assert_never

from ztpm_idp.domain import ledger, people, pictures, refusals, registry, restoring, revocation
from ztpm_idp.domain.asking import approvals, envelopes, latches
from ztpm_idp.domain.codes import IdpCode, Refusal
from ztpm_idp.domain.commands import (
    AnswerChange,
    Attest,
    CastVote,
    ClearLatch,
    CloseOpening,
    CompleteRecovery,
    Delegate,
    DrawToken,
    GiveNonce,
    Initialise,
    Issue,
    OpenTier4,
    ProposeChange,
    Recover,
    RegisterAgent,
    RegisterPep,
    RegisterPerson,
    RegisterSensor,
    RegisterTool,
    RestoreAgent,
    RestoreStore,
    ResumeStore,
    Revoke,
    RevokeEnvelope,
    SignEnvelope,
    SignMandate,
    StateTrust,
    SuspendAgent,
    TakeAsk,
    TakeBack,
    TakeLatch,
    TakeMark,
    TakePicture,
    TakeRecords,
    VouchAgent,
)
from ztpm_idp.domain.lending import attestation, issuance, mandates
from ztpm_idp.domain.login import devices, sessions
from ztpm_idp.domain.login.commands import (
    AnswerDevice,
    AskDevice,
    EndLogin,
    EndSessionKey,
    EnterCode,
    LogIn,
    LogOut,
    OfferLogin,
    PollDevice,
)
from ztpm_idp.domain.oauth import deciding as oauth
from ztpm_idp.domain.oauth.commands import EndAccess, EndFamily, OAuthCommand
from ztpm_idp.domain.oauth.lending import exchanged
from ztpm_idp.domain.parties import RegisteredPep, RegisteredSensor, Standing
from ztpm_idp.domain.upkeep import upkeep
from ztpm_idp.domain.upkeep.acts import RetirePart, SuspendPart, UpkeepCommand

if TYPE_CHECKING:
    from ztpm_idp.domain.commands import Command
    from ztpm_idp.domain.registry import Outcome
    from ztpm_idp.domain.rules import Rules
    from ztpm_idp.domain.state import State

BESIDE = Initialise | Recover | CompleteRecovery | RestoreStore | TakeBack | AskDevice | PollDevice
"""Commands without a registered caller."""
WHILE_RESTORING = (
    RestoreStore
    | TakeBack
    | TakeMark
    | ResumeStore
    | Revoke
    | SuspendAgent
    | EndAccess
    | EndFamily
    | SuspendPart
    | RetirePart
    | Recover
    | CompleteRecovery
)
"""Commands that a store takes while it is being restored: what restoring needs, and what only takes authority back."""


def decide(rules: Rules, state: State, command: Command, at_ms: int) -> Outcome:
    """The events that follow from `command`, or why nothing does. Total and deterministic.

    Args:
        rules: those that the deployment fixes.
        state: at least the part that `wanted(command)` names.
        command: parsed strictly.
        at_ms: now, wall clock.
    """
    if not isinstance(command, BESIDE):
        refused = caller_refused(state, command.by)
        if refused is not None:
            return refused
        if state.parties[command.by].standing is Standing.SUSPENDED and not isinstance(command, Revoke | EndAccess):
            return Refusal(IdpCode.AGENT_SUSPENDED, "it may only revoke what it holds")
    if state.restoring and not isinstance(command, WHILE_RESTORING):
        return restoring.waiting(state)
    outcome = _decided(rules, state, command, at_ms)
    if isinstance(command, BESIDE) or not isinstance(outcome, Refusal):
        return outcome
    return refusals.bounded(state, command.by, outcome, at_ms)


def _decided(rules: Rules, state: State, command: Command, at_ms: int) -> Outcome:
    if isinstance(command, OAuthCommand):
        return oauth.decide(rules, state, command, at_ms)
    if isinstance(command, UpkeepCommand):
        return upkeep.decide(rules, state, command)
    match command:
        case Initialise():
            return registry.initialise(state, command)
        case RegisterPerson():
            return people.register_person(rules, state, command)
        case ProposeChange():
            return people.propose(rules, state, command, at_ms)
        case AnswerChange():
            return people.answer(rules, state, command, at_ms)
        case Recover():
            return people.recover(rules, state, command, at_ms)
        case CompleteRecovery():
            return people.complete(rules, state, command, at_ms)
        case RegisterAgent():
            return registry.register_agent(rules, state, command)
        case RegisterPep():
            return registry.register_pep(rules, state, command)
        case RegisterSensor():
            return registry.register_sensor(rules, state, command)
        case RegisterTool():
            return registry.register_tool(state, command)
        case StateTrust():
            return registry.state_trust(state, command)
        case SuspendAgent():
            return registry.suspend_agent(state, command)
        case RestoreAgent():
            return registry.restore_agent(rules, state, command, at_ms)
        case GiveNonce():
            return attestation.give_nonce(rules, state, command, at_ms)
        case Attest():
            return attestation.attest(rules, state, command, at_ms)
        case Issue():
            return issuance.issue(rules, state, command, at_ms)
        case Delegate(resource=None):
            return issuance.delegate(rules, state, command, at_ms)
        case Delegate():
            return exchanged(rules, state, command, at_ms)
        case Revoke():
            return revocation.revoke(state, command)
        case TakeRecords():
            return ledger.take_records(rules, state, command, at_ms)
        case TakePicture():
            return pictures.take_picture(state, command)
        case TakeAsk():
            return approvals.take_ask(rules, state, command, at_ms)
        case CastVote():
            return approvals.cast_vote(rules, state, command, at_ms)
        case OpenTier4():
            return approvals.open_tier_4(rules, state, command, at_ms)
        case CloseOpening():
            return approvals.close_opening(state, command)
        case RestoreStore():
            return restoring.restore(state, command)
        case TakeBack(found=found):
            return restoring.taken_back(state, found)
        case TakeMark():
            return restoring.take_mark(rules, state, command)
        case ResumeStore():
            return restoring.resume(state, command)
        case VouchAgent():
            return restoring.vouch(state, command)
        case SignMandate():
            return mandates.sign(rules, state, command, at_ms)
        case DrawToken():
            return mandates.draw(rules, state, command, at_ms)
        case OfferLogin() | LogIn() | LogOut() | EndLogin():
            return sessions.login(state, command, at_ms)
        case AskDevice() | PollDevice() | EnterCode() | AnswerDevice() | EndSessionKey():
            return devices.device(rules, state, command, at_ms)
        case SignEnvelope():
            return envelopes.sign(rules, state, command, at_ms)
        case RevokeEnvelope():
            return envelopes.revoke(state, command)
        case TakeLatch():
            return latches.take(rules, state, command, at_ms)
        case ClearLatch():
            return latches.clear(rules, state, command, at_ms)
        case _:
            assert_never(command)


def caller_refused(state: State, caller: str) -> Refusal | None:
    """Refusal of a caller that may do nothing at all.

    It is unknown, a sensor, revoked since it was authenticated, or an enforcement point that is suspended.
    """
    party = state.parties.get(caller)
    if party is None or isinstance(party, RegisteredSensor):
        return Refusal(IdpCode.CALLER_UNKNOWN, "not registered")
    if party.standing is Standing.REVOKED:
        return Refusal(IdpCode.CALLER_INACTIVE, "revoked")
    if isinstance(party, RegisteredPep) and party.standing is Standing.SUSPENDED:
        return Refusal(IdpCode.CALLER_SUSPENDED, "suspended")
    return None
