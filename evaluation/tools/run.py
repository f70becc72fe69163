"""One run: the same act with and without a guard, over HTTP and as a function, in turns."""

from __future__ import annotations

import os
import random
import secrets
import time
from typing import TYPE_CHECKING, Final

from mcp import Client
from mcp.client.streamable_http import streamable_http_client

from capabilities.proof.proof import prove
from evaluation.harness.machine import machine
from evaluation.tools import act, parts
from evaluation.tools.bench import ActResult
from evaluation.tools.place import PROGRAM, SERVER, place
from evaluation.tools.served import BARE_PATH
from evaluation.tools.turns import WARM_UP, check_refused, finished, in_turns
from pep import GuardConfig, GuardedFunctions, pins
from pep.point.guarded_functions import function_pins
from pep.request.authority import PresentedRequest
from ztpm.base.processes import Child
from ztpm_idp.client import direct_http

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping
    from pathlib import Path

    from evaluation.tools.bench import ActRow
    from evaluation.tools.place import Place
    from ztpm_idp.client import Agent

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
            guarded, bare = finished(_over_http(at, agent, GuardConfig.read(served), calls, order))
        finally:
            server.stop()
        told(f"{calls} pairs of calls of a function")
        program = at.point("program", PROGRAM, function_pins([act.open_valve]))
        enforced, plain, parts_us = finished(_of_a_function(at, agent, program, calls, order))
    return ActResult(
        guarded, bare, enforced, plain, parts_us=parts_us, seconds=time.monotonic() - began, machine=machine()
    )


async def _over_http(at: Place, agent: Agent, config: GuardConfig, calls: int, order: random.Random) -> list[ActRow]:
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

        await check_refused(lambda: tools.call(act.NAME, act.OUTSIDE))
        return await in_turns({GUARDED: guarded, BARE: bare}, {"result": act.ANSWER}, calls, order)


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
        await check_refused(lambda: enforced(presented(), **act.OUTSIDE))
        # Proofs are made before, each for one call: making one is a part of its own.
        proofs = [presented() for _ in range(calls + WARM_UP)]

        async def guarded() -> object:
            return await enforced(proofs.pop(), **act.ARGUMENTS)

        async def bare() -> object:
            return act.open_valve(valve=act.VALVE, percent=act.ANSWER)

        one, other = await in_turns({ENFORCED: guarded, PLAIN: bare}, act.ANSWER, calls, order)
        return one, other, await parts.parts_us(point, presented, calls)
