"""Attestation as a rule: a nonce of ours, young, this agent's, signed by it over delegator and request, spent once.

Evidence of kind `key` proves that the agent's key is there and that its holder states the registered software. It does
not prove that this software runs. What is handed in besides makes it of another kind (`domain.lending.evidence`).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from capabilities.statements import attestation
from capabilities.values.errors import FaultCode, StatementError
from ztpm_idp.domain.codes import IdpCode, Refusal
from ztpm_idp.domain.events import AgentAttested, NonceConsumed, NonceGiven
from ztpm_idp.domain.lending.evidence import shown
from ztpm_idp.domain.parties import PersonRole, RegisteredAgent, Standing
from ztpm_idp.domain.registry import active_person

if TYPE_CHECKING:
    from capabilities.values.chain import EvidenceKind
    from ztpm_idp.domain.commands import Attest, GiveNonce
    from ztpm_idp.domain.registry import Outcome
    from ztpm_idp.domain.rules import Rules
    from ztpm_idp.domain.state import State

NO_DELEGATOR: Final = ""
"""Delegator of an attestation that stands alone."""
NO_REQUEST: Final = bytes(32)
"""Request digest of an attestation that stands alone."""


@dataclass(frozen=True, slots=True)
class AcceptedEvidence:
    """Accepted evidence of an agent.

    Attributes:
        spent: its nonce.
        kind: how far it is believed.
    """

    spent: NonceConsumed
    kind: EvidenceKind


def give_nonce(rules: Rules, state: State, command: GiveNonce, at_ms: int) -> Outcome:
    """Gives a nonce to a registered agent that is not revoked, a bounded number at a time."""
    match state.parties.get(command.by):
        case RegisteredAgent(standing=Standing.REGISTERED | Standing.ACTIVE) as agent:
            pass
        case _:
            return Refusal(IdpCode.NOT_PERMITTED, "agents ask for nonces")
    unused = sum(1 for n in state.nonces.values() if not n.consumed and _is_young(rules, n.given_ms, at_ms))
    if unused >= rules.open_nonces:
        return Refusal(IdpCode.TOO_MANY_NONCES, f"{rules.open_nonces} nonces are open")
    return (NonceGiven(command.nonce, agent.id, at_ms),)


def attest(rules: Rules, state: State, command: Attest, at_ms: int) -> Outcome:
    """Attests an agent that asks for itself; makes a registered agent active."""
    agent = state.parties.get(command.agent)
    if command.by != command.agent or not isinstance(agent, RegisteredAgent):
        return Refusal(IdpCode.NOT_PERMITTED, "an agent attests itself")
    if agent.standing is Standing.REVOKED:
        return Refusal(IdpCode.AGENT_INACTIVE, "the agent is revoked")
    found = judge(
        rules, state, agent, command.evidence, delegator=NO_DELEGATOR, request_digest=NO_REQUEST,
        purpose="attestation", at_ms=at_ms
    )  # fmt: skip
    match found:
        case Refusal():
            return found
        case AcceptedEvidence(spent=spent, kind=kind):
            return (spent, AgentAttested(agent.id, agent.software_digest, command.evidence, kind))


def may_receive(state: State, id_: str) -> RegisteredAgent | Refusal:
    """The agent, when it may receive authority: attested once, neither suspended nor revoked, its sponsor active.

    The state must hold the agent and, when it is registered, its sponsor.
    """
    match state.parties.get(id_):
        case RegisteredAgent(standing=Standing.REVOKED):
            return Refusal(IdpCode.AGENT_INACTIVE, "the agent is revoked")
        case RegisteredAgent(standing=Standing.SUSPENDED):
            return Refusal(IdpCode.AGENT_SUSPENDED, "the agent is suspended")
        case RegisteredAgent(standing=Standing.REGISTERED):
            return Refusal(FaultCode.HOP_NOT_ATTESTED, "the agent has never been attested")
        case RegisteredAgent() as agent if active_person(state, agent.sponsor, PersonRole.SPONSOR) is None:
            return Refusal(IdpCode.SPONSOR_INACTIVE, "the agent's sponsor is not active")
        case RegisteredAgent(held=True):
            return held(id_)
        case RegisteredAgent() as agent:
            return agent
        case _:
            return Refusal(IdpCode.NOT_FOUND, "no such agent")


def held(agent: str) -> Refusal:
    """Refusal of an agent for which nobody has vouched since a restore."""
    return Refusal(IdpCode.AGENT_HELD, f"an administrator must vouch for {agent}")


def judge(
    rules: Rules,
    state: State,
    agent: RegisteredAgent,
    evidence: str,
    *,
    delegator: str,
    request_digest: bytes,
    purpose: str,
    at_ms: int,
) -> AcceptedEvidence | Refusal:
    """The nonce that this evidence spends and the evidence's kind, or why it is refused.

    Args:
        rules: of the deployment.
        state: holds the agent's nonces.
        agent: who must have signed.
        evidence: compact JWS.
        delegator: the lender; the evidence must name it.
        request_digest: SHA-256 of the canonical request; the evidence must name it.
        purpose: the hop id or "attestation", for the record of the nonce.
        at_ms: now, wall clock.
    """
    # 1. The agent's registered key signed it, and it is about this agent.
    try:
        stated = attestation.open(evidence, {agent.key}, rules.caps)
    except StatementError as error:
        return _invalid(f"evidence: {error.code}")
    if stated.agent != agent.id or stated.key_thumbprint != agent.thumbprint:
        return _invalid("the evidence is about another agent or key")
    # 2. It is for exactly this act.
    if stated.delegator != delegator or stated.request_digest != request_digest:
        return _invalid("the evidence is for another delegator or request")
    # 3. The stated software is the registered one.
    if stated.measurement != agent.software_digest:
        return _invalid("the measurement is not the registered software")
    # 4. The nonce is ours, was given to this agent, is young, and unspent.
    nonce = state.nonces.get(stated.nonce)
    if nonce is None or nonce.agent != agent.id:
        return _invalid("the nonce is not one of ours, or not this agent's")
    if nonce.consumed:
        return _invalid("the nonce is spent")
    if not _is_young(rules, nonce.given_ms, at_ms):
        return _invalid("the nonce is too old")
    # 5. The statement is not older than its nonce and not from the future.
    skew_ms = rules.caps.skew_s * 1_000
    if not nonce.given_ms - skew_ms <= stated.at * 1_000 + 999 or not stated.at * 1_000 <= at_ms + skew_ms:
        return _invalid("the evidence was not made between the nonce and now")
    # 6. What is handed in besides, by the verifier of its kind, is of this very agent.
    found = shown(rules, agent, stated, at_ms / 1_000)
    if isinstance(found, Refusal):
        return found
    return AcceptedEvidence(NonceConsumed(nonce.nonce, purpose, found.credential, found.until * 1_000), found.kind)


def _is_young(rules: Rules, given_ms: int, at_ms: int) -> bool:
    return 0 <= at_ms - given_ms <= rules.nonce_age_s * 1_000


def _invalid(detail: str) -> Refusal:
    return Refusal(FaultCode.ATTESTATION_INVALID, detail)
