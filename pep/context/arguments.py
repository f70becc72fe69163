"""Origin of a call's arguments, by the receipts that come with it ([STM-10] in docs/spec.md).

An argument of a call has the label of a receipt only where it *is* the admitted value, or a part of it at a stated
place. Every other argument is the holder's own choice, and derives from the holder's known context and from every
receipt that was presented with it. So a receipt that is left out gains no integrity, and one that is added costs. The
taint that a holder hides by leaving one out is known only where its context is (`pep.context.flow`).

A receipt vouches for a number in its unit, never for the holder's use of it: scope, limits and physics judge that.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final, TypeAlias, assert_never

from capabilities.values.arguments import Fingerprint, fingerprint, plain
from capabilities.values.errors import QuantityError
from capabilities.values.units import DeclaredUnit, ListOf, Quantity, Unit, parse
from pep.context import json_value as values
from pep.context import receipts
from pep.context.flow import own
from pep.context.json_value import NOWHERE, Plain, ValueFault
from pep.context.receipts import ReceiptFault
from policies.evidence.content_readings import ArgumentReading
from policies.words.labels import NOBODY, Integrity, Label, joined, tainted

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping, Sequence

    from capabilities.values.arguments import Value
    from capabilities.values.caps import Caps
    from capabilities.values.units import Measure
    from pep.context.flow import Holder
    from policies.evidence.model import Request

PRESENTED: Final = 16
"""Most receipts of one call; their values together are no larger than one (`pep.context.json_value.VALUE_BYTES`)."""
_Test: TypeAlias = "Callable[[object, str], bool]"
"""Test of an argument against the part of a value at a pointer."""
_SI: Final[Mapping[Unit, str]] = MappingProxyType(
    {
        Unit.MICRORADIAN: "rad",
        Unit.MICRORADIAN_PER_SECOND: "rad_s",
        Unit.MICRORADIAN_PER_SECOND2: "rad_s2",
        Unit.MICROMETRE: "m",
        Unit.MICROMETRE_PER_SECOND: "m_s",
        Unit.MICROMETRE_PER_SECOND2: "m_s2",
        Unit.MILLINEWTON: "N",
        Unit.MILLINEWTON_METRE: "Nm",
        Unit.GRAM: "kg",
        Unit.MILLISECOND: "s",
        Unit.PERMILLE: "",
        Unit.COUNT: "",
    }
)
"""SI unit in which names of tools' parameters end; "" for a ratio and a count."""
_UNITS: Final = frozenset({*map(str, Unit), *_SI.values()} - {""})
_DISTRUSTED: Final = tainted(NOBODY)


@dataclass(frozen=True, slots=True)
class PresentedReceipt:
    """One receipt as a caller presents it, unverified.

    Attributes:
        receipt: text of the statement.
        value: JSON of the admitted value.
        pointers: JSON pointer (RFC 6901) into the value by name of the argument that comes from there.
    """

    receipt: str
    value: bytes
    pointers: Mapping[str, str]


@dataclass(frozen=True, slots=True)
class ArgumentContext:
    """Context in which the arguments of a call are judged.

    Attributes:
        holder: of the verified chain's last hop.
        context: label of what comes out of the holder's context, as far as it is known here (`Flow.label`).
        admitters: raw public key by canonical URL of every registered admission point.
        at: now, seconds since the epoch.
        caps: the bounds.
    """

    holder: Holder
    context: Label
    admitters: Mapping[str, bytes]
    at: float
    caps: Caps


def arguments(
    request: Request, presented: Sequence[PresentedReceipt], known: ArgumentContext
) -> tuple[ArgumentReading, ...]:
    """One reading for each parameter of the request, in its order. Pure, and never raises.

    A parameter equals what stands in an admitted value when the last name on the way there ends in its unit and the
    integer is the same ("speed_urad_s": 500000), or in the SI unit and the number is the same ("speed_rad_s": 0.5,
    "q_rad": [0.1, ...]). A number without a unit is vouched for only where the parameter has none. Of another kind a
    value equals itself, and a free one each value with its digest.

    Args:
        request: in integers.
        presented: receipts that came with the call.
        known: the context of the judgement.
    """
    wanted: dict[str, _Test] = {value.name: _test(value) for value in request.values}
    return _readings(wanted, presented, known)


def named_arguments(
    call: Mapping[str, object], presented: Sequence[PresentedReceipt], known: ArgumentContext
) -> tuple[ArgumentReading, ...]:
    """Readings as of `arguments`, for JSON arguments: each must equal the value at its place, to the letter.

    Args:
        call: arguments by name, in order.
        presented: receipts that came with the call.
        known: the context of the judgement.
    """
    wanted: dict[str, _Test] = {name: _json(value) for name, value in call.items()}
    return _readings(wanted, presented, known)


# --- one argument ----------------------------------------------------------------------------------------------------


def _test(value: Value) -> _Test:
    if isinstance(value, Quantity):
        return _quantity(value)
    if isinstance(value.value, Fingerprint):
        return lambda stated, _: _fingerprint(stated) == value.value
    if isinstance(value.kind, ListOf) and isinstance(value.kind.element, (Unit, DeclaredUnit)):
        return _list(value.name, value.kind.element, plain(value))
    return _json(plain(value))


