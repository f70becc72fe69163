"""Random requests, evidence and policy sets, from tables that sit on every boundary. `pick(options)` chooses; who chooses is the caller's."""

from dataclasses import replace

from capabilities.values.chain import Attestation, Chain, EvidenceKind, Hop, Refusal, Sponsor
from capabilities.values.errors import Fault, FaultCode
from capabilities.values.scope import Range, Scope, Tier
from capabilities.values.units import Quantity, Unit
from policies.decision.combine import AllOf, Always, AnyOf, Check, Not
from policies.evidence.conduct_readings import BehaviourReading, Deviation, Feature, SequenceReading
from policies.evidence.content_readings import (
    ArgumentReading,
    ContextReading,
    InstructionReading,
    ItemKind,
    ItemReading,
    MessageReading,
)
from policies.evidence.evidence import EdgeReading, PerceptionReading, SensorReading
from policies.words.labels import Integrity, Label, Source

from policies import (
    NOT_COLLECTED,
    ROWS,
    ApprovalReading,
    Contribution,
    Effect,
    Evidence,
    ImpactFault,
    ImpactReading,
    Object,
    Obligation,
    ObligationKind,
    OpeningReading,
    Parameters,
    Point,
    Policy,
    PolicySet,
    Reason,
    Request,
    RobotReading,
    Subject,
    ToolReading,
    TrustReading,
    decide,
)

NOW = 1_000_000
STRANGE = 20
"""Number of values of which one is strange.

A triple has about fifteen, and one strange value is enough for a denial.
"""
RECORD = Obligation(ObligationKind.RECORD)


def mostly(pick, ordinary, strange):
    return pick(list(strange)) if pick(range(STRANGE)) == 0 else ordinary


def request(pick):
    return Request(
        request_id="r",
        points=frozenset(
            pick(
                [
                    *([(Point.TOOL, Point.ACTUATION)] * 12),
                    *([tuple(Point)] * 3),
                    *([(Point.OPERATOR, Point.AGENT, Point.CONTEXT)] * 3),
                    *[(point,) for point in Point],
                ]
            )
        ),
        audience=mostly(pick, "https://a/", ["https://b/"]),
        object=mostly(pick, "ur3e", ["ur5e"]),
        operation=mostly(pick, "move_joint", ["gripper_move", "read_state", "stop", "dance"]),
        values=(Quantity("speed", Unit.MICRORADIAN_PER_SECOND, pick([0, 400_000])),),
        at=float(NOW),
    )


def fault(pick):
    return Fault(pick(list(FaultCode)), pick(["TOK-1", "PRF-2"]), pick(["", "sponsor:alice", "hop:1"]))


def chain(pick):
    count = mostly(pick, 2, [1, 3, 9, 10])
    ages = [0, 3_600, 3_601, -5, -6, 86_400, 86_401]
    window = mostly(pick, 3_600, [86_400, 86_401])
    start = mostly(pick, NOW - 600, [NOW, NOW + 1, NOW - window])
    ceiling = Tier.SAFETY_CRITICAL
    hops = []
    for i in range(count):
        ceiling = min(ceiling, mostly(pick, pick([Tier.HIGH_CONSEQUENCE, Tier.SAFETY_CRITICAL]), list(Tier)))
        hops.append(
            Hop(
                index=i,
                hop_id=f"{i:032x}",
                agent=mostly(pick, "robotic", ["vision"]),
                key=bytes(32),
                delegator="alice",
                purpose="",
                request_digest=bytes(32),
                attestation=Attestation(EvidenceKind.KEY, bytes(32), NOW - mostly(pick, 60, ages)),
                scope=Scope((), ceiling, frozenset({"https://a/"}), frozenset(), 0, start, start + window),
            )
        )
    sponsor_age = mostly(
        pick, 300, [0, -5, -6, 900, 901, 3_600, 3_601, 28_800, 28_801, 86_400, 86_401, 604_800, 604_801]
    )
    sponsor = Sponsor("https://idp/", mostly(pick, "alice", ["bob", ""]), "operator-key", NOW - sponsor_age)
    age = mostly(pick, 100, [-1, 0, 2_000, 2_001, 30_000, 30_001])
    return Chain("t", bytes(32), sponsor, 1, tuple(hops), 1, age)


def refusal(pick):
    return Refusal(
        pick(list(FaultCode)),
        parameter=pick([None, "speed"]),
        value=7,
        unit=Unit.COUNT,
        bound=pick([None, Range(0, 5)]),
        nearest=5,
        hop=pick([None, 0]),
    )


