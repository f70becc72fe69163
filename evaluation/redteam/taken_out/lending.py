"""Attestation and containment, taken out of an identity provider."""

from __future__ import annotations

import secrets
from typing import TYPE_CHECKING, Any

from capabilities.statements import attestation as statement
from capabilities.values.chain import EvidenceKind
from capabilities.values.errors import FaultCode, StatementError
from ztpm_idp.domain import conduct
from ztpm_idp.domain.codes import Refusal
from ztpm_idp.domain.events import NonceConsumed, Revoked
from ztpm_idp.domain.lending import attestation, issuance, mandates
from ztpm_idp.domain.oauth import lending as oauth
from ztpm_idp.domain.parties import RegisteredAgent

if TYPE_CHECKING:
    from collections.abc import Iterable

    from policies.conduct.report import Report
    from ztpm_idp.domain.events import Event
    from ztpm_idp.domain.lending.attestation import AcceptedEvidence
    from ztpm_idp.domain.rules import Rules
    from ztpm_idp.domain.state import State

    Off = frozenset[str]


def boundary_attestation(off: Off) -> None:
    """Any text is evidence for any act, and an agent that was never attested may be lent to."""

    def judge(
        rules: Rules, state: State, agent: RegisteredAgent, evidence: str, *, purpose: str, **act: Any
    ) -> AcceptedEvidence:
        try:
            nonce = statement.open(evidence, {agent.key}, rules.caps).nonce
        except StatementError:
            nonce = secrets.token_urlsafe(16)
        return attestation.AcceptedEvidence(NonceConsumed(nonce, purpose), EvidenceKind.JWT)

    honest = attestation.may_receive

    def may_receive(state: State, id_: str) -> RegisteredAgent | Refusal:
        found, party = honest(state, id_), state.parties.get(id_)
        unattested = isinstance(found, Refusal) and found.code is FaultCode.HOP_NOT_ATTESTED
        return party if unattested and isinstance(party, RegisteredAgent) else found

    for module in (attestation, issuance, mandates):
        module.judge = judge  # type: ignore[attr-defined]
    for each in (attestation, issuance, mandates, oauth):
        each.may_receive = may_receive  # type: ignore[attr-defined]


def scope_contraction(off: Off) -> None:
    """A contracted agent draws tokens as before, and keeps its mandates."""
    honest = conduct.observed

    def observed(rules: Rules, state: State, reports: Iterable[Report], at_ms: int) -> tuple[Event, ...]:
        found = honest(rules, state, reports, at_ms)
        return tuple(each for each in found if not (isinstance(each, Revoked) and each.reason == conduct.CONTRACTED))

    conduct.observed = observed
    for module in (mandates, oauth):
        module.contracted = lambda rules, state, agent, at_ms: None  # type: ignore[attr-defined]
