"""Reader of plain values by annotation: the strict inverse of `policies.words.canonical.plain`.

A dataclass is an object with its type's name and its fields; a field with a default may be absent. Any value that its
annotation does not admit is refused with its place.
"""

from __future__ import annotations

import types
from dataclasses import MISSING, Field, fields, is_dataclass
from enum import Enum
from functools import cache
from typing import TYPE_CHECKING, Any, Final, Union, get_args, get_origin, get_type_hints

from capabilities.values import chain, errors, scope, units
from policies.evidence import conduct_readings, content_readings, evidence, fact_reading, model
from policies.words import canonical, labels, reason_table
from policies.words.errors import PolicyError, PolicyFault

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

_MODULES: Final = (
    chain,
    errors,
    scope,
    units,
    conduct_readings,
    evidence,
    labels,
    model,
    reason_table,
    content_readings,
    fact_reading,
)
_NAMES: Final = {name: value for module in _MODULES for name, value in vars(module).items() if isinstance(value, type)}
"""Types that the annotations of readings name; some are imported there for the type checker alone."""


def members(kind: type[Any]) -> dict[str, tuple[Any, bool]]:
    """Fields of a written dataclass: the annotation of each, and whether it must be stated."""
    hints = get_type_hints(kind, localns=_NAMES)
    return {f.name: (hints[f.name], not _defaults(f)) for f in fields(kind) if f.init}


def _defaults(member: Field[Any]) -> bool:
    return member.default is not MISSING or member.default_factory is not MISSING


@cache
def reader_of(hint: Any) -> Callable[[object, str], Any]:
    """Reader of a plain value for this annotation: a function of the value and its place.

    It is made once for each annotation.
    """
    if hint in _LEAVES:
        return _LEAVES[hint]
    if hint is type(None):
        return _nothing
    origin, arguments = get_origin(hint), get_args(hint)
    if origin in (Union, types.UnionType):
        return _one_of(arguments)
    if origin is frozenset:
        return _set_of(reader_of(arguments[0]))
    if origin is tuple:
        return _tuple_of(arguments)
    if isinstance(hint, type) and issubclass(hint, Enum):
        return _member_of(hint)
    if isinstance(hint, type) and is_dataclass(hint):
        return _record_of(hint)
    raise TypeError(hint)


def _record_of(kind: type[Any]) -> Callable[[object, str], Any]:
    known = {name: (reader_of(hint), required) for name, (hint, required) in members(kind).items()}
    required = {"type"} | {name for name, (_, needed) in known.items() if needed}

    def read_record(plain: object, where: str) -> Any:
        table = read_table(plain, where)
        expect_keys(table, where, required, set(known))
        if table["type"] != kind.__name__:
            raise PolicyError(PolicyFault.UNKNOWN_VALUE, f"{where}.type", kind.__name__)
        return kind(**{n: known[n][0](v, f"{where}.{n}") for n, v in table.items() if n != "type"})

    return read_record


def _one_of(alternatives: tuple[Any, ...]) -> Callable[[object, str], Any]:
    """Records are told apart by their type's name, all other values by their own type."""
    records = {a.__name__: reader_of(a) for a in alternatives if is_dataclass(a) and isinstance(a, type)}
    others = [reader_of(a) for a in alternatives if not is_dataclass(a)]
    words = ", ".join(getattr(a, "__name__", str(a)) for a in alternatives)

    def read_alternative(plain: object, where: str) -> Any:
        if isinstance(plain, dict) and isinstance(plain.get("type"), str) and plain["type"] in records:
            return records[plain["type"]](plain, where)
        for reader in others:
            try:
                return reader(plain, where)
            except PolicyError:
                continue
        raise PolicyError(PolicyFault.WRONG_TYPE, where, f"one of {words}")

    return read_alternative


def _set_of(reader: Callable[[object, str], Any]) -> Callable[[object, str], Any]:
    def read_set(plain: object, where: str) -> frozenset[Any]:
        table = read_table(plain, where)
        expect_keys(table, where, {"set"}, set())
        found = [reader(member, f"{where}.set[{i}]") for i, member in enumerate(read_list(table["set"], where))]
        if len(set(found)) != len(found):
            raise PolicyError(PolicyFault.DUPLICATE_VALUE, where)
        return frozenset(found)

    return read_set


