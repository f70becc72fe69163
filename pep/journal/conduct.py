"""Conduct of holders as this enforcement point knows it: the identity provider's word and its own records.

Its own records count at once, before the provider has heard of them, and only ever tighten. Of the two the stricter one
is read. It hears of its records as they are written.
"""

from __future__ import annotations

import threading
from collections import OrderedDict, deque
from dataclasses import replace
from typing import TYPE_CHECKING, Any, Final

from capabilities.values.chain import Chain
from capabilities.values.scope import Each, Flags, OneOf, Range, Stems, Words
from policies.conduct import behaviour, journal_reports, trust
from policies.conduct.behaviour import NOTHING_KNOWN, RestoreError
from policies.conduct.trust import NOTHING_REPORTED, chain_trust
from policies.evidence.conduct_readings import BehaviourReading, Deviation, Feature
from policies.evidence.evidence import Evidence, ImpactReading

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from capabilities.statements.conduct import AgentEntry
    from capabilities.values.scope import Bound
    from pep.base.ports import Clock, Journal, Registry
    from policies.conduct.report import Report
    from policies.evidence.evidence import TrustReading
    from policies.evidence.model import Request
    from policies.words.parameters import Parameters

OPEN: Final = 256
"""PERMITs that wait for their outcome, at most: far more than can be under way at a time."""
RECALLED: Final = 1_024
"""Records that are recalled after a restart, in about half a second.

Many times the number that ever waits to be shipped.
"""
UNHEARD: Final = 64
"""Records that wait for a reading, at most."""
SELF: Final = "this enforcement point"
"""Source of own reports; no registered party has such a name."""
PERSON: Final = "a person, says the identity provider"
"""Author of a restoration, as own reports name it."""
_FEATURES: Final = {str(feature): feature for feature in Feature}


class Conduct:
    """Journal that learns the conduct of holders from its own records, and joins it with the registry's.

    The `Journal` port. Any thread.

    Args:
        journal: durable.
        registry: the identity provider's word.
        clock: wall time of own records.
        parameters: of the policy set.
    """

    def __init__(self, journal: Journal, *, registry: Registry, clock: Clock, parameters: Parameters) -> None:
        self._journal = journal
        self._registry = registry
        self._clock = clock
        self._parameters = parameters
        self._lock = threading.Lock()
        self._unheard: deque[tuple[str, Mapping[str, Any], int]] = deque()
        self._open: OrderedDict[str, tuple[Report, str]] = OrderedDict()
        self._trust = NOTHING_REPORTED
        self._behaviour = NOTHING_KNOWN

    def append(self, kind: str, body: dict[str, object]) -> str:
        """Appends a durable record, whose conduct counts in each later reading; the record's hash (hex).

        Raises:
            JournalError: as the journal.
        """
        return self._later(self._journal.append(kind, body), kind, body)

    def note(self, kind: str, body: dict[str, object]) -> str:
        """As `append`, of a record that nothing waits for."""
        return self._later(self._journal.note(kind, body), kind, body)

    def _later(self, digest: str, kind: str, body: dict[str, object]) -> str:
        """Keeps a record for the next reading: what waits for the record does not wait for what it teaches."""
        self._unheard.append((kind, body, int(self._clock.wall_s() * 1_000)))
        if len(self._unheard) > UNHEARD:
            self.hear()
        return digest

    def hear(self) -> None:
        """Takes in the conduct of its records, which else waits until it is asked for."""
        while self._unheard:
            try:
                heard = self._unheard.popleft()
            except IndexError:  # another thread was quicker
                return
            self._hear(*heard)

    def settle(self) -> None:
        """Every note survives a power cut."""
        self._journal.settle()

    def recall(self, records: Iterable[Mapping[str, Any]]) -> None:
        """Takes in the newest records of an earlier process; the identity provider has heard of the older ones.

        Args:
            records: of the whole journal, oldest first; the newest `RECALLED` are recalled.
        """
        for record in deque(records, maxlen=RECALLED):
            self._hear(record["kind"], record["body"], record["at_ms"])

    def trust(self, chain: Chain, *, at: float) -> TrustReading:
        """Trust along the chain, one edge for each hop, as of `at` (seconds since the epoch)."""
        self.hear()
        word = self._registry.conduct()
        parties = (chain.sponsor.subject, *(hop.agent for hop in chain.hops))
        with self._lock:
            own = self._trust
        return chain_trust(
            (self._registry.trust_permille(hop.agent) for hop in chain.hops),
            self._parameters,
            parties=parties,
            snapshot=word.edges,
            state=own,
            at=int(at),
        )

    def behaviour(self, agent: str, *, at: float) -> BehaviourReading:
        """The behaviour of an agent, as of `at` (seconds since the epoch); as old as the identity provider's word."""
        self.hear()
        word = self._registry.conduct()
        told = word.agents.get(agent)
        with self._lock:
            own = self._own(agent, told, at=int(at), age_ms=word.age_ms)
        return own if told is None else _stricter(own, told)

    def _own(self, agent: str, told: AgentEntry | None, *, at: int, age_ms: int) -> BehaviourReading:
        own = behaviour.reading(self._behaviour, agent, at, age_ms, self._parameters)
        restored_at = None if told is None else told.restored_at
        if restored_at is None or own.deviated_at is None or not own.deviated_at <= restored_at:
            return own
        # A person has said that what was seen until then is all right. Whether its work has changed is not said: what
        # is usual is learned anew here, and judged by the identity provider meanwhile.
        try:
            self._behaviour = behaviour.relearn(self._behaviour, agent, by=PERSON, at=restored_at)
        except RestoreError:
            return own
        return behaviour.reading(self._behaviour, agent, at, age_ms, self._parameters)

    def _hear(self, kind: str, body: Mapping[str, Any], at_ms: int) -> None:
        with self._lock:
            match kind:
                case "decision":
                    found = journal_reports.decided(body, reporter=SELF, at_ms=at_ms)
                    if found is None:
                        return
                    if found.open:
                        self._open[found.report.request_id] = found.report, found.role
                        if len(self._open) > OPEN:
                            self._open.popitem(last=False)
                    else:
                        self._observe(found.report, found.role)
                case "outcome":
                    request_id = body.get("request_id")
                    before, role = self._open.get(request_id, (None, "")) if isinstance(request_id, str) else (None, "")
                    report = None if before is None else journal_reports.concluded(before, body, at_ms=at_ms)
                    if report is not None:
                        del self._open[report.request_id]
                        self._observe(report, role)
                case _:
                    pass

    def _observe(self, report: Report, role: str) -> None:
        self._trust = trust.observe(self._trust, report, self._parameters, now=report.at)
        self._behaviour = behaviour.observe(self._behaviour, report, self._parameters, now=report.at, role=role)


