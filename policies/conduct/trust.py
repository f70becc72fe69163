"""Trust of one edge, capped by the policy's prior; a chain has the trust of its weakest edge.

Knowledge can only lower trust: an edge without a statement has the prior, an edge stated above it has the prior, and
nothing flows along the chain (CATP-1). So no statement or report, true or forged, makes an agent more trusted than an
unknown one. Trust that an edge loses by its agent's acts (CATP-3) comes back with time, up to the prior and never
above it.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from types import MappingProxyType
from typing import TYPE_CHECKING, Any, Final

from policies.conduct.counted_reports import CountedReports
from policies.conduct.decay import decayed, ticks_between
from policies.conduct.report import Edge, ReportError, is_count, is_text, keyed, listed
from policies.conduct.trust_changes import charge, credit_milli
from policies.evidence.evidence import EdgeReading, TrustReading
from policies.words.canonical import EXACT

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping, Sequence

    from policies.conduct.report import Report
    from policies.words.parameters import Parameters

GRAIN: Final = 1_000_000
"""Accounts are kept in millionths of a charge's thousandth, so that rounding down at each decay is not seen."""
EDGES_MAX: Final = 4_096
"""Edges with an account. Beyond it the edge that was charged least is forgotten."""


@dataclass(frozen=True, slots=True)
class Account:
    """Account of one edge as one reporter states it.

    Attributes:
        at: up to when it is decayed, seconds since the epoch.
        good, bad: decayed sums of credits and charges, each at most its cap; in thousandths times `GRAIN`.
    """

    at: int
    good: int
    bad: int


@dataclass(frozen=True, slots=True)
class TrustState:
    """Trust state: the reports, as far as they still count.

    All that bears on an edge is in the reports about its delegate. So one state may hold all agents, or each agent may
    have one of its own: the scores are the same.

    Attributes:
        accounts: by edge, then by reporter.
        seen: by reporter.
    """

    accounts: Mapping[Edge, Mapping[str, Account]] = field(default_factory=lambda: MappingProxyType({}))
    seen: Mapping[str, CountedReports] = field(default_factory=lambda: MappingProxyType({}))

    def to_json(self) -> dict[str, Any]:
        """Plain JSON of the state, ordered, so that equal states have equal texts."""
        return {
            "accounts": [
                [*edge, reporter, held.at, held.good, held.bad]
                for edge, by_reporter in sorted(self.accounts.items())
                for reporter, held in sorted(by_reporter.items())
            ],
            "seen": [[reporter, seen.to_json()] for reporter, seen in sorted(self.seen.items())],
        }

    @classmethod
    def from_json(cls, body: object) -> TrustState:
        """State that `to_json` wrote, exactly.

        Raises:
            ReportError: it is not that.
        """
        fields = keyed(body, {"accounts", "seen"}, "trust")
        accounts: dict[Edge, dict[str, Account]] = {}
        for row in listed(fields["accounts"], "accounts"):
            match row:
                case [delegator, delegate, reporter, at, good, bad]:
                    pass
                case _:
                    raise ReportError("accounts")
            if not all(map(is_text, (delegator, delegate, reporter))):
                raise ReportError("accounts")
            if not (is_count(at, EXACT) and is_count(good, EXACT) and is_count(bad, EXACT)):
                raise ReportError("accounts")
            accounts.setdefault(Edge(delegator, delegate), {})[reporter] = Account(at, good, bad)
        seen = {}
        for row in listed(fields["seen"], "seen"):
            match row:
                case [reporter, kept] if is_text(reporter):
                    seen[reporter] = CountedReports.from_json(kept)
                case _:
                    raise ReportError("seen")
        return cls(MappingProxyType(accounts), MappingProxyType(seen))


NOTHING_REPORTED: Final = TrustState()
"""State before the first report."""


def observe(state: TrustState, report: Report, parameters: Parameters, *, now: int) -> TrustState:
    """The state after the report; the same state when the report is not to be counted.

    Not counted: one whose request id this reporter gave before, one that is older than the remembered ones of this
    reporter, and one from the future, which would put off its decay. A late one is charged as if it had come in time.

    Args:
        state: before.
        report: its signature was verified, and `reporter` is the enforcement point whose key signed it.
        parameters: of the policy set.
        now: seconds since the epoch, by the receiver's clock.
    """
    if report.at > now + parameters.skew_s:
        return state
    seen = state.seen.get(report.reporter, CountedReports()).added(report.at, report.request_id)
    if seen is None:
        return state
    all_seen = MappingProxyType({**state.seen, report.reporter: seen})
    good, bad = credit_milli(report) * GRAIN, charge(report).milli * GRAIN
    if not good and not bad:
        return TrustState(state.accounts, all_seen)
    of_edge = state.accounts.get(report.edge, {})
    before = of_edge.get(report.reporter)
    newest = report.at if before is None else max(before.at, report.at)
    had_good, had_bad = (0, 0) if before is None else _at(before, newest, parameters)
    late = ticks_between(report.at, newest, half_life_s=parameters.trust_half_life_s)
    after = Account(
        newest,
        min(had_good + decayed(good, late), parameters.trust_good_cap_milli * GRAIN),
        min(had_bad + decayed(bad, late), parameters.trust_bad_cap_milli * GRAIN),
    )
    accounts = {**state.accounts, report.edge: MappingProxyType({**of_edge, report.reporter: after})}
    return TrustState(MappingProxyType(_bounded(accounts)), all_seen)