def _tuple_of(arguments: tuple[Any, ...]) -> Callable[[object, str], Any]:
    """Reader of a tuple: any number of one kind, or one of each kind."""
    if arguments[-1] is not Ellipsis:
        each = [reader_of(argument) for argument in arguments]

        def read_each(plain: object, where: str) -> tuple[Any, ...]:
            listed = read_list(plain, where)
            if len(listed) != len(each):
                raise PolicyError(PolicyFault.OUT_OF_RANGE, where, f"{len(each)} members")
            return tuple(
                reader(member, f"{where}[{i}]") for i, (reader, member) in enumerate(zip(each, listed, strict=True))
            )

        return read_each
    one = reader_of(arguments[0])
    return lambda plain, where: tuple(one(m, f"{where}[{i}]") for i, m in enumerate(read_list(plain, where)))


def _member_of(kind: type[Enum]) -> Callable[[object, str], Any]:
    known = {(type(member.value), member.value): member for member in kind}

    def read_member(plain: object, where: str) -> Enum:
        if not isinstance(plain, (str, int)) or (type(plain), plain) not in known:
            raise PolicyError(PolicyFault.UNKNOWN_VALUE, where, f"one of {', '.join(str(m.value) for m in kind)}")
        return known[type(plain), plain]

    return read_member


def read_text(plain: object, where: str) -> str:
    """A text."""
    if type(plain) is not str:
        raise PolicyError(PolicyFault.WRONG_TYPE, where, "a text is wanted")
    return plain


def _flag(plain: object, where: str) -> bool:
    if type(plain) is not bool:
        raise PolicyError(PolicyFault.WRONG_TYPE, where, "true or false is wanted")
    return plain


def read_integer(plain: object, where: str) -> int:
    """An integer; one that JSON readers do not keep stands in text."""
    if type(plain) is int and abs(plain) <= canonical.EXACT:
        return plain
    match plain:
        case {"int": str(text), **rest} if not rest and len(text) <= 64:
            try:
                large = int(text)
            except ValueError:
                large = 0
            if abs(large) > canonical.EXACT and str(large) == text:
                return large
    raise PolicyError(PolicyFault.WRONG_TYPE, where, "an integer is wanted")


def read_number(plain: object, where: str) -> float:
    """A float: exact in hex, or a plain number as people write it."""
    if type(plain) in (int, float):
        try:
            return float(plain)  # type: ignore[arg-type]  # one of the two
        except OverflowError:
            raise PolicyError(PolicyFault.OUT_OF_RANGE, where) from None
    match plain:
        case {"float": str(text), **rest} if not rest and len(text) <= 32:
            try:
                value = float.fromhex(text)
            except (ValueError, OverflowError):
                value = 0.0
            if value.hex() == text:
                return value
    raise PolicyError(PolicyFault.WRONG_TYPE, where, "a number is wanted")


def _bytes(plain: object, where: str) -> bytes:
    match plain:
        case {"hex": str(text), **rest} if not rest and text == text.lower():
            try:
                return bytes.fromhex(text)
            except ValueError:
                pass
    raise PolicyError(PolicyFault.WRONG_TYPE, where, "bytes in hex are wanted")


def _nothing(plain: object, where: str) -> None:
    if plain is not None:
        raise PolicyError(PolicyFault.WRONG_TYPE, where, "null is wanted")


_LEAVES: Final[Mapping[Any, Callable[[object, str], Any]]] = {
    str: read_text, bool: _flag, int: read_integer, float: read_number, bytes: _bytes,
}  # fmt: skip


def read_table(plain: object, where: str) -> dict[str, object]:
    """A JSON object."""
    if not isinstance(plain, dict) or not all(type(key) is str for key in plain):
        raise PolicyError(PolicyFault.WRONG_TYPE, where, "a table is wanted")
    return plain


def read_list(plain: object, where: str) -> list[object]:
    """A JSON array."""
    if not isinstance(plain, list):
        raise PolicyError(PolicyFault.WRONG_TYPE, where, "a list is wanted")
    return plain


def expect_keys(table: Mapping[str, object], where: str, required: set[str], optional: set[str]) -> None:
    """Exactly these keys."""
    for key in table:
        if key not in required and key not in optional:
            raise PolicyError(PolicyFault.UNKNOWN_KEY, f"{where}.{key}"[:128] if where else key[:128])
    for key in sorted(required):
        if key not in table:
            raise PolicyError(PolicyFault.MISSING_KEY, f"{where}.{key}" if where else key)
