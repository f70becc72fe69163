"""One run: for each database and number of workers, rounds in which provider and bare endpoint take turns."""

from __future__ import annotations

import asyncio
import os
import statistics
import tempfile
import time
from contextlib import AsyncExitStack, suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Final

from evaluation.harness.absent import AbsentError
from evaluation.harness.machine import machine
from evaluation.harness.timing import WrongAnswerError
from evaluation.idp import databases
from evaluation.idp.bench import (
    BARE,
    OPERATIONS,
    IdpResult,
    OperationRow,
    PlaceRow,
    percentile,
    slope,
)
from evaluation.idp.horizon import Follower, horizons_ms
from evaluation.idp.load import sent
from evaluation.idp.place import place
from evaluation.idp.work import Work

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from evaluation.idp.load import Answered, Ready
    from evaluation.idp.place import IdpPlace

CLIENTS: Final = 8
FOLLOWERS: Final = 4
ROUNDS: Final = 5
WORKERS: Final = (1, 2)
BATCH: Final = 200
"""Requests of one operation in one round: the last one's proof is still young when it is sent."""
KNOWN_S: Final = 10.0
"""Longest wait for followers to know the last revocation of a round."""
WARM_UP: Final = 1
"""Rounds that are not counted: statements are compiled in them, and connections made."""
NOT_MADE: Final = "not measured"
PAGE_KIB: Final = os.sysconf("SC_PAGESIZE") // 1024


@dataclass
class _Series:
    """Answers to one operation, round by round."""

    rates: list[float] = field(default_factory=list)
    ratios: list[float] = field(default_factory=list)
    took_s: list[float] = field(default_factory=list)
    cpu_s: float = 0.0


@dataclass
class _Place:
    """Measurement of one place."""

    at: IdpPlace
    database: str
    workers: int
    series: dict[str, _Series] = field(default_factory=dict)
    horizons: list[float] = field(default_factory=list)
    memory: list[tuple[float, float]] = field(default_factory=list)
    asked: int = 0
    told: Callable[[str], object] = lambda _: None
    round: str = ""


def run(
    kinds: Sequence[str],
    *,
    agents: int,
    batch: int = BATCH,
    rounds: int = ROUNDS,
    workers: Sequence[int] = WORKERS,
    told: Callable[[str], object],
) -> IdpResult:
    """Result of a run.

    Args:
        kinds: of databases, or URLs of empty ones.
        agents: registered, at least two for each request of a batch.
        batch: requests of one operation in one round.
        rounds: timed ones.
        workers: numbers of processes, of provider and bare endpoint alike.
        told: receives the name of each step.

    Raises:
        WrongAnswerError: an answer was no success.
        ChildError: a process did not start.
    """
    began, operations, places = time.monotonic(), list[OperationRow](), list[PlaceRow]()
    for kind in kinds:
        for number in workers:
            name = kind.partition(":")[0].partition("+")[0]
            told(f"{name}, {number} workers: {agents} agents")
            try:
                with (
                    tempfile.TemporaryDirectory(prefix="ztpm-bench-") as folder,
                    databases.empty(kind, Path(folder)) as url,
                    place(Path(folder), url, workers=number, agents=agents) as at,
                ):
                    measured = asyncio.run(_measured(at, name, number, batch=batch, rounds=rounds, told=told))
            except AbsentError as error:
                places.append(PlaceRow(name, number, agents, why=str(error)))
                continue
            except WrongAnswerError as error:
                raise WrongAnswerError(f"{name}, {number} workers: {error}") from error
            operations += _rows(measured)
            places.append(_place_row(measured, agents))
    return IdpResult(operations, places, clients=CLIENTS, seconds=time.monotonic() - began, machine=machine())


async def _measured(
    at: IdpPlace, database: str, workers: int, *, batch: int, rounds: int, told: Callable[[str], object]
) -> _Place:
    found = _Place(at, database, workers, told=told)
    for turn in range(rounds + WARM_UP):
        found.round = f"{database}, {workers} workers: round {turn + 1} of {rounds + WARM_UP}"
        if turn == WARM_UP:
            found.series.clear()
            found.horizons.clear()
            found.memory.clear()
        await _round(found, Work(at), batch=batch, turn=turn)
        found.memory.append((found.asked / 1_000, sum(map(_memory_kib, at.pids[0]))))
    return found