def impact(pick):
    return ImpactReading(
        tier=pick([Tier(1), Tier(1), Tier(2), Tier(2), Tier(3), Tier(3), Tier(4)]),
        index_milli=mostly(pick, 1_500, [0, 4_000, 4_001, -1]),
        violations=mostly(pick, (), [("person",), ("zone", "self")]),
        contributions=pick([(), (Contribution("person", 1_500, "wrist", "p1", 10, 20, 30),)]),
        lower_tier_speed=pick([None, 10]),
        tcp_speed_um_s=mostly(pick, pick([0, 250_000]), [250_001]),
        contact_permille=mostly(pick, pick([0, 1_000]), [1_001]),
        start_urad=pick([(), (0,) * 6]),
        perception=mostly(pick, "fresh", ["stale", "missing", "", "Fresh"]),
        perception_age_ms=pick([None, 50]),
        scene_digest="s",
        model_digest="m",
        engine="numpy",
    )


def perception(pick):
    states = [
        ("fresh", ""),
        ("stale", ""),
        ("missing", ""),
        ("invalid", "UNTRUSTED"),
        ("invalid", ""),
        ("Fresh", ""),
        ("", ""),
    ]
    sensors = [("camera-1", mostly(pick, ("fresh", ""), states)) for _ in range(mostly(pick, 1, [0, 2]))]
    return PerceptionReading(tuple(SensorReading(name, *state, pick([None, 50])) for name, state in sensors))


def robot(pick):
    return RobotReading(
        robot_mode=mostly(pick, 7, [-1, 5, 6, 8]),
        safety_mode=mostly(pick, 1, [0, 2, 3, 4, 7]),
        remote_control=mostly(pick, True, [False, None]),
        exclusive=mostly(pick, True, [False]),
        payload_g=mostly(pick, 1_000, [999, 1_001, 0]),
        expected_payload_g=mostly(pick, 1_000, [None, 999]),
        frames_match=mostly(pick, True, [False]),
    )


APPROVAL = ApprovalReading(
    "a" * 32, "granted", frozenset(), Tier(3), 0, frozenset(), (), "m", "", (), "alice", "", False, 1, 1, 0, 0
)
"""Stands for "one that fits, mostly": `approved` fills it in once the rest of the case is known."""


def opening(pick):
    return OpeningReading(
        mostly(pick, "o", ["p"]),
        "bob",
        mostly(pick, 1, [0]),
        NOW + mostly(pick, 60, [0, -1]),
        mostly(pick, 0, [2_000, 2_001, -1]),
    )


def approved(pick, seen, policies, tier):
    """The evidence with an approval that fits the case but for a few members."""
    if seen.approval is not APPROVAL:
        return seen
    impact_reading = seen.impact if isinstance(seen.impact, ImpactReading) else None
    shown = 1_500 if impact_reading is None else impact_reading.index_milli
    asked = ["TIER_NEEDS_APPROVAL", "PERCEPTION_MISSING", "TRUST_TOO_LOW", "APPROVAL_REQUIRED", "TIER_SAFETY_CRITICAL"]
    reading = ApprovalReading(
        ask_id="a" * 32,
        state=pick(["granted"] * 14 + ["open", "denied", "used", "withdrawn", "expired", "nonsense"]),
        reasons=mostly(pick, frozenset(asked), [frozenset(asked) - {pick(asked)}]),
        tier=mostly(pick, Tier(3) if tier is None else tier, list(Tier)),
        index_milli=shown - mostly(pick, pick([0, 50, -100]), [51]),
        contributors=mostly(
            pick, frozenset({("person", "p1"), ("rigid", "box")}), [frozenset(), frozenset({("person", "p2")})]
        ),
        start_urad=mostly(
            pick,
            () if impact_reading is None else tuple(x + pick([0, 2_000, -2_000]) for x in impact_reading.start_urad),
            [(0,) * 5, (2_001,) + (0,) * 5, (0,) * 5 + (-2_001,), ()],
        ),
        model_digest=mostly(pick, "m", ["n"]),
        policy_digest=mostly(pick, policies.digest, [""]),
        approvers=mostly(pick, ("bob", "carol"), [("alice",), ("bob",), ("alice", "bob"), ("bob", "bob"), ()]),
        sponsor=mostly(pick, "alice", ["bob"]),
        opening_id=mostly(pick, "o", ["", "p"]),
        sees_clear=pick([True, True, False]),
        uses_left=mostly(pick, 1, [0, 2]),
        use=1,
        not_after=NOW + mostly(pick, 60, [0, -1]),
        age_ms=mostly(pick, 100, [0, 2_000, 2_001, -1]),
    )
    return replace(seen, approval=reading)


