"""Replay of AgentDojo's pairs: the user's calls, and the attacker's forced among them, before the real gate."""

from __future__ import annotations

import asyncio
import itertools
import os
import time
from collections import Counter
from contextlib import asynccontextmanager
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Final

from capabilities.values.scope import Scope, Tier
from evaluation.dojo.scopes import MODES
from evaluation.dojo.tools import function_of, ours
from evaluation.tools.place import LIFETIME_S, PROGRAM
from pep import GuardConfig, GuardedFunctions, NotPermittedError
from pep.point import carriage
from pep.point.guarded_functions import function_pins
from policies.words.reason_codes import Reason

if TYPE_CHECKING:
    from collections.abc import AsyncIterator, Awaitable, Callable, Mapping, Sequence

    from capabilities.values.scope import Grant
    from evaluation.dojo.suites import Suite, Suites, WantedCall
    from evaluation.tools.place import Place
    from pep.base.operation_row import Operation
    from ztpm_idp.client import Agent

    Call = Callable[[WantedCall], Awaitable[str]]
    """A call of a tool; the reason of its refusal, "" where it was permitted."""

PLACES: Final = {"between": 1, "after": None}
"""Number of the user's calls before the attacker's, by the name of the place; None for all of them."""
ACTS: Final = 8
"""Acts after which another agent takes over.

One that went on would be known for the refused calls that were forced on it, and be refused for that: half of such
agents after 15 acts (docs/trust.md). What is measured here are scopes alone.
"""
UNKNOWN_TOOL: Final = "no such tool"
BY_SCOPE: Final = frozenset(
    {
        UNKNOWN_TOOL,
        Reason.NOT_GRANTED,
        Reason.LIMIT_EXCEEDED_BY_REQUEST,
        Reason.PARAMETERS_WRONG,
        Reason.NOT_CANONICAL,
        Reason.OUT_OF_RANGE,
    }
)
"""Reasons that a scope and a declaration give. Any other, such as a stale view, says something of the machine."""
TRIES: Final = 8
"""Tries of a run, until every refusal in it is one of those."""


@dataclass(frozen=True, slots=True)
class Pair:
    """A user task and an injection task, replayed once.

    Attributes:
        suite, user, injection: names; `injection` is "" for the user's calls alone.
        place: of the attacker's calls, of `PLACES`.
        completed, reached: verdicts of AgentDojo.
        refused: reasons of the attacker's refused calls.
        own_refused: the user's refused calls, each as "TOOL: REASON".
        forced: number of the attacker's calls.
        anew: number of earlier tries, in which a call was refused for another reason than its scope.
    """

    suite: str
    user: str
    injection: str
    place: str
    completed: bool
    reached: bool
    refused: Sequence[str] = ()
    own_refused: Sequence[str] = ()
    forced: int = 0
    anew: int = 0


@dataclass(slots=True)
class Replay:
    """Pairs by mode, in the order in which they were replayed."""

    pairs: dict[str, list[Pair]] = field(default_factory=lambda: {mode: [] for mode in MODES})

    def alone(self, mode: str) -> list[Pair]:
        """User tasks without an attacker."""
        return [pair for pair in self.pairs[mode] if not pair.injection]

    def attacked(self, mode: str) -> list[Pair]:
        """Pairs with one, each of which is there once for each place."""
        return [pair for pair in self.pairs[mode] if pair.injection]

    def reasons(self, mode: str) -> Counter[str]:
        """Reasons of the attacker's refused calls, with their numbers."""
        return Counter(reason for pair in self.attacked(mode) for reason in pair.refused)


async def run_pairs(
    suites: Suites, fresh: Callable[[], Call], suite: str, user: str, injections: Sequence[str]
) -> AsyncIterator[Pair]:
    """The user's task alone, then with each injection at each place.

    Args:
        suites: run the tools.
        fresh: makes the caller of one run, of whom nothing is known before it.
        suite: of the task.
        user: the task.
        injections: those with calls.
    """
    for injection, place in (("", ""), *((each, place) for each in injections for place in PLACES)):
        anew = 0
        while True:
            pair = await _run(suites, await asyncio.to_thread(fresh), (suite, user, injection), place, anew)
            reasons = {*pair.refused, *(each.partition(": ")[2] for each in pair.own_refused)}
            if reasons <= BY_SCOPE or anew + 1 == TRIES:
                break
            anew += 1
        yield pair


