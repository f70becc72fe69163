"""Values of conduct: the reducers' states of one agent, and the part that enforcement points are told."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import TYPE_CHECKING

from policies.conduct.behaviour import NOTHING_KNOWN, BehaviourState
from policies.conduct.trust import NOTHING_REPORTED, TrustState

if TYPE_CHECKING:
    from collections.abc import Mapping

    from policies.conduct.history import AgentHistory
    from policies.conduct.report import Edge, Report
    from policies.evidence.conduct_readings import BehaviourReading


@dataclass(frozen=True, slots=True)
class AgentConduct:
    """Conduct of one agent: the reducers' states, and the second at which a person last restored it, or None."""

    trust: TrustState = NOTHING_REPORTED
    behaviour: BehaviourState = NOTHING_KNOWN
    restored_at: int | None = None


@dataclass(frozen=True, slots=True)
class Published:
    """Conduct of an agent as it is published to enforcement points.

    Attributes:
        scores: trust in each edge into it that something was ever reported about, in permille.
        default_permille: of an edge that is not told of.
        reading: of its behaviour.
        restored_at: as in `AgentConduct`.
    """

    scores: Mapping[Edge, int]
    default_permille: int
    reading: BehaviourReading
    restored_at: int | None


@dataclass(frozen=True, slots=True)
class Concerned:
    """Subjects of records: requests whose PERMIT may be open, and the hops under which they were asked."""

    requests: frozenset[str] = frozenset()
    hops: frozenset[str] = frozenset()


@dataclass(frozen=True, slots=True)
class Held:
    """Conduct that the state holds of the concerned agents.

    Attributes:
        agents: by id; one that is not here is one of which nothing was reported.
        open: reports of PERMITs of the enforcement point, by request id: as if nothing had been sent.
        made: the edge of each concerned hop that was ever made.
        peers: for agents that are too young for a baseline of their own, the histories of others of the same sponsor
            and role, by agent; at most `conduct.PEERS` of each.
    """

    agents: Mapping[str, AgentConduct] = field(default_factory=lambda: MappingProxyType({}))
    open: Mapping[str, Report] = field(default_factory=lambda: MappingProxyType({}))
    made: Mapping[str, Edge] = field(default_factory=lambda: MappingProxyType({}))
    peers: Mapping[str, Mapping[str, AgentHistory]] = field(default_factory=lambda: MappingProxyType({}))

    def of(self, agents: frozenset[str]) -> Held:
        """The conduct of these agents, and their peers, alone."""
        return replace(
            self,
            agents={agent: conduct for agent, conduct in self.agents.items() if agent in agents},
            peers={agent: peers for agent, peers in self.peers.items() if agent in agents},
        )
