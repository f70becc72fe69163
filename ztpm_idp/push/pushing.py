"""Pushing beside a provider: each open question and latch is told to each webhook and device once, by one worker.

Nothing waits for it: an ask is taken and answered also where nobody can be told of it. The store is read each time, so
that what is to be sent outlives a restart, and ends with its question or latch.
"""

from __future__ import annotations

import asyncio
import logging
from contextlib import suppress
from secrets import token_bytes
from typing import TYPE_CHECKING, Final, assert_never

from capabilities.statements.people import ask as ask_statement
from capabilities.statements.people import latch as latch_statement
from capabilities.values.errors import CapabilityError
from ztpm_idp.domain.asking.asks import ANSWERED_MEMORY_S, AskState
from ztpm_idp.domain.asking.pushes import Awaited, Listed, Matter, Occasion, Plan, PushCode, PushFailed, planned
from ztpm_idp.domain.asking.subscriptions import DEVICE
from ztpm_idp.domain.locks import WHOLE, Locks
from ztpm_idp.outward import resolve
from ztpm_idp.provider.metrics import TAKEN
from ztpm_idp.push.devices import GONE, send_to_device
from ztpm_idp.push.encryption import signing_key
from ztpm_idp.push.message import of_ask, of_latch, request_of
from ztpm_idp.push.sending import SEND_S, send, silence
from ztpm_idp.store.errors import ConflictError, StoreUnavailableError
from ztpm_idp.store.push.pushes import Pushes

if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    from cryptography.hazmat.primitives.asymmetric import ec

    from ztpm_idp.domain.asking.pushes import Key, Push
    from ztpm_idp.domain.asking.subscriptions import Subscription
    from ztpm_idp.outward import Resolver
    from ztpm_idp.provider.metrics import Metrics
    from ztpm_idp.provider.provider import Provider
    from ztpm_idp.push.message import Message
    from ztpm_idp.push.sending import Sent
    from ztpm_idp.store.view import View
    from ztpm_idp.web_push_settings import WebPush
    from ztpm_idp.webhook_settings import Webhook

PERIOD_S: Final = 1.0
"""Ours: time between two looks, for what another worker left and what is due again."""
AT_ONCE: Final = 8
"""Ours: most requests of one worker under way at a time."""
LATCHES: Final = 64
"""Ours: most latches that are looked at, the newest: as many as a list shows."""
ACTOR: Final = "provider"
"""Actor in the ledger of what the provider itself could not do."""
BESIDE: Final = Locks(frozenset({WHOLE}), frozenset())
"""Locks of an entry about a push: beside all but what runs alone, since no command is decided on it."""
_LOG: Final = logging.getLogger(__name__)


