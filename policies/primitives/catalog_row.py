"""One row of the catalog: everything that is said about a primitive in one place."""

from __future__ import annotations

from dataclasses import dataclass, fields
from enum import StrEnum
from typing import TYPE_CHECKING, Any

from policies.words.parameters import PARAMETERS, ParameterRow
from policies.words.reason_table import Reason, reasons_of

if TYPE_CHECKING:
    from policies.evidence.model import Point
    from policies.primitives.base import Primitive


class Domain(StrEnum):
    """The paper's five domains."""

    AID = "agent identity and delegation"
    CII = "cognition and instruction integrity"
    TEA = "tool execution and actuation"
    CATP = "cross-agent trust and propagation"
    ABG = "agent behaviour governance"


class Attack(StrEnum):
    """The paper's five attack classes."""

    AC_1 = "AC-1"
    """Adversarial perception."""
    AC_2 = "AC-2"
    """Cross-agent prompt propagation."""
    AC_3 = "AC-3"
    """Context poisoning."""
    AC_4 = "AC-4"
    """Tool scope escalation."""
    AC_5 = "AC-5"
    """Actuation sequence abuse."""


class Defence(StrEnum):
    """Dimension of the paper's three in which a primitive counters an attack."""

    DETECTION = "detection"
    PREVENTION = "prevention"
    CONTAINMENT = "containment"


@dataclass(frozen=True, slots=True)
class CatalogRow:
    """One primitive.

    Attributes:
        id: the paper's id.
        name: ours.
        must_hold: the condition, in one sentence.
        points: the enforcement points at which it has evidence.
        evidence: the readings it looks at.
        decides: the class that decides it.
        counters: the attacks it counters, each in which dimension (the paper's table).
        meaning_is_ours: the paper's text does not define the id; the meaning is taken from its domain's paragraph.
    """

    id: str
    name: str
    must_hold: str
    points: frozenset[Point]
    evidence: tuple[str, ...]
    decides: type[Any]
    counters: tuple[tuple[Attack, Defence], ...] = ()
    meaning_is_ours: bool = False

    @property
    def domain(self) -> Domain:
        """The domain that the id names."""
        return Domain[self.id.partition("-")[0]]

    @property
    def clause(self) -> str:
        """Id of the normative sentence in docs/primitives.md."""
        return f"POL-{self.id}"

    @property
    def parameters(self) -> tuple[ParameterRow, ...]:
        """The parameters that the class takes, with unit and range."""
        return tuple(PARAMETERS[f.name] for f in fields(self.decides))

    @property
    def reasons(self) -> tuple[Reason, ...]:
        """The reason codes that it finds of its own; `EVIDENCE_MISSING` is common to all."""
        return reasons_of(self.id)

    def make(self, **values: int) -> Primitive:
        """The primitive with these parameters, each in its unit and already inside its range."""
        primitive: Primitive = self.decides(**values)
        return primitive
