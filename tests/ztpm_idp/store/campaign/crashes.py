"""kill -9 of a provider at every boundary of its store and at random instants: nothing acknowledged is lost."""

from __future__ import annotations

import asyncio
import json
import os
import random
import select
import signal
import time
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import httpx2
import sqlalchemy as sa
from tests.progress import Progress
from tests.ztpm_idp.store.campaign.scene import Prepared, Scene, contradictions
from tests.ztpm_idp.world import ISSUER

from ztpm_idp.client import ProofAuth

if TYPE_CHECKING:
    from collections.abc import Callable

RESTART_S = 5.0
"""Longest start after a crash (reliability.md, C3), in seconds."""


@dataclass
class Found:
    """Figures of a campaign, and how far each request's boundaries were tried.

    Attributes:
        places: number of the next boundary, by request.
        over: requests whose boundaries were all tried.
    """

    places: dict[str, int] = field(default_factory=dict)
    over: list[str] = field(default_factory=list)
    points: int = 0
    instants: int = 0
    acknowledged: int = 0
    slowest_s: float = 0.0
    lost: list[str] = field(default_factory=list)
    half: list[str] = field(default_factory=list)
    twice: list[str] = field(default_factory=list)

    @property
    def clean(self) -> bool:
        return not self.lost and not self.half and not self.twice and self.slowest_s < RESTART_S


def at_every_point(
    scene: Scene,
    found: Found,
    *,
    step: int = 1,
    names: frozenset[str] | None = None,
    keep: Callable[[], None] = lambda: None,
) -> None:
    """Each request of the scene, killed at each boundary of the store in turn, and tried again after that.

    Args:
        scene: whose provider it is.
        found: that it adds to, and goes on from.
        step: between two boundaries that are tried.
        names: of the requests; None: all.
        keep: keeps what was found so far.
    """
    progress = Progress()
    for request in scene.requests:
        if request.name in found.over or (names is not None and request.name not in names):
            continue
        whole = _whole(scene, request)
        place, ended = found.places.get(request.name, 0), False
        while not ended:
            progress.at(f"{scene.database}: {request.name} at boundary {place}, {found.points} in all")
            scene.reset()
            told, ended = _killed(scene, [request], place=place)
            _check(scene, request, whole, told, found, f"{scene.database} {request.name} {place}")
            found.points += not ended
            place += step
            found.places[request.name] = place
            keep()
        found.over.append(request.name)
        keep()


def _whole(scene: Scene, request: Prepared) -> dict[str, tuple[int, int]]:
    """The change that the request makes when nothing goes wrong."""
    scene.reset()
    told, ended = _killed(scene, [request], place=None)
    assert ended and told and told[0]["status"] < 300, (request.name, told)
    change = scene.change(scene.rows())
    assert request.table in change, (request.name, change)
    return change


def _check(scene, request, whole, told, found: Found, where: str) -> None:
    begun = time.monotonic()
    rows = scene.rows()
    found.slowest_s = max(found.slowest_s, time.monotonic() - begun)
    change, acknowledged = scene.change(rows), bool(told)
    found.acknowledged += acknowledged
    if acknowledged and not change:
        found.lost.append(where)
    if change not in ({}, whole) or contradictions(rows):
        found.half.append(f"{where}: {change} {contradictions(rows)}")
    # The same once more: it is done once in all.
    again, ended = _killed(scene, [request], place=None)
    rows = scene.rows()
    if contradictions(rows) or scene.change(rows).get(request.table) != whole[request.table]:
        found.twice.append(f"{where}: {scene.change(rows)}")
    status = again[0]["status"] if ended and again else 500
    if status >= 500 or (not change and status >= 300):
        found.twice.append(f"{where}: answered {status} afterwards")


