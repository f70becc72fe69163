"""Conduct of agents, from the records of enforcement points and from this provider's own delegations.

The reducers are those of `policies`; here they are fed. A report counts when its authority was lent by this provider to
the agent that acted, for an audience that the reporter serves. Any other report is kept in the ledger like every
record, and counts for nothing.
"""

from __future__ import annotations

from dataclasses import replace
from types import MappingProxyType
from typing import TYPE_CHECKING, Final

from policies.conduct import behaviour, journal_reports, trust
from policies.conduct.report import TEXT_MAX, Report, ReportError
from policies.evidence.model import Effect
from ztpm_idp.domain.agent_conduct import AgentConduct, Concerned, Published
from ztpm_idp.domain.events import ConductObserved, PermitConcluded, PermitOpened, RevocationKind, Revoked
from ztpm_idp.domain.parties import RegisteredAgent

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from capabilities.values.chain import Chain
    from policies.conduct.behaviour import BehaviourState
    from policies.words.parameters import Parameters
    from ztpm_idp.domain.codes import Code
    from ztpm_idp.domain.events import Event, RecordTaken
    from ztpm_idp.domain.parties import RegisteredPep
    from ztpm_idp.domain.rules import Rules
    from ztpm_idp.domain.state import State

DELEGATE: Final = "delegate"
"""The operation of lending on."""
PEERS: Final = 8
"""Number of others of its role that a young agent is compared with."""
CONTRACTED: Final = "the agent was contracted"
"""Reason for which the mandates of a contracted agent are revoked."""
OPEN_RECORDS: Final = 4_096
"""Most records that may follow a PERMIT before its outcome; a later outcome makes no report."""


# --- from records ----------------------------------------------------------------------------------------------------


def concerned(records: Iterable[Mapping[str, object]]) -> Concerned:
    """Subjects that must be loaded for these records, of any shape."""
    requests, hops = set[str](), set[str]()
    for record in records:
        match record:
            case {"kind": "outcome", "body": {"request_id": str(request_id)}} if _plain(request_id):
                requests.add(request_id)
            case {"kind": "decision", "pep": str(pep), "at_ms": int(at_ms), "body": dict(body)}:
                found = journal_reports.decided(body, reporter=pep, at_ms=at_ms)
                if found is not None and _plain(found.hop_id):
                    hops.add(found.hop_id)
            case _:
                pass
    return Concerned(frozenset(requests), frozenset(hops))


def reported(
    rules: Rules, state: State, pep: RegisteredPep, taken: Iterable[RecordTaken], at_ms: int
) -> tuple[Event, ...]:
    """Events that new records of a journal, in order, tell of the agents that acted."""
    events: list[Event] = []
    reports, open_ = list[Report](), dict(state.held.open)
    for record in taken:
        written, body = int(str(record.record["at_ms"])), record.record["body"]
        if not isinstance(body, dict):  # no record of this shape was taken
            raise AssertionError  # noqa: TRY004  an invariant
        match record.record["kind"]:
            case "decision":
                found = journal_reports.decided(body, reporter=pep.id, at_ms=written)
                if found is None or not _ours(state, pep, found):
                    continue
                if found.open:
                    open_[found.report.request_id] = found.report
                    events.append(PermitOpened(pep.id, record.seq, found.report))
                else:
                    reports.append(found.report)
            case "outcome":
                request_id = body.get("request_id")
                before = open_.get(request_id) if isinstance(request_id, str) else None
                after = None if before is None else journal_reports.concluded(before, body, at_ms=written)
                if after is not None:
                    del open_[after.request_id]
                    events.append(PermitConcluded(pep.id, after.request_id))
                    reports.append(after)
            case _:
                pass
    return (*events, *observed(rules, state, reports, at_ms))


def _plain(name: str) -> bool:
    """True where every database can look the name up."""
    return len(name) <= TEXT_MAX and name.isprintable()