async def _round(found: _Place, work: Work, *, batch: int, turn: int) -> None:
    at = found.at
    first = turn * 2 * batch
    holders = [(first + 2 * n) % len(at.agents) for n in range(batch)]
    delegates = [holder + 1 for holder in holders]
    bare = await _sent(found, BARE, [work.bare(holder) for holder in holders], None)
    nonces = await _sent(found, "nonce", [work.nonce(holder) for holder in holders], bare)
    issued = await _sent(
        found, "issue", [work.issue(h, n["nonce"]) for h, n in zip(holders, nonces.bodies, strict=True)], bare
    )
    again = await _sent(found, "nonce", [work.nonce(delegate) for delegate in delegates], bare)
    lent = zip(holders, issued.bodies, delegates, again.bodies, strict=True)
    await _sent(
        found, "delegate", [work.delegate(h, t["token"], d, n["nonce"]) for h, t, d, n in lent], bare
    )  # fmt: skip
    access = [turn * batch + n for n in range(batch)]
    told = await _sent(found, "introspect", [work.introspect(n % len(at.access)) for n in access], bare)
    if not all(answer["active"] for answer in told.bodies):
        raise WrongAnswerError("introspect: an access token that is good is none")
    held = list(zip(holders, issued.bodies, strict=True))
    async with AsyncExitStack() as following:
        followers = [Follower(at, n) for n in range(FOLLOWERS)]
        for follower in followers:
            task = asyncio.create_task(follower.follow())
            following.push_async_callback(_ended, task)
        revoked = await _sent(found, "revoke", [work.revoke(h, t["token_id"]) for h, t in held], bare)
        newest = max(answer["epoch"] for answer in revoked.bodies)
        async with asyncio.timeout(KNOWN_S):
            await asyncio.gather(*[follower.has_read(newest) for follower in followers])
        found.horizons += horizons_ms(followers, revoked)


async def _sent(found: _Place, operation: str, requests: list[Ready], bare: Answered | None) -> Answered:
    """Answers to a batch of one operation, put on record beside the bare endpoint's of the same round."""
    own = bare is not None
    found.told(f"{found.round}: {operation}")
    places, pids = (found.at.provider, found.at.pids[0]) if own else (found.at.bare, found.at.pids[1])
    before = sum(map(_cpu_s, pids))
    answered = await sent(places, requests, clients=CLIENTS)
    series = found.series.setdefault(operation, _Series())
    series.cpu_s += sum(map(_cpu_s, pids)) - before
    rate = len(requests) / answered.seconds
    series.rates.append(rate)
    series.took_s += answered.took_s
    if bare is not None:
        series.ratios.append(rate * bare.seconds / len(bare.bodies))
        found.asked += len(requests)
    return answered


async def _ended(task: asyncio.Task[None]) -> None:
    task.cancel()
    with suppress(asyncio.CancelledError):
        await task


def _rows(found: _Place) -> list[OperationRow]:
    rows = []
    for operation in (BARE, *OPERATIONS):
        series = found.series.get(operation)
        if series is None:
            rows.append(OperationRow(found.database, found.workers, operation, why=NOT_MADE))
            continue
        n = len(series.took_s)
        rows.append(
            OperationRow(
                found.database,
                found.workers,
                operation,
                n=n,
                per_s=round(statistics.median(series.rates), 1),
                ratio=round(statistics.median(series.ratios), 3) if series.ratios else None,
                p50_ms=round(statistics.median(series.took_s) * 1e3, 2),
                p99_ms=round(percentile(series.took_s, 99) * 1e3, 2),
                cpu_ms=round(series.cpu_s / n * 1e3, 2),
            )
        )
    return rows


def _place_row(found: _Place, agents: int) -> PlaceRow:
    return PlaceRow(
        found.database,
        found.workers,
        agents,
        revocation_p50_ms=round(statistics.median(found.horizons), 1),
        revocation_p99_ms=round(percentile(found.horizons, 99), 1),
        followers=FOLLOWERS,
        memory_mib=round(found.memory[-1][1] / 1024, 1),
        memory_slope_kib=round(slope(found.memory), 1),
    )


def _cpu_s(pid: int) -> float:
    """Processor time of a process so far, seconds."""
    fields = Path(f"/proc/{pid}/stat").read_text(encoding="ascii").rpartition(")")[2].split()
    return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")


def _memory_kib(pid: int) -> int:
    """Resident memory of a process now, KiB."""
    return int(Path(f"/proc/{pid}/statm").read_text(encoding="ascii").split()[1]) * PAGE_KIB
