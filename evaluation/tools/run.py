"""One run: the same act with and without a guard, over HTTP and as a function, in turns."""

from __future__ import annotations

import asyncio
import os
import random
import secrets
import time
from typing import TYPE_CHECKING, Any, Final

from mcp import Client
from mcp.client.streamable_http import streamable_http_client

from capabilities.proof.proof import prove
from evaluation.harness.machine import machine
from evaluation.tools import act, parts
from evaluation.tools.bench import ActResult, NotMeasuredError, row_of
from evaluation.tools.place import PROGRAM, SERVER, place
from evaluation.tools.served import BARE_PATH
from pep import GuardConfig, GuardedFunctions, NotPermittedError, pins
from pep.point.guarded_functions import function_pins
from pep.request.authority import PresentedRequest
from ztpm.base.processes import Child
from ztpm_idp.client import ClientError, Denied, direct_http

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable, Mapping
    from pathlib import Path

    from evaluation.tools.bench import ActRow
    from evaluation.tools.place import Place
    from ztpm_idp.client import Agent

    Act = Callable[[], Awaitable[object]]

WARM_UP: Final = 20
"""Calls of each way before the timed ones."""
BODY: Final = b"{}"
GUARDED, BARE, ENFORCED, PLAIN = "guarded, HTTP", "unguarded, HTTP", "guarded, function", "unguarded, function"


def run(calls: int, *, seed: int, told: Callable[[str], None]) -> ActResult:
    """The act, so many times on each way.

    Args:
        calls: timed ones of each way.
        seed: of the order within each pair of calls.
        told: receives the name of each step.

    Raises:
        NotMeasuredError: a call had a wrong answer, or too many were refused.
        ClientError: the provider or the server did not answer.
        ChildError: one of them did not start.
    """
    began, order = time.monotonic(), random.Random(seed)  # noqa: S311 - turns
    told("starting an identity provider and a tool server")
    with place() as at:
        agent = at.agent("worker")
        served = at.point("plant", SERVER, pins(act.server()))
        server = Child.start("tool server", "evaluation.tools.served", str(served), environment=at.environment)
        try:
            told(f"{calls} pairs of calls over HTTP")
            guarded, bare = asyncio.run(_over_http(at, agent, GuardConfig.read(served), calls, order))
        finally:
            server.stop()
        told(f"{calls} pairs of calls of a function")
        program = at.point("program", PROGRAM, function_pins([act.open_valve]))
        enforced, plain, parts_us = asyncio.run(_of_a_function(at, agent, program, calls, order))
    return ActResult(
        guarded, bare, enforced, plain, parts_us=parts_us, seconds=time.monotonic() - began, machine=machine()
    )


async def _over_http(
    at: Place, agent: Agent, config: GuardConfig, calls: int, order: random.Random
) -> tuple[ActRow, ActRow]:
    token = at.lent(agent, act.open_valve, config.audience)
    address = f"http://{at.host}:{SERVER}{BARE_PATH}"
    async with (
        agent.tools(config.audience, token) as tools,
        direct_http.async_client() as http,
        Client(streamable_http_client(address, http_client=http)) as client,
    ):

        async def guarded() -> object:
            return (await tools.call(act.NAME, act.ARGUMENTS)).structured_content

        async def bare() -> object:
            return (await client.call_tool(act.NAME, act.ARGUMENTS)).structured_content

        try:
            await _is_refused(lambda: tools.call(act.NAME, act.OUTSIDE))
            return await _in_turns({GUARDED: guarded, BARE: bare}, {"result": act.ANSWER}, calls, order)
        except (NotMeasuredError, ClientError) as error:
            failed = error
    # The SDK's client would wrap what is raised inside of it.
    raise failed


async def _of_a_function(
    at: Place, agent: Agent, file: Path, calls: int, order: random.Random
) -> tuple[ActRow, ActRow, Mapping[str, float]]:
    os.environ.update(at.environment)
    try:
        point = GuardedFunctions(GuardConfig.read(file), [act.open_valve])
    finally:
        for name in at.environment:
            os.environ.pop(name, None)
    audience = point.config.audience
    token = at.lent(agent, act.open_valve, audience)

    def presented() -> PresentedRequest:
        jti, now = secrets.token_urlsafe(16), int(time.time())
        proof = prove(agent.key, method="POST", url=audience, body=BODY, token=token, at=now, jti=jti)
        return PresentedRequest(token, proof, "POST", audience, BODY)

    async with point.living():
        enforced = point.enforced(act.open_valve)
        await _is_refused(lambda: enforced(presented(), **act.OUTSIDE))
        # Proofs are made before, each for one call: making one is a part of its own.
        proofs = [presented() for _ in range(calls + WARM_UP)]

        async def guarded() -> object:
            return await enforced(proofs.pop(), **act.ARGUMENTS)

        async def bare() -> object:
            return act.open_valve(valve=act.VALVE, percent=act.ANSWER)

        rows = await _in_turns({ENFORCED: guarded, PLAIN: bare}, act.ANSWER, calls, order)
        return *rows, await parts.parts_us(point, presented, calls)


async def _in_turns(ways: Mapping[str, Act], answer: object, calls: int, order: random.Random) -> tuple[ActRow, ActRow]:
    """Rows of two ways that are called in pairs, in a new random order each time.

    Raises:
        NotMeasuredError: one answered otherwise, or too many calls were refused.
    """
    took: dict[str, list[int]] = {way: [] for way in ways}
    refused = dict.fromkeys(ways, 0)
    pair = list(ways.items())
    for timed in (False,) * WARM_UP + (True,) * calls:
        order.shuffle(pair)
        for way, once in pair:
            began = time.perf_counter_ns()
            try:
                found: Any = await once()
            except (Denied, NotPermittedError):
                found = answer
                refused[way] += timed
            ended = time.perf_counter_ns()
            if found != answer:
                raise NotMeasuredError(f"{way}: another answer")
            if timed:
                took[way].append(ended - began)
    one, other = (row_of(way, took[way], refused[way]) for way in ways)
    return one, other


async def _is_refused(once: Act) -> None:
    """Checks that the guard stands there at all.

    Raises:
        NotMeasuredError: it does not.
    """
    try:
        await once()
    except (Denied, NotPermittedError):
        return
    raise NotMeasuredError("what the token does not permit was permitted")
