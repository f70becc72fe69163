"""Physical Impact Tiers: the runtime tier, and the rule of each tier.

`pit(inv) = max(tool.pit_class, param_pit(inv.params), context_pit(env))`: the tool's registered base tier, and the tier
of parameters and world: as physics computed it, or, for what has none, as declared rows give it. Rows only raise.
Unknown is never a low tier: without both there is no tier.
"""

from __future__ import annotations

from enum import StrEnum
from types import MappingProxyType
from typing import TYPE_CHECKING, Final

from capabilities.values.scope import Tier
from policies.evidence.evidence import DeclaredImpact, ImpactReading, ToolReading

if TYPE_CHECKING:
    from collections.abc import Mapping

    from policies.evidence.evidence import Evidence
    from policies.evidence.model import Decision
    from policies.words.parameters import Parameters

FRESH: Final = "fresh"
"""The one state of perception that adds nothing to the tier."""
UNSEEN_FLOOR: Final = Tier.HIGH_CONSEQUENCE
"""Least tier of an act whose world nothing sees freshly (docs/physics.md, PHY-8; [FCT-3])."""


class TierRule(StrEnum):
    """Rule of a tier."""

    AUDIT = "PERMIT, audit"
    TRUST = "PERMIT when trust is at least theta, else DEFER"
    ASK = "DEFER; DENY on timeout"
    REFUSE = "DENY; only with prior dual authorisation by two different people"


RULES: Final[Mapping[Tier, TierRule]] = MappingProxyType(
    {
        Tier.NO_EFFECT: TierRule.AUDIT,
        Tier.REVERSIBLE: TierRule.AUDIT,
        Tier.CONSEQUENTIAL: TierRule.TRUST,
        Tier.HIGH_CONSEQUENCE: TierRule.ASK,
        Tier.SAFETY_CRITICAL: TierRule.REFUSE,
    }
)
"""The paper's table."""


def base_tier(evidence: Evidence) -> Tier | None:
    """The tool's registered base tier, or None when it is not known."""
    tool = evidence.tool
    if not isinstance(tool, ToolReading) or tool.base_tier is None:
        return None
    return Tier(tool.base_tier)


def declared_tier(impact: DeclaredImpact) -> Tier:
    """Tier that declared rows give to an act: at least 3 where one of their facts is not fresh."""
    return Tier(impact.tier) if facts_fresh(impact) else max(Tier(impact.tier), UNSEEN_FLOOR)


def facts_fresh(impact: DeclaredImpact) -> bool:
    """True where every fact that the rows depend on is fresh, also where there is none."""
    return all(fact.state == FRESH for fact in impact.facts)


def runtime_tier(evidence: Evidence, *, physical: bool) -> Tier | None:
    """Runtime tier of the request: the base tier, raised by the declared or, for a physical act, the computed one.

    Args:
        evidence: where `tool` and `impact` are read.
        physical: whether a policy makes the answer depend on the physical impact.

    Returns:
        The tier, or None when a part of it is not known. A fault is no tier.
    """
    base, impact = base_tier(evidence), evidence.impact
    if base is not None and isinstance(impact, DeclaredImpact):
        return max(base, declared_tier(impact))
    if base is None or not physical:
        return base
    if not isinstance(impact, ImpactReading):
        return None
    floor = Tier.NO_EFFECT if impact.perception == FRESH else UNSEEN_FLOOR
    return max(base, Tier(impact.tier), floor)


def authorised_milli(decision: Decision, parameters: Parameters) -> int:
    """The impact index, in thousandths, up to which a PERMIT goes on being one while its effect lasts.

    Without people's answer the decision would have been the same all over its tier; with one it holds for the index
    that was decided and the slack that an approval has, and never for the tier above.
    """
    if decision.tier is None or decision.index is None:
        return 0
    whole = int(decision.tier) * 1_000
    return whole if decision.approval is None else min(whole, decision.index + parameters.approved_index_slack_milli)
