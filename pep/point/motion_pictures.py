"""Pictures of decided motions: made beside what moves, named on record, and brought to the identity provider ([CON-9]).

None is made before its decision is on record and its effect under way, and nothing waits for one. What goes wrong
costs the picture alone, and the record says so.
"""

from __future__ import annotations

import asyncio
import json
import os
import pickle
import sys
from collections import deque
from contextlib import suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from capabilities import tracing
from capabilities.statements.people.picture import PICTURE_BYTES, digest_of
from pep.base.errors import FeedError, JournalError, PepError, PepFault
from pep.point.picture_drawer import HEAD, NONE, TEXT, Packing

if TYPE_CHECKING:
    from collections.abc import Callable, Sequence

    from pep.base.ports import Clock
    from pep.provider.ask_client import AskClient
    from pep.world.questions import AssessedQuestion, AssessedQuestions

AFTER_MS: Final = 250
"""Ours: milliseconds from the decision until its picture is begun; a command is sent within 50."""
WAITING: Final = 8
"""Ours: most motions whose pictures wait to be made."""
A_MINUTE: Final = {True: 60, False: 20}
"""Ours: pictures made in any minute, of motions and of what was refused.

So denials push out no picture of a motion.
"""
MINUTE_MS: Final = 60_000
PATIENCE_S: Final = 60.0
"""Longest wait for one picture; the first has to wait a second of an idle processor for its process."""
KEPT: Final = 64
"""Ours: most pictures that wait for the provider, 256 kB each at most; beyond it the oldest is given up."""
PERIOD_S: Final = 0.5
BACK_OFF_S: Final = 5.0
ANSWER_BYTES: Final = 4_096
"""Longest answer of the provider that is read."""
SECRETS: Final = "ZTPM_"
"""Beginning of the names of our own variables, of which one is a passphrase."""


@dataclass(frozen=True, slots=True)
class _Wanted:
    """Picture that is to be made, or, without a question, a reason to be told.

    Attributes:
        body: of its record, so far.
        question: that it shows.
        due_ms: the time before which it is not begun.
    """

    body: dict[str, object]
    question: AssessedQuestion | None
    due_ms: int


