"""64 uses of one thing at the same time, by two processes: exactly one of them wins, round after round."""

from __future__ import annotations

import asyncio
import json
import multiprocessing
import os
import secrets
from collections import Counter
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import sqlalchemy as sa
from capabilities.statements.people import vote
from tests.progress import Progress
from tests.unread import unread
from tests.ztpm_idp.store.campaign.scene import Scene
from tests.ztpm_idp.world import MEASUREMENT
from ztpm_idp.domain.commands import CastVote, Issue
from ztpm_idp.domain.events import SignedRequest
from ztpm_idp.provider.problems import Problem

from capabilities.keys import keys
from capabilities.statements import attestation
from ztpm_idp.store import StoreUnavailableError
from ztpm_idp.store import schema as t

if TYPE_CHECKING:
    from collections.abc import Callable

WORKERS, USES = 2, 64
KINDS = ("proof", "nonce", "vote")
PATIENCE_S = 120
SIGNED = SignedRequest("POST", "http://127.0.0.1/x", "{}", "")


@dataclass
class Rounds:
    """Rounds by kind, and those in which not exactly one use was taken."""

    played: Counter = field(default_factory=Counter)
    wrong: list[str] = field(default_factory=list)
    unavailable: int = 0


def play(scene: Scene, rounds: int, found: Rounds, *, keep: Callable[[], None] = lambda: None) -> None:
    """Rounds that are left, of each kind in turn, by processes with a store of their own."""
    begin = found.played.total()
    if begin >= rounds:
        return
    progress = Progress()
    scene.reset()
    context = multiprocessing.get_context("fork")
    gate = context.Barrier(WORKERS)
    pipes, children = [], []
    for worker in range(WORKERS):
        reads, writes = os.pipe()
        child = context.Process(target=_work, args=(scene, range(begin, rounds), gate, writes, worker))
        child.start()
        os.close(writes)
        pipes.append(os.fdopen(reads, "rb"))
        children.append(child)
    for number in range(begin, rounds):
        progress.at(f"{scene.database}: {number} of {rounds} rounds, {len(found.wrong)} wrong")
        told = [json.loads(pipe.readline()) for pipe in pipes]
        kind, taken = KINDS[number % len(KINDS)], sum(each["taken"] for each in told)
        found.played[kind] += 1
        found.unavailable += sum(each["unavailable"] for each in told)
        if taken != 1 or sum(each["uses"] for each in told) != USES:
            found.wrong.append(f"{scene.database} round {number}: {taken} of {kind}")
        keep()
    for child, pipe in zip(children, pipes, strict=True):
        pipe.close()
        child.join()


def _work(scene, rounds, gate, out, worker):
    asyncio.run(_rounds(scene, rounds, gate, out))
    os._exit(0)


async def _rounds(scene, rounds, gate, out):
    async with scene.app.router.lifespan_context(scene.app):
        provider = scene.app.state.provider
        for number in rounds:
            use = await _prepared(scene, provider, number, gate)
            gate.wait(PATIENCE_S)
            codes = await asyncio.gather(*(_code(use) for _ in range(USES // WORKERS)))
            told = {"taken": codes.count(""), "unavailable": codes.count("STORE_UNAVAILABLE"), "uses": len(codes)}
            os.write(out, json.dumps(told).encode() + b"\n")


async def _code(use) -> str:
    try:
        return "" if await use() else "REPLAYED"
    except Problem as problem:
        return str(problem.code)
    except StoreUnavailableError:
        return "STORE_UNAVAILABLE"


async def _prepared(scene, provider, number, gate):
    """The one act that every use of a round tries, by the number of the round."""
    world, at, store = scene.world, int(scene.world.clock()), provider.store
    match KINDS[number % len(KINDS)]:
        case "proof":
            ends_ms = (at + 60) * 1_000
            return lambda: store.first_use(key=bytes(32), jti=f"round-{number}", expires_ms=ends_ms, at_ms=at * 1_000)
        case "nonce":
            nonce = f"{number:032x}"
            await _once(store, gate, sa.insert(t.nonces).values(nonce=nonce, agent="mover", given_ms=at * 1_000))
            return lambda: provider.run(_issue(world, nonce, at), actor="alice")
        case "vote":
            row = dict(zip((c.name for c in t.asks.columns), scene.before["asks"][0], strict=True))
            row["ask_id"] = f"{number:032x}"
            await _once(store, gate, sa.insert(t.asks).values(**row))
            text = _vote(world, row, at)
            return lambda: provider.run(CastVote("carol", row["ask_id"], text, SIGNED), actor="carol")


def _issue(world, nonce, at) -> Issue:
    """One of many requests with the same evidence."""
    key = world.private["mover"]
    evidence = attestation.Evidence(
        agent="mover", key_thumbprint=keys.thumbprint(keys.public_raw(key)), nonce=nonce, delegator="alice",
        request_digest=bytes(32), measurement=MEASUREMENT, at=at, workload="",
    )  # fmt: skip
    token, hop = keys.b64u(secrets.token_bytes(16)), secrets.token_hex(16)
    return Issue(
        "alice", "mover", "p", world.scope(), bytes(32), attestation.sign(evidence, key), token, hop, SIGNED
    )  # fmt: skip


def _vote(world, row, at) -> str:
    said = vote.Vote(
        ask_id=row["ask_id"], nonce=row["nonce"], ask_digest=row["digest"], answer="approve", approver="carol",
        sees_clear=False, uses=1, not_after=at + 120, at=at,
    )  # fmt: skip
    return unread(vote, said, world.private["carol"])


async def _once(store, gate, insert) -> None:
    """One of the processes writes the row, and both go on when it is there."""
    if gate.wait(PATIENCE_S) == 0:
        async with store.write() as transaction:
            await transaction._connection.execute(insert)
    gate.wait(PATIENCE_S)
