"""Domain TEA, its last primitive: a command is judged together with earlier and queued ones."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, assert_never

from capabilities.values.chain import Chain
from capabilities.values.scope import Tier
from policies.evidence.conduct_readings import SequenceReading
from policies.evidence.evidence import NotCollected, prior_leave
from policies.evidence.tiers import RULES, TierRule
from policies.primitives.base import Defers, Fails, Holds, found, missing, verified_chain
from policies.words.reason_table import Reason

if TYPE_CHECKING:
    from policies.evidence.model import Finding
    from policies.primitives.base import Case, Verdict


@dataclass(frozen=True, slots=True)
class SequenceCoherence:
    """TEA-6: the command together with earlier and queued ones stays safe.

    Small steps are taken together, so that none of them hides their sum.
    """

    alternations_max_count: int
    sequence_drift_urad: int
    id: ClassVar[str] = "TEA-6"

    def judge(self, case: Case) -> Verdict:
        """Holds when the arm is free and at its expected place, and the whole has at most tier 2.

        A whole above the ceiling fails. Tier 3 asks a person, and so does tier 4 under a person's prior leave; without
        that it fails. As TEA-4 does for the command alone, so that a higher tier never gets a milder answer.
        """
        chain = verified_chain(self.id, case)
        if not isinstance(chain, Chain):
            return chain
        match case.evidence.sequence:
            case NotCollected():
                return missing(self.id, "sequence")
            case SequenceReading() as sequence:
                return self._reading(case, chain, sequence)
            case _:
                assert_never(case.evidence.sequence)

    def _reading(self, case: Case, chain: Chain, sequence: SequenceReading) -> Verdict:
        wrong: list[Finding] = []
        if sequence.unfinished is not False:
            wrong.append(found(self.id, Reason.BUSY))
        if sequence.held_known is not True:
            wrong.append(found(self.id, Reason.SEQUENCE_UNKNOWN))
        if not 0 <= sequence.drift_urad <= self.sequence_drift_urad:
            detail = {"drift_urad": sequence.drift_urad, "sequence_drift_urad": self.sequence_drift_urad}
            wrong.append(found(self.id, Reason.SEQUENCE_DRIFT, **detail))
        if not 0 <= sequence.alternations <= self.alternations_max_count:
            counts = {"alternations": sequence.alternations, "alternations_max_count": self.alternations_max_count}
            wrong.append(found(self.id, Reason.SEQUENCE_ALTERNATES, **counts))
        if wrong:
            return Fails(tuple(wrong))
        if sequence.tier is None or case.tier is None:
            return missing(self.id, "sequence.tier")
        tier = max(Tier(sequence.tier), case.tier)
        whole = {
            "tier": int(tier),
            "ceiling": int(chain.scope.ceiling),
            "index_milli": sequence.index_milli,
            "acts": sequence.acts,
        }
        if not tier <= chain.scope.ceiling:
            return Fails((found(self.id, Reason.SEQUENCE_TOO_HIGH, **whole),))
        match RULES[tier]:
            case TierRule.AUDIT | TierRule.TRUST:
                return Holds()
            case TierRule.REFUSE if prior_leave(case.evidence) is None:
                return Fails((found(self.id, Reason.SEQUENCE_TOO_HIGH, **whole),))
            case TierRule.ASK | TierRule.REFUSE:
                return Defers((found(self.id, Reason.SEQUENCE_NEEDS_APPROVAL, **whole),))
            case rule:
                assert_never(rule)