def triple(pick):
    """Request, evidence and policy set; the evidence may hold an approval that was given for this very case."""
    asked, seen, policies = request(pick), evidence(pick), policy_set(pick)
    return asked, approved(pick, seen, policies, decide(asked, seen, policies).tier), policies


def instruction(pick):
    return InstructionReading(
        fault=mostly(pick, "", ["SIGNATURE_INVALID"]),
        principal=mostly(pick, "alice", [""]),
        signed_at=NOW - mostly(pick, 60, [-5, -6, 3_600, 3_601]),
        well_formed=mostly(pick, True, [False]),
        intent_digest=mostly(pick, "dd", [""]),
        bound_digest=mostly(pick, "dd", ["", "DD"]),
    )


def message(pick):
    truths = [mostly(pick, True, [False]) for _ in range(5)]
    age_s = mostly(pick, 5, [-5, -6, 60, 61, None])
    return MessageReading(mostly(pick, "", ["STATEMENT_MALFORMED"]), "vision", "robotic", *truths, age_s)


def label(pick):
    integrity = mostly(pick, pick([Integrity.SENSED, Integrity.PRINCIPAL]), list(Integrity))
    return Label(frozenset({pick(list(Source))}), frozenset(), integrity, 10, mostly(pick, False, [True]))


def item(pick):
    return ItemReading(
        kind=pick(list(ItemKind)),
        id="i",
        label=label(pick),
        signs=mostly(pick, (), [("hidden text",)]),
        as_authority=mostly(pick, False, [True]),
        fault=mostly(pick, "", ["CHANGED"]),
        listed=mostly(pick, True, [False]),
        manifest_age_s=mostly(pick, 60, [None, -1, 604_800, 604_801]),
        writer_authorised=mostly(pick, True, [False]),
        of_request=mostly(pick, True, [False]),
        of_pin=mostly(pick, True, [False]),
    )


def context(pick):
    names = mostly(pick, ("speed",), [(), ("speed", "q0"), ("q0",)])
    arguments = tuple(ArgumentReading(name, label(pick), mostly(pick, "", ["RECEIPT_UNTRUSTED"])) for name in names)
    return ContextReading(tuple(item(pick) for _ in range(mostly(pick, pick([1, 2]), [0]))), arguments)


def sequence(pick):
    return SequenceReading(
        unfinished=mostly(pick, False, [True]),
        tier=mostly(pick, pick([Tier(1), Tier(2)]), [None, *Tier]),
        index_milli=mostly(pick, 900, [None]),
        drift_urad=mostly(pick, 0, [-1, 20_000, 20_001]),
        alternations=mostly(pick, 0, [-1, 6, 7]),
        held_known=mostly(pick, True, [False]),
        acts=1,
    )


def behaviour(pick):
    odd = mostly(pick, (), [tuple(Deviation(feature, NOW - 9, 1_100) for feature in Feature if pick([True, False]))])
    return BehaviourReading(
        agent=mostly(pick, "robotic", ["vision"]),
        deviations=odd,
        deviated_at=mostly(pick, None, [NOW - 61, NOW - 60, NOW]),
        contracted=mostly(pick, False, [True]),
        samples=pick([0, 500]),
        age_ms=mostly(pick, 100, [-1, 0, 5_000, 5_001]),
    )


def trust(pick, known):
    """A reading for a chain: mostly of its very edges."""
    score = mostly(pick, pick([699, 700, 800]), [0, 701, 1_000, 1_001, -1])
    hops = known.hops if isinstance(known, Chain) else ()
    edges = tuple(EdgeReading(h.delegator, h.agent, mostly(pick, 800, [-1, 0, 700, 801])) for h in hops)
    return TrustReading(score, mostly(pick, edges, [(), edges[1:], (*edges, EdgeReading("a", "b", 800))]))


