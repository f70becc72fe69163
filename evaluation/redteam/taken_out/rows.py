"""One row for each primitive and one for the computed physics: where its checks are, and their removal."""

from __future__ import annotations

from dataclasses import dataclass
from importlib import import_module
from typing import TYPE_CHECKING, Final

from policies.primitives.base import Holds
from policies.primitives.catalog import ROWS

if TYPE_CHECKING:
    from collections.abc import Collection

PHYSICS: Final = "physics"
"""Computed tiers and the watch: off beside primitives that decide by registered classes and declared rows alone."""
PROVIDER: Final = "identity provider"
GATEWAY: Final = "gateway"
TOOLS: Final = "tool server"
POINT: Final = "point"
"""Any process of an arena that is none of the embedded cell's: an admission point, a guarded server."""
CELL: Final = frozenset({PROVIDER, GATEWAY, TOOLS, "controller", "sensor"})
"""Processes of the embedded cell, by their names."""

_ANY: Final = frozenset({PROVIDER, GATEWAY, TOOLS, POINT})
_E4_E5: Final = frozenset({GATEWAY, POINT})
_E2_E5: Final = frozenset({PROVIDER, GATEWAY, POINT})


@dataclass(frozen=True, slots=True)
class Taken:
    """Removal of one primitive's checks.

    Attributes:
        id: of the primitive, or `PHYSICS`.
        processes: in which its checks are.
        others: functions beside its own judgement, as `module:name` of this package; each is given all that is off.
    """

    id: str
    processes: frozenset[str]
    others: tuple[str, ...] = ()

    def take_out(self, off: frozenset[str]) -> None:
        """Takes the checks out of this process."""
        row = ROWS.get(self.id)
        if row is not None:
            row.decides.judge = lambda self, case: Holds()
        for each in self.others:
            module, name = each.split(":")
            getattr(import_module(f"evaluation.redteam.taken_out.{module}"), name)(off)


TAKEN: Final = {
    row.id: row
    for row in (
        Taken("AID-1", frozenset({GATEWAY, TOOLS, POINT}), ("tokens:agent_authentication",)),
        Taken("AID-2", _ANY, ("tokens:human_root",)),
        Taken("AID-3", _ANY, ("tokens:link_validity",)),
        Taken("AID-4", _ANY, ("tokens:scope_escalation",)),
        Taken("AID-5", _ANY, ("tokens:bounded_chain",)),
        Taken("CII-1", frozenset({POINT}), ("context:operator_input",)),
        Taken("CII-2", frozenset({POINT}), ("context:instruction_isolation",)),
        Taken("CII-3", frozenset({POINT}), ("context:retrieval_integrity",)),
        Taken("CII-4", _E4_E5, ("world:sensor_provenance",)),
        Taken("CII-5", _E4_E5, ("context:content_provenance",)),
        Taken("CII-6", frozenset({POINT}), ("context:message_integrity",)),
        Taken("TEA-1", _E4_E5, ("tokens:tool_scope",)),
        Taken("TEA-2", _E4_E5, ("tokens:parameter_limits",)),
        Taken("TEA-3", _E4_E5, ("tokens:tool_identity",)),
        Taken("TEA-4", _E4_E5, ("tokens:ceiling", "world:impact_gate")),
        Taken("TEA-5", _E4_E5),
        Taken("TEA-6", _E4_E5, ("world:sequence_coherence",)),
        Taken("CATP-1", _E2_E5, ("tokens:non_transitive_trust",)),
        Taken("CATP-2", _ANY, ("tokens:scope_narrowing",)),
        Taken("CATP-3", _E2_E5),
        Taken("CATP-4", _ANY, ("tokens:boundary_attestation", "lending:boundary_attestation")),
        Taken("ABG-1", _E4_E5),
        Taken("ABG-2", _E4_E5),
        Taken("ABG-3", _E2_E5),
        Taken("ABG-4", _E2_E5, ("lending:scope_contraction",)),
        Taken(PHYSICS, _E4_E5, ("world:computed_physics",)),
    )
}
"""Every row by id."""


def concerning(child: str, off: Collection[str]) -> frozenset[str]:
    """Those of `off` that have a check in a process.

    Args:
        child: name of it, as `Child.begin` is given it.
        off: ids.
    """
    kind = child if child in CELL else POINT
    return frozenset(id_ for id_ in off if kind in TAKEN[id_].processes)


def take_out(off: frozenset[str]) -> None:
    """Takes the checks of these out of this process."""
    for id_ in sorted(off):
        TAKEN[id_].take_out(off)
