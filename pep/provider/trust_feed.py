"""Following the trust bundle: a newer one by a registry key that is trusted already takes its place at once.

Every answer of the provider says in a header which version it has. That is a hint and nothing more: it makes this point
ask for the bundle, which is verified by succession ([TRB-5]). A forged hint causes a question, one a second at most; a
suppressed one leaves the ordinary period to find out.
"""

from __future__ import annotations

import asyncio
import contextlib
from typing import TYPE_CHECKING, Final

from capabilities.rotation.succession import succeed
from capabilities.values import strict_json
from capabilities.values.errors import CapabilityError, Fault, FaultCode
from pep.base.errors import FeedError, PepFault

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable

    from capabilities.keys.trust import TrustBundle
    from capabilities.values.caps import Caps
    from pep.base.ports import Clock

HEADER: Final = "ztpm-trust"
"""Header with the version of the provider's trust bundle."""
PERIOD_S: Final = 10.0
"""Time between two questions that nothing asked for."""
PAUSE_S: Final = 1.0
"""Shortest time between two questions."""
_DIGITS: Final = 10
"""Most digits of a version: one step a second for three hundred years."""


class TrustFeed:
    """The trust bundle of an enforcement point, from now on.

    Args:
        get: asks the provider for the text at a path.
        held: the bundle to begin with.
        caps: bounds on statements.
        clock: both clocks.
        incident: told about every refused answer.

    Attributes:
        held: the bundle that is acted on.
        followers: told of each bundle that takes its place, in order, in the event loop.
        keep: writes a bundle where a restart finds it, before it is acted on.
    """

    def __init__(
        self,
        get: Callable[[str, dict[str, str]], Awaitable[str]],
        held: TrustBundle,
        *,
        caps: Caps,
        clock: Clock,
        incident: Callable[[FeedError], None],
    ) -> None:
        self._get = get
        self.held = held
        self._caps = caps
        self._clock = clock
        self._incident = incident
        self._wake = asyncio.Event()
        self.followers: list[Callable[[TrustBundle], None]] = []
        self.keep: Callable[[TrustBundle], None] = lambda _: None

    def hint(self, version: str | None) -> None:
        """Hears the version that an answer names; a newer one makes the next question come at once."""
        number = version is not None and version.isascii() and version.isdigit() and len(version) <= _DIGITS
        if version is not None and number and int(version) > self.held.version:
            self._wake.set()

    def doubt(self) -> None:
        """A signature was by no trusted key: there may be a newer bundle."""
        self._wake.set()

    async def run(self) -> None:
        """Asks for ever: every `PERIOD_S`, and after a hint."""
        self._wake = asyncio.Event()  # of this very loop
        while True:
            with contextlib.suppress(TimeoutError):
                async with asyncio.timeout(PERIOD_S):
                    await self._wake.wait()
            self._wake.clear()
            try:
                await self.pull()
            except FeedError as error:
                self._incident(error)
            await asyncio.sleep(PAUSE_S)

    async def pull(self) -> None:
        """Asks once, and takes what is newer.

        Raises:
            FeedError: `FEED_UNREACHABLE` without an answer; `FEED_UNTRUSTED` for one that may not take the place of
                what is held; `STATE_UNREADABLE` where it could not be kept. What is held stands then.
        """
        text = await self._get("/trust/signed", {})
        try:
            statements = strict_json.parse_object(text.encode()).get("statements")
        except CapabilityError as error:
            raise FeedError(PepFault.FEED_UNREACHABLE, "not a bundle") from error
        if not isinstance(statements, list) or not all(isinstance(one, str) for one in statements):
            raise FeedError(PepFault.FEED_UNREACHABLE, "not a bundle")
        faults: list[Fault] = []
        for one in statements:
            newer = succeed(self.held, one, at=self._clock.wall_s(), caps=self._caps)
            if isinstance(newer, Fault):
                faults.append(newer)
                continue
            if newer.version > self.held.version:
                await self._take(newer)
            return
        # By keys that this point does not know yet, or any more, it may not be led; older words are no news.
        if any(fault.code is not FaultCode.REPLAYED for fault in faults):
            raise FeedError(PepFault.FEED_UNTRUSTED, f"trust bundle: {faults[0].code}: {faults[0].detail}")

    async def _take(self, newer: TrustBundle) -> None:
        try:
            await asyncio.to_thread(self.keep, newer)
        except OSError as error:
            raise FeedError(PepFault.STATE_UNREADABLE, "the trust bundle could not be kept") from error
        self.held = newer
        for tell in self.followers:
            tell(newer)