def evidence(pick):
    faults = [*Reason, "", "nonsense"]
    known = mostly(pick, chain(pick), [fault(pick), NOT_COLLECTED])
    return Evidence(
        at=float(NOW),
        at_ms=5,
        chain=known,
        proof=mostly(pick, True, [False, fault(pick), NOT_COLLECTED]),
        request_fault=mostly(pick, None, [refusal(pick), fault(pick), NOT_COLLECTED]),
        robot_fault=mostly(pick, None, [refusal(pick), NOT_COLLECTED]),
        tool=mostly(
            pick,
            ToolReading("t", "aa", "aa", mostly(pick, Tier(1), list(Tier))),
            [
                ToolReading("t", "aa", "bb", Tier(1)),
                ToolReading("t", None, "aa", None),
                ToolReading("t", "", "", Tier(0)),
                NOT_COLLECTED,
            ],
        ),
        trust=mostly(pick, trust(pick, known), [NOT_COLLECTED]),
        impact=mostly(pick, impact(pick), [ImpactFault(str(pick(faults))), NOT_COLLECTED]),
        perception=mostly(pick, perception(pick), [NOT_COLLECTED]),
        robot=mostly(pick, robot(pick), [NOT_COLLECTED]),
        approval=pick([None, NOT_COLLECTED, APPROVAL, APPROVAL]),
        opening=mostly(pick, pick([None, opening(pick), opening(pick)]), [NOT_COLLECTED]),
        instruction=mostly(pick, instruction(pick), [NOT_COLLECTED]),
        message=mostly(pick, message(pick), [NOT_COLLECTED]),
        context=mostly(pick, context(pick), [NOT_COLLECTED]),
        sequence=mostly(pick, sequence(pick), [NOT_COLLECTED]),
        behaviour=mostly(pick, behaviour(pick), [NOT_COLLECTED]),
    )


def check(pick, points, *, gate):
    rows = [row for row in ROWS.values() if points <= row.points and (gate or row.id != "TEA-4")]
    row = pick(rows)
    values = {p.name: p.default for p in row.parameters}
    if row.id == "CATP-3":
        values["trust_theta_permille"] = pick([0, 700, 1_000])
    if row.id == "CII-2":
        values["suspicious_admitted_count"] = pick([0, 1])
    if row.id == "CII-5":
        values["agent_max_tier"], values["recorded_max_tier"] = pick([(0, 2), (1, 2), (1, 4), (4, 4)])
    if row.id == "ABG-4":
        values["contracted_max_tier"] = pick([0, 1, 3])
    return Check(row.make(**values))


def positive(pick, points, depth):
    """A predicate in which every primitive stands under an even number of `not`."""
    kind = pick(["check", "check", "all", "any", "notnot"]) if depth else "check"
    match kind:
        case "check":
            return check(pick, points, gate=False)
        case "all":
            return AllOf(tuple(positive(pick, points, depth - 1) for _ in range(pick([1, 2, 3]))))
        case "any":
            return AnyOf(tuple(positive(pick, points, depth - 1) for _ in range(pick([1, 2, 3]))))
        case "notnot":
            return Not(Not(positive(pick, points, depth - 1)))


def negative(pick, points, depth):
    """The mirror: every primitive under an odd number."""
    kind = pick(["not", "not", "all", "any"]) if depth else "not"
    match kind:
        case "not":
            return Not(positive(pick, points, max(0, depth - 1)))
        case "all":
            return AllOf(tuple(negative(pick, points, depth - 1) for _ in range(pick([1, 2]))))
        case "any":
            return AnyOf(tuple(negative(pick, points, depth - 1) for _ in range(pick([1, 2]))))


def policy(pick, name):
    effect = pick([Effect.PERMIT, Effect.PERMIT, Effect.PERMIT, Effect.DENY, Effect.DEFER])
    points = pick(
        [
            *([frozenset({Point.TOOL}), frozenset({Point.TOOL, Point.ACTUATION}), frozenset({Point.ACTUATION})] * 2),
            *(frozenset({point}) for point in (Point.OPERATOR, Point.AGENT, Point.CONTEXT)),
            frozenset({Point.CONTEXT, Point.TOOL}),
        ]
    )
    pit_bound = None
    if effect is Effect.PERMIT:
        predicate = positive(pick, points, pick([0, 1, 2]))
        if points <= ROWS["TEA-4"].points and pick([True, False]):
            pit_bound = pick([Tier(0), Tier(1), Tier(2), Tier(3), Tier(3), Tier(4)])
            predicate = AllOf((predicate, Check(ROWS["TEA-4"].make())))
    else:
        predicate = mostly(pick, negative(pick, points, pick([0, 1, 2])), [Always()])
    return Policy(
        id=name,
        subject=pick(
            [Subject(), Subject(), Subject(), Subject(frozenset({"robotic"})), Subject(None, frozenset({"alice"}))]
        ),
        object=pick(
            [
                Object(),
                Object(),
                Object(None, None, frozenset({"stop"})),
                Object(frozenset({"ur3e"}), frozenset({"move_joint", "stop"})),
            ]
        ),
        predicate=predicate,
        points=points,
        effect=effect,
        obligations=frozenset({RECORD}),
        pit_bound=pit_bound,
    )


def policy_set(pick):
    return PolicySet(
        "random", 1, tuple(policy(pick, f"p{i}") for i in range(pick([0, 1, 1, 1, 2, 2, 3, 4]))), Parameters()
    )


def raised(impact_reading, tier):
    return replace(impact_reading, tier=tier)
