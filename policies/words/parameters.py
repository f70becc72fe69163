"""Every number that a policy set may choose, in one place: value, unit, range, meaning and source.

A set states the values that hold for all its policies; a policy may state another one beside the primitive that uses
it.
"""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from types import MappingProxyType
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Mapping


def _named(default: int, *, unit: str, low: int, high: int, meaning: str, source: str) -> int:
    """A field with its row in the table of parameters."""
    metadata = {"unit": unit, "low": low, "high": high, "meaning": meaning, "source": source}
    value: int = field(default=default, metadata=metadata)
    return value


@dataclass(frozen=True, slots=True)
class Parameters:
    """The values of one policy set. Integers only; each name ends in its unit."""

    trust_prior_permille: int = _named(
        800,
        unit="permille",
        low=0,
        high=1000,
        meaning="trust in an edge of which nothing is stated; also the most that a statement can give",
        source="the paper: prior 0.8",
    )
    trust_theta_permille: int = _named(
        700,
        unit="permille",
        low=0,
        high=1000,
        meaning="least trust at which a tier 2 act needs no person",
        source="the paper: theta 0.7",
    )
    lease_motion_ms: int = _named(
        2_000,
        unit="ms",
        low=1,
        high=2_000,
        meaning="oldest revocation view on which an act with physical impact may be permitted",
        source="ours: a PEP that hears nothing of revocations permits motion for at most 2 s",
    )
    lease_other_ms: int = _named(
        30_000,
        unit="ms",
        low=1,
        high=30_000,
        meaning="oldest revocation view on which any other act may be permitted, a stop included",
        source="ours: what moves nothing may bear a short outage of the feed",
    )
    attestation_age_s: int = _named(
        3_600,
        unit="s",
        low=1,
        high=86_400,
        meaning="oldest attestation of an agent in the chain",
        source="ours: the longest life of a hop with evidence of kind key",
    )
    sponsor_age_tier_0_s: int = _named(
        604_800,
        unit="s",
        low=1,
        high=604_800,
        meaning="oldest authentication of the sponsor for tier 0",
        source="ours: the longest life of a mandate",
    )
    sponsor_age_tier_1_s: int = _named(
        86_400,
        unit="s",
        low=1,
        high=86_400,
        meaning="oldest authentication of the sponsor for tier 1",
        source="ours: the longest life of a token that was not drawn",
    )
    sponsor_age_tier_2_s: int = _named(
        28_800,
        unit="s",
        low=1,
        high=86_400,
        meaning="oldest authentication of the sponsor for tier 2",
        source="ours: one working shift",
    )
    sponsor_age_tier_3_s: int = _named(
        3_600,
        unit="s",
        low=1,
        high=86_400,
        meaning="oldest authentication of the sponsor for tier 3",
        source="ours: one hour",
    )
    sponsor_age_tier_4_s: int = _named(
        900,
        unit="s",
        low=1,
        high=86_400,
        meaning="oldest authentication of the sponsor for tier 4",
        source="ours: NIST SP 800-63B-4 asks for re-authentication after 15 idle minutes at AAL3",
    )
    hops_max_count: int = _named(
        8,
        unit="count",
        low=0,
        high=8,
        meaning="most delegations after the authority block",
        source="capabilities.values.caps: hops",
    )
    lifetime_max_s: int = _named(
        86_400,
        unit="s",
        low=1,
        high=86_400,
        meaning="longest window of the effective scope",
        source="capabilities.values.caps: lifetime_s",
    )
    skew_s: int = _named(
        5,
        unit="s",
        low=0,
        high=5,
        meaning="how far in the future a time that another machine wrote may lie",
        source="capabilities.values.caps: skew_s",
    )
    verdict_lifetime_ms: int = _named(
        50,
        unit="ms",
        low=1,
        high=50,
        meaning="how long after the decision an act with physical impact may begin",
        source="ours: in 50 ms a person at 1.6 m/s comes 0.08 m nearer than was judged",
    )
    verdict_lifetime_other_ms: int = _named(
        1_000,
        unit="ms",
        low=1,
        high=1_000,
        meaning="how long after the decision any other act may begin",
        source="ours: evidence of an act without physical impact may be one second old",
    )
    approved_tcp_speed_um_s: int = _named(
        250_000,
        unit="um_s",
        low=1,
        high=250_000,
        meaning="fastest tool centre point of an approved tier 3 act, and of any approved act in an unseen cell",
        source="DESIGN section 6; ISO 10218-1: reduced speed is at most 250 mm/s",
    )
    approved_contact_permille: int = _named(
        1_000,
        unit="permille",
        low=0,
        high=1_000,
        meaning="highest ratio of contact speed to its limit (PFL) of an approved tier 3 act",
        source="DESIGN section 6; ISO/TS 15066: a contact stays under the limits of the body region",
    )
    approved_index_slack_milli: int = _named(
        50,
        unit="milli",
        low=0,
        high=50,
        meaning="how much higher the index may be at use than it was shown",
        source="DESIGN section 6: 0.05",
    )
    approved_start_slack_urad: int = _named(
        2_000,
        unit="urad",
        low=0,
        high=2_000,
        meaning="how far each joint may be at use from where it was shown",
        source="DESIGN section 6: 2 mrad",
    )
    intent_age_s: int = _named(
        3_600,
        unit="s",
        low=1,
        high=86_400,
        meaning="oldest instruction of a person that may be acted on",
        source="ours: as long as a hop of evidence kind key lives",
    )
    message_age_s: int = _named(
        60,
        unit="s",
        low=1,
        high=3_600,
        meaning="oldest message between agents that may be acted on",
        source="ours: what is asked for is asked for now; `capabilities.statements.context.message` lets one live 1 h",
    )
    manifest_age_s: int = _named(
        604_800,
        unit="s",
        low=1,
        high=31_536_000,
        meaning="oldest manifest of a curated collection",
        source="ours: a curator looks at a collection at least once a week",
    )
    suspicious_admitted_count: int = _named(
        1,
        unit="count",
        low=0,
        high=1,
        meaning="1: a text with instructions or hidden characters in it is admitted as tainted; 0: it is refused",
        source="ours: screening is evidence and errs; the taint is what protects",
    )
    unvouched_max_tier: int = _named(
        0,
        unit="tier",
        low=0,
        high=4,
        meaning="highest tier of an act with an argument that derives from a text for which nobody vouches, or tainted",
        source="ours: such a text moves nothing",
    )
    agent_max_tier: int = _named(
        4,
        unit="tier",
        low=0,
        high=4,
        meaning="highest tier of an act with an argument that is an agent's own choice",
        source="ours: scope, physics and people bound it; a stricter set asks for provenance from tier 2 on",
    )
    recorded_max_tier: int = _named(
        4,
        unit="tier",
        low=0,
        high=4,
        meaning="highest tier of an act with an argument from a tool's response, memory or a curated document",
        source="ours: as an agent's own choice, which it could pass it off as; a stricter set believes it up to tier 2",
    )
    alternations_max_count: int = _named(
        6,
        unit="count",
        low=0,
        high=1_000,
        meaning="most acts within the window that undo each other",
        source="ours: three times there and back is work; more is shaking",
    )
    sequence_drift_urad: int = _named(
        20_000,
        unit="urad",
        low=0,
        high=1_000_000,
        meaning="how far a joint may be from where the committed state says that it is",
        source="ours: 20 mrad, which moves the tool of a UR3e by at most 10 mm at its reach of 0.5 m",
    )
    behaviour_age_ms: int = _named(
        5_000,
        unit="ms",
        low=1,
        high=60_000,
        meaning="oldest word about the holder's behaviour on which an act with physical impact may be permitted",
        source="ours: behaviour is known over minutes; a PEP adds what it saw itself at once",
    )
    contracted_max_tier: int = _named(
        0,
        unit="tier",
        low=0,
        high=4,
        meaning="highest tier of an act of an agent that holds the minimum safe set",
        source="ours: it may look and it may stop",
    )
    trust_half_life_s: int = _named(
        86_400,
        unit="s",
        low=60,
        high=31_536_000,
        meaning="time in which what was reported for or against an edge loses half its weight",
        source="ours: a day's work is half forgotten the next day; docs/trust.md plots it",
    )
    trust_prior_weight_milli: int = _named(
        20_000,
        unit="milli",
        low=1,
        high=1_000_000,
        meaning="how many good acts the prior stands for: s0 of the score",
        source="ours: with theta 0.7 of prior 0.8, three wrongs of a stranger ask for a person",
    )
    trust_good_cap_milli: int = _named(
        40_000,
        unit="milli",
        low=0,
        high=1_000_000,
        meaning="most that one reporter's good word can weigh, against its own bad word alone",
        source="ours: good standing buys patience for at most nine wrongs instead of three",
    )
    trust_bad_cap_milli: int = _named(
        20_000,
        unit="milli",
        low=0,
        high=1_000_000,
        meaning="most that one reporter's bad word can weigh: alone it leaves prior * s0 / (s0 + this)",
        source="ours: a single liar takes at most half of the prior, and a single witness still counts",
    )
    behaviour_learn_count: int = _named(
        256,
        unit="count",
        low=64,
        high=1_024,
        meaning="acts from which an agent's own baseline is made: the first half fixes ranges, the second how often "
        "they are left",
        source="ours: the upper 97.5 % bound of a share seen 0 times in 128 acts is 3 %",
    )
    behaviour_false_alarm_count: int = _named(
        10_000,
        unit="count",
        low=1_000,
        high=1_000_000,
        meaning="acts of an unchanged agent between two false alarms of one feature, on average and at least",
        source="ours; thresholds by the Markov chain of Brook and Evans 1972 (evaluation.conduct.thresholds)",
    )
    behaviour_near_permille: int = _named(
        900,
        unit="permille",
        low=1,
        high=1_000,
        meaning="from which share of its limit on an act is close to it",
        source="ours: the last tenth",
    )
    behaviour_refused_max_permille: int = _named(
        100,
        unit="permille",
        low=1,
        high=500,
        meaning="highest share of refused acts that a baseline may hold to be usual; about twice as many are noticed",
        source="ours: who is refused more often than one time in ten is no example for itself",
    )
    behaviour_near_max_permille: int = _named(
        1_000,
        unit="permille",
        low=1,
        high=1_000,
        meaning="highest share of acts close to a limit that a baseline may hold to be usual; above 800 any",
        source="ours: what was lent up to a limit may be used up to it; a change towards it is what is looked for",
    )
    behaviour_probed_max_permille: int = _named(
        50,
        unit="permille",
        low=1,
        high=500,
        meaning="highest share of acts that ask for what was not lent, from the first act on",
        source="ours: an agent knows what it was lent; six such acts in a row are noticed",
    )
    behaviour_repeat_count: int = _named(
        500,
        unit="count",
        low=1,
        high=100_000,
        meaning="acts within which a second alarm of one feature contracts the agent",
        source="ours: one false alarm in 10,000 acts comes twice in 500 acts one time in twenty",
    )


