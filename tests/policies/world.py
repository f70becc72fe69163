"""Builds requests, evidence and cases from the plain documents of tests/vectors/primitives."""

import copy
import tomllib
from dataclasses import replace
from pathlib import Path

from capabilities.values.chain import Attestation, Chain, EvidenceKind, Hop, Refusal, Sponsor
from capabilities.values.errors import Fault, FaultCode
from capabilities.values.scope import Grant, Limit, OneOf, Range, Scope, Tier
from capabilities.values.units import Parameter, Quantity, Unit
from policies.decision.load import load_shipped
from policies.evidence.conduct_readings import BehaviourReading, Deviation, Feature, SequenceReading
from policies.evidence.content_readings import (
    ArgumentReading,
    ContextReading,
    InstructionReading,
    ItemKind,
    ItemReading,
    MessageReading,
)
from policies.evidence.evidence import (
    NOT_COLLECTED,
    ApprovalReading,
    Contribution,
    EdgeReading,
    Evidence,
    ImpactFault,
    ImpactReading,
    OpeningReading,
    PerceptionReading,
    RobotReading,
    SensorReading,
    ToolReading,
    TrustReading,
)
from policies.evidence.model import Point, Request
from policies.evidence.tiers import runtime_tier
from policies.primitives.base import Case
from policies.words.labels import Integrity, Label, Source

VECTORS = Path(__file__).parents[1] / "vectors" / "primitives"
WORLD = tomllib.loads((VECTORS / "world.toml").read_text("utf-8"))

GRANTS = (
    Grant(
        "ur3e",
        "move_joint",
        (
            Limit(Parameter("q0", Unit.MICRORADIAN), Range(-3_000_000, 3_000_000)),
            Limit(Parameter("speed", Unit.MICRORADIAN_PER_SECOND), Range(0, 1_000_000)),
        ),
    ),
    Grant("ur3e", "read_state"),
)


def changed(given=None):
    """A copy of the ordinary case with `given` written over it."""
    world = copy.deepcopy(WORLD)
    for path, value in (given or {}).items():
        where = world
        *steps, last = path.split(".")
        for step in steps:
            where = where[int(step)] if isinstance(where, list) else where[step]
        if isinstance(where, list):
            where[int(last)] = value
        else:
            assert last in where or path in {"evidence.proof"}, f"{path} is not in world.toml"
            where[last] = value
    return world


def bound(plain):
    match plain:
        case None | "none":
            return None
        case {"one_of": values}:
            return OneOf(frozenset(values))
        case {"low": low, "high": high}:
            return Range(low, high)


def fault(plain):
    return Fault(FaultCode(plain["fault"]), plain.get("clause", "TOK-0"), plain.get("detail", ""))


def refusal(plain):
    if plain == "none":
        return None
    if plain == "not collected":
        return NOT_COLLECTED
    if "fault" in plain:
        return fault(plain)
    rest = {k: plain[k] for k in ("parameter", "value", "nearest", "hop", "hop_id", "agent", "sponsor") if k in plain}
    if "unit" in plain:
        rest["unit"] = Unit(plain["unit"])
    return Refusal(FaultCode(plain["refusal"]), bound=bound(plain.get("bound")), **rest)


def chain(plain):
    if plain == "not collected":
        return NOT_COLLECTED
    if "fault" in plain:
        return fault(plain)
    hops = tuple(
        Hop(
            index=i,
            hop_id=h["hop_id"],
            agent=h["agent"],
            key=bytes([i]) * 32,
            delegator=h["delegator"],
            purpose="test",
            request_digest=bytes(32),
            attestation=Attestation(EvidenceKind.KEY, bytes(32), h["attested_at"]),
            scope=Scope(
                grants=GRANTS,
                ceiling=Tier(h["ceiling"]),
                audiences=frozenset(h["audiences"]),
                delegates=frozenset(),
                depth=1,
                not_before=h["not_before"],
                not_after=h["not_after"],
            ),
        )
        for i, h in enumerate(plain["hops"])
    )
    return Chain(
        token_id=plain["token_id"],
        digest=bytes(32),
        sponsor=Sponsor(**plain["sponsor"]),
        root_key_id=plain["root_key_id"],
        hops=hops,
        epoch=plain["epoch"],
        view_age_ms=plain["view_age_ms"],
    )


def none(value):
    return None if value == "none" else value


def tool(plain):
    if plain == "not collected":
        return NOT_COLLECTED
    base = none(plain["base_tier"])
    return ToolReading(
        plain["name"], none(plain["approved_digest"]), plain["actual_digest"], None if base is None else Tier(base)
    )


def impact(plain):
    if plain == "not collected":
        return NOT_COLLECTED
    if "fault" in plain:
        return ImpactFault(plain["fault"], plain.get("detail", ""))
    return ImpactReading(
        **{
            **plain,
            "tier": Tier(plain["tier"]),
            "violations": tuple(plain["violations"]),
            "contributions": tuple(Contribution(**c) for c in plain["contributions"]),
            "lower_tier_speed": none(plain["lower_tier_speed"]),
            "start_urad": tuple(plain["start_urad"]),
            "perception_age_ms": none(plain["perception_age_ms"]),
        }
    )


def perception(plain):
    if plain == "not collected":
        return NOT_COLLECTED
    return PerceptionReading(tuple(SensorReading(**{**s, "age_ms": none(s["age_ms"])}) for s in plain["sensors"]))


def robot(plain):
    if plain == "not collected":
        return NOT_COLLECTED
    return RobotReading(**{key: None if value == "unknown" else value for key, value in plain.items()})


