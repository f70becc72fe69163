"""Usual work of an agent: many equal calls, by which an enforcement point learns to know it."""

from __future__ import annotations

import json
from typing import TYPE_CHECKING, Any, ClassVar, Final, Literal

import httpx2
import msgspec

from evaluation.redteam.acts.act import Act
from evaluation.redteam.acts.arm import worst
from evaluation.redteam.parts import Came, Effect
from ztpm.demo.forgeries import PLAIN_CALL
from ztpm.stage.calls import post
from ztpm.stage.stage import in_time

if TYPE_CHECKING:
    from evaluation.redteam.bare import BareArena
    from evaluation.redteam.guarded import GuardedArena


TIMEOUT_S: Final = 30.0


class Routine(Act, frozen=True, kw_only=True, tag="routine"):
    """Equal calls of a tool, one after another, none of which does harm.

    Attributes:
        place: `arm`, `desk`, or `notes`: the tools beside the admission point.
        tool: name.
        arguments: of each call.
        calls: number of them; a baseline is learned from `behaviour_learn_count` acts.
    """

    point: ClassVar[str] = "e4"

    place: Literal["arm", "desk", "notes"]
    tool: str
    calls: int
    arguments: dict[str, Any] = msgspec.field(default_factory=dict)

    def bare(self, arena: BareArena) -> Came:  # noqa: ARG002 - nobody learns to know anybody there
        """Nothing: with no enforcement there is no past."""
        return Came(Effect.DONE)

    def guarded(self, arena: GuardedArena) -> Came:
        """Calls the tool so often; after a refusal the rest is tried all the same."""
        if self.place == "notes":
            room = arena.admission
            agent = arena.stage.agents[room.holder(arena.cast, self.by)]
            token, url = arena.stage.tokens[agent.id], room.audience
        else:
            agent, token, url = arena.agent(self.by), arena.token(self.by, self.place), arena.url(self.place)
        asked = {"name": self.tool, "arguments": self.arguments}
        body = json.dumps({"jsonrpc": "2.0", "id": 1, "method": "tools/call", "params": asked}).encode()
        headers = {**PLAIN_CALL, "mcp-name": self.tool}
        with httpx2.Client(auth=agent.auth(token), timeout=TIMEOUT_S) as http:
            several = [in_time(lambda: post(http, url, body, headers)) for _ in range(self.calls)]
        return worst([arena.came_of(each, self.point) for each in several])
