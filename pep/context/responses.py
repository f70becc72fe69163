"""A tool's answer, bound to its call and to the approved definition, by the PEP that asked the tool.

A result is believed as a record: this tool, as it was pinned, answered so to this recorded call ([STM-11] in
docs/spec.md, CII-5, TEA-3). Only a receipt for exactly this value says more of it.
"""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Final

from capabilities.statements.context import response
from capabilities.statements.context.response import Response
from capabilities.values.errors import CapabilityError, FaultCode
from pep.context.flow import Holder
from pep.context.receipts import LIFETIME_S, ReceiptFault, label_of, refusal, verify
from policies.evidence.content_readings import ItemKind, ItemReading
from policies.words.labels import NOBODY, Integrity, Label, Source, aged, joined

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from capabilities.keys.keys import PrivateKey
    from capabilities.statements.context.response import Call
    from capabilities.values.caps import Caps
    from pep.context.json_value import Plain

RECEIPTS: Final = 16
"""Most receipts that are looked at for one result."""
RESULT_CHANGED: Final = "RESULT_CHANGED"
"""Fault of a result other than the one that the enforcement point signed."""
_OTHER_CALL: Final = frozenset({FaultCode.WRONG_AUDIENCE, FaultCode.PROOF_NOT_FOR_THIS_REQUEST})
"""Faults of a true statement about another call."""


def vouch(value: Plain, *, call: Call, definition: str, tainted: bool, key: PrivateKey, at: float) -> str:
    """Signs that this value is the tool's answer to this call; it counts as long as a receipt.

    Args:
        value: the result.
        call: as it was decided and recorded.
        definition: digest (hex) of the tool's definition, the approved one before and after the tool answered.
        tainted: some argument of the call was.
        key: of the enforcement point.
        at: now, seconds since the epoch.
    """
    said = Response(
        audience=call.audience,
        agent=call.agent,
        hop_id=call.hop_id,
        proof=call.proof,
        request=call.request,
        tool=call.tool,
        definition=definition,
        result=value.digest,
        tainted=tainted,
        at=int(at),
        not_after=int(at) + LIFETIME_S,
    )
    return response.sign(said, key)


def recorded(audience: str, *, tainted: bool) -> Label:
    """Label of the answer that a pinned tool behind this enforcement point has just given.

    A tool may give back what it was given, so a taint of its arguments is one of its result.
    """
    return Label(frozenset({Source.TOOL}), frozenset({audience}), Integrity.RECORDED, 0, tainted)


def read(
    text: str,
    value: Plain,
    *,
    call: Call,
    approved: str | None,
    peps: Mapping[str, bytes],
    receipts: Sequence[str] = (),
    at: float,
    caps: Caps,
) -> ItemReading:
    """Reading of a result for admission; never raises.

    Args:
        text: the enforcement point's word for it, as it came with the result.
        value: the result as it came.
        call: as it was recorded when it was made.
        approved: digest (hex) of the tool's approved definition, from the signed registry; None when it has none.
        peps: raw public key by canonical URL of every registered enforcement point.
        receipts: that came with the result; each counts only where it vouches for exactly this value and holder.
        at: now, seconds since the epoch.
        caps: the bounds.
    """
    id_ = f"{call.tool}:{call.proof[:16]}"
    # 1 the key of the one enforcement point that was called
    key = peps.get(call.audience)
    try:
        said = response.open(text, frozenset() if key is None else frozenset({key}), caps)
    except CapabilityError as error:
        return _disbelieved(id_, str(error.code))
    # 2 this very result
    if said.result != value.digest:
        return _disbelieved(id_, RESULT_CHANGED)
    # 3 to this very call, now
    fault = response.refusal(said, call, at=at, caps=caps)
    if fault is not None and fault.code not in _OTHER_CALL:
        return _disbelieved(id_, str(fault.code))
    # 4 by the tool as it was approved: the definition that TEA-3 compared stands in the word for its result
    of_pin = approved is not None and said.definition == approved
    label = aged(recorded(said.audience, tainted=said.tainted), int((at - said.at) * 1_000))
    if fault is None and of_pin:
        label = _carried(label, value, call, peps=peps, receipts=receipts, at=at, caps=caps)
    return ItemReading(ItemKind.TOOL_RESPONSE, id_, label, of_request=fault is None, of_pin=of_pin)


def _carried(
    label: Label,
    value: Plain,
    call: Call,
    *,
    peps: Mapping[str, bytes],
    receipts: Sequence[str],
    at: float,
    caps: Caps,
) -> Label:
    """Label from the receipts for exactly this value and holder, joined; without one, the label itself."""
    holder = Holder(call.hop_id, call.agent)
    known = []
    for text in receipts[:RECEIPTS]:
        receipt = verify(text, admitters=peps, caps=caps)
        if isinstance(receipt, ReceiptFault) or receipt.value != value.digest:
            continue
        if refusal(receipt, holder=holder, at=at, caps=caps) is None:
            known.append(label_of(receipt, at=at))
    if not known:
        return label
    found = joined(known)
    return replace(
        found,
        sources=found.sources | label.sources,
        signers=found.signers | label.signers,
        tainted=found.tainted or label.tainted,
    )


def _disbelieved(id_: str, fault: str) -> ItemReading:
    return ItemReading(ItemKind.TOOL_RESPONSE, id_, NOBODY, fault=fault)