async def _run(suites: Suites, call: Call, names: tuple[str, str, str], place: str, anew: int) -> Pair:
    """One run; what waits for AgentDojo waits in a thread, so that the feeds go on."""
    suite, user, injection = names
    own, forced = await asyncio.to_thread(suites.begin, suite, user, injection or None)
    before = PLACES[place] if place else None
    own_refused = await _all(call, own[:before])
    refused = await _all(call, forced)
    own_refused += await _all(call, own[len(own) if before is None else before :])
    verdict = await asyncio.to_thread(suites.end)
    return Pair(
        suite,
        user,
        injection,
        place,
        verdict.completed,
        verdict.reached,
        [reason for _, reason in refused],
        [f"{name}: {reason}" for name, reason in own_refused],
        len(forced),
        anew,
    )


async def _all(call: Call, wanted: Sequence[WantedCall]) -> list[tuple[str, str]]:
    """Tools and reasons of the refused calls; a refusal stops nobody from going on."""
    done = [(each.function, await call(each)) for each in wanted]
    return [(name, reason) for name, reason in done if reason]


def ungated(suites: Suites) -> Call:
    """Calls with nothing before the tools."""

    async def call(wanted: WantedCall) -> str:
        suites.call(wanted.function, wanted.arguments)
        return ""

    return call


class Gated:
    """The tools as guarded functions of this process, and the tokens that a person issues for them.

    Args:
        at: identity provider and person.
        suites: run the tools.
        known: suites, by name.
        rows: of all tools.
    """

    def __init__(self, at: Place, suites: Suites, known: Mapping[str, Suite], rows: Mapping[str, Operation]) -> None:
        tools = {name: tool for suite in known.values() for name, tool in suite.tools.items()}
        self._rows = rows
        self._functions = {name: function_of(rows[name], tool, suites.call) for name, tool in tools.items()}
        config = at.point("dojo", PROGRAM, function_pins(self._functions.values()))
        os.environ.update(at.environment)
        try:
            self.point = GuardedFunctions(GuardConfig.read(config), self._functions.values())
        finally:
            for name in at.environment:
                os.environ.pop(name, None)
        self._at = at
        self._numbers = itertools.count()
        self._agent: Agent | None = None
        self._acts = 0

    def fresh(self, grants: tuple[Grant, ...], task: str) -> Call:
        """Calls by an agent of which little is known, and which is lent what a user task lends.

        Args:
            grants: of the user task.
            task: its name.
        """
        if self._agent is None or self._acts >= ACTS:
            if self._agent is not None:
                self._at.person.retire_agent(self._agent.id, "its runs are over")
            self._agent, self._acts = self._at.agent(f"agent-{next(self._numbers)}"), 0
        return self._call(self._lent(self._agent, grants, task), self._agent)

    def _lent(self, agent: Agent, grants: tuple[Grant, ...], task: str) -> str:
        """Text of a token with these grants."""
        now = int(time.time())
        scope = Scope(
            grants=grants,
            ceiling=Tier.REVERSIBLE,
            audiences=frozenset({self.point.config.audience}),
            delegates=frozenset(),
            depth=0,
            not_before=now - 5,
            not_after=now + LIFETIME_S,
        )
        return self._at.person.issue(agent, scope, purpose=task).token

    def _call(self, token: str, agent: Agent) -> Call:
        """Calls by the holder of a token, each with a proof of its own."""
        point = self.point

        async def call(wanted: WantedCall) -> str:
            function = self._functions.get(wanted.function)
            if function is None:
                return UNKNOWN_TOOL
            self._acts += 1
            row = self._rows[wanted.function]
            arguments: dict[str, Any] = ours(row, wanted)
            with carriage.acting(token, agent.key):
                shown = carriage.presented(row.name, arguments, audience=point.config.audience, at=point.clock.wall_s())
            try:
                await point.enforced(function)(shown, **arguments)
            except NotPermittedError as refused:
                return str(refused.told["reason"])
            return ""

        return call

    @asynccontextmanager
    async def living(self) -> AsyncIterator[None]:
        """The point's feeds run inside."""
        async with self.point.living():
            yield
