"""Digest of the request that sends an operation's numbers: what is about to be sent, beside what was decided."""

from __future__ import annotations

from typing import TYPE_CHECKING, TypeAlias

from capabilities.values.arguments import Value, argument
from capabilities.values.errors import FaultCode, QuantityError
from capabilities.values.units import ListOf, Parameter, Unit, parse
from policies.evidence.model import Request

if TYPE_CHECKING:
    from collections.abc import Sequence

    from pep.base.operation_row import Operation

Number: TypeAlias = float | tuple[float, ...]
"""A parameter in SI units: a number, or a list of them."""


def value_of(parameter: Parameter, number: Number) -> Value:
    """Parameter of a request, in integers.

    Raises:
        QuantityError: with the codes of `capabilities.values.units.parse`.
    """
    kind = parameter.kind
    if isinstance(kind, ListOf) and isinstance(kind.element, Unit) and isinstance(number, tuple):
        return argument(parameter.name, kind, [parse(each, kind.element) for each in number])
    if isinstance(kind, Unit) and not isinstance(number, tuple):
        return argument(parameter.name, kind, parse(number, kind))
    raise QuantityError(FaultCode.PARAMETERS_WRONG, "a number for a list, or a list for a number")


def digest_of(operation: Operation, numbers: Sequence[Number], *, audience: str) -> str:
    """Digest of the request that sends these numbers; "" when they are no request.

    Args:
        operation: that is about to be sent.
        numbers: its parameters in order, in SI units: the very values that go to the device.
        audience: canonical URL of the server that decided.
    """
    if len(numbers) != len(operation.parameters):
        return ""
    try:
        values = tuple(map(value_of, operation.parameters, numbers))
    except QuantityError:
        return ""
    return Request("", frozenset(), audience, operation.object, operation.name, values, 0.0).digest
