"""Pushing beside a provider: each open question and latch is told to each webhook once, by one of the workers.

Nothing waits for it: an ask is taken and answered also where nobody can be told of it. The store is read each time, so
that what is to be sent outlives a restart, and ends with its question or latch.
"""

from __future__ import annotations

import asyncio
import logging
from contextlib import suppress
from typing import TYPE_CHECKING, Final, assert_never

from capabilities.statements.people import ask as ask_statement
from capabilities.statements.people import latch as latch_statement
from capabilities.values.errors import CapabilityError
from ztpm_idp.domain.asking.asks import ANSWERED_MEMORY_S, AskState
from ztpm_idp.domain.asking.pushes import Awaited, Listed, Matter, Occasion, Plan, PushCode, PushFailed, planned
from ztpm_idp.domain.locks import WHOLE, Locks
from ztpm_idp.provider.metrics import TAKEN
from ztpm_idp.push.message import of_ask, of_latch, request_of
from ztpm_idp.push.sending import SEND_S, send, silence
from ztpm_idp.store.errors import ConflictError, StoreUnavailableError
from ztpm_idp.store.push.pushes import Pushes

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from ztpm_idp.domain.asking.pushes import Key, Push
    from ztpm_idp.provider.metrics import Metrics
    from ztpm_idp.provider.provider import Provider
    from ztpm_idp.push.message import Message
    from ztpm_idp.store.view import View
    from ztpm_idp.webhook_settings import Webhook

PERIOD_S: Final = 1.0
"""Ours: time between two looks, for what another worker left and what is due again."""
AT_ONCE: Final = 8
"""Ours: most requests of one worker under way at a time."""
LATCHES: Final = 64
"""Ours: most latches that are looked at, the newest: as many as a list shows."""
ACTOR: Final = "provider"
"""Actor in the ledger of what the provider itself could not do."""
_LOCKS: Final = Locks(frozenset({WHOLE}), frozenset())
"""Locks of an entry about a push: beside all but what runs alone, since no command is decided on it."""
_LOG: Final = logging.getLogger(__name__)


