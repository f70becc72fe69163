"""Enforcement point without a robot, in the program that has the tools: the common parts, and a gate."""

from __future__ import annotations

import asyncio
from contextlib import asynccontextmanager
from typing import TYPE_CHECKING, Any, Final

from capabilities.values.caps import DEFAULT as CAPS
from pep.base.collector import spare_what_stands
from pep.base.errors import ConfigError, DeclarationError, PepFault
from pep.gate.gate import Gate
from pep.journal.budget_store import BudgetStore
from pep.journal.task_store import TASKS, TaskStore
from pep.perception.fact_feed import FactFeed
from pep.point.deferrals import Deferrals, recover_gate
from pep.point.parts import PointParts, opened

if TYPE_CHECKING:
    from collections.abc import AsyncIterator, Coroutine, Iterable

    from pep.base.operation_row import Operation
    from pep.point.guard_config import GuardConfig
    from pep.request.edge import Edge

ASK_MS: Final = 600_000
"""Time for which an ask about an act waits for people.

Ours: the world of an act changes more slowly than that of an arm.
"""


class DecidingPoint(PointParts):
    """Parts of an enforcement point without a robot, composed.

    Args:
        config: of it.

    Attributes:
        asks: deferrals.
        facts: of sensors.
        gate: decides and enforces.
        kept: deferred calls that their callers look after.
    """

    def __init__(self, config: GuardConfig) -> None:
        try:
            config.folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        except OSError as error:
            raise ConfigError(PepFault.CONFIG_INVALID, f"folder: {type(error).__name__}") from error
        inputs = opened(config)
        trust, key = inputs["trust"], inputs["key"]
        self._key = key
        super().__init__(config, trust=trust, key=key, http=inputs["http"])
        self._sensor_address = config.sensor_address() if config.sensors else None
        self.facts = FactFeed(self.follower, clock=self.clock, caps=CAPS, incident=self._frame_incident)
        self.kept = TaskStore(config.state_dir / TASKS)
        people = Deferrals.of(self, journal=self.journal, timeout_ms=ASK_MS, trust=trust, key=key, pictures=None)
        self.asks, self._asking = people.asks, people.asking
        self.gate = Gate(
            clock=self.clock,
            authority=self.authority,
            registry=self.follower,
            robot=None,
            policies=inputs["policies"],
            journal=self.journal,
            budgets=BudgetStore(config.budget_file),
            asks=self.asks,
            announcer=self._asking,
            facts=self.facts,
        )
        recover_gate(self.journal, gate=self.gate, asks=self.asks, proofs=self.recover)

    @property
    def edge(self) -> Edge:
        """The gate."""
        return self.gate

    def beside(self) -> dict[str, Coroutine[Any, Any, None]]:
        """Tasks that run as long as it serves, by name."""
        return {**super().beside(), "asking": self._asking.run()}

    async def declare(self) -> None:
        """Lets what is declared be called, once the first views are there.

        Raises:
            DeclarationError: it must not be.
        """

    @asynccontextmanager
    async def living(self) -> AsyncIterator[None]:
        """The feeds run inside, and everything is released afterwards.

        Raises:
            DeclarationError: as `declare`; nothing was served then.
        """
        tasks = [self.incidents.watched(what, part) for what, part in self.beside().items()]
        try:
            await self.first_view()
            spare_what_stands()
            await self.declare()
            yield
        finally:
            await self.facts.close()
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)
            await self.release()
            self.kept.close()

    async def hear(self, rows: Iterable[Operation]) -> None:
        """Hears the sensors on whose facts these rows depend.

        Raises:
            ConfigError: `CONFIG_INVALID`, where a row depends on a fact and nothing is configured to hear it, or
                the address cannot be listened at.
        """
        facts = {fact.fact: (fact, row.name) for row in rows for fact in row.facts}
        if self._sensor_address is None:
            for name, (_, tool) in sorted(facts.items()):
                raise ConfigError(PepFault.CONFIG_INVALID, f"sensors is missing: {tool} depends on {name}")
            return
        host, port = self._sensor_address
        try:
            await self.facts.listen((fact for fact, _ in facts.values()), host=host, port=port)
        except OSError as error:
            raise ConfigError(PepFault.CONFIG_INVALID, f"sensors: {type(error).__name__}") from error

    def _frame_incident(self, sensor: str, fault: str, detail: str, count: int) -> None:
        self.note({"what": "perception", "sensor": sensor, "fault": fault, "detail": detail, "count": count})

    def check_registered(self, name: str, digest: str) -> None:
        """Checks that a tool is registered as it is now.

        Args:
            name: of the tool and its operation.
            digest: of its definition.

        Raises:
            DeclarationError: `TOOL_UNKNOWN` or `TOOL_DEFINITION_CHANGED`, naming it.
        """
        registered = self.follower.tool(name)
        if registered is None or registered.operation != name:
            raise DeclarationError(PepFault.TOOL_UNKNOWN, name)
        if registered.definition_digest != digest:
            raise DeclarationError(PepFault.TOOL_DEFINITION_CHANGED, name)