def _ours(state: State, pep: RegisteredPep, found: journal_reports.RecordedDecision) -> bool:
    """True where the record has an audience of the enforcement point, and a hop made for just this edge."""
    if not _plain(found.report.request_id):
        return False
    return found.audience in pep.audiences and state.held.made.get(found.hop_id) == found.report.edge


def observed(rules: Rules, state: State, reports: Iterable[Report], at_ms: int) -> tuple[Event, ...]:
    """Conduct after the reports, one event for each agent that they are about; a contracted one loses its mandates."""
    parameters, now, known = rules.policies.parameters, at_ms // 1_000, dict[str, AgentConduct]()
    for report in reports:
        before = known.get(report.agent) or of(state, report.agent)
        party = state.parties.get(report.agent)
        role = party.role if isinstance(party, RegisteredAgent) else ""
        known[report.agent] = replace(
            before,
            trust=trust.observe(before.trust, report, parameters, now=now),
            behaviour=_beside(state, before.behaviour, report, parameters, now=now, role=role),
        )
    found = [
        ConductObserved(agent, conduct, published(agent, conduct, at=now, parameters=parameters))
        for agent, conduct in sorted(known.items())
    ]
    contracted = {event.agent for event in found if event.published.reading.contracted}
    lost = (
        Revoked(RevocationKind.MANDATE, mandate.mandate_id, CONTRACTED, None)
        for mandate in state.mandates
        if mandate.agent in contracted
    )
    return (*found, *lost)


def _beside(
    state: State, before: BehaviourState, report: Report, parameters: Parameters, *, now: int, role: str
) -> BehaviourState:
    """The agent's own state after the report, which was looked at beside its peers' where it is still young."""
    own = before.careers.get(report.agent)
    young = own is None or own.baseline is None
    peers = state.held.peers.get(report.agent, {}) if young else {}
    together = replace(before, careers=MappingProxyType({**peers, **before.careers}))
    after = behaviour.observe(together, report, parameters, now=now, role=role)
    careers = {agent: career for agent, career in after.careers.items() if agent == report.agent}
    return replace(after, careers=MappingProxyType(careers))


# --- from here -------------------------------------------------------------------------------------------------------


def of_delegation(rules: Rules, chain: Chain, request_id: str, *, at_ms: int, refused: Code | None) -> Report | None:
    """Report of this provider on a holder that asked to delegate; None when it cannot be put into one.

    Args:
        rules: name the provider.
        chain: the holder's, verified.
        request_id: unique for this provider.
        at_ms: now, wall clock.
        refused: why, or None when it was made.
    """
    try:
        return Report(
            reporter=rules.issuer,
            request_id=request_id,
            agent=chain.leaf.agent,
            delegators=(chain.sponsor.subject, *(hop.agent for hop in chain.hops)),
            at=at_ms // 1_000,
            operation=DELEGATE,
            # Lending moves nothing: it earns nothing (policies.conduct.trust_changes).
            base_tier=0,
            runtime_tier=0,
            effect=str(Effect.PERMIT if refused is None else Effect.DENY),
            reason="PERMITTED" if refused is None else refused.value,
            outcome="done" if refused is None else "none",
            values=(),
            near_permille=None,
        )
    except ReportError:
        return None


# --- known conduct ---------------------------------------------------------------------------------------------------


def of(state: State, agent: str) -> AgentConduct:
    """Conduct of an agent that the command wanted to see."""
    return state.held.agents.get(agent) or AgentConduct()


def published(agent: str, conduct: AgentConduct, *, at: int, parameters: Parameters) -> Published:
    """Conduct of an agent as published to enforcement points, as of `at` (seconds)."""
    return Published(
        scores={edge: trust.score(conduct.trust, edge, at, None, parameters) for edge in conduct.trust.accounts},
        default_permille=parameters.trust_prior_permille,
        reading=behaviour.reading(conduct.behaviour, agent, at, 0, parameters),
        restored_at=conduct.restored_at,
    )