class Pushing:
    """Pushing of one worker.

    Args:
        provider: whose questions these are.
        webhooks: that are told of them.
        metrics: count what became of each try; None: nobody does.
        patience_s: longest time for one try.
    """

    def __init__(
        self,
        provider: Provider,
        webhooks: Iterable[Webhook],
        *,
        metrics: Metrics | None = None,
        patience_s: float = SEND_S,
    ) -> None:
        self._provider = provider
        self._webhooks = {each.stated.name: each for each in webhooks}
        self._metrics = metrics
        self._patience_s = patience_s
        self._hint = asyncio.Event()
        self._under_way = set[asyncio.Task[None]]()
        silence()

    def told(self) -> None:
        """Looks at once: an ask or a latch was taken."""
        self._hint.set()

    async def run(self) -> None:
        """Pushes for ever; returns at once where there is no webhook."""
        if not self._webhooks:
            return
        try:
            while True:
                self._hint.clear()
                try:
                    await self.look()
                except Exception as error:  # noqa: BLE001  of ours; the next look is not to be lost with this one
                    _LOG.error("questions were not looked at: %s", type(error).__name__)
                with suppress(TimeoutError):
                    await asyncio.wait_for(self._hint.wait(), PERIOD_S)
        finally:
            for task in self._under_way:
                task.cancel()
            await self.settled()

    async def settled(self) -> None:
        """Every try that is under way has ended."""
        await asyncio.gather(*self._under_way, return_exceptions=True)

    async def look(self) -> None:
        """Looks once, and begins to send what is due."""
        try:
            plan, messages = await self._planned()
        except (StoreUnavailableError, ConflictError) as error:
            # The rows are as they were: the next look finds the same.
            _LOG.warning("questions were not looked at: %s", type(error).__name__)
            return
        for push in plan.send:
            if push.key not in messages:
                continue
            task = asyncio.create_task(self._sent(push, messages[push.key]))
            self._under_way.add(task)
            task.add_done_callback(self._under_way.discard)

    async def _planned(self) -> tuple[Plan, Mapping[Key, Message]]:
        """The plan of now, already kept, and what it sends."""
        store = self._provider.store
        async with store.read() as view:  # most looks find nothing to do, and hold nobody up
            plan, *_ = await self._plan_of(view)
        if not plan:
            return plan, {}
        async with store.write(_LOCKS) as transaction:
            await transaction.pushes.turn()
            at_ms = self._provider.now_ms()
            plan, states, known = await self._plan_of(transaction)
            await transaction.pushes.keep((*plan.send, *plan.wait, *plan.given_up), known=known)
            await transaction.pushes.forget(at_ms=at_ms)
            failed = [PushFailed(push) for push in plan.given_up]
            if failed:
                await transaction.append(failed, actor=ACTOR, at_ms=at_ms)
            wanted = {matter: _ids(plan.send, matter) for matter in Matter}
            signed = {
                Matter.ASK: await transaction.approvals.signed(wanted[Matter.ASK]),
                Matter.LATCH: await transaction.latches.signed(wanted[Matter.LATCH]),
            }
        for push in plan.given_up:
            self._tell_failed(push, "nobody is waited for any more")
        for push in plan.wait:
            if push.key not in known:
                _LOG.warning("webhook %s: %s: more questions than one person reads", push.webhook, push.code)
                self._count(PushCode.PUSH_OVER_BUDGET)
        return plan, self._messages(plan.send, states, signed)

    def _messages(
        self,
        pushes: Iterable[Push],
        states: Mapping[str, AskState],
        signed: Mapping[Matter, Mapping[str, tuple[str, bytes]]],
    ) -> Mapping[Key, Message]:
        """Each message, but for those about what their point's key of now did not sign."""
        caps = self._provider.rules.caps
        messages: dict[Key, Message] = {}
        for push in pushes:
            id_ = push.subject.id
            text, key = signed[push.subject.matter][id_]
            try:
                match push.subject.matter:
                    case Matter.ASK:
                        messages[push.key] = of_ask(push.event, ask_statement.open(text, {key}, caps), states[id_])
                    case Matter.LATCH:
                        messages[push.key] = of_latch(push.event, latch_statement.open(text, {key}, caps))
                    case _:
                        assert_never(push.subject.matter)
            except CapabilityError as error:
                _LOG.warning("a %s is not pushed: %s", push.subject.matter, error.code)
        return messages

    async def _plan_of(self, view: View) -> tuple[Plan, Mapping[str, AskState], Mapping[Key, Push]]:
        """The plan, how each ask stands by its id, and the pushes that have a row."""
        at_ms = self._provider.now_ms()
        asks = await view.approvals.not_long_over(since_s=at_ms // 1_000 - ANSWERED_MEMORY_S)
        latches = await view.latches.not_long_over(since_ms=at_ms - ANSWERED_MEMORY_S * 1_000, most=LATCHES)
        states = {each.ask.ask_id: each.state(at_ms) for each in asks}
        awaited = [Awaited(Occasion(Matter.LATCH, each.latch_id), not each.released) for each in latches]
        awaited += [Awaited(Occasion(Matter.ASK, id_), state is AskState.OPEN) for id_, state in states.items()]
        known = await view.pushes.of(each.subject for each in awaited)
        webhooks = (Listed(name, each.stated.ends) for name, each in self._webhooks.items())
        plan = planned(
            awaited, known, webhooks,
            a_minute=self._provider.settings.asks_a_minute, most=AT_ONCE - len(self._under_way), at_ms=at_ms,
        )  # fmt: skip
        return plan, states, known

    async def _sent(self, push: Push, message: Message) -> None:
        """Sends one push, and keeps what became of it."""
        webhook = self._webhooks[push.webhook]
        url, body = request_of(message, webhook)
        sent = await send(webhook, url, body, patience_s=self._patience_s)
        self._count(TAKEN if sent.code is None else sent.code)
        after = push.tried(sent.code, again=sent.again, again_s=sent.again_s, at_ms=self._provider.now_ms())
        try:
            await self._keep(after)
        except (StoreUnavailableError, ConflictError) as error:
            # Whoever takes the next turn sends it once more.
            _LOG.warning("webhook %s: its answer was not kept: %s", push.webhook, type(error).__name__)
            return
        if after.done and after.code is not None:
            self._tell_failed(after, sent.detail)
        elif after.code is not None:
            _LOG.warning("webhook %s: %s: %s; tried again", push.webhook, after.code, sent.detail)

    async def _keep(self, after: Push) -> None:
        store = self._provider.store
        if not after.done or after.code is None:
            async with store.beside() as connection:
                await Pushes(connection).change(after)
            return
        async with store.write(_LOCKS) as transaction:
            await transaction.pushes.change(after)
            await transaction.append((PushFailed(after),), actor=ACTOR, at_ms=self._provider.now_ms())

    def _tell_failed(self, push: Push, why: str) -> None:
        _LOG.error("webhook %s: %s: %s; given up after %d tries", push.webhook, push.code, why, push.tries)

    def _count(self, outcome: str) -> None:
        if self._metrics is not None:
            self._metrics.pushed(outcome)


def _ids(pushes: Iterable[Push], matter: Matter) -> frozenset[str]:
    return frozenset(push.subject.id for push in pushes if push.subject.matter is matter)
