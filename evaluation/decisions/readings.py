"""Our evidence, made of plain facts."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any, Final

from capabilities import Chain, Fault, Sponsor, Tier
from capabilities.values.chain import Attestation, EvidenceKind, Hop, Refusal
from capabilities.values.errors import FaultCode
from capabilities.values.scope import Range
from capabilities.values.units import Unit
from evaluation.tokens.peers import lending as tokens
from evaluation.tokens.workload import REALISTIC
from policies import Contribution, Evidence, ImpactFault, ImpactReading, RobotReading
from policies.evidence.conduct_readings import BehaviourReading, Deviation, Feature, SequenceReading
from policies.evidence.content_readings import ArgumentReading, ContextReading
from policies.evidence.evidence import EdgeReading, PerceptionReading, SensorReading, ToolReading, TrustReading
from policies.words.labels import Integrity, Label, Source

if TYPE_CHECKING:
    from collections.abc import Mapping

    from policies import Request

Fact = str | int | bool | frozenset[str]
Facts = dict[str, Fact]

HOPS: Final = 4
"""Hops of the chain: the sponsor's, and three delegations."""
AGENTS: Final = tuple(f"agent-{hop}" for hop in range(HOPS))
EDGES: Final = tuple(zip(("alice", *AGENTS), AGENTS, strict=False))
VERIFIED: Final = "verified"
NEVER: Final = 10**9
"""Seconds since something that never happened."""


def names_of(facts: Mapping[str, Fact], name: str) -> list[str]:
    """The members of a fact that is a set, in order."""
    value = facts[name]
    assert isinstance(value, frozenset)
    return sorted(value)


class Reader:
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
        return names_of(self._facts, name)


def evidence(f: Reader, request: Request) -> Evidence:
    """Every reading, as its facts say. Nobody was asked."""
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


def _chain(f: Reader) -> Chain:
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


def _edges(f: Reader) -> tuple[EdgeReading, ...]:
    """Trust of each edge of the chain, the last one the least; or of another chain's edges."""
    first, *rest = EDGES if f.edges_of_chain else EDGES[::-1]
    return (EdgeReading(*first, f.least_edge_permille), *(EdgeReading(*edge, 800) for edge in rest))


def _impact(f: Reader) -> ImpactReading:
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


def _context(f: Reader, request: Request) -> ContextReading:
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