class Pushing:
    """Pushing of one worker.

    Args:
        provider: whose questions these are.
        webhooks: that are told of them.
        web_push: the way to devices; None: there is none.
        metrics: count what became of each try; None: nobody does.
        patience_s: longest time for one try.
        resolver: of the names of push services.
    """

    def __init__(
        self,
        provider: Provider,
        webhooks: Iterable[Webhook],
        *,
        web_push: WebPush | None = None,
        metrics: Metrics | None = None,
        patience_s: float = SEND_S,
        resolver: Resolver = resolve,
    ) -> None:
        self._provider = provider
        self._web_push = web_push
        self._resolver = resolver
        self._key: ec.EllipticCurvePrivateKey | None = None
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
        """Pushes for ever; returns at once where nobody can be told."""
        if not self._webhooks and self._web_push is None:
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
            plan, messages, devices = await self._planned()
        except (StoreUnavailableError, ConflictError) as error:
            # The rows are as they were: the next look finds the same.
            _LOG.warning("questions were not looked at: %s", type(error).__name__)
            return
        for push in plan.send:
            if push.key not in messages:
                continue
            task = asyncio.create_task(self._sent(push, messages[push.key], devices.get(push.webhook)))
            self._under_way.add(task)
            task.add_done_callback(self._under_way.discard)

    async def _planned(self) -> tuple[Plan, Mapping[Key, Message], Mapping[str, Subscription]]:
        """The plan of now, already kept, what it sends, and the devices by name."""
        store = self._provider.store
        async with store.read() as view:  # most looks find nothing to do, and hold nobody up
            plan, *_ = await self._plan_of(view)
        if not plan:
            return plan, {}, {}
        async with store.write(BESIDE) as transaction:
            await transaction.pushes.turn()
            at_ms = self._provider.now_ms()
            plan, states, known, devices = await self._plan_of(transaction)
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
                _LOG.warning("push to %s: %s: more questions than one person reads", push.webhook, push.code)
                self._count(PushCode.PUSH_OVER_BUDGET)
        return plan, self._messages(plan.send, states, signed), devices

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

    async def _plan_of(
        self, view: View
    ) -> tuple[Plan, Mapping[str, AskState], Mapping[Key, Push], Mapping[str, Subscription]]:
        """The plan, how each ask stands by its id, the pushes that have a row, and the devices."""
        at_ms = self._provider.now_ms()
        asks = await view.approvals.not_long_over(since_s=at_ms // 1_000 - ANSWERED_MEMORY_S)
        latches = await view.latches.not_long_over(since_ms=at_ms - ANSWERED_MEMORY_S * 1_000, most=LATCHES)
        states = {each.ask.ask_id: each.state(at_ms) for each in asks}
        awaited = [Awaited(Occasion(Matter.LATCH, each.latch_id), not each.released) for each in latches]
        awaited += [Awaited(Occasion(Matter.ASK, id_), state is AskState.OPEN) for id_, state in states.items()]
        known = await view.pushes.of(each.subject for each in awaited)
        living = () if self._web_push is None else await view.subscriptions.living(at_ms=at_ms)
        devices = {each.name: each for each in living}
        listed = [Listed(name, each.stated.ends) for name, each in self._webhooks.items()]
        listed += [Listed(name, ends=False) for name in devices]
        plan = planned(
            awaited, known, listed,
            a_minute=self._provider.settings.asks_a_minute, most=AT_ONCE - len(self._under_way), at_ms=at_ms,
        )  # fmt: skip
        return plan, states, known, devices

    async def _sent(self, push: Push, message: Message, device: Subscription | None) -> None:
        """Sends one push, and keeps what became of it."""
        if device is None:
            webhook = self._webhooks[push.webhook]
            url, body = request_of(message, webhook)
            sent = await send(webhook, url, body, patience_s=self._patience_s)
        else:
            sent = await self._sent_to(device, message)
        self._count(TAKEN if sent.code is None else sent.code)
        after = push.tried(sent.code, again=sent.again, again_s=sent.again_s, at_ms=self._provider.now_ms())
        try:
            await self._keep(after, gone=device is not None and sent.status in GONE)
        except (StoreUnavailableError, ConflictError) as error:
            # Whoever takes the next turn sends it once more.
            _LOG.warning("push to %s: its answer was not kept: %s", push.webhook, type(error).__name__)
            return
        if after.done and after.code is not None:
            self._tell_failed(after, sent.detail)
        elif after.code is not None:
            _LOG.warning("push to %s: %s: %s; tried again", push.webhook, after.code, sent.detail)

    async def _sent_to(self, device: Subscription, message: Message) -> Sent:
        if self._web_push is None:
            raise AssertionError("a device is listed where there is Web Push")
        if self._key is None:
            async with self._provider.store.read() as view:
                self._key = signing_key(await view.sessions.secret())
        return await send_to_device(
            self._web_push,
            device,
            message,
            key=self._key,
            random=token_bytes,
            at_s=self._provider.now_ms() // 1_000,
            resolver=self._resolver,
            patience_s=self._patience_s,
        )

    async def _keep(self, after: Push, *, gone: bool) -> None:
        store = self._provider.store
        if not after.done or after.code is None:
            async with store.beside() as connection:
                await Pushes(connection).change(after)
            return
        async with store.write(BESIDE) as transaction:
            await transaction.pushes.change(after)
            if gone:
                await transaction.subscriptions.end(after.webhook.removeprefix(DEVICE))
            await transaction.append((PushFailed(after),), actor=ACTOR, at_ms=self._provider.now_ms())

    def _tell_failed(self, push: Push, why: str) -> None:
        _LOG.error("push to %s: %s: %s; given up after %d tries", push.webhook, push.code, why, push.tries)

    def _count(self, outcome: str) -> None:
        if self._metrics is not None:
            self._metrics.pushed(outcome)


def _ids(pushes: Iterable[Push], matter: Matter) -> frozenset[str]:
    return frozenset(push.subject.id for push in pushes if push.subject.matter is matter)