@dataclass(frozen=True, slots=True)
class ParameterRow:
    """One parameter as the documentation and the loader know it. `low` and `high` are both allowed."""

    name: str
    default: int
    unit: str
    low: int
    high: int
    meaning: str
    source: str


def _rows() -> Mapping[str, ParameterRow]:
    rows = {}
    for f in fields(Parameters):
        if not isinstance(f.default, int):
            raise TypeError(f.name)
        rows[f.name] = ParameterRow(f.name, f.default, **f.metadata)
    return MappingProxyType(rows)


PARAMETERS: Final = _rows()
"""Every parameter by name."""

GATE_PARAMETERS: Final = frozenset({"lease_motion_ms", "lease_other_ms"})
"""Parameters that a primitive takes and an enforcement point uses besides, for every caller."""

MORE_IS_STRICTER: Final = frozenset({"trust_theta_permille"})
"""Parameters of which a greater value denies or asks more; of all others but the following a smaller one does."""
UNORDERED: Final = frozenset(
    name
    for name in PARAMETERS
    if name.startswith(("trust_half", "trust_prior_w", "trust_good", "trust_bad"))
    or (name.startswith("behaviour_") and name != "behaviour_age_ms")
)
"""Parameters by which trust and behaviour are learned: another value is neither stricter nor laxer."""


def stricter(name: str, was: int, now: int) -> bool:
    """True where the parameter denies and asks at least as much as it did."""
    if name in UNORDERED:
        return now == was
    return now >= was if name in MORE_IS_STRICTER else now <= was


def laxer(name: str, was: int, now: int) -> int:
    """The value that denies and asks less; of a parameter without an order, the new one."""
    return now if name in UNORDERED or not stricter(name, was, now) else was