def at_random_instants(
    scene: Scene, found: Found, *, number: int, seed: int, keep: Callable[[], None] = lambda: None
) -> None:
    """Requests one after another, until the process is killed at an instant that nobody chose.

    Args:
        scene: whose provider it is.
        found: that it adds to, and goes on from.
        number: of instants in all.
        seed: of the instants, each drawn by itself.
        keep: keeps what was found so far.
    """
    if found.instants >= number:
        return
    progress = Progress()
    scene.reset()
    begun = time.monotonic()
    told, _ = _killed(scene, scene.more, place=None)
    lasts_s = time.monotonic() - begun
    assert len(told) == len(scene.more), told[-1:]
    for instant in range(found.instants, number):
        progress.at(f"{scene.database}: {instant} of {number} instants")
        drawn = random.Random(f"{seed} {instant}")  # noqa: S311 - an instant
        scene.reset()
        told, _ = _killed(scene, scene.more, place=None, after_s=drawn.uniform(0, lasts_s))
        where = f"{scene.database} instant {instant}"
        begun = time.monotonic()
        rows = scene.rows()
        found.slowest_s = max(found.slowest_s, time.monotonic() - begun)
        if wrong := contradictions(rows):
            found.half.append(f"{where}: {wrong}")
        hops, revoked = {row[0] for row in rows["hops"]}, {row[2] for row in rows["revocations"]}
        for each in told:
            found.acknowledged += 1
            request, answer = scene.more[each["n"]], each["answer"]
            if request.name == "revoke" and request.body["id"] not in revoked:
                found.lost.append(f"{where}: a revocation")
            if request.name != "revoke" and answer["hop_id"] not in hops:
                found.lost.append(f"{where}: a hop")
        if len(hops) + len(revoked) > len(scene.before["hops"]) + len(scene.before["revocations"]) + len(told) + 1:
            found.twice.append(f"{where}: more than was asked for")
        found.instants += 1
        keep()


def _killed(scene, requests, *, place: int | None, after_s: float | None = None) -> tuple[list[dict], bool]:
    """The answers that a process of its own gave to these requests, and whether it lived to give them all.

    Args:
        scene: whose provider it is.
        requests: one after another.
        place: number of the boundary at which it kills itself, or None.
        after_s: seconds after which it is killed, or None.
    """
    reads, writes = os.pipe()
    child = os.fork()
    if not child:
        try:
            os.close(reads)
            asyncio.run(_serve(scene, requests, place, writes))
            os._exit(0)
        finally:
            os._exit(1)
    os.close(writes)
    with os.fdopen(reads, "rb") as answers:
        told, due = answers.readline(), None
        assert told == b"begun\n", "it did not start"
        if after_s is not None:
            due = time.monotonic() + after_s
            while (left := due - time.monotonic()) > 0 and not _over(child, left):
                pass
            os.kill(child, signal.SIGKILL)
        said = [json.loads(line) for line in answers.read().splitlines(keepends=True) if line.endswith(b"\n")]
    _, status = os.waitpid(child, 0)
    assert os.WIFSIGNALED(status) or os.waitstatus_to_exitcode(status) == 0, "it failed by itself"
    return said, not os.WIFSIGNALED(status)


def _over(child: int, left_s: float) -> bool:
    """Waits for so long, or until the child has ended."""
    descriptor = os.pidfd_open(child)
    try:
        return bool(select.select([descriptor], [], [], left_s)[0])
    finally:
        os.close(descriptor)


async def _serve(scene: Scene, requests: list[Prepared], place: int | None, out: int) -> None:
    async with scene.app.router.lifespan_context(scene.app):
        os.write(out, b"begun\n")
        if place is not None:
            _arm(scene.app.state.provider.store._engine.sync_engine, place)
        transport = httpx2.ASGITransport(app=scene.app)
        async with httpx2.AsyncClient(transport=transport) as http:
            for number, request in enumerate(requests):
                auth = ProofAuth(scene.world.private[request.who], request.token, now=scene.world.clock)
                answer = await http.post(
                    ISSUER + request.path, content=request.content, auth=auth,
                    headers={"Content-Type": "application/json"},
                )  # fmt: skip
                told = {"n": number, "status": answer.status_code, "answer": answer.json()}
                os.write(out, json.dumps(told).encode() + b"\n")


def _arm(engine: sa.Engine, place: int) -> None:
    """This process kills itself at the boundary of this number: before and after each statement and commit."""
    left = [place]

    def boundary(*_) -> None:
        if not left[0]:
            os.kill(os.getpid(), signal.SIGKILL)
        left[0] -= 1

    commit = engine.dialect.do_commit

    def committed(connection) -> None:
        boundary()
        commit(connection)
        boundary()

    sa.event.listen(engine, "before_cursor_execute", boundary)
    sa.event.listen(engine, "after_cursor_execute", boundary)
    engine.dialect.do_commit = committed
