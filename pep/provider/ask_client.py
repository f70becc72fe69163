"""Asking people over the wire: asks are posted to the identity provider, and its signed word about them is fetched.

One pull is one question with a fresh nonce, so that the age of the word runs on our monotonic clock from the moment the
nonce was sent. The provider only carries what people signed: every vote in its word is verified once more, by `Asks`.
"""

from __future__ import annotations

import asyncio
import json
import secrets
from functools import partial
from typing import TYPE_CHECKING, Final

import httpx2

from capabilities.keys import keys
from capabilities.proof.proof import prove
from capabilities.statements.people import answers as answers_statement
from capabilities.values import trace_context
from capabilities.values.errors import CapabilityError
from pep.base.errors import FeedError, JournalError, PepError, PepFault
from pep.people.deferral import PICTURE_LOST, AskState
from policies.words.reason_table import Reason

if TYPE_CHECKING:
    from collections.abc import Callable

    from capabilities.keys.trust import TrustBundle
    from capabilities.statements.people.answers import Answers
    from capabilities.values.caps import Caps
    from pep.base.ports import Clock
    from pep.people.ask_composer import Asker
    from pep.people.asks import Asks
    from pep.people.deferral import AskNotice

PERIOD_S: Final = 0.25
"""Time between pulls while an answer could matter: an eighth of the greatest age of an approval's word."""
IDLE_S: Final = 2.0
"""Time between pulls while none could: the longest delay before an opening is noticed."""
TIMEOUT_S: Final = 1.0
"""Longest wait for one answer; two still fit into the motion lease."""
EXPIRY_PERIOD_S: Final = 0.1
BACK_OFF_S: Final = (0.25, 0.5, 1.0, 2.0, 5.0)
"""Waits after each failed post; the last one is repeated while the ask is open."""
REFUSAL_BYTES: Final = 4_096
"""Longest answer to a post that is read."""


