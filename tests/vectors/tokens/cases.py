"""Case of a vector before it has a token: its claim, the making of its token, its author's expectation."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field
from typing import Any

from capabilities.values.errors import FaultCode
from capabilities.values.scope import Scope
from tests.vectors.tokens.ordinary import slug
from tests.vectors.tokens.sealing import Sealed

Made = Sealed | bytes | str
"""A token under construction, its bytes, or its text."""


@dataclass(frozen=True)
class Accepted:
    """Steps 1 to 9 pass, and this scope holds: the one that the token was minted from."""

    scope: Scope


@dataclass(frozen=True)
class Permitted:
    """The request passes steps 11 and 12; for a claimed scope, Biscuit's authorizer agrees with it."""


@dataclass(frozen=True)
class Faulty:
    """The first fault."""

    code: FaultCode
    clause: str


@dataclass(frozen=True)
class Refused:
    """Refusal of the request by step 11; `of` has parameter, value, unit, bound and nearest, where there are any."""

    code: FaultCode
    hop: int
    of: dict[str, Any] = field(default_factory=dict)


Expected = Accepted | Permitted | Faulty | Refused


@dataclass(frozen=True)
class Case:
    """One vector.

    Attributes:
        title: what it shows, in words; its id is made of that and the clause.
        clause: what it belongs to.
        token: makes the token; or the title of the case of the same group whose token it is.
        expected: by hand.
        given: what differs from the ordinary case: trust, time, audience, view, lease_ms.
        request: object, operation, values, base_tier and, when it comes later, time.
        claimed: a scope that step 12 is asked about instead of the token's own.
    """

    title: str
    clause: str
    token: Callable[[], Made] | str
    expected: Expected
    given: dict[str, Any] = field(default_factory=dict)
    request: dict[str, Any] | None = None
    claimed: Scope | None = None

    @property
    def id(self) -> str:
        return f"{self.clause.lower()}-{slug(self.title)}"


@dataclass(frozen=True)
class Group:
    """The vectors of one file."""

    name: str
    says: str
    cases: tuple[Case, ...]


def faults(
    code: FaultCode, clause: str, made: dict[str, Callable[[], Made]], *, given: dict[str, Any] | None = None
) -> Iterator[Case]:
    """One case for each way to make a token that has this fault."""
    for title, token in made.items():
        yield Case(title, clause, token, Faulty(code, clause), given or {})


def group(name: str, says: str, *cases: Case | Iterable[Case]) -> Group:
    flat = [each for some in cases for each in ([some] if isinstance(some, Case) else some)]
    return Group(name, says, tuple(flat))
