"""Catalog of the 25 primitives: condition, points, evidence, and the class that decides.

Ids are the paper's. Clauses are the sentences of docs/primitives.md, which is generated from this table.
"""

from __future__ import annotations

from types import MappingProxyType
from typing import TYPE_CHECKING, Final

from policies.evidence.model import Point
from policies.primitives import cognition, governance, identity, propagation, sequence, tools
from policies.primitives.catalog_row import Attack, CatalogRow, Defence

if TYPE_CHECKING:
    from collections.abc import Mapping

_E1, _E2, _E3, _E4, _E5 = Point.OPERATOR, Point.AGENT, Point.CONTEXT, Point.TOOL, Point.ACTUATION
_DETECT, _PREVENT, _CONTAIN = Defence.DETECTION, Defence.PREVENTION, Defence.CONTAINMENT

CATALOG: Final = (
    CatalogRow(
        id="AID-1",
        name="agent authentication",
        must_hold=(
            "The caller is registered, active and freshly attested, and proves possession of the leaf holder's key."
        ),
        points=frozenset({_E1, _E2, _E4, _E5}),
        evidence=("chain", "proof"),
        decides=identity.AgentAuthentication,
        meaning_is_ours=True,
    ),
    CatalogRow(
        id="AID-2",
        name="human root",
        must_hold=(
            "The chain starts at an authenticated, active human principal, authenticated recently enough for the tier."
        ),
        points=frozenset({_E1, _E2, _E4, _E5}),
        evidence=("chain", "tool", "impact"),
        decides=identity.HumanRoot,
        meaning_is_ours=True,
    ),
    CatalogRow(
        id="AID-3",
        name="link validity",
        must_hold=(
            "Every link is signed by a trusted attester, unexpired and unrevoked, on a revocation view fresh for "
            "the act."
        ),
        points=frozenset({_E2, _E4, _E5}),
        evidence=("chain",),
        decides=identity.LinkValidity,
        meaning_is_ours=True,
    ),
    CatalogRow(
        id="AID-4",
        name="no scope escalation",
        must_hold="No link has more than its parent; an attempt is detected, recorded and refused.",
        points=frozenset({_E2, _E4, _E5}),
        evidence=("chain",),
        counters=((Attack.AC_4, _DETECT), (Attack.AC_4, _PREVENT)),
        decides=identity.NoScopeEscalation,
    ),
    CatalogRow(
        id="AID-5",
        name="bounded chain",
        must_hold="Depth, size, audience and lifetime of the chain are inside their bounds.",
        points=frozenset({_E2, _E4, _E5}),
        evidence=("chain",),
        decides=identity.BoundedChain,
        meaning_is_ours=True,
    ),
    CatalogRow(
        id="CII-1",
        name="operator input authenticity",
        must_hold=(
            "An instruction comes from an authenticated human, is well formed, and its intent digest is bound to "
            "the delegation."
        ),
        points=frozenset({_E1, _E2}),
        evidence=("instruction",),
        counters=((Attack.AC_2, _PREVENT),),
        decides=cognition.OperatorInput,
    ),
    CatalogRow(
        id="CII-2",
        name="instruction isolation",
        must_hold=(
            "Text that is not from a principal carries no authority; instruction-like or hidden text in it is "
            "detected and taints what derives from it."
        ),
        points=frozenset({_E1, _E2, _E3}),
        evidence=("context",),
        counters=((Attack.AC_2, _DETECT), (Attack.AC_3, _DETECT)),
        decides=cognition.InstructionIsolation,
    ),
    CatalogRow(
        id="CII-3",
        name="retrieval integrity",
        must_hold="Retrieved documents are signed by a curator, unmodified and listed in the audited manifest.",
        points=frozenset({_E3}),
        evidence=("context",),
        counters=((Attack.AC_3, _DETECT), (Attack.AC_3, _PREVENT)),
        decides=cognition.RetrievalIntegrity,
    ),
    CatalogRow(
        id="CII-4",
        name="sensor provenance",
        must_hold=(
            "Perception is signed by a registered, calibrated sensor, fresh, in sequence and consistent with "
            "independent evidence, before it can authorise motion."
        ),
        points=frozenset({_E3, _E5}),
        evidence=("perception", "impact"),
        counters=((Attack.AC_1, _DETECT), (Attack.AC_1, _PREVENT)),
        decides=cognition.SensorProvenance,
    ),
    CatalogRow(
        id="CII-5",
        name="memory and tool-response integrity",
        must_hold=(
            "What is written to memory or comes back from a tool has provenance and matches the pinned definition"
            " and the request."
        ),
        points=frozenset({_E3, _E4}),
        evidence=("context", "tool", "impact"),
        counters=((Attack.AC_3, _PREVENT),),
        decides=cognition.ProvenanceOfContent,
    ),
    CatalogRow(
        id="CII-6",
        name="message integrity",
        must_hold=(
            "A message between agents is signed by the delegating holder, in schema, addressed, in sequence, "
            "inside its delegation."
        ),
        points=frozenset({_E2}),
        evidence=("message",),
        counters=((Attack.AC_2, _DETECT),),
        decides=cognition.MessageIntegrity,
    ),
    CatalogRow(
        id="TEA-1",
        name="tool scope",
        must_hold="The operation on the object is granted at every hop.",
        points=frozenset({_E4, _E5}),
        evidence=("chain", "request_fault"),
        counters=((Attack.AC_4, _DETECT),),
        decides=tools.ToolScope,
    ),
    CatalogRow(
        id="TEA-2",
        name="parameter limits",
        must_hold="Every parameter is inside every hop's limits and the robot's own.",
        points=frozenset({_E4, _E5}),
        evidence=("chain", "request_fault", "robot_fault"),
        decides=tools.ParameterLimits,
    ),
    CatalogRow(
        id="TEA-3",
        name="tool identity",
        must_hold="The tool's definition equals its approved pin, and its base tier is registered.",
        points=frozenset({_E4}),
        evidence=("tool",),
        decides=tools.ToolIdentity,
        meaning_is_ours=True,
    ),
    CatalogRow(
        id="TEA-4",
        name="physical impact gate",
        must_hold=(
            "The runtime tier is computed from the live world, is under the token's ceiling, and selects the "
            "effect; actuation bounds follow."
        ),
        points=frozenset({_E4, _E5}),
        evidence=("chain", "tool", "impact"),
        counters=((Attack.AC_1, _PREVENT), (Attack.AC_5, _PREVENT)),
        decides=tools.PhysicalImpactGate,
    ),
    CatalogRow(
        id="TEA-5",
        name="state preconditions",
        must_hold=(
            "Robot mode, safety mode, remote control, exclusive motion lease, payload and frames are what the "
            "command assumes."
        ),
        points=frozenset({_E5}),
        evidence=("robot",),
        decides=tools.StatePreconditions,
        meaning_is_ours=True,
    ),
    CatalogRow(
        id="TEA-6",
        name="sequence coherence",
        must_hold="The command together with what was just done and what is queued stays safe.",
        points=frozenset({_E4, _E5}),
        evidence=("chain", "tool", "impact", "sequence", "opening"),
        counters=((Attack.AC_1, _CONTAIN), (Attack.AC_5, _DETECT), (Attack.AC_5, _PREVENT)),
        decides=sequence.SequenceCoherence,
    ),
    CatalogRow(
        id="CATP-1",
        name="non-transitive trust",
        must_hold=(
            "Trust belongs to one edge; nothing flows along a chain by default; a chain is as trusted as its "
            "weakest edge."
        ),
        points=frozenset({_E2, _E4, _E5}),
        evidence=("chain", "trust"),
        counters=((Attack.AC_2, _CONTAIN),),
        decides=propagation.NonTransitiveTrust,
    ),
    CatalogRow(
        id="CATP-2",
        name="scope narrowing",
        must_hold="A delegation is strictly narrower than what it comes from.",
        points=frozenset({_E2, _E4, _E5}),
        evidence=("chain",),
        counters=((Attack.AC_2, _CONTAIN), (Attack.AC_4, _PREVENT)),
        decides=propagation.ScopeNarrowing,
    ),
    CatalogRow(
        id="CATP-3",
        name="dynamic trust",
        must_hold=(
            "Trust in the chain, from history, anomalies and time, is enough for the tier; the score only ever "
            "tightens."
        ),
        points=frozenset({_E2, _E4, _E5}),
        evidence=("trust", "tool", "impact"),
        counters=((Attack.AC_4, _CONTAIN),),
        decides=propagation.DynamicTrust,
    ),
    CatalogRow(
        id="CATP-4",
        name="boundary re-attestation",
        must_hold="Each boundary re-attests the delegate; malformed or unauthorised delegations are refused.",
        points=frozenset({_E2, _E4, _E5}),
        evidence=("chain",),
        counters=((Attack.AC_2, _PREVENT),),
        decides=propagation.BoundaryAttestation,
    ),
    CatalogRow(
        id="ABG-1",
        name="behavioural baseline",
        must_hold=(
            "Over a window, tool use, parameters and rates conform to the agent's baseline; a deviation defers "
            "the next act."
        ),
        points=frozenset({_E4, _E5}),
        evidence=("chain", "behaviour"),
        counters=((Attack.AC_3, _CONTAIN), (Attack.AC_5, _CONTAIN)),
        decides=governance.BehaviouralBaseline,
    ),
    CatalogRow(
        id="ABG-2",
        name="drift containment",
        must_hold="Near-boundary and escalating patterns are recognised and contained before a bound is crossed.",
        points=frozenset({_E5}),
        evidence=("chain", "behaviour"),
        counters=((Attack.AC_1, _CONTAIN), (Attack.AC_5, _CONTAIN)),
        decides=governance.DriftContainment,
    ),
    CatalogRow(
        id="ABG-3",
        name="re-verification",
        must_hold="A deviation forces re-attestation before the next physical act.",
        points=frozenset({_E2, _E4, _E5}),
        evidence=("chain", "behaviour"),
        decides=governance.Reverification,
        meaning_is_ours=True,
    ),
    CatalogRow(
        id="ABG-4",
        name="scope contraction",
        must_hold="After a deviation the agent holds the minimum safe set until a human principal restores it.",
        points=frozenset({_E4, _E5}),
        evidence=("chain", "behaviour"),
        counters=((Attack.AC_3, _CONTAIN), (Attack.AC_4, _CONTAIN)),
        decides=governance.ScopeContraction,
    ),
)

"""The 25 rows, in the paper's order."""

ROWS: Final[Mapping[str, CatalogRow]] = MappingProxyType({row.id: row for row in CATALOG})
"""Rows by id."""
