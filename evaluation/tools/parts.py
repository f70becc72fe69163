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
    from pathlib import Path

    from pep import GuardedFunctions
    from pep.request.authority import PresentedRequest

PAUSE_S: Final = 0.002
"""Pause between two records, as between two calls: a disk that is never left alone is another one."""
DECISION, OUTCOME = "decision on record", "outcome noted"


async def parts_us(point: GuardedFunctions, presented: Callable[[], PresentedRequest], calls: int) -> dict[str, float]:
    """Median of each part of a permitted act, in microseconds.

    Args:
        point: has permitted some.
        presented: makes fresh credentials.
        calls: of each part.
    """
    folder = point.config.state_dir
    decision = _newest(folder, "decision")
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
    await _records(folder, decision, calls, found)
    loop = asyncio.get_running_loop()
    for _ in range(calls):
        with _timed(found, "a worker asked, and its answer awaited"):
            await loop.run_in_executor(None, int)
    return {name: round(statistics.median(each) / 1e3, 2) for name, each in found.items()}


async def record_us(folder: Path, calls: int) -> float:
    """Median time of what is on record of one permitted act, in microseconds.

    Args:
        folder: state of an enforcement point that has permitted some.
        calls: of each part.
    """
    found: dict[str, list[int]] = {}
    await _records(folder, _newest(folder, "decision"), calls, found)
    return round(sum(statistics.median(found[part]) for part in (DECISION, OUTCOME)) / 1e3, 2)


async def _records(folder: Path, decision: dict[str, Any], calls: int, found: dict[str, list[int]]) -> None:
    """Times the bare disk of the folder, and records in a journal of its own on it."""
    outcome = _newest(folder, "outcome")
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
            with _timed(found, DECISION):
                journal.append("decision", decision)
            with _timed(found, OUTCOME):
                journal.note("outcome", outcome)
            await asyncio.sleep(PAUSE_S)
    finally:
        journal.close()


def _newest(folder: Path, kind: str) -> dict[str, Any]:
    """Body of the newest record of a kind in the journal of an enforcement point: of a permitted act."""
    records = map(json.loads, (folder / "journal.ndjson").read_text("utf-8").splitlines())
    bodies = (record["body"] for record in records if record["kind"] == kind)
    *_, newest = (body for body in bodies if kind != "decision" or body["decision"]["effect"] == "PERMIT")
    return newest  # type: ignore[no-any-return]


@contextmanager
def _timed(found: dict[str, list[int]], part: str) -> Iterator[None]:
    began = time.perf_counter_ns()
    yield
    found.setdefault(part, []).append(time.perf_counter_ns() - began)
