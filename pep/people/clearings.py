"""Clearings of a latch, each verified with its approver's registered key or passkey, and counted. Pure.

The identity provider carries clearings and cannot make one. Clause [STM-22].
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING

from capabilities.statements.people import clearing as clearing_statement
from capabilities.statements.people import passkey_clearing, passkey_text
from capabilities.statements.people.assertion import relying_party
from capabilities.statements.people.vote import digest_of
from capabilities.statements.statement_form import signer_thumbprint
from capabilities.values.errors import CapabilityError, FaultCode, StatementError
from pep.people.votes import own_key

if TYPE_CHECKING:
    from collections.abc import Iterable

    from capabilities.statements.people.clearing import Clearing
    from capabilities.statements.people.latch import Latch
    from capabilities.values.caps import Caps
    from pep.base.ports import Approvers


class ClearingFault(StrEnum):
    """Reason why a signed clearing does not count, beside the faults of a statement."""

    CLEARING_NOT_FOR_THIS_LATCH = "CLEARING_NOT_FOR_THIS_LATCH"
    CLEARING_NOT_YOURS = "CLEARING_NOT_YOURS"
    CLEARING_OUT_OF_TIME = "CLEARING_OUT_OF_TIME"


@dataclass(frozen=True, slots=True)
class CountedClearings:
    """Clearings of one latch, counted.

    Attributes:
        approvers: the different people whose clearings count now, sorted.
        texts: of what counts, one of each of them.
        rejected: code of each text that does not count.
    """

    approvers: tuple[str, ...]
    texts: tuple[str, ...]
    rejected: dict[str, ClearingFault | FaultCode]


def count(
    texts: Iterable[str], latch: Latch, latch_text: str, people: Approvers, *, at: float, caps: Caps
) -> CountedClearings:
    """The clearings, each person once.

    Args:
        texts: as people made them.
        latch: the latch in force; its issuer names the relying party of passkeys.
        latch_text: its text, every word of which a clearing binds.
        people: registered approvers, as of now.
        at: now, seconds since the epoch.
        caps: bounds.
    """
    counted: dict[str, str] = {}
    rejected: dict[str, ClearingFault | FaultCode] = {}
    for text in texts:
        found = read_clearing(text, latch, latch_text, people, at=at, caps=caps)
        if isinstance(found, str):
            rejected[text] = found
        else:
            counted.setdefault(found.approver, text)
    return CountedClearings(tuple(sorted(counted)), tuple(counted[name] for name in sorted(counted)), rejected)


def read_clearing(
    text: str, latch: Latch, latch_text: str, people: Approvers, *, at: float, caps: Caps
) -> Clearing | ClearingFault | FaultCode:
    """The clearing, when a registered approver made it, in time, for exactly this latch; else the code of its fault.

    Args: as of `count`.
    """
    try:
        stated, own = _opened(text, latch, people, caps)
    except CapabilityError as error:
        return error.code
    if not own:
        return ClearingFault.CLEARING_NOT_YOURS
    # [STM-22] this latch, and every word of it
    meant = (stated.latch_id, stated.latch_digest, stated.audience, stated.robot, stated.cause)
    if meant != (latch.latch_id, digest_of(latch_text), latch.audience, latch.robot, latch.cause):
        return ClearingFault.CLEARING_NOT_FOR_THIS_LATCH
    if not (latch.at - caps.skew_s <= stated.at <= at + caps.skew_s and at <= stated.not_after):
        return ClearingFault.CLEARING_OUT_OF_TIME
    return stated


def _opened(text: str, latch: Latch, people: Approvers, caps: Caps) -> tuple[Clearing, bool]:
    """The clearing, and whether a key or passkey of its own author made it.

    Raises:
        CapabilityError: as `clearing.open` and `passkey_clearing.open`.
    """
    if passkey_text.is_one(text):
        party = relying_party(latch.issuer)
        if party is None:
            raise StatementError(FaultCode.STATEMENT_UNTRUSTED, "no passkey belongs to an address")
        passkeys = people.passkeys()
        stated, key = passkey_clearing.open(text, list(passkeys), latch=latch, party=party)
        return stated, passkeys[key] == stated.approver
    approvers = people.approvers()
    stated = clearing_statement.open(text, list(approvers), caps)
    return stated, own_key(approvers, stated.approver, signer_thumbprint(text)) is not None
