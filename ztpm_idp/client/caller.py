"""Requests to the identity provider by one key, and what comes of them."""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, Final, Self
from urllib.parse import quote

import httpx2
import rfc8785

from ztpm_idp.client import direct_http
from ztpm_idp.client.signing import MetaAuth, ProofAuth

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping
    from types import TracebackType

    from capabilities.keys.keys import PrivateKey

TIMEOUT_S: Final = 30.0
"""Longest wait for one answer."""


class ClientError(Exception):
    """The identity provider refused, or did not answer as it should.

    Attributes:
        code: the reason; `UNREACHABLE`, `ANSWER_MALFORMED` and `ASK_CHANGED` are this client's own.
        status: HTTP status, 0 when there was no answer.
        detail: for people.
        explanation: of `NOT_NARROWER`: `places`, each with `nearest`, `could_narrow`, and `repaired`, the nearest
            restriction that is accepted (`capabilities.values.explanation`).
    """

    def __init__(self, code: str, status: int, detail: str = "", explanation: dict[str, Any] | None = None) -> None:
        super().__init__(f"{code} ({status}): {detail}")
        self.code = code
        self.status = status
        self.detail = detail
        self.explanation = explanation


@dataclass(frozen=True, slots=True)
class Revocation:
    """Revocation that was made.

    Attributes:
        epoch: the one at which it holds.
        known: whether the provider ever made or registered such a thing; otherwise the id may be a slip.
        at_ms: when it was acknowledged, by the provider's clock; 0 of an earlier provider.
    """

    epoch: int
    known: bool
    at_ms: int = 0


@dataclass(frozen=True, slots=True)
class Issued:
    """Token that was lent.

    Attributes:
        token: its text. It is not shown when this is printed; only the holder's key makes it useful, still keep it to
            yourself.
        token_id, hop_id: for revoking it.
        expires_at: seconds since the epoch.
    """

    token: str = field(repr=False)
    token_id: str
    hop_id: str
    expires_at: int


