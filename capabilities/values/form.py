"""Forms: frozen types by which plain values are read, and as which they are written again.

Results of our strict readers go in (`strict_json.read`, `tomllib`), never bytes: msgspec keeps the last of two
equal keys, and knows nothing of canonical text.
"""

from __future__ import annotations

from abc import ABCMeta
from typing import TYPE_CHECKING, Any, Final, TypeVar

import msgspec
from msgspec import Meta

from capabilities.values.errors import CapabilityError

if TYPE_CHECKING:
    from collections.abc import Callable

T = TypeVar("T")
_AT: Final = " - at `$"
"""Stands in msgspec's message between the cause and the place."""
_CAUSES: Final = {
    "Invalid": "an unknown word",
    "Object contains": "an unknown member",
    "Expected `str` matching": "a wrong form",
}
"""Our words for those causes of msgspec that repeat a text of the value or a pattern, by their beginnings."""


class Form(msgspec.Struct, frozen=True, forbid_unknown_fields=True, omit_defaults=True):
    """Base of every form: exactly its members, each of its type.

    A member that has its default is left out.
    """


class FormError(ValueError):
    """A value that is not of its form.

    Attributes:
        place: the member, such as "objects[3].shape"; "" for the whole.
        cause: the fault in it, without any text of the value.
    """

    def __init__(self, place: str, cause: str) -> None:
        super().__init__(f"{place}: {cause}" if place else cause)
        self.place = place
        self.cause = cause


def read(kind: Any, value: object) -> Any:
    """The plain value as a `kind`: a form, or any type that msgspec knows.

    Raises:
        FormError: naming the first place that is wrong.
    """
    try:
        return msgspec.convert(value, kind, strict=True, dec_hook=_converted)
    except msgspec.ValidationError as error:
        raise _refused(kind, value, str(error)) from None


def plain(value: object) -> Any:
    """The JSON value that a form is read from; bytes stay bytes."""
    return msgspec.to_builtins(value, builtin_types=(bytes,))


def whole(pattern: str) -> Meta:
    """The constraint of a text that the pattern matches whole. The last part: `$` also stands before a line's end."""
    return Meta(pattern=rf"^(?:{pattern})$(?!\n)")


def words(*allowed: str) -> Meta:
    """The constraint of a text that is one of these words."""
    return whole("|".join(sorted(allowed)))


def within(low: int, high: int) -> Meta:
    """The constraint of an integer in low..high."""
    return Meta(ge=low, le=high)


def upto(most: int) -> Meta:
    """The constraint of a list of at most `most` members, or a text of as many characters."""
    return Meta(max_length=most)


def converted(into: type, of: Callable[[object], object]) -> Any:
    """The type of a member that a function of its own reads.

    Args:
        into: the type of the result.
        of: that function; its `CapabilityError` or `FormError` states the fault.
    """
    made = ABCMeta("converted", (), {"of": staticmethod(of)})
    made.register(into)
    return made


def _converted(kind: Any, value: object) -> object:
    try:
        return kind.of(value)
    except CapabilityError as error:
        raise ValueError(error.detail) from None


def _refused(kind: Any, value: object, message: str) -> FormError:
    cause, found, place = message.rpartition(_AT)
    if not found:
        cause, place = message, ""
    if isinstance(value, dict) and not value.keys() <= {*getattr(kind, "__struct_encode_fields__", value)}:
        place = ""  # a stranger chose a member's name, and it may look like a place
    said = next((ours for begins, ours in _CAUSES.items() if cause.startswith(begins)), cause.replace("`", ""))
    return FormError(place.strip("`").removeprefix("."), said[:1].lower() + said[1:])
