"""What is known of a case, as plain facts: the one source of our evidence and of every engine's attributes.

Ages and the runtime tier are ready numbers: no engine has to compute them, and ours computes them from the readings.
"""

from __future__ import annotations

from dataclasses import dataclass, fields, replace
from itertools import count
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final

from capabilities import Chain, Fault, Sponsor, Tier
from capabilities.chain import Attestation, EvidenceKind, Hop, Refusal
from capabilities.errors import FaultCode
from capabilities.scope import Range
from capabilities.units import Unit
from evaluation.bench import tokens
from evaluation.bench.workload import OBJECT, REALISTIC, quantities
from policies import NOT_COLLECTED, Contribution, Evidence, ImpactFault, ImpactReading, Point, Request, RobotReading
from policies.conduct import BehaviourReading, Deviation, Feature, SequenceReading
from policies.evidence import EdgeReading, PerceptionReading, SensorReading, ToolReading, TrustReading
from policies.labels import Integrity, Label, Source
from policies.said import ArgumentReading, ContextReading

if TYPE_CHECKING:
    from collections.abc import Mapping

Fact = str | int | bool | frozenset[str]
Facts = dict[str, Fact]

HOPS: Final = 4
"""Of the chain: the sponsor's, and three delegations."""
AGENTS: Final = tuple(f"agent-{hop}" for hop in range(HOPS))
EDGES: Final = tuple(zip(("alice", *AGENTS), AGENTS, strict=False))
VERIFIED: Final = "verified"
NEVER: Final = 10**9
"""Seconds since something that never happened."""

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
        # what was done before
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
        # what the arguments derive from
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
"""The facts of each reading that is not always there; what no policy looks at is not given to anybody."""


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
        points=frozenset(Point(point) for point in _names(facts, "points")),
        audience=str(facts["audience"]),
        object=OBJECT,
        operation=operation,
        values=values,
        at=float(tokens.NOW),
    )
    everything = _evidence(_Reader(facts), request)
    kept = {"at", "at_ms", "chain", "proof", "tool", "approval", "opening", *readings}
    absent: dict[str, Any] = {f.name: NOT_COLLECTED for f in fields(everything) if f.name not in kept}
    evidence = replace(everything, **absent)
    withheld = {name for reading, names in OF_READING.items() if reading not in readings for name in names}
    return Situation(request, evidence, _given({k: v for k, v in facts.items() if k not in withheld}))


def _given(facts: Facts) -> Facts:
    """The facts with what is worked out for the engines."""
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


def _names(facts: Mapping[str, Fact], name: str) -> list[str]:
    value = facts[name]
    assert isinstance(value, frozenset)
    return sorted(value)


class _Reader:
    """Facts by their names."""

    def __init__(self, facts: Facts) -> None:
        self._facts = facts

    def __getattr__(self, name: str) -> Any:
        return self._facts[name]

    def fault(self, name: str) -> Fault:
        """A fact that is a code, as the fault of that code."""
        return Fault(FaultCode(str(self._facts[name])), "TOK-3")

    def names(self, name: str) -> list[str]:
        """A fact that is a set, in order."""
        return _names(self._facts, name)


def _evidence(f: _Reader, request: Request) -> Evidence:
    """Every reading, as its facts say."""
    return Evidence(
        at=float(tokens.NOW),
        at_ms=1_000,
        chain=_chain(f) if f.chain == VERIFIED else f.fault("chain"),
        proof=True if f.proof == VERIFIED else f.fault("proof"),
        request_fault=_refusal(f.request_fault),
        robot_fault=_refusal(f.robot_fault),
        tool=ToolReading(request.operation, f.approved_digest, f.actual_digest, Tier(f.base_tier)),
        trust=TrustReading(f.trust_permille, _edges(f)),
        impact=_impact(f) if f.impact == "computed" else ImpactFault(f.impact),
        perception=PerceptionReading(tuple(SensorReading(f"camera-{s}", s, "", 20) for s in f.names("sensors"))),
        robot=RobotReading(
            robot_mode=f.robot_mode,
            safety_mode=f.safety_mode,
            remote_control=f.remote_control,
            exclusive=f.exclusive,
            payload_g=f.payload_g,
            expected_payload_g=f.expected_payload_g,
            frames_match=f.frames_match,
        ),
        sequence=SequenceReading(
            f.unfinished, Tier(f.sequence_tier), 900, f.drift_urad, f.alternations, f.held_known, acts=1
        ),
        behaviour=BehaviourReading(
            agent=f.behaviour_of,
            deviations=tuple(Deviation(Feature(name), tokens.NOW, 1_200) for name in f.names("deviations")),
            deviated_at=None if f.deviated_ago_s == NEVER else tokens.NOW - f.deviated_ago_s,
            contracted=f.contracted,
            samples=1_000,
            age_ms=f.behaviour_age_ms,
        ),
        context=_context(f, request),
        approval=None,  # nobody was asked
        opening=None,
    )


