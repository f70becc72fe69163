"""Calls of tools, of the arm and of the desk, with the caller's credentials or with forged ones."""

from __future__ import annotations

import json
import threading
from concurrent.futures import ThreadPoolExecutor
from typing import TYPE_CHECKING, Any, ClassVar, Final

import httpx2
import msgspec

from evaluation.redteam.acts.act import Act
from evaluation.redteam.acts.narrowing import Narrowing  # noqa: TC001 - msgspec reads it
from evaluation.redteam.acts.presenting import Presents, credentials
from evaluation.redteam.parts import Came, Effect, Place
from pep.base.stop_model import STOP_DECELERATION_RAD_S2
from ztpm.demo.forgeries import PLAIN_CALL
from ztpm.stage.calls import Answer, call, resend, send
from ztpm.stage.stage import in_time

if TYPE_CHECKING:
    from evaluation.redteam.attempts import Begun
    from evaluation.redteam.bare import BareArena
    from evaluation.redteam.guarded import GuardedArena

MOVED_RAD: Final = 0.005
"""Way of a joint from which on the arm has moved: more than the noise of standstill."""
MOST_WORDS: Final = 160
"""Characters of what is told of a harm."""
ARM_POINTS: Final = frozenset({"move_joint", "move_path", "speed_joint", "gripper_move", "set_digital_output"})
"""Tools of the arm on which e5 decides, if nothing earlier does."""


