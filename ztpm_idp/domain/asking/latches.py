"""Latches at the provider: an enforcement point tells of one, approvers clear it; the provider clears none itself.

Whether a clearing counts, the enforcement point decides: what is checked here keeps slips away from people. Clause
[STM-22].
"""

from __future__ import annotations

from typing import TYPE_CHECKING

from capabilities.statements.people import clearing as clearings
from capabilities.statements.people import latch as latches
from capabilities.statements.people import passkey_clearing, passkey_text
from capabilities.statements.people.assertion import relying_party
from capabilities.statements.people.vote import digest_of
from capabilities.values.errors import FaultCode, StatementError
from ztpm_idp.domain.asking.latch_acts import ClearingRecord, ClearingSigned, LatchRecord, LatchTaken
from ztpm_idp.domain.asking.refusing import Refusing, whose
from ztpm_idp.domain.codes import IdpCode
from ztpm_idp.domain.parties import PersonRole, RegisteredPep, Standing
from ztpm_idp.domain.registry import active_person

if TYPE_CHECKING:
    from capabilities.statements.people.clearing import Clearing
    from ztpm_idp.domain.commands import ClearLatch, TakeLatch
    from ztpm_idp.domain.parties import RegisteredPerson
    from ztpm_idp.domain.registry import Outcome
    from ztpm_idp.domain.rules import Rules
    from ztpm_idp.domain.state import State


def take(rules: Rules, state: State, command: TakeLatch, at_ms: int) -> Outcome:
    """An enforcement point's latch waits for people; nothing happens again while the very same does.

    One that people have cleared and that is told of again still is in force there: it waits again.
    """
    known = state.latch
    refused = Refusing("latch", "" if known is None else known.latch_id, command.by, command.text, None)
    # 1. The caller is an enforcement point, now, and signed this latch itself.
    pep = state.parties.get(command.by)
    if not isinstance(pep, RegisteredPep) or pep.standing is not Standing.ACTIVE:
        return refused(IdpCode.NOT_PERMITTED, "enforcement points tell of latches")
    try:
        latch = latches.open(command.text, {pep.key}, rules.caps)
    except StatementError as error:
        return refused(error.code, error.detail)
    refused = Refusing("latch", latch.latch_id, command.by, command.text, None)
    # 2. It speaks of itself, to this provider.
    if latch.pep != pep.id or latch.audience not in pep.audiences or latch.issuer != rules.issuer:
        return refused(IdpCode.NOT_PERMITTED, "the latch is another enforcement point's, or another provider's")
    # 3. An id means one latch, for ever; its text may be another one after the point has a new key.
    digest = digest_of(command.text)
    if known is not None and (known.pep, known.cause, known.at) != (pep.id, str(latch.cause), latch.at):
        return refused(IdpCode.LATCH_DIFFERS, "another latch has this id")
    if known is not None and known.digest == digest and not (known.released and not _counting(state, known, at_ms)):
        return ()
    record = LatchRecord(
        latch_id=latch.latch_id,
        digest=digest,
        pep=pep.id,
        audience=latch.audience,
        robot=latch.robot,
        cause=str(latch.cause),
        approvers=latch.approvers,
        at=latch.at,
        text=command.text,
    )
    return (LatchTaken(record),)


def clear(rules: Rules, state: State, command: ClearLatch, at_ms: int) -> Outcome:
    """An approver's own clearing of exactly this latch; nothing happens again for the very same text."""
    refused = Refusing("clearing", command.latch_id, command.by, command.text, command.signed)
    # 1. The caller is an approver, now: never an agent, a sensor, an enforcement point.
    person = active_person(state, command.by, PersonRole.APPROVER)
    if person is None:
        return refused(IdpCode.NOT_PERMITTED, "approvers clear latches")
    # 2. The latch exists.
    latch = state.latch
    if latch is None:
        return refused(IdpCode.LATCH_UNKNOWN, "no such latch")
    # 3. The clearing is signed by a key of the caller's own, or made by its passkey, and names the caller.
    try:
        stated = _opened(rules, state, latch, command, person)
    except StatementError as error:
        code = whose(rules, state, command.text, error, kind=clearings.KIND, not_yours=IdpCode.CLEARING_NOT_YOURS)
        return refused(code, error.detail)
    if stated.approver != person.id:
        return refused(IdpCode.CLEARING_NOT_YOURS, "the clearing names another person")
    # 4. It is for this latch, and for every word of it.
    meant = (stated.latch_id, stated.latch_digest, stated.audience, stated.robot, str(stated.cause))
    if meant != (latch.latch_id, latch.digest, latch.audience, latch.robot, latch.cause):
        return refused(IdpCode.CLEARING_NOT_FOR_THIS_LATCH, "the clearing is for another latch, or another text of it")
    # 5. Its times are sane.
    skew_ms = rules.caps.skew_s * 1_000
    signed_in_time = latch.at * 1_000 - skew_ms <= stated.at * 1_000 <= at_ms + skew_ms
    if not (signed_in_time and at_ms <= stated.not_after * 1_000):
        return refused(IdpCode.CLEARING_OUT_OF_TIME, f"signed by now, for at most {clearings.LIFETIME_S} s")
    # 6. This person has none that counts already.
    counting = _counting(state, latch, at_ms)
    if (mine := counting.get(person.id)) is not None:
        return () if mine.text == command.text else refused(IdpCode.CLEARED_BEFORE, "one clearing of each person")
    made = ClearingRecord(person.id, stated.not_after, stated.latch_digest, command.text)
    enough = len(counting) + 1 >= latch.approvers
    return (ClearingSigned(latch.latch_id, latch.audience, len(state.clearings) + 1, made, enough),)


def _counting(state: State, latch: LatchRecord, at_ms: int) -> dict[str, ClearingRecord]:
    """By approver, the clearings that count now."""
    return {each.approver: each for each in state.clearings if each.counts(latch, at_ms)}


def _opened(rules: Rules, state: State, latch: LatchRecord, command: ClearLatch, person: RegisteredPerson) -> Clearing:
    """The clearing, by a key or a passkey of the person's own.

    Raises:
        StatementError: as `clearing.open` and `passkey_clearing.open`.
    """
    if not passkey_text.is_one(command.text):
        return clearings.open(command.text, person.keys, rules.caps)
    party, pep = relying_party(rules.issuer), state.parties.get(latch.pep)
    if party is None or not isinstance(pep, RegisteredPep):
        raise StatementError(FaultCode.STATEMENT_UNTRUSTED, "no passkey counts here")
    shown = latches.open(latch.text, {pep.key}, rules.caps)
    return passkey_clearing.open(command.text, person.passkey_keys, latch=shown, party=party)[0]