def score(state: TrustState, edge: Edge, at: int, stated_permille: int | None, parameters: Parameters) -> int:
    """Trust in one edge, in permille: the prior as its agent's acts lowered it, and never more than is stated.

    prior * s0 / (s0 + sum over reporters of bad * s0 / (s0 + good)), rounded to the nearest. With one reporter that is
    prior * (s0 + good) / (s0 + good + bad). A reporter's good word weighs against its own bad word alone: no
    reporter can whitewash another's report. Its bad word is capped: alone it leaves at least
    prior * s0 / (s0 + cap).

    Args:
        state: reports up to now.
        edge: delegator and delegate.
        at: seconds since the epoch.
        stated_permille: as `edge_trust` takes it.
        parameters: of the policy set.
    """
    most = edge_trust(stated_permille, parameters)
    s0 = parameters.trust_prior_weight_milli * GRAIN
    against = 0
    for account in state.accounts.get(edge, {}).values():
        good, bad = _at(account, at, parameters)
        against += -(-bad * s0 // (s0 + good))  # rounded up: rounding favours no one who was charged
    whole = s0 + against
    return min(most, (2 * parameters.trust_prior_permille * s0 + whole) // (2 * whole))


def scores(state: TrustState, at: int, parameters: Parameters) -> dict[Edge, int]:
    """Scores of the edges below the prior, for a signed snapshot; an edge outside it has the prior."""
    found = {edge: score(state, edge, at, None, parameters) for edge in sorted(state.accounts)}
    return {edge: permille for edge, permille in found.items() if permille < parameters.trust_prior_permille}


def edge_trust(stated_permille: int | None, parameters: Parameters) -> int:
    """The most that one edge may be trusted, 0 to the prior, in permille.

    Args:
        stated_permille: the trust that the signed registry states in the edge's delegate, or None when it states none.
            Anything that is not an integer from 0 to 1000 is no statement that can be believed, and gives 0.
        parameters: of the policy set.
    """
    if stated_permille is None:
        return parameters.trust_prior_permille
    if type(stated_permille) is not int or not 0 <= stated_permille <= 1000:
        return 0
    return min(stated_permille, parameters.trust_prior_permille)


def chain_trust(
    stated_permille: Iterable[int | None],
    parameters: Parameters,
    *,
    parties: Sequence[str] = (),
    snapshot: Mapping[Edge, int] = MappingProxyType({}),
    state: TrustState = NOTHING_REPORTED,
    at: int = 0,
) -> TrustReading:
    """Trust reading of a chain: one edge for each hop, and the weakest of them.

    Every argument can only lower it.

    Args:
        stated_permille: one entry for each hop, the authority block's agent first; a chain without edges has no trust
            at all.
        parameters: of the policy set.
        parties: the sponsor, then each hop's agent: one more than hops. Without them only the stated trust is
            known, and the reading names no edges; with another number of them it is no chain, and has no trust.
        snapshot: the identity provider's scores (`scores`); an edge that is not in it is not lowered by it.
        state: this enforcement point's own reports: they may only tighten, and only here.
        at: seconds since the epoch, for `state`.
    """
    stated = tuple(stated_permille)
    if not parties:
        return TrustReading(min((edge_trust(one, parameters) for one in stated), default=0))
    if len(parties) != len(stated) + 1:
        return TrustReading(0)
    edges = []
    for one, delegator, delegate in zip(stated, parties, parties[1:], strict=False):
        edge = Edge(delegator, delegate)
        most = min(score(state, edge, at, one, parameters), edge_trust(snapshot.get(edge), parameters))
        edges.append(EdgeReading(delegator, delegate, most))
    return TrustReading(min((edge.score_permille for edge in edges), default=0), tuple(edges))


def _at(account: Account, at: int, parameters: Parameters) -> tuple[int, int]:
    """Good and bad at an instant, each at most its cap, which another policy set may have lowered meanwhile."""
    ticks = ticks_between(account.at, at, half_life_s=parameters.trust_half_life_s)
    good, bad = decayed(account.good, ticks), decayed(account.bad, ticks)
    return (
        min(good, parameters.trust_good_cap_milli * GRAIN),
        min(bad, parameters.trust_bad_cap_milli * GRAIN),
    )


def _bounded(accounts: dict[Edge, Mapping[str, Account]]) -> dict[Edge, Mapping[str, Account]]:
    """Without the edge that was charged least, when there are too many."""
    if len(accounts) > EDGES_MAX:
        del accounts[min(accounts, key=lambda edge: (max(held.bad for held in accounts[edge].values()), edge))]
    return accounts
