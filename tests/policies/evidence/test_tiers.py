"""Runtime tier, the rule of each tier, and the reach of a PERMIT while its effect lasts."""

from dataclasses import replace

import pytest
from capabilities.values.scope import Tier
from policies.evidence.tiers import RULES, TierRule, authorised_milli, base_tier, runtime_tier
from tests.policies import world

from policies import NOT_COLLECTED, ImpactFault, Parameters, decide, load_shipped

SET = load_shipped("paper-default")


def test_the_papers_table():
    assert dict(RULES) == {
        Tier(0): TierRule.AUDIT,
        Tier(1): TierRule.AUDIT,
        Tier(2): TierRule.TRUST,
        Tier(3): TierRule.ASK,
        Tier(4): TierRule.REFUSE,
    }


@pytest.mark.parametrize("base", list(Tier))
@pytest.mark.parametrize("computed", list(Tier))
def test_the_tier_of_a_physical_act_is_the_higher_of_two(base, computed):
    _, seen = world.asked({"evidence.tool.base_tier": int(base), "evidence.impact.tier": int(computed)})
    assert runtime_tier(seen, physical=True) is max(base, computed)
    assert runtime_tier(seen, physical=False) is base
    unseen = replace(seen, impact=replace(seen.impact, perception="stale"))
    assert runtime_tier(unseen, physical=True) is max(base, computed, Tier.HIGH_CONSEQUENCE)
    assert runtime_tier(unseen, physical=False) is base


def test_what_is_not_known_is_no_tier():
    _, seen = world.asked()
    for tool in (NOT_COLLECTED, replace(seen.tool, base_tier=None)):
        unknown = replace(seen, tool=tool)
        assert (
            base_tier(unknown) is runtime_tier(unknown, physical=True) is runtime_tier(unknown, physical=False) is None
        )
    for impact in (NOT_COLLECTED, ImpactFault("BUSY")):
        unknown = replace(seen, impact=impact)
        assert runtime_tier(unknown, physical=True) is None
        assert runtime_tier(unknown, physical=False) is base_tier(unknown) is Tier.REVERSIBLE


@pytest.mark.parametrize("tier", [1, 2])
def test_without_people_a_permit_reaches_to_the_top_of_its_tier(tier):
    decision = decide(
        *world.asked({"evidence.impact.tier": tier, "evidence.impact.index_milli": tier * 1_000 - 700}), SET
    )
    assert decision.tier is Tier(tier)
    assert authorised_milli(decision, Parameters()) == tier * 1_000


@pytest.mark.parametrize(
    ("index", "reach"), [(2_500, 2_550), (2_949, 2_999), (2_950, 3_000), (2_980, 3_000), (3_000, 3_000)]
)
def test_with_people_it_reaches_as_far_as_their_slack_and_never_into_the_next_tier(index, reach):
    decision = replace(decide(*world.approved(Tier.HIGH_CONSEQUENCE)), index=index)
    assert decision.approval is not None
    assert authorised_milli(decision, Parameters(approved_index_slack_milli=50)) == reach
    assert authorised_milli(decision, Parameters(approved_index_slack_milli=0)) == index


def test_without_a_tier_or_an_index_it_reaches_nowhere():
    decision = decide(*world.asked(), SET)
    for unknown in ({"tier": None}, {"index": None}, {"tier": None, "index": None}):
        assert authorised_milli(replace(decision, **unknown), Parameters()) == 0