def _list(name: str, unit: Measure, numbers: Any) -> _Test:
    """Test that a list in an admitted value is these quantities, each by the unit in the list's name."""
    members = [_quantity(Quantity(name, unit, number)) for number in numbers]

    def same(stated: object, pointer: str) -> bool:
        if not isinstance(stated, list) or len(stated) != len(members):
            return False
        return all(one(each, pointer) for one, each in zip(members, stated, strict=True))

    return same


def _fingerprint(stated: object) -> Fingerprint | None:
    try:
        return fingerprint(stated)
    except QuantityError:
        return None


def _quantity(quantity: Quantity) -> _Test:
    """Test that a number in an admitted value is this quantity, by the unit in its name."""

    def same(stated: object, pointer: str) -> bool:
        unit = _unit(values.named(pointer))
        if unit == str(quantity.unit):
            return type(stated) is int and stated == quantity.value
        if not isinstance(quantity.unit, Unit) or unit != _SI.get(quantity.unit):
            return False
        try:
            return parse(stated, quantity.unit) == quantity.value
        except QuantityError:
            return False

    return same


def _json(value: object) -> _Test:
    """Test that a part of an admitted value is this one, type and all."""
    wanted = values.plain(value)

    def same(stated: object, _: str) -> bool:
        found = values.plain(stated)
        return isinstance(wanted, Plain) and isinstance(found, Plain) and wanted.raw == found.raw

    return same


def _unit(name: str) -> str:
    """The longest unit that a name ends in, "" for none: "speed_rad_s" is in rad/s, and not in seconds."""
    ends = (unit for unit in _UNITS if name == unit or name.endswith(f"_{unit}"))
    return max(ends, key=len, default="")


# --- what was presented ----------------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True)
class _Judged:
    """One presented receipt, judged: its label where its signature is believed, else its fault."""

    pointers: Mapping[str, str]
    value: object
    label: Label | None
    fault: ReceiptFault | None


def _judge(one: PresentedReceipt, known: ArgumentContext) -> _Judged:
    receipt = receipts.verify(one.receipt, admitters=known.admitters, caps=known.caps)
    if isinstance(receipt, ReceiptFault):
        return _Judged(one.pointers, NOWHERE, None, receipt)
    label = receipts.label_of(receipt, at=known.at)
    fault = receipts.refusal(receipt, holder=known.holder, at=known.at, caps=known.caps)
    if fault is not None:
        return _Judged(one.pointers, NOWHERE, label, fault)
    shown = values.read(one.value)
    match shown:
        case ValueFault.TOO_LARGE:
            return _Judged(one.pointers, NOWHERE, label, ReceiptFault.VALUE_TOO_LARGE)
        case ValueFault.MALFORMED:
            return _Judged(one.pointers, NOWHERE, label, ReceiptFault.VALUE_MALFORMED)
        case Plain() if shown.digest != receipt.value:
            return _Judged(one.pointers, NOWHERE, label, ReceiptFault.VALUE_CHANGED)
        case Plain():
            return _Judged(one.pointers, shown.value, label, None)
        case _:
            assert_never(shown)


def _readings(
    wanted: Mapping[str, _Test],
    presented: Sequence[PresentedReceipt],
    known: ArgumentContext,
) -> tuple[ArgumentReading, ...]:
    if len(presented) > PRESENTED:
        return tuple(ArgumentReading(name, _DISTRUSTED, str(ReceiptFault.TOO_MANY)) for name in wanted)
    if sum(len(one.value) for one in presented) > values.VALUE_BYTES:
        return tuple(ArgumentReading(name, _DISTRUSTED, str(ReceiptFault.VALUE_TOO_LARGE)) for name in wanted)
    judged = [_judge(one, known) for one in presented]
    # The holder knows each shown value. A receipt that is over, or another's, still tells of a reading.
    chosen = joined((own(known.holder), known.context, *(one.label for one in judged if one.label is not None)))
    everywhere = next((fault for one in judged if (fault := _of_none(one, wanted)) is not None), None)
    return tuple(_reading(name, same, judged, chosen, everywhere) for name, same in wanted.items())


def _of_none(one: _Judged, wanted: Mapping[str, _Test]) -> ReceiptFault | None:
    """Fault of a receipt that names no argument of the call, so that all arguments bear it."""
    if not one.pointers.keys() <= wanted.keys():
        return ReceiptFault.UNKNOWN_ARGUMENT
    return None if one.pointers else one.fault


def _reading(
    name: str, same: _Test, judged: Sequence[_Judged], chosen: Label, everywhere: ReceiptFault | None
) -> ArgumentReading:
    """Reading of one argument: of its receipts, which must all be believed, or of its holder's choice."""
    vouching = [one for one in judged if name in one.pointers]
    fault = everywhere
    for one in vouching:
        pointer = one.pointers[name]
        fault = fault or one.fault
        if fault is None and not same(values.found(one.value, pointer), pointer):
            fault = ReceiptFault.NOT_AT_THAT_PLACE
    if fault is not None:
        return ArgumentReading(name, replace(chosen, integrity=Integrity.NONE), str(fault))
    labels = [one.label for one in vouching if one.label is not None]
    return ArgumentReading(name, joined(labels) if labels else chosen)
