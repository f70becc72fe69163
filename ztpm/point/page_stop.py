"""Stop of the arm on the cell's page ([LIV-2]): first the motion, then the lease, then the record."""

from __future__ import annotations

import asyncio
import contextlib
from typing import TYPE_CHECKING

from pep.base.errors import JournalError
from pep.rtde.lease.lease import LeaseEnding

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable

    from pep.gate.gate import Gate
    from pep.rtde.judge.latching import Latching
    from pep.rtde.lease.lease import Leases
    from pep.rtde.motion.standstill import MotionEnd
    from pep.rtde.own.tool_motions import ToolMotions


class PageStop:
    """Stop of one gateway's arm, which asks for no name. On its event loop.

    Args:
        leases: of the robot.
        tools: stop arm and fingers, also those of a program.
        latching: latches the robot where the policies name such a stop.
        gate: keeps the record.
        end: ends the open lease, and tells its program.
    """

    def __init__(
        self,
        *,
        leases: Leases,
        tools: ToolMotions,
        latching: Latching,
        gate: Gate,
        end: Callable[[LeaseEnding], Awaitable[None]],
    ) -> None:
        self._leases = leases
        self._tools = tools
        self._latching = latching
        self._gate = gate
        self._end = end
        self._tasks: set[asyncio.Task[None]] = set()

    async def __call__(self) -> dict[str, object]:
        """Begins to stop the arm; the rest follows. The answer has the agent whose lease ends, or ""."""
        lease = self._leases.current
        standing = asyncio.ensure_future(self._tools.stop())
        await asyncio.sleep(0)  # it has begun
        task = asyncio.get_running_loop().create_task(self._after(standing, None if lease is None else lease.agent))
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
        return {"begun": True, "lease": "" if lease is None else lease.agent}

    async def close(self) -> None:
        """Waits for the records of earlier stops."""
        await asyncio.gather(*self._tasks, return_exceptions=True)

    async def _after(self, standing: Awaitable[MotionEnd], agent: str | None) -> None:
        self._latching.asked()
        if agent is not None:
            await self._end(LeaseEnding.STOPPED)
        body = {
            "effect": "PERMIT",
            "operation": "stop",
            "caller": None,
            "fault": None,
            "asked": "page",
            "lease": agent,
            "result": {"end": str((await standing).end)},
        }
        with contextlib.suppress(JournalError):  # a stop that cannot be recorded is still a stop
            await self._gate.record("outcome", {"request_id": "stop", "decision": "", "outcome": "done", "stop": body})