class Caller:
    """Requests by one registered key.

    Attributes:
        notice: told with the last answer, to administrators alone: a recovery by the root key that waits; or empty.
        on_notice: takes each new one.
    """

    def __init__(
        self,
        id: str,  # noqa: A002  the word of the wire
        key: PrivateKey,
        issuer: str,
        *,
        transport: httpx2.BaseTransport | None = None,
        now: Callable[[], float] = time.time,
    ) -> None:
        self.id = id
        self.issuer = issuer
        self._key = key
        self._now = now
        self._transport = transport
        self.notice = ""
        self.on_notice: Callable[[str], None] | None = None
        self._http = direct_http.client(TIMEOUT_S, transport)

    def __repr__(self) -> str:
        return f"{type(self).__name__}({self.id!r}, {self.issuer!r})"

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()

    def close(self) -> None:
        """Its connections are closed."""
        self._http.close()

    def auth(self, token: str | None = None) -> ProofAuth:
        """Signs requests of any `httpx2` client, such as an MCP transport's, as this caller; presents `token`."""
        return ProofAuth(self._key, token, now=self._now)

    def meta(
        self, tool: str, arguments: Mapping[str, object] | None, token: str, *, audience: str
    ) -> dict[str, object]:
        """The `_meta` of one call, signed as this caller, for an MCP client in the server's own process.

        Example::

            await client.call_tool(tool, arguments, meta=agent.meta(tool, arguments, token, audience=url))

        Args:
            tool: name of it.
            arguments: of the call.
            token: this caller's.
            audience: canonical URL of the server.
        """
        params = {"name": tool} if arguments is None else {"name": tool, "arguments": dict(arguments)}
        signed = MetaAuth(self._key, lambda: token, audience, now=self._now).signed("tools/call", params)
        meta: dict[str, object] = signed["_meta"]  # type: ignore[assignment]  # an object, as it was made
        return meta

    def revoke(self, kind: str, id: str, reason: str) -> int:  # noqa: A002  the word of the wire
        """The thing is revoked for ever; the epoch at which it is.

        Args:
            kind: "token", "hop", "agent", "key", "sponsor", "audience" or "mandate".
            id: of that kind.
            reason: for the ledger.
        """
        return self.revocation(kind, id, reason).epoch

    def revocation(self, kind: str, id: str, reason: str) -> Revocation:  # noqa: A002  the word of the wire
        """Revokes as `revoke` does, and tells whether the provider ever knew such a thing."""
        answer = self._post("/revocations", {"kind": kind, "id": id, "reason": reason})
        try:
            return Revocation(int(answer["epoch"]), known=answer["known"] is True, at_ms=int(answer.get("at_ms", 0)))
        except (KeyError, ValueError, TypeError):
            raise ClientError("ANSWER_MALFORMED", 200) from None

    def points(self) -> dict[str, Any]:
        """Newest line and epoch of the feed, and `points`: how far each enforcement point says that it follows.

        Each has pep, audiences, line, epoch, confirmed_ms (when that came), heard_ms and connected; times are the
        provider's, milliseconds since the epoch, as `now_ms` is.
        """
        found: dict[str, Any] = self._json(self._send("GET", "/revocations/points", b"", None))
        return found

    def mandates(self) -> list[dict[str, Any]]:
        """Mandates that this caller signed or may draw from, the newest first; every one for an administrator.

        Each has mandate_id, state ("in force", "suspended", "revoked", "ended", "over"), sponsor, agent, purpose,
        signed_at, not_after (seconds since the epoch) and live, the number of its tokens that are.
        """
        found: list[dict[str, Any]] = self._json(self._send("GET", "/mandates", b"", None))
        return found

    def mandate(self, mandate_id: str) -> dict[str, Any]:
        """A mandate as `mandates` tells it, with its scope, its signed text as `mandate`, and its newest `draws`.

        Each draw has token_id, hop_id, drawn_at, not_after (seconds since the epoch) and `live`.

        Raises:
            ClientError: `MANDATE_UNKNOWN`, also for one of other parties.
        """
        found: dict[str, Any] = self._json(self._send("GET", f"/mandates/{quote(mandate_id, safe='')}", b"", None))
        return found

    def agents(self) -> list[dict[str, Any]]:
        """Every registered agent.

        Each has id, status, held, sponsor, role, model, software_digest, key, trust_permille, workload, `trust_by`
        (score in permille by delegator, where it is not the prior) and `conduct` (`deviations`, `deviated_at`,
        `contracted`, `samples`, `restored_at`; None when nothing was reported).
        """
        found: list[dict[str, Any]] = self._json(self._send("GET", "/agents", b"", None))
        return found

    def _post(self, path: str, body: Mapping[str, object], *, token: str | None = None) -> dict[str, Any]:
        answer: dict[str, Any] = self._json(self._send("POST", path, rfc8785.dumps(dict(body)), token))  # type: ignore[arg-type]
        return answer

    def _send(self, method: str, path: str, content: bytes, token: str | None) -> httpx2.Response:
        headers = {"Content-Type": "application/json"} if content else {}
        try:
            response = self._http.request(
                method,
                self.issuer + path,
                content=content,
                headers=headers,
                auth=self.auth(token),
                follow_redirects=False,
            )
        except httpx2.HTTPError as error:
            raise ClientError("UNREACHABLE", 0, f"{self.issuer}: {type(error).__name__}") from error
        before, self.notice = self.notice, response.headers.get("ztpm-notice", "")
        if self.notice not in {"", before} and self.on_notice is not None:
            self.on_notice(self.notice)
        if response.is_success:
            return response
        try:
            problem = response.json()
            code, detail, why = str(problem["code"]), str(problem.get("detail", "")), problem.get("explanation")
        except (ValueError, KeyError, TypeError, AttributeError):
            code, detail, why = "ANSWER_MALFORMED", "", None
        raise ClientError(code, response.status_code, detail, why if isinstance(why, dict) else None)

    def _json(self, response: httpx2.Response) -> Any:
        try:
            return response.json()
        except ValueError:
            raise ClientError("ANSWER_MALFORMED", response.status_code) from None

    def _issued(self, answer: dict[str, Any]) -> Issued:
        try:
            return Issued(
                str(answer["token"]), str(answer["token_id"]), str(answer["hop_id"]), int(answer["expires_at"])
            )
        except (KeyError, ValueError):
            raise ClientError("ANSWER_MALFORMED", 201) from None
