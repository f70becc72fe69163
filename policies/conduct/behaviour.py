"""Behaviour of agents compared with their own past: baselines, change detectors, and deviations (ABG-1 to 4).

Pure reducers over the reports of enforcement points; `reading` is the value that the primitives judge.

**Learning.** The first half of an agent's first acts fixes the reference that later acts are compared with
(policies.conduct.baseline). The second half counts how often each question is answered yes. The detectors use the upper
97.5 % bound of that share, so that a short sample errs towards silence. Until then the agent is compared with the other
agents of its role, once one of them has learned, and with the most that any baseline may hold usual: no agent can learn
to ask for more than it was lent. After that the baseline stands still until a person lets it be learned anew.

**Alarms.** An alarm is a deviation, until a person restores the agent. Probing (refusals) and work at the limits
contract at once, since the next act may be the one that crosses a limit. New tools, other parameters, another rate and
a climb may also be new work. So their first alarm defers and asks for re-attestation (the primitives do that with the
reading), and a second alarm of any feature within `behaviour_repeat_count` acts contracts.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import reduce
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final

from policies.conduct.baseline import BLOCK, FEATURES, act_of
from policies.conduct.counted_reports import CountedReports
from policies.conduct.history import AgentHistory, Alarm, Baseline
from policies.conduct.report import ReportError, is_text, keyed, listed
from policies.evidence.conduct_readings import BehaviourReading, Deviation, Feature

if TYPE_CHECKING:
    from collections.abc import Mapping

    from policies.conduct.baseline import Act
    from policies.conduct.report import Report
    from policies.words.parameters import Parameters

AT_ONCE: Final = frozenset({Feature.REFUSALS, Feature.NEAR_BOUNDARY})
"""Features that contract the scope at their first alarm."""
STOP: Final = "stop"
"""Operation that counts for nothing here: an agent that stops often shall never be held back from stopping."""


class RestoreError(Exception):
    """A restoration by one who is no person, or of an agent of which nothing is known."""


@dataclass(frozen=True, slots=True)
class BehaviourState:
    """Behaviour of every agent, as known from reports. Plain JSON and back, exactly.

    One state may hold all agents, or those of one role; an agent with a state of its own is compared with no role.

    Attributes:
        careers: by agent.
        seen: by reporter.
    """

    careers: Mapping[str, AgentHistory] = field(default_factory=lambda: MappingProxyType({}))
    seen: Mapping[str, CountedReports] = field(default_factory=lambda: MappingProxyType({}))

    def to_json(self) -> dict[str, Any]:
        """Plain JSON of the state, ordered, so that equal states have equal texts."""
        parts: dict[str, Mapping[str, Any]] = {"careers": self.careers, "seen": self.seen}
        return {part: [[name, held.to_json()] for name, held in sorted(each.items())] for part, each in parts.items()}

    @classmethod
    def from_json(cls, body: object) -> BehaviourState:
        """State that `to_json` wrote, exactly.

        Raises:
            ReportError: it is not that.
        """
        fields = keyed(body, set(cls.__slots__), "behaviour")
        readers = {"careers": AgentHistory.from_json, "seen": CountedReports.from_json}
        parts: dict[str, Any] = {}
        for part, reads in readers.items():
            rows = [listed(row, part) for row in listed(fields[part], part)]
            if not all(len(row) == 2 and is_text(row[0]) for row in rows):
                raise ReportError(part)
            parts[part] = MappingProxyType({name: reads(held) for name, held in rows})
        return cls(**parts)


NOTHING_KNOWN: Final = BehaviourState()
"""State before the first report."""


def observe(
    state: BehaviourState, report: Report, parameters: Parameters, *, now: int, role: str = ""
) -> BehaviourState:
    """The state after the report; the same state when the report is not to be counted (as in policies.conduct.trust).

    Args:
        state: before.
        report: its signature was verified, and `reporter` is the enforcement point whose key signed it.
        parameters: of the policy set.
        now: seconds since the epoch, by the receiver's clock.
        role: of the agent in the registry; while it is too young for a baseline of its own it is compared with what
            agents of this role do. "" when it has none.
    """
    if report.at > now + parameters.skew_s:
        return state
    seen = state.seen.get(report.reporter, CountedReports()).added(report.at, report.request_id)
    if seen is None:
        return state
    state = replace(state, seen=MappingProxyType({**state.seen, report.reporter: seen}))
    if report.operation == STOP:
        return state
    career = replace(state.careers.get(report.agent, AgentHistory()), role=role)
    career, act = _timed(career, report, parameters)
    career, alarms = career.judged(act, _usual(state, report.agent, career), parameters)
    for alarm in alarms:
        career = _deviated(career, alarm, min(report.at, now), parameters)
    return _with(state, report.agent, career.learned(act, parameters))


def reading(state: BehaviourState, agent: str, at: int, age_ms: int, parameters: Parameters) -> BehaviourReading:
    """Behaviour reading that the primitives judge.

    An agent of which nothing is known is still being learned: no samples, no deviation.

    Args:
        state: reports up to `at`.
        agent: the holder.
        at: seconds since the epoch. Nothing fades with it: a deviation stays one until a person restores the agent.
        age_ms: of the newest word of the identity provider, as the reader knows it.
        parameters: of the policy set.
    """
    del at
    career = state.careers.get(agent, AgentHistory())
    return BehaviourReading(
        agent=agent,
        deviations=tuple(Deviation(d.feature, d.since, d.score_milli) for d in career.deviations),
        deviated_at=max((d.newest for d in career.deviations), default=None),
        contracted=career.contracted,
        samples=min(career.acts, parameters.behaviour_learn_count),
        age_ms=age_ms,
    )


def restore(state: BehaviourState, agent: str, *, by: str, at: int) -> BehaviourState:
    """The agent without deviations, not contracted, its detectors started afresh; its baseline stays.

    Args:
        state: before.
        agent: to be restored.
        by: the person. The caller has verified that it is a registered, active person; a name known here as that
            of an agent or a reporter is refused in any case.
        at: seconds since the epoch.

    Raises:
        RestoreError: `by` is no person, or the agent is not known.
    """
    return _with(state, agent, _known(state, agent, by=by).restored(by=by, at=at))


def relearn(state: BehaviourState, agent: str, *, by: str, at: int) -> BehaviourState:
    """Like `restore`, and the agent's baseline is learned anew: a person says that its work has changed.

    Raises:
        RestoreError: as in `restore`.
    """
    _known(state, agent, by=by)
    return _with(state, agent, AgentHistory(restored_by=by, restored_at=at))


def _known(state: BehaviourState, agent: str, *, by: str) -> AgentHistory:
    if agent not in state.careers or not is_text(by) or by == agent or by in state.careers or by in state.seen:
        raise RestoreError(agent)
    return state.careers[agent]


def _with(state: BehaviourState, agent: str, career: AgentHistory) -> BehaviourState:
    return replace(state, careers=MappingProxyType({**state.careers, agent: career}))


def _timed(career: AgentHistory, report: Report, parameters: Parameters) -> tuple[AgentHistory, Act]:
    """The act, with the time of its block when it ends one.

    A late report is not timed: a reporter that was cut off would make a slow agent look quick.
    """
    if report.at < career.newest:
        return career, act_of(report, parameters, span_s=None)
    if career.blocked + 1 < BLOCK and career.acts:
        return replace(career, newest=report.at, blocked=career.blocked + 1), act_of(report, parameters, span_s=None)
    span_s = report.at - career.anchor if career.acts else None
    timed = replace(career, newest=report.at, anchor=report.at, blocked=0)
    return timed, act_of(report, parameters, span_s=span_s)


def _deviated(career: AgentHistory, alarm: Alarm, at: int, parameters: Parameters) -> AgentHistory:
    """History with the alarm in it, contracted when it is one that contracts."""
    feature = FEATURES[alarm.watch]
    # two questions about one act are one alarm
    again = career.alarmed is not None and 0 < career.acts - career.alarmed <= parameters.behaviour_repeat_count
    return replace(
        career.noted(feature, at=at, score_milli=alarm.score_milli),
        contracted=career.contracted or again or feature in AT_ONCE,
        alarmed=career.acts,
    )


def _usual(state: BehaviourState, agent: str, career: AgentHistory) -> Baseline | None:
    """Baseline of the other agents of the role, the widest of all that learned and do not deviate."""
    if career.baseline is not None or not career.role:
        return None
    learned = [
        other.baseline
        for name, other in sorted(state.careers.items())
        if name != agent and other.role == career.role and other.baseline is not None and not other.deviations
    ]
    return reduce(Baseline.joined, learned) if learned else None
