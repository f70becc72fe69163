"""Strict reading of TOML tables into frozen dataclasses: exact types, no extra keys, finite numbers only."""

from __future__ import annotations

import json
import tomllib
from typing import TYPE_CHECKING, Any, Final, TypeVar

from pydantic import ConfigDict, TypeAdapter, ValidationError

if TYPE_CHECKING:
    from collections.abc import Mapping

T = TypeVar("T")

STRICT: Final = ConfigDict(strict=True, extra="forbid", allow_inf_nan=False)
"""Configuration that every dataclass read from a file carries as `__pydantic_config__`."""


class FormError(ValueError):
    """A table that does not have the declared form."""


def read_table(kind: type[T], table: Mapping[str, Any]) -> T:
    """The table as a `kind`.

    The way over JSON text is on purpose: there a list is a tuple's only spelling, and NaN, infinities and dates have
    none.

    Raises:
        FormError: names the first place that is wrong.
    """
    try:
        return TypeAdapter(kind).validate_json(json.dumps(table, allow_nan=False))
    except ValidationError as error:
        first = error.errors(include_url=False, include_input=False, include_context=False)[0]
        where = ".".join(str(part) for part in first["loc"])
        raise FormError(f"{where}: {first['msg']}") from error
    except (TypeError, ValueError) as error:
        raise FormError("a value is not finite or has no strict form") from error


def read_toml(text: str) -> dict[str, Any]:
    """The table that a TOML text spells.

    Raises:
        FormError: not TOML.
    """
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        raise FormError(f"not TOML: {error}") from error
