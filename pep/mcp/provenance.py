"""Provenance of a call's arguments and of its result: receipts in `_meta`, in both directions.

A caller shows receipts under `RECEIPTS`, each `{"receipt", "value", "pointers"}`: the signed text, the admitted value,
and for each argument that comes from it a JSON pointer into the value. Arguments are named as the request names them. A
caller that sets `RECEIPT` to true gets under the same name a receipt for the result's structured content, and under
`RESPONSE` the enforcement point's word that it is the answer to this very call.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

from capabilities.statements.context.response import Call as Called
from capabilities.values.caps import DEFAULT as CAPS
from pep.context import destinations, receipts, responses
from pep.context import json_value as values
from pep.context.arguments import PRESENTED, ArgumentContext, PresentedReceipt, arguments
from pep.context.destinations import DestinationFault
from pep.context.flow import Holder, own
from pep.context.json_value import Plain
from policies.evidence.content_readings import ContextReading

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from capabilities.keys.keys import PrivateKey
    from capabilities.values.caps import Caps
    from capabilities.values.chain import Chain, Hop
    from pep.base.operation_row import Operation
    from pep.context.destinations import Texts
    from pep.context.flow import Flow
    from policies.evidence.evidence import ToolReading
    from policies.evidence.model import Request

RECEIPTS: Final = "dev.ztpm/receipts"
RECEIPT: Final = "dev.ztpm/receipt"
RESPONSE: Final = "dev.ztpm/response"
RECEIPT_BYTES: Final = 24_576
"""Longest text of a receipt: one with 64 signers of 256 bytes; the body around it has its own cap."""
_MEMBERS: Final = frozenset({"receipt", "value", "pointers"})


@dataclass(frozen=True, slots=True)
class Unreadable:
    """Reason why a call's receipts cannot be read. `detail` is for the holder."""

    detail: str


def shown(meta: object) -> tuple[PresentedReceipt, ...] | Unreadable:
    """Receipts of a call, unverified and in its order; none where it shows none.

    Args:
        meta: its `_meta`, as a strict reader saw it.
    """
    listed = meta.get(RECEIPTS, []) if isinstance(meta, dict) else []
    if not isinstance(listed, list) or len(listed) > PRESENTED:
        return Unreadable(f"{RECEIPTS} is no list of at most {PRESENTED}")
    found = []
    for one in listed:
        read = _one(one)
        if isinstance(read, Unreadable):
            return read
        found.append(read)
    return tuple(found)


def _one(one: object) -> PresentedReceipt | Unreadable:
    if not isinstance(one, dict) or one.keys() != _MEMBERS:
        return Unreadable(f"not exactly {', '.join(sorted(_MEMBERS))}")
    text, pointers, value = one["receipt"], one["pointers"], values.plain(one["value"])
    if not isinstance(text, str) or not text.isascii() or len(text) > RECEIPT_BYTES:
        return Unreadable("a receipt that is no text of a statement")
    if not isinstance(value, Plain):
        return Unreadable("a value that is none")
    if not isinstance(pointers, dict) or not all(_is_pointer(pointer) for pointer in pointers.values()):
        return Unreadable("pointers that are none")
    return PresentedReceipt(text, value.raw, pointers)


def _is_pointer(pointer: object) -> bool:
    return isinstance(pointer, str) and values.tokens(pointer) is not None


def wanted(meta: object) -> bool:
    """True where the caller asks for a receipt of the result."""
    return isinstance(meta, dict) and meta.get(RECEIPT) is True


def unvouched(
    request: Request, presented: tuple[PresentedReceipt, ...], *, operation: Operation, chain: Chain, at: float
) -> ContextReading:
    """Context of each parameter without a known admission point: its holder's choice, with no receipt counted.

    What the holder was told is unknown here, so a destination is believed only where the grant names it.
    """
    holder = Holder.of(chain.leaf)
    readings = arguments(request, presented, ArgumentContext(holder, own(holder), {}, at, CAPS))
    fault = destinations.unknown
    return ContextReading((), destinations.judged(readings, request, operation, chain=chain, fault=fault))


class Vouching:
    """An enforcement point's knowledge of its callers' values, and its signature under its own results.

    Args:
        key: of this enforcement point.
        audience: its canonical URL.
        admitters: raw public key by canonical URL of every registered admission point, as of now.
        flow: contents of all contexts, as far as they are known here; None where nobody follows them: no receipt is
            believed or given then, and a response counts as tainted, since its arguments may be.
        caps: the bounds.
    """

    def __init__(
        self,
        *,
        key: PrivateKey,
        audience: str,
        admitters: Callable[[], Mapping[str, bytes]],
        flow: Flow | None,
        caps: Caps,
    ) -> None:
        self._key = key
        self._audience = audience
        self._admitters = admitters
        self._flow = flow
        self._caps = caps

    def context(
        self,
        request: Request,
        presented: tuple[PresentedReceipt, ...],
        *,
        operation: Operation,
        chain: Chain,
        at: float,
    ) -> ContextReading:
        """Context of each parameter of the request; a call without receipts is its holder's own choice."""
        flow = self._flow
        if flow is None:
            return unvouched(request, presented, operation=operation, chain=chain, at=at)
        known = ArgumentContext(
            holder=Holder.of(chain.leaf),
            context=flow.label(flow.context(chain.leaf)),
            admitters=self._admitters(),
            at=at,
            caps=self._caps,
        )
        readings = arguments(request, presented, known)

        def fault(word: str, shown: Texts) -> DestinationFault | None:
            return DestinationFault.FROM_TEXT if flow.names(word, chain.hops, shown) else None

        shown = (one.value for one in presented)
        return ContextReading(
            (), destinations.judged(readings, request, operation, chain=chain, fault=fault, shown=shown)
        )

    def meta(
        self,
        content: object,
        *,
        request: Request,
        reading: ContextReading,
        tool: ToolReading,
        leaf: Hop,
        proof: str,
        at: float,
    ) -> dict[str, Any]:
        """Members of `_meta` that go out with a result; none for a content that no receipt can name.

        Args:
            content: the structured content.
            request: that was decided, and done.
            reading: of its arguments.
            tool: as it was registered and served before and after it answered.
            leaf: last hop of the caller.
            proof: name of the call's proof.
            at: now, seconds since the epoch.
        """
        value = values.plain(content)
        if not isinstance(value, Plain) or not isinstance(content, dict):
            return {}
        unknown = self._flow is None
        tainted = unknown or any(argument.label.tainted or argument.fault for argument in reading.arguments)
        holder = Holder.of(leaf)
        call = Called(self._audience, holder.agent, holder.hop_id, proof, request.digest, tool.name)
        vouched = responses.vouch(
            value, call=call, definition=tool.actual_digest, tainted=tainted, key=self._key, at=at
        )
        if unknown:
            return {RESPONSE: vouched}
        label = responses.recorded(self._audience, tainted=tainted)
        receipt = receipts.issue(value, label, holder, audience=self._audience, key=self._key, at=at)
        return {RECEIPT: receipt, RESPONSE: vouched}
