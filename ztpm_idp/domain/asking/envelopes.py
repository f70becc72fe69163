"""Envelopes at the provider: an approver's approval beforehand is taken, carried, revoked; none is made here."""

from __future__ import annotations

from typing import TYPE_CHECKING, Final

from capabilities.keys.keys import thumbprint
from capabilities.statements.people import answers
from capabilities.statements.people import envelope as envelopes
from capabilities.statements.people.vote import digest_of
from capabilities.values.errors import StatementError
from ztpm_idp.domain.asking.envelope_acts import EnvelopeRecord, EnvelopeRevoked, EnvelopeSigned
from ztpm_idp.domain.asking.refusing import Refusing, whose
from ztpm_idp.domain.codes import IdpCode
from ztpm_idp.domain.parties import PersonRole, RegisteredAgent, Standing
from ztpm_idp.domain.registry import active_person

if TYPE_CHECKING:
    from ztpm_idp.domain.commands import RevokeEnvelope, SignEnvelope
    from ztpm_idp.domain.registry import Outcome
    from ztpm_idp.domain.rules import Rules
    from ztpm_idp.domain.state import State

ENVELOPES: Final = answers.ENVELOPES
"""Most envelopes of one audience in force at a time."""


def sign(rules: Rules, state: State, command: SignEnvelope, at_ms: int) -> Outcome:
    """An approver's envelope; nothing happens again for the very same text."""
    known = state.envelope
    refused = Refusing("envelope", "" if known is None else known.envelope_id, command.by, command.text, command.signed)
    # 1. The caller is an approver, now, and signed this envelope itself.
    person = active_person(state, command.by, PersonRole.APPROVER)
    if person is None:
        return refused(IdpCode.NOT_PERMITTED, "approvers approve beforehand")
    try:
        envelope = envelopes.open(command.text, person.keys, rules.caps)
    except StatementError as error:
        code = whose(rules, state, command.text, error, kind=envelopes.KIND, not_yours=IdpCode.ENVELOPE_NOT_YOURS)
        return refused(code, error.detail)
    refused = Refusing("envelope", envelope.envelope_id, command.by, command.text, command.signed)
    if envelope.approver != person.id:
        return refused(IdpCode.ENVELOPE_NOT_YOURS, "the envelope names another person")
    # 2. An id means one text, for ever, and one thing.
    digest = digest_of(command.text)
    if known is not None:
        return () if known.digest == digest else refused(IdpCode.ENVELOPE_DIFFERS, "another envelope has this id")
    if state.asked is not None:
        return refused(IdpCode.ENVELOPE_DIFFERS, "an ask has this id")
    # 3. It is for now: no envelope is put by.
    ahead_ms = at_ms + rules.caps.skew_s * 1_000
    if not (envelope.not_before * 1_000 <= ahead_ms and at_ms < envelope.not_after * 1_000):
        return refused(IdpCode.ENVELOPE_OUT_OF_TIME, f"begun by now, for at most {envelopes.LIFETIME_S} s")
    # 4. It can match something: a slip would approve nothing and seem to.
    match state.parties.get(envelope.agent):
        case RegisteredAgent(standing=Standing.REVOKED):
            return refused(IdpCode.AGENT_INACTIVE, "the agent is revoked")
        case RegisteredAgent(key=key, sponsor=sponsor) if thumbprint(key) == envelope.agent_key:
            if sponsor != envelope.sponsor and envelope.sponsor not in state.parties:
                return refused(IdpCode.NOT_FOUND, "no such sponsor")
        case _:
            return refused(IdpCode.NOT_FOUND, "no such agent with this key")
    if envelope.audience not in state.served:
        return refused(IdpCode.NOT_FOUND, "no enforcement point serves this audience")
    # 5. All of them fit one answer to the enforcement point.
    if not sum(1 for other in state.envelopes if not other.over(at_ms)) < ENVELOPES:
        return refused(IdpCode.TOO_MANY_ENVELOPES, f"{ENVELOPES} envelopes of this audience are in force")
    record = EnvelopeRecord(
        envelope_id=envelope.envelope_id,
        digest=digest,
        approver=envelope.approver,
        audience=envelope.audience,
        agent=envelope.agent,
        not_before=envelope.not_before,
        not_after=envelope.not_after,
        revoked=False,
        text=command.text,
    )
    return (EnvelopeSigned(record),)


def revoke(state: State, command: RevokeEnvelope) -> Outcome:
    """Revokes an envelope for any approver, not only its own: revoking only takes away. A second time has no effect."""
    refused = Refusing("envelope-revoking", command.envelope_id, command.by, "", None)
    if active_person(state, command.by, PersonRole.APPROVER) is None:
        return refused(IdpCode.NOT_PERMITTED, "approvers revoke envelopes")
    if state.envelope is None:
        return refused(IdpCode.ENVELOPE_UNKNOWN, "no such envelope")
    if state.envelope.revoked:
        return ()
    return (EnvelopeRevoked(state.envelope.envelope_id, command.reason),)
