"""Charge of one gate run: durable before its effect, given back where the effect is known not to have begun."""

from __future__ import annotations

import asyncio
import contextlib
from functools import partial
from typing import TYPE_CHECKING, Final, TypeVar

from capabilities.values.chain import Chain
from pep.base.errors import ActuationRefusedError
from pep.journal.budget_store import Shortfall, Spending
from pep.request.charges import charges
from pep.request.denial import denial
from policies.evidence.model import Effect
from policies.words.reason_table import Reason

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable
    from concurrent.futures import Executor

    from pep.base.ports import Clock
    from pep.journal.budget_store import BudgetStore
    from pep.request.permit import Permit
    from policies.evidence.evidence import Evidence
    from policies.evidence.model import Decision, Request

T = TypeVar("T")

SCOPE: Final = "AID-4"
"""Primitive behind `BUDGET_SPENT`: no link does more than its parent allows."""


class BudgetCharge:
    """Charge of one run.

    Args:
        store: of what is spent.
        recorder: writes it, beside the event loop and in order with the records.
        clock: its wall time.
        request: of the run.
    """

    def __init__(self, store: BudgetStore, *, recorder: Executor, clock: Clock, request: Request) -> None:
        self._store = store
        self._recorder = recorder
        self._clock = clock
        self._request = request
        self._spending: Spending | None = None
        self._begun = False

    async def charged(self, evidence: Evidence, decision: Decision) -> Decision:
        """The decision, once a PERMIT is charged; or its denial where a budget is spent.

        Nobody is asked about what is then denied. A PERMIT that is decided anew is not charged again.

        Raises:
            JournalError: the charge could not be made durable.
        """
        ask = self._store.charge if decision.effect is Effect.PERMIT else self._store.look
        return await self._asked(ask, evidence, decision)

    async def looked(self, evidence: Evidence, decision: Decision) -> Decision:
        """The decision, or its denial where a budget is spent; nothing is charged.

        Raises:
            JournalError: the store cannot be asked.
        """
        return await self._asked(self._store.look, evidence, decision)

    async def _asked(
        self, ask: Callable[..., Spending | Shortfall | None], evidence: Evidence, decision: Decision
    ) -> Decision:
        if decision.effect is Effect.DENY or self._spending is not None or not isinstance(evidence.chain, Chain):
            return decision
        chain = evidence.chain
        due = charges(chain, self._request)
        if not due:
            return decision
        now_ms = int(self._clock.wall_s() * 1000)
        answer = await asyncio.get_running_loop().run_in_executor(self._recorder, partial(ask, due, wall_ms=now_ms))
        if isinstance(answer, Spending):
            self._spending = answer
        return self._denied(decision, chain, answer) if isinstance(answer, Shortfall) else decision

    def _denied(self, decision: Decision, chain: Chain, short: Shortfall) -> Decision:
        charge, hop = short.charge, chain.hops[short.charge.hop]
        return denial(
            decision,
            Reason.BUDGET_SPENT,
            SCOPE,
            **({"parameter": charge.parameter} if charge.parameter else {}),
            budget={"most": charge.most, "per_s": charge.window_s},
            asked=charge.amount,
            left=short.left,
            more_at=None if short.more_at_ms is None else -(-short.more_at_ms // 1000),
            set_by={"hop": hop.index, "agent": hop.agent, "sponsor": chain.sponsor.subject},
        )

    def watched(self, effect: Callable[[Permit], Awaitable[T]]) -> Callable[[Permit], Awaitable[T]]:
        """The effect, which has begun unless it was refused before anything was sent."""

        async def run(permit: Permit) -> T:
            self._begun = True
            try:
                return await effect(permit)
            except ActuationRefusedError:
                self._begun = not permit.void()
                raise

        return run

    def settle(self) -> None:
        """Gives the charge back where the effect has not begun; it waits for nothing, and a failure leaves it spent."""
        if self._spending is not None and not self._begun:
            with contextlib.suppress(RuntimeError):  # the recorder has ended
                self._recorder.submit(self._store.give_back, self._spending)
