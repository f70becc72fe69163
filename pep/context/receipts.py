"""Receipts: one admission point's word for a value, believed by another for exactly that value ([STM-10])."""

from __future__ import annotations

from enum import StrEnum
from typing import TYPE_CHECKING, Final

from capabilities.keys import keys as key_forms
from capabilities.statements import statement_form
from capabilities.statements.context import admission as statement
from capabilities.statements.context.admission import Receipt
from capabilities.values.errors import CapabilityError
from pep.context.label_words import label_in, words_of
from policies.words.labels import aged

if TYPE_CHECKING:
    from collections.abc import Mapping

    from capabilities.keys.keys import PrivateKey
    from capabilities.values.caps import Caps
    from pep.context.flow import Holder
    from pep.context.json_value import Plain
    from policies.words.labels import Label

LIFETIME_S: Final = 600
"""Time for which a receipt counts: the value is used within one task. Ours; a statement allows an hour."""


class ReceiptFault(StrEnum):
    """Reason why a receipt is not believed for an argument."""

    TOO_MANY = "TOO_MANY"
    STATEMENT_MALFORMED = "STATEMENT_MALFORMED"
    STATEMENT_WRONG_KIND = "STATEMENT_WRONG_KIND"
    STATEMENT_UNTRUSTED = "STATEMENT_UNTRUSTED"
    """Signed by no registered admission point, or by another than it names."""
    OTHER_HOLDER = "OTHER_HOLDER"
    NOT_YET_VALID = "NOT_YET_VALID"
    EXPIRED = "EXPIRED"
    VALUE_TOO_LARGE = "VALUE_TOO_LARGE"
    VALUE_MALFORMED = "VALUE_MALFORMED"
    VALUE_CHANGED = "VALUE_CHANGED"
    """The value that was presented is not the one that was admitted."""
    NOT_AT_THAT_PLACE = "NOT_AT_THAT_PLACE"
    """The argument differs from the value there, or is not in its unit."""
    UNKNOWN_ARGUMENT = "UNKNOWN_ARGUMENT"
    """The call has no argument of that name."""


def issue(
    value: Plain,
    label: Label,
    holder: Holder,
    *,
    audience: str,
    key: PrivateKey,
    at: float,
) -> str:
    """Receipt for a value that was admitted for a holder.

    Args:
        value: that was admitted.
        label: of it.
        holder: for whom.
        audience: canonical URL of the admission point whose `key` signs.
        key: of the PEP.
        at: now, seconds since the epoch.
    """
    return statement.sign(
        Receipt(
            audience=audience,
            agent=holder.agent,
            hop_id=holder.hop_id,
            value=value.digest,
            **words_of(label),
            at=int(at),
            not_after=int(at) + LIFETIME_S,
        ),
        key,
    )


def verify(text: str, *, admitters: Mapping[str, bytes], caps: Caps) -> Receipt | ReceiptFault:
    """The receipt, signed with the registered key of the very admission point that it names; never raises.

    Args:
        text: compact JWS.
        admitters: raw public key by canonical URL of every registered admission point.
        caps: the bounds.
    """
    try:
        receipt = statement.open(text, frozenset(admitters.values()), caps)
    except CapabilityError as error:
        return ReceiptFault(str(error.code))
    named = admitters.get(receipt.audience)
    if named is None or key_forms.thumbprint(named) != statement_form.signer_thumbprint(text):
        return ReceiptFault.STATEMENT_UNTRUSTED
    return receipt


def refusal(receipt: Receipt, *, holder: Holder, at: float, caps: Caps) -> ReceiptFault | None:
    """Reason why the receipt does not count for this holder now; None when it counts."""
    if (receipt.hop_id, receipt.agent) != (holder.hop_id, holder.agent):
        return ReceiptFault.OTHER_HOLDER
    if not receipt.at <= at + caps.skew_s:
        return ReceiptFault.NOT_YET_VALID
    return None if at < receipt.not_after else ReceiptFault.EXPIRED


def label_of(receipt: Receipt, *, at: float) -> Label:
    """The label that the receipt states, as old as the value is now."""
    return aged(label_in(receipt), int((at - receipt.at) * 1_000))
