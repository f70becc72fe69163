"""How an agent behaves, against how it used to: baselines, change detectors, and what a deviation does (ABG-1 to 4).

Pure reducers over the reports of enforcement points; `reading` is what the primitives judge.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final

from policies.conduct import BehaviourReading
from policies.report import ReportError, is_count, is_text, keyed, listed

if TYPE_CHECKING:
    from collections.abc import Mapping

    from policies.parameters import Parameters
    from policies.report import Report


@dataclass(frozen=True, slots=True)
class BehaviourState:
    """What is known of every agent's conduct. Plain JSON and back, exactly.

    One state may hold all agents, or each agent may have one of its own (then without baselines of roles).
    """

    samples: Mapping[str, int] = field(default_factory=lambda: MappingProxyType({}))

    def to_json(self) -> dict[str, Any]:
        """As plain JSON, ordered, so that equal states have equal texts."""
        return {"samples": [list(item) for item in sorted(self.samples.items())]}

    @classmethod
    def from_json(cls, body: object) -> BehaviourState:
        """What `to_json` wrote, exactly.

        Raises:
            ReportError: it is not that.
        """
        rows = listed(keyed(body, {"samples"}, "behaviour")["samples"], "samples")
        if not all(len(listed(row, "samples")) == 2 and is_text(row[0]) and is_count(row[1], 2**53) for row in rows):
            raise ReportError("samples")
        return cls(MappingProxyType({row[0]: row[1] for row in rows}))


NOTHING_KNOWN: Final = BehaviourState()
"""Before the first report."""


class RestoreError(Exception):
    """A restoration by one who is no person, or of an agent of which nothing is known."""


def observe(
    state: BehaviourState, report: Report, parameters: Parameters, *, now: int, role: str = ""
) -> BehaviourState:
    """The state after the report; the same state when the report is not to be counted (as in policies.trust).

    Args:
        state: before.
        report: its signature was verified, and `reporter` is the enforcement point whose key signed it.
        parameters: of the policy set.
        now: seconds since the epoch, by the receiver's clock.
        role: of the agent in the registry; while it is too young for a baseline of its own it is compared with what
            agents of this role do. "" when it has none.
    """
    del parameters, now, role
    return BehaviourState(MappingProxyType({**state.samples, report.agent: state.samples.get(report.agent, 0) + 1}))


def reading(state: BehaviourState, agent: str, at: int, age_ms: int, parameters: Parameters) -> BehaviourReading:
    """What the primitives judge. An agent of which nothing is known is being learned: no samples, no deviation.

    Args:
        state: reports up to `at`.
        agent: the holder.
        at: seconds since the epoch.
        age_ms: of the newest word of the identity provider, as the reader knows it.
        parameters: of the policy set.
    """
    del at, parameters
    return BehaviourReading(agent, (), None, contracted=False, samples=state.samples.get(agent, 0), age_ms=age_ms)


def restore(state: BehaviourState, agent: str, *, by: str, at: int) -> BehaviourState:
    """The agent without deviations, not contracted, its detectors started afresh; its baseline stays.

    Args:
        state: before.
        agent: to be restored.
        by: the person. The caller has verified that it is a registered, active person; whoever is known here as an
            agent or as a reporter is refused in any case.
        at: seconds since the epoch.

    Raises:
        RestoreError: `by` is no person, or the agent is not known.
    """
    del by, at
    if agent not in state.samples:
        raise RestoreError(agent)
    return state


def relearn(state: BehaviourState, agent: str, *, by: str, at: int) -> BehaviourState:
    """Like `restore`, and the agent's baseline is learned anew: a person says that its work has changed.

    Raises:
        RestoreError: as in `restore`.
    """
    return restore(state, agent, by=by, at=at)
