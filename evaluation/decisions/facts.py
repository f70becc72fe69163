"""Facts of a case, plain: the one source of our evidence and of every engine's attributes.

Ages and the runtime tier are ready numbers: no engine has to compute them, and ours computes them from the readings.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from itertools import count
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final

from evaluation.decisions import readings as made
from evaluation.decisions.readings import AGENTS, HOPS, NEVER, VERIFIED, names_of
from evaluation.tokens.peers import lending as tokens
from evaluation.tokens.workload import OBJECT, REALISTIC, quantities
from policies import NOT_COLLECTED, Evidence, Point, Request

if TYPE_CHECKING:
    from collections.abc import Mapping

    from evaluation.decisions.readings import Fact, Facts

ORDINARY: Final[Mapping[str, Fact]] = MappingProxyType(
    {
        "agent": AGENTS[-1],
        "operation": "move_joint",
        "points": frozenset({"e4", "e5"}),
        # authority
        "chain": VERIFIED,
        "proof": VERIFIED,
        "sponsor": "alice",
        "issuer": tokens.ISSUER,
        "sponsor_age_s": 600,
        "leaf_attestation_age_s": 60,
        "oldest_attestation_age_s": 500,
        "valid_since_s": 60,
        "valid_for_s": 3_000,
        "view_age_ms": 100,
        "audience": tokens.SERVER,
        "audiences": frozenset({tokens.SERVER}),
        "delegations": HOPS - 1,
        "ceiling": 3,
        # scope and tool
        "request_fault": "none",
        "robot_fault": "none",
        "approved_digest": "a5" * 32,
        "actual_digest": "a5" * 32,
        "base_tier": 1,
        # trust
        "trust_permille": 800,
        "least_edge_permille": 800,
        "edges_of_chain": True,
        # physics
        "impact": "computed",
        "impact_tier": 1,
        "index_milli": 900,
        "violations": frozenset(),
        "perception": "fresh",
        "sensors": frozenset({"fresh"}),
        # the robot
        "robot_mode": 7,
        "safety_mode": 1,
        "remote_control": True,
        "exclusive": True,
        "payload_g": 1_200,
        "expected_payload_g": 1_200,
        "frames_match": True,
        # earlier acts
        "unfinished": False,
        "held_known": True,
        "drift_urad": 100,
        "alternations": 0,
        "sequence_tier": 1,
        "behaviour_of": AGENTS[-1],
        "behaviour_age_ms": 200,
        "deviations": frozenset(),
        "deviated_ago_s": NEVER,
        "contracted": False,
        # origins of the arguments
        "unnamed_arguments": 0,
        "integrities": frozenset({"AGENT"}),
    }
)
"""A move that is permitted: four hops, a small motion, an empty cell."""

OF_READING: Final[Mapping[str, tuple[str, ...]]] = MappingProxyType(
    {
        "trust": ("trust_permille", "least_edge_permille", "edges_of_chain"),
        "impact": ("impact", "impact_tier", "index_milli", "violations", "perception"),
        "perception": ("sensors",),
        "robot": (
            "robot_mode", "safety_mode", "remote_control", "exclusive", "payload_g", "expected_payload_g",
            "frames_match",
        ),
        "robot_fault": ("robot_fault",),
        "request_fault": ("request_fault",),
        "sequence": ("unfinished", "held_known", "drift_urad", "alternations", "sequence_tier"),
        "behaviour": ("behaviour_of", "behaviour_age_ms", "deviations", "deviated_ago_s", "contracted"),
        "context": ("unnamed_arguments", "integrities"),
    }
)  # fmt: skip
"""Facts of each reading that may be absent; a reading that no policy looks at is given to no engine."""


@dataclass(frozen=True, slots=True)
class Situation:
    """One case to decide, in both forms.

    Attributes:
        request, evidence: for us.
        facts: for everybody else; the same.
    """

    request: Request
    evidence: Evidence
    facts: Facts


_SERIAL: Final = count(1)


def situation(changes: Mapping[str, Fact], readings: frozenset[str]) -> Situation:
    """The ordinary case with `changes`, in values that no earlier call had.

    Args:
        changes: facts that differ.
        readings: names of the members of `Evidence` that are collected, beside chain, proof and tool.
    """
    serial = next(_SERIAL)
    # a view of another age and a request of another name each time: no answer could be a remembered one
    facts = {**ORDINARY, "view_age_ms": 100 + serial % 100, **changes}
    operation = str(facts["operation"])
    values = quantities(REALISTIC, REALISTIC.values) if operation == REALISTIC.operation else ()
    request = Request(
        request_id=f"request-{serial}",
        points=frozenset(Point(point) for point in names_of(facts, "points")),
        audience=str(facts["audience"]),
        object=OBJECT,
        operation=operation,
        values=values,
        at=float(tokens.NOW),
    )
    everything = made.evidence(made.Reader(facts), request)
    kept = {"at", "at_ms", "chain", "proof", "tool", "approval", "opening", *readings}
    absent: dict[str, Any] = {f.name: NOT_COLLECTED for f in fields(everything) if f.name not in kept}
    evidence = replace(everything, **absent)
    withheld = {name for reading, names in OF_READING.items() if reading not in readings for name in names}
    return Situation(request, evidence, _given({k: v for k, v in facts.items() if k not in withheld}))


def _given(facts: Facts) -> Facts:
    """Facts with the values that are computed for the engines."""
    given = {**facts, "lifetime_s": _int(facts, "valid_since_s") + _int(facts, "valid_for_s")}
    given["newest_attestation_age_s"] = min(
        _int(facts, "leaf_attestation_age_s"), _int(facts, "oldest_attestation_age_s")
    )
    given["tier"] = _int(facts, "base_tier")
    if "impact_tier" in facts:
        unseen = 0 if facts["perception"] == "fresh" else 3
        given["tier"] = max(_int(facts, "base_tier"), _int(facts, "impact_tier"), unseen)
    return given


def _int(facts: Mapping[str, Fact], name: str) -> int:
    value = facts[name]
    assert isinstance(value, int)
    return value