class MotionPictures:
    """The `Pictured` port, and the loops behind it. On one event loop.

    Args:
        questions: what physics answered of late.
        clock: its monotonic time counts.
        record: writes a record of what has happened; nothing waits for its disk.
        shipped: the number of the newest record in the journal, and that of the newest in the ledger.
        asking: connection to the provider, with this point's proof.
        incident: told of what the provider does not take.
        drawer: arguments of Python for the process that makes pictures; it gets none of our own variables.
    """

    def __init__(
        self,
        questions: AssessedQuestions,
        *,
        clock: Clock,
        record: Callable[[str, dict[str, object]], None],
        shipped: Callable[[], tuple[int, int]],
        asking: AskClient,
        incident: Callable[[PepError], None],
        drawer: Sequence[str] = ("-m", "pep.point.picture_drawer"),
    ) -> None:
        self._questions = questions
        self._clock = clock
        self._record = record
        self._shipped = shipped
        self._asking = asking
        self._incident = incident
        self._arguments = drawer
        self._wanted: deque[_Wanted] = deque()
        self._waiting = 0
        self._some = asyncio.Event()
        self._made_ms: dict[bool, deque[int]] = {moves: deque(maxlen=most) for moves, most in A_MINUTE.items()}
        self._packing = Packing()
        self._drawer: asyncio.subprocess.Process | None = None
        self._unsent: deque[tuple[int, str, str]] = deque(maxlen=KEPT)

    def __call__(self, request_id: str, record: str, *, moves: bool) -> None:
        """See `pep.gate.robot_ports.Pictured`."""
        question = self._questions.question(request_id)
        if question is None:
            return
        now_ms, made_ms = self._clock.monotonic_ms(), self._made_ms[moves]
        if self._waiting >= WAITING or (len(made_ms) == made_ms.maxlen and now_ms - made_ms[0] < MINUTE_MS):
            question = None
        else:
            made_ms.append(now_ms)
            self._waiting += 1
        body: dict[str, object] = {"request_id": request_id, "decision": record}
        if (trace_id := tracing.trace_id()) is not None:
            body["trace_id"] = trace_id
        self._wanted.append(_Wanted(body, question, now_ms + AFTER_MS))
        self._some.set()

    async def run(self) -> None:
        """Makes and brings pictures for ever; the process that makes them ends with this."""
        try:
            await asyncio.gather(self._make_for_ever(), self._bring_for_ever())
        finally:
            self._end_drawer()

    # -- making

    async def _make_for_ever(self) -> None:
        while True:
            while not self._wanted:
                self._some.clear()
                await self._some.wait()
            wanted = self._wanted[0]
            if (wait_ms := wanted.due_ms - self._clock.monotonic_ms()) > 0:
                await asyncio.sleep(wait_ms / 1_000)
            made: str | PepFault | None = PepFault.PICTURE_CROWDED
            if wanted.question is not None:
                made = await self._made(wanted.question)
                self._waiting -= 1
            self._wanted.popleft()
            try:
                self._tell(wanted.body, made)
            except JournalError as error:
                self._incident(error)

    def _tell(self, body: dict[str, object], made: str | PepFault | None) -> None:
        """Names the picture, or the reason why there is none, on record; an act without the arm has neither."""
        match made:
            case None:
                return
            case PepFault():
                self._record("picture", body | {"reason": str(made)})
            case _:
                digest = digest_of(made)
                self._record("picture", body | {"digest": digest, "bytes": len(made)})
                self._unsent.append((self._shipped()[0], digest, made))

    async def _made(self, question: AssessedQuestion) -> str | PepFault | None:
        """Text of the picture; None for an act without the arm."""
        try:
            async with asyncio.timeout(PATIENCE_S):
                return await self._drawn(question)
        except (pickle.PicklingError, AttributeError, TypeError, RecursionError):  # of a question that is not packed
            return PepFault.PICTURE_IMPOSSIBLE
        except (OSError, EOFError, TimeoutError, ValueError):  # of the process, or of what it says
            self._end_drawer()
            return PepFault.PICTURE_DRAWER_ENDED

    async def _drawn(self, question: AssessedQuestion) -> str | PepFault | None:
        if self._drawer is None:
            self._drawer = await asyncio.create_subprocess_exec(
                *(sys.executable, *self._arguments),
                stdin=asyncio.subprocess.PIPE,
                stdout=asyncio.subprocess.PIPE,
                env={name: value for name, value in os.environ.items() if not name.startswith(SECRETS)},
            )
        asked, told = self._drawer.stdin, self._drawer.stdout
        if asked is None or told is None:
            raise AssertionError
        asked.write(self._packing.packed(question))
        await asked.drain()
        kind, length = HEAD.unpack(await told.readexactly(HEAD.size))
        if length > PICTURE_BYTES:
            raise ValueError("longer than any picture")
        said = (await told.readexactly(length)).decode("ascii")
        if kind == NONE:
            return None
        return said if kind == TEXT else PepFault(said)

    def _end_drawer(self) -> None:
        if self._drawer is not None:
            with suppress(ProcessLookupError):
                self._drawer.kill()
            self._drawer = None

    # -- bringing

    async def _bring_for_ever(self) -> None:
        pause_s = PERIOD_S
        while True:
            await asyncio.sleep(pause_s)
            pause_s = PERIOD_S if await self.bring() else BACK_OFF_S

    async def bring(self) -> bool:
        """Brings each picture whose record is in the ledger; False where the provider could not be asked."""
        while self._unsent and self._unsent[0][0] <= self._shipped()[1]:
            first = self._unsent[0]
            body = json.dumps({"picture": first[2]}).encode()
            try:
                status, _ = await self._asking.send("POST", "/ledger/pictures", body=body, most_bytes=ANSWER_BYTES)
            except FeedError:
                return False
            if status == 429 or status >= 500:
                return False
            if status not in {200, 201}:
                self._incident(FeedError(PepFault.PICTURE_NOT_TAKEN, f"status {status}, {first[1]}"))
            if self._unsent and self._unsent[0] is first:  # else it was given up meanwhile
                self._unsent.popleft()
        return True