def _stricter(own: BehaviourReading, told: AgentEntry) -> BehaviourReading:
    """All that either of the two says against the agent."""
    found = {deviation.feature: deviation for deviation in own.deviations}
    for entry in told.deviations:
        feature = _FEATURES.get(entry.feature)
        if feature is None:
            continue
        here = found.get(feature, Deviation(feature, entry.since, entry.score_milli))
        found[feature] = Deviation(feature, min(here.since, entry.since), max(here.score_milli, entry.score_milli))
    # A feature that this version does not know is a deviation all the same, with the usual consequences.
    unknown = any(entry.feature not in _FEATURES for entry in told.deviations)
    return replace(
        own,
        deviations=tuple(found[feature] for feature in sorted(found)),
        deviated_at=max((at for at in (own.deviated_at, told.deviated_at) if at is not None), default=None),
        contracted=own.contracted or told.contracted or unknown,
        samples=max(own.samples, told.samples),
    )


def near_permille(request: Request, evidence: Evidence) -> int | None:
    """Closeness of the request to the bounds of its chain: 0 far, 1000 at a bound, None unknown.

    Of a parameter it is its part of the bound on its side of zero; of its physics, the index's part of the highest one
    that the ceiling lets through.
    """
    chain = evidence.chain
    if not isinstance(chain, Chain):
        return None
    grant = chain.scope.find(request.object, request.operation)
    bounds = {} if grant is None else {limit.parameter.name: limit.bound for limit in grant.limits}
    near = [_near(value.value, bounds[value.name]) for value in request.quantities if value.name in bounds]
    highest = int(chain.scope.ceiling)
    if isinstance(evidence.impact, ImpactReading) and highest:
        near.append(min(1_000, evidence.impact.index_milli // highest))
    return max((one for one in near if one is not None), default=None)


def _near(value: int, bound: Bound) -> int | None:
    match bound:
        case Range(low, high):
            end = high if value > 0 else low
            # A bound at zero, or on the other side of it, is none that a value grows towards.
            return min(1_000, 1_000 * abs(value) // abs(end)) if value * end > 0 else 0
        case OneOf() | Flags() | Words() | Stems() | Each():
            return None