def _chain(f: _Reader) -> Chain:
    """A chain whose first hop has the oldest attestation, and every other one that of the leaf."""
    scope = replace(
        tokens.scope(REALISTIC, 0),
        ceiling=Tier(f.ceiling),
        audiences=f.audiences,
        not_before=tokens.NOW - f.valid_since_s,
        not_after=tokens.NOW + f.valid_for_s,
    )
    count_of_hops = f.delegations + 1
    names = (*AGENTS[:-1], *(f"agent-{n}" for n in range(HOPS, count_of_hops)), AGENTS[-1])
    hops = tuple(
        Hop(
            index=index,
            hop_id=f"{index:032x}",
            agent=agent,
            key=bytes(32),
            delegator="alice" if index == 0 else names[index - 1],
            purpose="pick the red part",
            request_digest=bytes(32),
            attestation=Attestation(
                EvidenceKind.KEY,
                bytes(32),
                tokens.NOW - (f.oldest_attestation_age_s if index == 0 else f.leaf_attestation_age_s),
            ),
            scope=scope,
        )
        for index, agent in enumerate(names)
    )
    return Chain(
        token_id="A" * 22,
        digest=bytes(32),
        sponsor=Sponsor(f.issuer, f.sponsor, "operator-key", tokens.NOW - f.sponsor_age_s),
        root_key_id=tokens.ROOT_ID,
        hops=hops,
        epoch=1,
        view_age_ms=f.view_age_ms,
    )


def _refusal(code: str) -> Refusal | None:
    """A refusal of the request's speed, or None."""
    if code == "none":
        return None
    return Refusal(
        code=FaultCode(code),
        parameter="speed",
        value=1_047_198,
        unit=Unit.MICRORADIAN_PER_SECOND,
        bound=Range(1, 1_047_197),
        nearest=1_047_197,
        hop=0,
        hop_id="0" * 32,
        agent=AGENTS[0],
        sponsor="alice",
    )


def _edges(f: _Reader) -> tuple[EdgeReading, ...]:
    """Trust of each edge of the chain, the last one the least; or of another chain's edges."""
    first, *rest = EDGES if f.edges_of_chain else EDGES[::-1]
    return (EdgeReading(*first, f.least_edge_permille), *(EdgeReading(*edge, 800) for edge in rest))


def _impact(f: _Reader) -> ImpactReading:
    return ImpactReading(
        tier=Tier(f.impact_tier),
        index_milli=f.index_milli,
        violations=tuple(f.names("violations")),
        contributions=(Contribution("speed", f.index_milli, "tool0", "", 400, 600_000, 180_000),),
        lower_tier_speed=None,
        tcp_speed_um_s=180_000,
        contact_permille=0,
        start_urad=(0, -1_570_796, 1_570_796, 0, 0, 0),
        perception=f.perception,
        perception_age_ms=20,
        scene_digest="5c" * 32,
        model_digest="3d" * 32,
        engine="kernel",
    )


def _context(f: _Reader, request: Request) -> ContextReading:
    """Each argument with a label of one of the integrities; the first of them unnamed where that is said."""
    vouched = f.names("integrities")
    arguments = [
        ArgumentReading(
            value.name,
            Label(frozenset({Source.AGENT}), frozenset({AGENTS[-1]}), Integrity[vouched[n % len(vouched)]], 50),
        )
        for n, value in enumerate(request.values)
    ]
    return ContextReading(arguments=tuple(arguments[f.unnamed_arguments :]))