class Call(Act, frozen=True, kw_only=True, tag="call"):
    """Call of a tool.

    Attributes:
        place: `desk` or `arm`.
        tool: name.
        arguments: of the call, as they take effect.
        raw: text of the arguments in the request, where it is another one than a client would write.
        presents: credentials that go with it.
        of: role out of whose token forged ones are made.
        wider: restriction of a forged hop.
        change: of a forged token: text before and after, or which part.
        again: name of an earlier call whose very headers and body are sent once more; with other `arguments` its body
            is exchanged.
        times: so many calls, all at once.
        most: so many of them do no harm.
        harms_with: name of an earlier act without which this is the caller's own lawful work, and no harm.
    """

    point: ClassVar[str] = "e4"

    place: Place = "desk"
    tool: str
    arguments: dict[str, Any] = msgspec.field(default_factory=dict)
    raw: str = ""
    presents: Presents = "own"
    of: str = ""
    wider: Narrowing | None = None
    change: tuple[str, ...] = ()
    again: str = ""
    times: int = 1
    most: int = 0
    harms_with: str = ""

    def bare(self, arena: BareArena) -> Came:
        """Calls the tool of a desk without a guard, or drives the controller."""
        asked = self._as_sent(arena)
        if self.place == "arm":
            drive(arena, self.tool, asked)
            return Came(Effect.DONE)

        def once(_: int) -> Came:
            if self.raw:
                answer = send(httpx2.Auth(), arena.desk.url, self._body(), self._plain())
            else:
                answer = call(arena.desk.url, httpx2.Auth(), self.tool, asked)
            return Came(Effect.DONE if answer.status < 400 else Effect.DENIED, "", str(answer.status))

        return self._each(once)

    def guarded(self, arena: GuardedArena) -> Came:
        """Calls the tool before the enforcement points."""
        if self.presents == "own" and not self.raw and not self.again and self.times == 1:
            came, answer = arena.asked(self.by, self.place, self.tool, self.arguments, point=self._point)
            if answer.exchange is not None and self.name:
                arena.attempts.sent[self.name] = answer.exchange
            return came
        return self._each(lambda _: arena.came_of(self._forced(arena), self._point))

    def _as_sent(self, arena: BareArena | GuardedArena) -> dict[str, Any]:
        """Arguments: its own, or those of the earlier call that is sent again."""
        earlier = (one.act for one in arena.attempts.begun if self.again and one.act.name == self.again)
        return self.arguments or next((act.arguments for act in earlier if isinstance(act, Call)), {})

    @property
    def _point(self) -> str:
        return "e5" if self.place == "arm" and self.tool in ARM_POINTS else "e4"

    def _each(self, once: Any) -> Came:
        """The mildest of what came of each call, all of them at once."""
        if self.times == 1:
            return once(0)  # type: ignore[no-any-return]
        with ThreadPoolExecutor(self.times) as pool:
            several: list[Came] = list(pool.map(once, range(self.times)))
        order = (Effect.DENIED, Effect.DEFERRED, Effect.STOPPED, Effect.DONE)
        return min(several, key=lambda came: order.index(came.effect))

    def _forced(self, arena: GuardedArena) -> Answer:
        """Answer to the call with its credentials, sent again where the verdict came too late."""
        url = arena.url(self.place)
        if self.again:
            earlier = arena.attempts.sent[self.again]
            return resend(earlier, body=self._other_body(earlier.body) if self.arguments else None)
        return in_time(lambda: self._once(arena, url))

    def _once(self, arena: GuardedArena, url: str) -> Answer:
        """Answer to the call with credentials that are made for it."""
        auth = credentials(arena, self.by, self.place, self.presents, of=self.of, wider=self.wider, change=self.change)
        if self.raw:
            return send(auth, url, self._body(), self._plain())
        return call(url, auth, self.tool, self.arguments)

    def _plain(self) -> dict[str, str]:
        return {**PLAIN_CALL, "mcp-name": self.tool}

    def _body(self) -> bytes:
        """Request with the arguments as they are written, which no client would write so."""
        return (
            '{"jsonrpc":"2.0","id":1,"method":"tools/call","params":{"name":'
            f'{json.dumps(self.tool)},"arguments":{self.raw}}}}}'
        ).encode()

    def _other_body(self, body: bytes) -> bytes:
        asked = json.loads(body)
        asked["params"] = {**asked["params"], "name": self.tool, "arguments": self.arguments}
        return json.dumps(asked).encode()

    def did(self, arena: BareArena | GuardedArena, begun: Begun) -> str:
        """The tool and what it did, where that truly happened."""
        if not self.harms or (self.harms_with and not arena.attempts.came_about(self.harms_with)):
            return ""
        if self.place == "desk":
            asked = self._as_sent(arena)
            others = (one.act for one in arena.attempts.begun if isinstance(one.act, Call) and not one.act.harms)
            lawful = sum(act.times for act in others if (act.tool, act.arguments) == (self.tool, asked))
            happened = arena.desk.papers.times(self.tool, asked) > lawful + self.most
            told = ", ".join(f"{name}={value}" for name, value in asked.items())
            return f"{self.tool} by {self.by}: {told}"[:MOST_WORDS] if happened else ""
        samples = [one for one in arena.eyes.since(begun.from_s) if one.arrived_s <= begun.to_s]
        if not samples:
            return ""
        way = max(abs(a - b) for one in samples for a, b in zip(one.q_rad, samples[0].q_rad, strict=True))
        return f"the arm went {way:.2f} rad for {self.by}" if way > MOVED_RAD else ""


def drive(arena: BareArena, tool: str, arguments: dict[str, Any]) -> None:
    """Drives the controller as the tool of that name would.

    Raises:
        ValueError: there is no such tool.
    """
    control, told = arena.control, dict(arguments)
    if tool == "move_joint":
        control.moveJ(told["q_rad"], told["speed_rad_s"], told["acceleration_rad_s2"])
    elif tool == "move_path":
        for point in told["waypoints_rad"]:
            control.moveJ(point, told["speed_rad_s"], told["acceleration_rad_s2"])
    elif tool == "speed_joint":
        control.speedJ(told["qd_rad_s"], told["acceleration_rad_s2"], told["duration_s"])
        threading.Event().wait(told["duration_s"])
        control.speedStop(told["acceleration_rad_s2"])
    elif tool == "stop":
        control.stopJ(STOP_DECELERATION_RAD_S2)
    elif tool != "read_state":  # which an unmodified client reads on a connection of its own
        raise ValueError(f"no tool of the arm that is driven without enforcement: {tool}")