def approval(plain):
    if isinstance(plain, str):
        return None if plain == "none" else NOT_COLLECTED
    return ApprovalReading(
        **{
            **plain,
            "tier": Tier(plain["tier"]),
            "reasons": frozenset(plain["reasons"]),
            "contributors": frozenset(map(tuple, plain["contributors"])),
            "start_urad": tuple(plain["start_urad"]),
            "approvers": tuple(plain["approvers"]),
        }
    )


def opening(plain):
    if isinstance(plain, str):
        return None if plain == "none" else NOT_COLLECTED
    return OpeningReading(**plain)


def trust(plain):
    if plain == "not collected":
        return NOT_COLLECTED
    return TrustReading(plain["score_permille"], tuple(EdgeReading(**edge) for edge in plain["edges"]))


def said(kind, plain):
    return NOT_COLLECTED if plain == "not collected" else kind(**{key: none(value) for key, value in plain.items()})


def label(plain):
    sources = frozenset(Source(source) for source in plain["sources"])
    rest = {**plain, "sources": sources, "signers": frozenset(plain["signers"])}
    return Label(**{**rest, "integrity": Integrity(plain["integrity"])})


def item(plain):
    rest = {key: none(value) for key, value in plain.items()}
    return ItemReading(
        **{**rest, "kind": ItemKind(plain["kind"]), "label": label(plain["label"]), "signs": tuple(plain["signs"])}
    )


def context(plain):
    if plain == "not collected":
        return NOT_COLLECTED
    arguments = (ArgumentReading(each["name"], label(each["label"]), each["fault"]) for each in plain["arguments"])
    return ContextReading(tuple(map(item, plain["items"])), tuple(arguments))


def sequence(plain):
    if plain == "not collected":
        return NOT_COLLECTED
    tier = none(plain["tier"])
    rest = {**plain, "index_milli": none(plain["index_milli"]), "tier": None if tier is None else Tier(tier)}
    return SequenceReading(**rest)


def behaviour(plain):
    if plain == "not collected":
        return NOT_COLLECTED
    odd = (Deviation(**{**each, "feature": Feature(each["feature"])}) for each in plain["deviations"])
    return BehaviourReading(**{**plain, "deviations": tuple(odd), "deviated_at": none(plain["deviated_at"])})


def proof(plain):
    if plain == "not collected":
        return NOT_COLLECTED
    return fault(plain) if isinstance(plain, dict) else plain


def request(plain):
    return Request(
        **{
            **plain,
            "points": frozenset(Point(p) for p in plain["points"]),
            "values": tuple(Quantity(v["name"], Unit(v["unit"]), v["value"]) for v in plain["values"]),
        }
    )


def evidence(plain):
    return Evidence(
        at=plain["at"],
        at_ms=plain["at_ms"],
        chain=chain(plain["chain"]),
        proof=proof(plain["proof"]),
        request_fault=refusal(plain["request_fault"]),
        robot_fault=refusal(plain["robot_fault"]),
        tool=tool(plain["tool"]),
        trust=trust(plain["trust"]),
        impact=impact(plain["impact"]),
        perception=perception(plain["perception"]),
        robot=robot(plain["robot"]),
        approval=approval(plain["approval"]),
        opening=opening(plain["opening"]),
        instruction=said(InstructionReading, plain["instruction"]),
        message=said(MessageReading, plain["message"]),
        context=context(plain["context"]),
        sequence=sequence(plain["sequence"]),
        behaviour=behaviour(plain["behaviour"]),
    )


def put(whole, steps, value):
    """Copy of `whole` with `value`, of any type, at this place."""
    if not steps:
        return value
    first, *rest = steps
    if isinstance(whole, tuple):
        return tuple(put(each, rest, value) if n == int(first) else each for n, each in enumerate(whole))
    return replace(whole, **{first: put(getattr(whole, first), rest, value)})


def asked(given=None, raw=None):
    """Request and evidence; `raw` is put into them as it is, once they are made."""
    world = changed(given)
    both = {"request": request(world["request"]), "evidence": evidence(world["evidence"])}
    for path, value in (raw or {}).items():
        first, *steps = path.split(".")
        both[first] = put(both[first], steps, value)
    return both["request"], both["evidence"]


def case(given=None):
    one, readings = asked(given)
    physical = changed(given)["physical"]
    return Case(one, readings, physical, runtime_tier(readings, physical=physical))


OPENING = {"opening_id": "0b" * 16, "opener": "carol", "uses_left": 1, "not_after": 1_000_600, "age_ms": 100}


def approved(at_tier, /, **changes):
    """Request, evidence and the shipped set: a move of this tier with its approval, but for `changes`."""
    policies = load_shipped("paper-default")
    given = {"evidence.impact.tier": int(at_tier), "evidence.impact.index_milli": 1000 * at_tier - 500, "evidence.chain.hops": [
        {**hop, "ceiling": int(at_tier)} for hop in WORLD["evidence"]["chain"]["hops"]
    ]}  # fmt: skip
    if at_tier == 4:
        given["evidence.opening"] = OPENING
    request, seen = asked(given)
    reading = ApprovalReading(
        ask_id="a5" * 16,
        state="granted",
        reasons=frozenset({"TIER_NEEDS_APPROVAL", "TIER_SAFETY_CRITICAL", "SEQUENCE_NEEDS_APPROVAL"}),
        tier=Tier(at_tier),
        index_milli=seen.impact.index_milli,
        contributors=frozenset((c.kind, c.object) for c in seen.impact.contributions),
        start_urad=seen.impact.start_urad,
        model_digest=seen.impact.model_digest,
        policy_digest=policies.digest,
        approvers=("alice", "bob"),
        sponsor="alice",
        opening_id=OPENING["opening_id"] if at_tier == 4 else "",
        sees_clear=True,
        uses_left=1,
        use=1,
        not_after=1_000_120,
        age_ms=100,
    )
    return request, replace(seen, approval=replace(reading, **changes)), policies
