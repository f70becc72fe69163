"""Arguments: the values of a request's parameters, each with its kind and in its one spelling."""

from __future__ import annotations

import hashlib
import re
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final, TypeAlias, assert_never

import rfc8785

from capabilities.values import text
from capabilities.values.errors import FaultCode, QuantityError, ScopeError
from capabilities.values.units import INT_LIMIT, DeclaredUnit, Kind, ListOf, Quantity, Sort, Unit
from capabilities.values.well_formed import LIST_LENGTH

if TYPE_CHECKING:
    from capabilities.values.bounds import Measured

_SHA256: Final = re.compile("[0-9a-f]{64}", re.ASCII)
WORD_BYTES: Final = 1_024
"""Most bytes of UTF-8 of a text, path or URL in a request."""


@dataclass(frozen=True, slots=True)
class Fingerprint:
    """Form of a free value in decisions and records: size and SHA-256 of its canonical JSON (RFC 8785).

    Attributes:
        size_bytes: at least 1.
        sha256: 64 hex digits.
    """

    size_bytes: int
    sha256: str


@dataclass(frozen=True, slots=True)
class Argument:
    """One parameter of a request that is no quantity: its name, kind and value, of the kind's type.

    The value is a truth value, a canonical text, path or URL, a fingerprint, or a list.
    """

    name: str
    kind: Sort | ListOf
    value: bool | str | Fingerprint | tuple[int | bool | str, ...]


Value: TypeAlias = Quantity | Argument
"""One parameter of a request."""


def argument(name: str, kind: Kind, value: object) -> Value:
    """The parameter of this name and kind with a plain JSON value; integers are of the unit itself.

    Raises:
        QuantityError: `PARAMETERS_WRONG` for a value of another type, `OUT_OF_RANGE` for an integer, a size or a length
            beyond the profile's, `NOT_CANONICAL` for another spelling than the one.
    """
    match kind:
        case Unit() | DeclaredUnit():
            return Quantity(name, kind, _integer(value))
        case Sort.FREE:
            return Argument(name, kind, fingerprint(value))
        case Sort.FLAG | Sort.TEXT | Sort.PATH | Sort.URL:
            return Argument(name, kind, _scalar(kind, value))
        case ListOf(element):
            if not isinstance(value, (list, tuple)):
                raise QuantityError(FaultCode.PARAMETERS_WRONG, "not a list")
            if len(value) > LIST_LENGTH:
                raise QuantityError(FaultCode.OUT_OF_RANGE, f"a list of more than {LIST_LENGTH}")
            return Argument(name, kind, tuple([_member(element, member) for member in value]))
        case _:
            assert_never(kind)


def fingerprint(value: object) -> Fingerprint:
    """The fingerprint of any JSON value.

    Raises:
        QuantityError: `NOT_CANONICAL` for what has no form of RFC 8785.
    """
    try:
        spelled = rfc8785.dumps(value)  # type: ignore[arg-type]  # it refuses what is no JSON value
    except (rfc8785.CanonicalizationError, ValueError, RecursionError):
        raise QuantityError(FaultCode.NOT_CANONICAL, "no JSON value that has one form") from None
    return Fingerprint(len(spelled), hashlib.sha256(spelled).hexdigest())


def plain(value: Value) -> object:
    """The value as plain JSON, in digests, records and questions; a fingerprint is `{"sha256", "size_bytes"}`."""
    match value.value:
        case Fingerprint(size_bytes, sha256):
            return {"sha256": sha256, "size_bytes": size_bytes}
        case tuple() as members:
            return list(members)
        case scalar:
            return scalar


def restated(name: str, kind: Kind, stated: object) -> Value:
    """The parameter whose value is stated as `plain` states it.

    Raises:
        QuantityError: as `argument`; `PARAMETERS_WRONG` also for what is no fingerprint.
    """
    if kind is not Sort.FREE:
        return argument(name, kind, stated)
    match stated:
        case {"sha256": str(sha256), "size_bytes": int(size), **rest} if not rest and type(size) is int:
            if 1 <= size <= INT_LIMIT and _SHA256.fullmatch(sha256):
                return Argument(name, kind, Fingerprint(size, sha256))
    raise QuantityError(FaultCode.PARAMETERS_WRONG, "no fingerprint")


def kind_given(value: Value) -> Kind:
    """The kind of a request's parameter."""
    return value.unit if isinstance(value, Quantity) else value.kind


def is_of(kind: Kind, value: Value) -> bool:
    """True where a request's parameter is of this kind, of its exact type and in its one spelling."""
    match kind:
        case Unit() | DeclaredUnit():
            return isinstance(value, Quantity) and value.unit == kind and type(value.value) is int
        case Sort() | ListOf():
            return isinstance(value, Argument) and value.kind == kind and _is_plain(kind, value.value)
        case _:
            assert_never(kind)


def measured(value: Value) -> Measured:
    """The part of a request's parameter that its bound is asked of."""
    return value.value.size_bytes if isinstance(value.value, Fingerprint) else value.value


def _is_plain(kind: Sort | ListOf, value: object) -> bool:
    if kind is Sort.FREE:
        return isinstance(value, Fingerprint) and type(value.size_bytes) is int and value.size_bytes >= 1
    if isinstance(kind, ListOf) and type(value) is not tuple:
        return False
    try:
        argument("", kind, value)
    except QuantityError:
        return False
    return True


def _member(kind: Kind, value: object) -> int | bool | str:
    if isinstance(kind, (Unit, DeclaredUnit)):
        return _integer(value)
    return _scalar(kind, value)


def _integer(value: object) -> int:
    if type(value) is not int:
        raise QuantityError(FaultCode.PARAMETERS_WRONG, "not an integer")
    if not -INT_LIMIT <= value <= INT_LIMIT:
        raise QuantityError(FaultCode.OUT_OF_RANGE, f"beyond {INT_LIMIT}")
    return value


def _scalar(kind: Kind, value: object) -> bool | str:
    """The truth value or word of a kind that has one."""
    if kind is Sort.FLAG:
        if type(value) is not bool:
            raise QuantityError(FaultCode.PARAMETERS_WRONG, "not a truth value")
        return value
    if type(value) is not str:
        raise QuantityError(FaultCode.PARAMETERS_WRONG, "not a text")
    try:
        return text.WORD[kind](value, most_bytes=WORD_BYTES)
    except ScopeError as error:
        raise QuantityError(FaultCode.NOT_CANONICAL, error.detail) from None
