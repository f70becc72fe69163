"""Trust in an agent over time, by what enforcement points recorded of it. Pure.

The reducer is that of `policies`, fed anew with the records that the ledger has; what it gives is for people to look
at, and nothing is decided on it.
"""

from __future__ import annotations

import json
from collections import defaultdict
from typing import TYPE_CHECKING, Any

from policies.conduct import journal_reports, trust
from policies.conduct.report import Report

if TYPE_CHECKING:
    from collections.abc import Iterable

    from policies.words.parameters import Parameters

Line = list[tuple[int, int]]
"""(Time in seconds, trust in permille) pairs, in order."""


def trust_over_time(lines: Iterable[bytes], agent: str, parameters: Parameters, *, now: int) -> dict[str, Line]:
    """Trust in the agent by each delegator that a record tells of, at each record and now.

    Args:
        lines: entries of the ledger about it, in order; any but records of decisions and outcomes change nothing.
        agent: its id.
        parameters: of the policy set.
        now: seconds since the epoch.
    """
    state, open_ = trust.NOTHING_REPORTED, dict[str, Report]()
    found = defaultdict[str, Line](list)
    for line in lines:
        entry = json.loads(line)
        record = entry["body"].get("record") if isinstance(entry.get("body"), dict) else None
        report = None if not isinstance(record, dict) else _report(record, open_)
        if report is None or report.agent != agent:
            continue
        at = entry["at_ms"] // 1_000
        state = trust.observe(state, report, parameters, now=at)
        for edge in state.accounts:
            if edge.delegate == agent:
                found[edge.delegator].append((at, trust.score(state, edge, at, None, parameters)))
    for edge in state.accounts:
        if edge.delegate == agent:
            found[edge.delegator].append((now, trust.score(state, edge, now, None, parameters)))
    return dict(found)


def _report(record: dict[str, Any], open_: dict[str, Report]) -> Report | None:
    """The report that a record concludes, if it does; a PERMIT waits for its outcome."""
    body, at_ms = record.get("body"), record.get("at_ms")
    if not isinstance(body, dict) or type(at_ms) is not int:
        return None
    match record.get("kind"):
        case "decision":
            found = journal_reports.decided(body, reporter=str(record.get("pep")), at_ms=at_ms)
            if found is None or not found.open:
                return None if found is None else found.report
            open_[found.report.request_id] = found.report
            return None
        case "outcome":
            before = open_.pop(str(body.get("request_id")), None)
            return None if before is None else journal_reports.concluded(before, body, at_ms=at_ms)
        case _:
            return None
