"""Domain ABG, agent behaviour governance: the holder's behaviour against its baseline, and the contracted scope.

Knowledge of behaviour only ever tightens: an agent of which nothing bad is known is permitted nothing for it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, assert_never

from capabilities.values.chain import Chain
from policies.evidence.conduct_readings import DRIFT, BehaviourReading
from policies.evidence.evidence import NotCollected
from policies.evidence.model import Point
from policies.primitives.base import Defers, Fails, Holds, fails, found, missing, verified_chain
from policies.words.reason_table import Reason

if TYPE_CHECKING:
    from policies.evidence.conduct_readings import Deviation
    from policies.primitives.base import Case, Verdict


def known_behaviour(primitive: str, case: Case, *, age_ms: int) -> BehaviourReading | Fails:
    """Reading of the holder's behaviour, or the refusal in its place.

    A reading of another agent is none of the holder's. An old one refuses physical acts alone.
    """
    chain = verified_chain(primitive, case)
    if not isinstance(chain, Chain):
        return chain
    match case.evidence.behaviour:
        case NotCollected():
            return missing(primitive, "behaviour")
        case BehaviourReading() as behaviour:
            if behaviour.agent != chain.leaf.agent:
                return missing(primitive, "behaviour")
            if not behaviour.age_ms >= 0:
                return missing(primitive, "behaviour")
            if case.physical and not behaviour.age_ms <= age_ms:
                return fails(primitive, Reason.BEHAVIOUR_OLD, age_ms=behaviour.age_ms, behaviour_age_ms=age_ms)
            return behaviour
        case _:
            assert_never(case.evidence.behaviour)


def _plain(deviations: list[Deviation]) -> list[dict[str, object]]:
    return [{"feature": str(d.feature), "since": d.since, "score_milli": d.score_milli} for d in deviations]


@dataclass(frozen=True, slots=True)
class BehaviouralBaseline:
    """ABG-1: tools, parameters, rates and refusals are those of the agent's baseline; a deviation asks a person."""

    behaviour_age_ms: int
    id: ClassVar[str] = "ABG-1"

    def judge(self, case: Case) -> Verdict:
        """Holds without a deviation; defers with one."""
        behaviour = known_behaviour(self.id, case, age_ms=self.behaviour_age_ms)
        if not isinstance(behaviour, BehaviourReading):
            return behaviour
        odd = [deviation for deviation in behaviour.deviations if deviation.feature not in DRIFT]
        if odd:
            return Defers((found(self.id, Reason.BEHAVIOUR_DEVIATES, agent=behaviour.agent, deviations=_plain(odd)),))
        return Holds()


@dataclass(frozen=True, slots=True)
class DriftContainment:
    """ABG-2: acts that draw near to bounds, or escalate, are contained before a bound is crossed."""

    behaviour_age_ms: int
    id: ClassVar[str] = "ABG-2"

    def judge(self, case: Case) -> Verdict:
        """Holds while neither the share of acts near a limit nor the slope of escalation left its baseline."""
        behaviour = known_behaviour(self.id, case, age_ms=self.behaviour_age_ms)
        if not isinstance(behaviour, BehaviourReading):
            return behaviour
        drifting = [deviation for deviation in behaviour.deviations if deviation.feature in DRIFT]
        if drifting:
            return fails(self.id, Reason.BEHAVIOUR_DRIFTS, agent=behaviour.agent, deviations=_plain(drifting))
        return Holds()


@dataclass(frozen=True, slots=True)
class Reverification:
    """ABG-3: after a deviation the agent is attested again before its next physical act, or before it is delegated to.

    "After" is strictly later: an attestation in the same second may have come before.
    """

    behaviour_age_ms: int
    id: ClassVar[str] = "ABG-3"

    def judge(self, case: Case) -> Verdict:
        """Holds when the leaf was attested after its newest deviation, or when nothing physical depends on it."""
        behaviour = known_behaviour(self.id, case, age_ms=self.behaviour_age_ms)
        if not isinstance(behaviour, BehaviourReading):
            return behaviour
        chain = case.evidence.chain
        if behaviour.deviated_at is None or not (case.physical or Point.AGENT in case.request.points):
            return Holds()
        if isinstance(chain, Chain) and chain.leaf.attestation.at > behaviour.deviated_at:
            return Holds()
        return fails(self.id, Reason.REATTESTATION_NEEDED, agent=behaviour.agent, deviated_at=behaviour.deviated_at)


@dataclass(frozen=True, slots=True)
class ScopeContraction:
    """ABG-4: after a deviation the agent holds the minimum safe set, until a person restores it."""

    contracted_max_tier: int
    behaviour_age_ms: int
    id: ClassVar[str] = "ABG-4"

    def judge(self, case: Case) -> Verdict:
        """Holds when the agent is not contracted, or the act is of at most `contracted_max_tier`."""
        behaviour = known_behaviour(self.id, case, age_ms=self.behaviour_age_ms)
        if not isinstance(behaviour, BehaviourReading):
            return behaviour
        if behaviour.contracted is False:
            return Holds()
        if case.tier is not None and case.tier <= self.contracted_max_tier:
            return Holds()
        tier = None if case.tier is None else int(case.tier)
        return fails(
            self.id,
            Reason.SCOPE_CONTRACTED,
            agent=behaviour.agent,
            tier=tier,
            contracted_max_tier=self.contracted_max_tier,
        )
