"""Forms of people's and agents' words: strict pydantic models, registered by name, with the operations each asks for.

Pydantic, since the project validates with it at every edge: a strict model has no `$ref` to follow, no format to
interpret and no second dialect. A form is closed: no member that it does not name, no number that is not finite.
"""

from __future__ import annotations

from dataclasses import dataclass
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final

from pydantic import BaseModel, ConfigDict

from pep.base.errors import ConfigError, PepFault

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable

    from capabilities.values.units import Quantity

ASKED: Final = 64
"""Most operations that one body asks for: as many as a scope has grants."""


class FormBody(BaseModel):
    """The base of every form, and of every model inside one."""

    model_config = ConfigDict(strict=True, extra="forbid", frozen=True, allow_inf_nan=False)


@dataclass(frozen=True, slots=True)
class RequestedOperation:
    """One operation that a body asks for; `values` is None when it does not say with which parameters."""

    object: str
    operation: str
    values: tuple[Quantity, ...] | None = None


def asks_nothing(_: Any) -> tuple[RequestedOperation, ...]:
    """Operations of a form that only tells: none."""
    return ()


@dataclass(frozen=True, slots=True)
class Form:
    """A registered form.

    Attributes:
        name: as statements name it in `schema`.
        body: the model.
        asks: every operation that a body of this form asks for. What raises counts as not of the form.
    """

    name: str
    body: type[FormBody]
    asks: Callable[[Any], tuple[RequestedOperation, ...]]


@dataclass(frozen=True, slots=True)
class ParsedBody:
    """A body of its form."""

    body: FormBody
    asked: tuple[RequestedOperation, ...]


class Forms:
    """The forms that an enforcement point knows.

    Args:
        forms: each name once.

    Raises:
        ConfigError: `CONFIG_INVALID` for a name twice, and for a form that is not closed.
    """

    def __init__(self, forms: Iterable[Form] = ()) -> None:
        known: dict[str, Form] = {}
        for form in forms:
            if form.name in known:
                raise ConfigError(PepFault.CONFIG_INVALID, f"the form {form.name} twice")
            if not _closed(form.body.model_json_schema()):
                raise ConfigError(PepFault.CONFIG_INVALID, f"the form {form.name} takes members that it does not name")
            known[form.name] = form
        self._known = MappingProxyType(known)

    def read(self, schema: str, body: bytes) -> ParsedBody | None:
        """Reads the body by its form; None for an unknown form or a body of another. Never raises.

        Args:
            schema: name of the form.
            body: canonical JSON of an object.
        """
        form = self._known.get(schema)
        if form is None:
            return None
        try:
            read = form.body.model_validate_json(body, strict=True)
            asked = tuple(form.asks(read))
        except Exception:  # noqa: BLE001 - a body that its own form cannot read is not of that form
            return None
        return ParsedBody(read, asked) if len(asked) <= ASKED else None


def _closed(schema: object) -> bool:
    """True where every object in a JSON schema names its members and forbids others."""
    match schema:
        case {"type": "object", **rest} if rest.get("additionalProperties") is not False:
            return False
        case dict():
            return all(map(_closed, schema.values()))
        case list():
            return all(map(_closed, schema))
        case _:
            return True