class AskClient:
    """The `Announcer` port, and the loops behind it.

    Args:
        asks: takes what was answered.
        http: client of the identity provider.
        asker: author of the asks; its key makes the proofs.
        trust: keys of the registry, which sign answers.
        caps: bounds on statements.
        clock: both clocks.
        incident: told about every refused answer and every post that failed.

    Attributes:
        heard: told, on a thread, of each verified word; one that raises a `PepError` is an incident.
        urgent: whether something else than a deferral waits for people.
    """

    def __init__(
        self,
        asks: Asks,
        http: httpx2.AsyncClient,
        *,
        asker: Asker,
        trust: TrustBundle,
        caps: Caps,
        clock: Clock,
        incident: Callable[[PepError], None],
    ) -> None:
        self._asks = asks
        self._http = http
        self._asker = asker
        self._trust = trust
        self._caps = caps
        self._clock = clock
        self._incident = incident
        self.heard: list[Callable[[Answers], None]] = []
        self.urgent: Callable[[], bool] = lambda: False
        self._asked = asyncio.Event()
        self._next_ms: dict[str, tuple[int, int]] = {}

    def renew(self, trust: TrustBundle) -> None:
        """Opens answers with the keys of this bundle from now on."""
        self._trust = trust

    async def announce(self, ask: AskNotice) -> AskState:
        """State of the ask after one try to post it, or at once when it was tried before."""
        self._asked.set()
        if ask.ask_id not in self._next_ms:
            await self._post(ask)
        state = self._asks.state_of(ask.ask_id)
        return state if state is AskState.REFUSED or state is AskState.LOST else AskState.OPEN

    async def run(self) -> None:
        """Posts, pulls and expires for ever. A provider that is down costs answers, and so denies in the end."""
        await asyncio.gather(self._post_for_ever(), self._pull_for_ever(), self._expire_for_ever())

    async def _post_for_ever(self) -> None:
        while True:
            waiting = self._asks.unposted()
            now_ms = self._clock.monotonic_ms()
            # forgotten with the deferral, so that neither grows without end
            self._next_ms = {ask_id: at for ask_id, at in self._next_ms.items() if self._asks.state_of(ask_id)}
            for ask in waiting:
                if self._next_ms.get(ask.ask_id, (0, 0))[1] <= now_ms:
                    await self._post(ask)
            await asyncio.sleep(PERIOD_S)

    async def _expire_for_ever(self) -> None:
        """Deferrals end on time, also when nobody comes back for them."""
        while True:
            try:
                await asyncio.to_thread(self._asks.expire)
            except JournalError as error:
                self._incident(error)
            await asyncio.sleep(EXPIRY_PERIOD_S)

    async def _pull_for_ever(self) -> None:
        while True:
            try:
                await self.pull()
            except PepError as error:
                self._incident(error)
            self._asked.clear()
            try:
                async with asyncio.timeout(PERIOD_S if self._asks.matter() or self.urgent() else IDLE_S):
                    await self._asked.wait()
                await asyncio.sleep(PERIOD_S)  # a new question; no person answers it sooner
            except TimeoutError:
                pass

    # -- posting

    async def _post(self, ask: AskNotice) -> None:
        """Posts the ask once. A refused or failed post is tried again later, while the deferral is open."""
        tries = self._next_ms.get(ask.ask_id, (0, 0))[0]
        wait_ms = int(BACK_OFF_S[min(tries, len(BACK_OFF_S) - 1)] * 1000)
        self._next_ms[ask.ask_id] = (tries + 1, self._clock.monotonic_ms() + int(TIMEOUT_S * 1000) + wait_ms)
        body = json.dumps({"ask": ask.text, **({"picture": ask.picture} if ask.picture else {})}).encode()
        try:
            status, answer = await self.send(
                "POST", "/approvals", body=body, most_bytes=REFUSAL_BYTES, trace_id=ask.trace_id
            )
            if status in {200, 201}:
                self._asks.posted(ask.ask_id)
            elif status == 429 and _code(answer) == Reason.ASK_BUDGET_SPENT:
                await asyncio.to_thread(self._asks.refuse, ask.ask_id)
            elif status == 409 and _code(answer) == PICTURE_LOST and ask.pictured and not ask.picture:
                # an earlier process of ours made it, and ended before the provider had it
                await asyncio.to_thread(partial(self._asks.refuse, ask.ask_id, lost=True))
            else:
                self._incident(FeedError(PepFault.ASK_NOT_TAKEN, f"status {status} {_code(answer)[:64]}"))
        except (FeedError, JournalError) as error:
            self._incident(error)

    # -- pulling

    async def pull(self) -> None:
        """Pulls one statement of answers, taken whole.

        Raises:
            FeedError: when the answer is refused or there is none; what was known before still stands, and ages.
            JournalError: when an answer could not be recorded.
        """
        nonce = keys.b64u(secrets.token_bytes(24))
        sent_ms = self._clock.monotonic_ms()
        status, content = await self.send(
            "GET",
            "/approvals/answers",
            query={"audience": self._asker.audience, "nonce": nonce},
            most_bytes=self._caps.statement_bytes,
        )
        if status != 200:
            raise FeedError(PepFault.FEED_UNREACHABLE, f"answers: status {status}")
        answers = self._verified(content, nonce)
        await asyncio.to_thread(self._asks.accept, answers, sent_ms=sent_ms)
        for follower in self.heard:
            await asyncio.to_thread(follower, answers)

    def _verified(self, content: bytes, nonce: str) -> Answers:
        try:
            answers = answers_statement.open(content.decode("ascii"), self._trust.registry, self._caps)
        except UnicodeDecodeError as error:
            raise FeedError(PepFault.FEED_UNTRUSTED, "answers: not ASCII") from error
        except CapabilityError as error:
            raise FeedError(PepFault.FEED_UNTRUSTED, f"answers: {error.code}") from error
        if answers.issuer != self._asker.issuer:
            raise FeedError(PepFault.FEED_WRONG_ISSUER, "answers")
        if answers.audience != self._asker.audience:
            raise FeedError(PepFault.ANSWERS_WRONG_AUDIENCE)
        if answers.nonce != nonce:
            raise FeedError(PepFault.FEED_WRONG_NONCE, "answers")
        return answers

    async def send(
        self,
        method: str,
        path: str,
        *,
        most_bytes: int,
        body: bytes = b"",
        query: dict[str, str] | None = None,
        trace_id: str = "",
    ) -> tuple[int, bytes]:
        """Status and content of one request with this PEP's proof; a content over the bound counts as none."""
        url = f"{self._asker.issuer}{path}"
        proof = prove(
            self._asker.key,
            method=method,
            url=url,
            body=body,
            token=None,
            at=int(self._clock.wall_s()),
            jti=secrets.token_urlsafe(18),
        )
        headers = {"dpop": proof, **({"content-type": "application/json"} if body else {})}
        if (ids := trace_context.of(trace_id, secrets.token_bytes)) is not None:
            headers[trace_context.HEADER] = ids.header
        content = bytearray()
        try:
            async with (
                asyncio.timeout(TIMEOUT_S),
                self._http.stream(
                    method, url, params=query, content=body or None, headers=headers, follow_redirects=False
                ) as response,
            ):
                async for part in response.aiter_bytes():
                    content += part
                    if not len(content) <= most_bytes:
                        raise FeedError(PepFault.FEED_UNTRUSTED, "an answer that is too large")
                return response.status_code, bytes(content)
        except (httpx2.HTTPError, TimeoutError) as error:
            raise FeedError(PepFault.FEED_UNREACHABLE, f"{path}: {type(error).__name__}") from error


def _code(content: bytes) -> str:
    """The reason code of a refusal, or ""."""
    try:
        answer = json.loads(content)
    except (ValueError, RecursionError):
        return ""
    code = answer.get("code") if isinstance(answer, dict) else None
    return code if isinstance(code, str) else ""
