"""Parts of the guard, each alone: what of an act's time goes where."""

from __future__ import annotations

import asyncio
import json
import os
import statistics
import time
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any, Final

from pep.base.clock import SystemClock
from pep.journal.file_journal import FileJournal
from policies.decision.load import load_shipped
from policies.decision.pdp import decide
from policies.evidence import case_json

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator

    from pep import GuardedFunctions
    from pep.request.authority import PresentedRequest

PAUSE_S: Final = 0.002
"""Pause between two records, as between two calls: a disk that is never left alone is another one."""


async def parts_us(point: GuardedFunctions, presented: Callable[[], PresentedRequest], calls: int) -> dict[str, float]:
    """Median of each part of a permitted act, in microseconds.

    Args:
        point: has permitted some.
        presented: makes fresh credentials.
        calls: of each part.
    """
    decision = _newest(point, "decision")
    case = case_json.read({name: decision[name] for name in ("form", "request", "evidence")})
    policies = load_shipped(point.config.policy)
    lease_ms = point.gate.lease_ms(case.request)
    found: dict[str, list[int]] = {}
    made: list[PresentedRequest] = []
    for _ in range(calls):
        with _timed(found, "proof made, by the caller"):
            made.append(presented())
    for each in made:
        with _timed(found, "token and proof checked"):
            point.authority.check(each, lease_ms=lease_ms)
    for _ in range(calls):
        with _timed(found, "policies decided"):
            decide(case.request, case.evidence, policies)
    await _records(point, decision, calls, found)
    loop = asyncio.get_running_loop()
    for _ in range(calls):
        with _timed(found, "a worker asked, and its answer awaited"):
            await loop.run_in_executor(None, int)
    return {name: round(statistics.median(each) / 1e3, 2) for name, each in found.items()}


async def _records(point: GuardedFunctions, decision: dict[str, Any], calls: int, found: dict[str, list[int]]) -> None:
    """Times the bare disk of the point, and records in a journal of its own on it."""
    outcome, folder = _newest(point, "outcome"), point.config.state_dir
    line = json.dumps(decision).encode()
    with (folder / "disk").open("ab", buffering=0) as file:
        for _ in range(calls):
            with _timed(found, "of a record, the disk alone"):
                file.write(line)
                os.fdatasync(file.fileno())
            await asyncio.sleep(PAUSE_S)
    journal = FileJournal.open(folder / "parts.ndjson", pep_id="parts", clock=SystemClock())
    try:
        for _ in range(calls):
            with _timed(found, "decision on record"):
                journal.append("decision", decision)
            with _timed(found, "outcome noted"):
                journal.note("outcome", outcome)
            await asyncio.sleep(PAUSE_S)
    finally:
        journal.close()


def _newest(point: GuardedFunctions, kind: str) -> dict[str, Any]:
    """Body of the newest record of a kind: of a permitted act."""
    bodies = (record["body"] for record in point.journal.records() if record["kind"] == kind)
    *_, newest = (body for body in bodies if kind != "decision" or body["decision"]["effect"] == "PERMIT")
    return newest  # type: ignore[no-any-return]


@contextmanager
def _timed(found: dict[str, list[int]], part: str) -> Iterator[None]:
    began = time.perf_counter_ns()
    yield
    found.setdefault(part, []).append(time.perf_counter_ns() - began)
