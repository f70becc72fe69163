"""Stop of the arm without a permit ([LIV-2], [LIV-7]): first the motion, then a word, the lease, the record."""

from __future__ import annotations

import asyncio
import contextlib
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from capabilities.values.errors import FaultCode
from pep.base.errors import JournalError
from pep.journal.replay_cache import proof_name
from pep.people.stop_words import SpokenStop
from pep.rtde.lease.lease import LeaseEnding

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable

    from pep.gate.gate import Gate
    from pep.people.stop_words import StopWords
    from pep.rtde.judge.latching import Latching
    from pep.rtde.lease.lease import Leases
    from pep.rtde.motion.standstill import MotionEnd
    from pep.rtde.own.tool_motions import ToolMotions

PAGE: Final = "page"
DOOR: Final = "gateway"
"""Places at which a stop is asked for, as the record names them."""


@dataclass(frozen=True, slots=True)
class HeardWord:
    """Outcome of the word on a stop.

    Attributes:
        person: whose word counts, or "".
        fault: code of why a word does not count, or "" where none came.
    """

    person: str = ""
    fault: str = ""


class OpenStop:
    """Stop of one gateway's arm, for all who reach it. On its event loop.

    Args:
        leases: of the robot.
        tools: stop arm and fingers, also those of a program.
        latching: latches the robot after a known person's word, and where the policies name such a stop.
        words: reads what people sign.
        gate: keeps the record.
        end: ends the open lease, and tells its program.
    """

    def __init__(
        self,
        *,
        leases: Leases,
        tools: ToolMotions,
        latching: Latching,
        words: StopWords,
        gate: Gate,
        end: Callable[[LeaseEnding], Awaitable[None]],
    ) -> None:
        self._leases = leases
        self._tools = tools
        self._latching = latching
        self._words = words
        self._gate = gate
        self._end = end
        self._tasks: set[asyncio.Task[None]] = set()

    async def __call__(self) -> dict[str, object]:
        """Begins to stop the arm, for the cell's page; the rest follows.

        The answer has the agent whose lease ends, or "".
        """
        _, agent = await self._begin(PAGE, _unsaid())
        return {"begun": True, "lease": agent or ""}

    async def by_word(self, word: Awaitable[str]) -> tuple[HeardWord, str, dict[str, object]]:
        """Begins to stop the arm, and then hears the word.

        Args:
            word: what a person signed, "" for nothing; it may take its time, for which the stop does not wait.

        Returns:
            What came of the word, the agent whose lease ends or "", and the latch as people are told of it.
        """
        hearing, agent = await self._begin(DOOR, word)
        return await asyncio.shield(hearing), agent or "", dict(self._latching.summary())

    async def close(self) -> None:
        """Waits for the records of earlier stops."""
        await asyncio.gather(*self._tasks, return_exceptions=True)

    async def _begin(self, asked: str, word: Awaitable[str]) -> tuple[asyncio.Future[HeardWord], str | None]:
        lease = self._leases.current
        agent = None if lease is None else lease.agent
        standing = asyncio.ensure_future(self._tools.stop())
        await asyncio.sleep(0)  # it has begun
        self._latching.asked()
        hearing = asyncio.ensure_future(self._hear(word))
        task = asyncio.get_running_loop().create_task(self._after(standing, hearing, agent, asked))
        self._tasks.add(task)
        task.add_done_callback(self._tasks.discard)
        return hearing, agent

    async def _hear(self, word: Awaitable[str]) -> HeardWord:
        """[LIV-7] Reads the word, and latches for one that counts; the latch and the word are on record then."""
        try:
            text = await word
            found = self._words.read(text) if text else None
        except Exception:  # noqa: BLE001 - what a stranger sends breaks no stop
            found = FaultCode.STATEMENT_MALFORMED
        if not isinstance(found, SpokenStop):
            return HeardWord(fault="" if found is None else str(found))
        stop = found.stop
        self._latching.asked(stop.person)
        await self._latching.keep()
        body: dict[str, object] = {
            "person": stop.person,
            "reason": stop.reason,
            "latch_id": self._latching.latches.latch_id,
            "proof": proof_name(found.key, stop.stop_id).hex(),
            "word": found.text,
        }
        with contextlib.suppress(JournalError):  # it latches all the same
            await self._gate.record("stop", body)
        return HeardWord(person=stop.person)

    async def _after(
        self, standing: Awaitable[MotionEnd], hearing: Awaitable[HeardWord], agent: str | None, asked: str
    ) -> None:
        if agent is not None:
            await self._end(LeaseEnding.STOPPED)
        end, heard = await standing, await hearing
        body = {
            "effect": "PERMIT",
            "operation": "stop",
            "caller": heard.person or None,
            "fault": heard.fault or None,
            "asked": asked,
            "lease": agent,
            "result": {"end": str(end.end)},
        }
        with contextlib.suppress(JournalError):  # a stop that cannot be recorded is still a stop
            await self._gate.record("outcome", {"request_id": "stop", "decision": "", "outcome": "done", "stop": body})


async def _unsaid() -> str:
    """No word: the page asks nobody for one."""
    return ""
