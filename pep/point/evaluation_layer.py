"""AuthZEN at an enforcement point: gateways that exist ask what it would decide about an act ([AZN-1] to [AZN-7]).

An answer is advice. It comes by the way of every call, up to its record, and nothing follows from it here: no permit is
made, no budget charged, no approval used, nobody asked. The act itself is decided anew where it is enforced.
"""

from __future__ import annotations

import asyncio
import json
import secrets
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final
from urllib.parse import urlsplit

from capabilities.proof.evaluation import METHOD
from capabilities.values.chain import Chain
from capabilities.values.errors import Fault, FaultCode
from pep.base import caller_place
from pep.base.access_token import TOKEN_BYTES, is_access_token
from pep.base.errors import ConfigError, JournalError, PepFault
from pep.base.operation_row import OperationKind
from pep.gate import records
from pep.mcp.body_screen import Unfit, screen
from pep.mcp.http_request import BEARER, SCHEME, Refusals, answer, digest, headers_of, read_body, short
from pep.mcp.mapping import Misfit, bare_request
from pep.mcp.provenance import unvouched
from pep.mcp.real_paths import resolved_request
from pep.mcp.resource_description import ALGORITHMS
from pep.point import evaluation_answer
from pep.point.evaluation_answer import Answer
from pep.point.evaluation_form import AGENT, OBJECT, Semantic, read
from pep.request.authority import NOBODY, Credentials, PresentedRequest
from pep.request.call import Call, tool_reading
from policies.evidence.model import Effect
from policies.words.reason_table import REASONS, Reason

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable, Mapping, Sequence

    from starlette.types import ASGIApp, Receive, Scope, Send

    from pep.base.operation_row import Operation
    from pep.base.ports import Clock, Registry
    from pep.gate.gate import Gate
    from pep.mcp.dpop import AccessTokens
    from pep.point.evaluation_form import Evaluations, Question
    from pep.request.authority import Authority

ONE: Final = "/access/v1/evaluation"
SEVERAL: Final = "/access/v1/evaluations"
WELL_KNOWN: Final = "/.well-known/authzen-configuration"
REQUEST_ID: Final = "x-request-id"
REQUEST_ID_LENGTH: Final = 256
"""Longest request id that is given back. Ours."""
DEADLINE_MS: Final = 2_000
"""Time from arrival after which no further evaluation of a request begins. Ours: gateways wait a second or few."""
AT_ONCE: Final = 4
"""Requests that are evaluated at the same time. Ours: calls have their turns in between."""
PROBLEM: Final = b"application/problem+json"


@dataclass(frozen=True, slots=True)
class _Caller:
    """Party that asks: an agent or client with its own credentials, or an enforcement point with its key alone."""

    name: str
    credentials: Credentials = NOBODY


class EvaluationLayer:
    """ASGI layer that answers evaluations beside a guarded app, at the origin of its audience.

    Args:
        app: the guarded app; all other paths are its own.
        gate: decides.
        authority: steps 1 to 10.
        registry: approved definitions, base tiers.
        peps: raw public key of each registered enforcement point of this audience, by its id, as of now.
        tools: operations that may be asked about, by name.
        served: gives the digest of each tool's definition as it is served now, by name.
        audience: canonical URL of the enforcement point.
        access: answers about access tokens of OAuth clients.
        clock: both clocks.

    Raises:
        ConfigError: `CONFIG_INVALID`, where the audience has one of the endpoints' own paths.
    """

    def __init__(
        self,
        app: ASGIApp,
        *,
        gate: Gate,
        authority: Authority,
        registry: Registry,
        peps: Callable[[], Mapping[str, bytes]],
        tools: Mapping[str, Operation],
        served: Callable[[], Awaitable[Mapping[str, str]]],
        audience: str,
        access: AccessTokens,
        clock: Clock,
    ) -> None:
        parts = urlsplit(audience)
        if parts.path in {ONE, SEVERAL, WELL_KNOWN}:
            raise ConfigError(PepFault.CONFIG_INVALID, "audience: its path is one of the evaluation endpoints'")
        self._app = app
        self._gate = gate
        self._authority = authority
        self._registry = registry
        self._peps = peps
        self._tools = tools
        self._served = served
        self._audience = audience
        self._origin = f"{parts.scheme}://{parts.netloc}"
        self._access = access
        self._clock = clock
        self._refusals = Refusals(gate, clock)
        self._places = asyncio.Semaphore(AT_ONCE)
        self._metadata = json.dumps(
            {
                "policy_decision_point": self._origin,
                "access_evaluation_endpoint": self._origin + ONE,
                "access_evaluations_endpoint": self._origin + SEVERAL,
            }
        ).encode()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """One ASGI connection."""
        if scope["type"] != "http" or scope["path"] not in {ONE, SEVERAL, WELL_KNOWN}:
            await self._app(scope, receive, send)
        elif scope["path"] == WELL_KNOWN:
            await self._tell_endpoints(scope, send)
        else:
            await self._evaluate(scope, receive, send)

    async def _tell_endpoints(self, scope: Scope, send: Send) -> None:
        if scope["method"] == "GET":
            await answer(send, 200, self._metadata)
        else:
            await answer(send, 405, b"", [(b"allow", b"GET")])

    async def _evaluate(self, scope: Scope, receive: Receive, send: Send) -> None:
        """One request for evaluations."""
        arrived_ms, headers = self._clock.monotonic_ms(), headers_of(scope)
        body = await read_body(receive)
        if body is None:
            return
        echoed = _echoed(headers)
        where: dict[str, object] = {"method": scope["method"], "path": scope["path"], "body": digest(body)}
        if scope["method"] != "POST":
            await answer(send, 405, b"", [(b"allow", b"POST"), *echoed])
            return
        # [AZN-2] read before anything is verified, as everywhere
        asked = _screened(scope, headers, body)
        if isinstance(asked, Unfit):
            await self._refuse(send, 400, asked.reason, echoed, where=where, detail=asked.detail)
            return
        # [AZN-1] who asks
        caller = await self._caller(headers, body, self._origin + scope["path"])
        if isinstance(caller, Fault):
            await self._refuse(send, 401, Reason(caller.code), echoed, where=where, fault=caller)
            return
        caller_place.proven(scope, caller.name)
        evaluations = read(asked, batch=scope["path"] == SEVERAL)
        if isinstance(evaluations, Unfit):
            where["caller"] = caller.name
            await self._refuse(
                send, 400, evaluations.reason, echoed, where=where, detail=evaluations.detail, known=caller.credentials
            )
            return
        async with self._places:
            answers = await self._answers(evaluations, caller, arrived_ms=arrived_ms)
            common: dict[str, object] = {"caller": caller.name, "request": short(headers.get(REQUEST_ID)), **where}
            answers = await self._recorded(answers, common)
        told: object = [each.told for each in answers]
        whole = {"evaluations": told} if evaluations.batch else answers[0].told
        await answer(send, 200, json.dumps(whole).encode(), echoed)

    # -- who asks

    async def _caller(self, headers: Mapping[str, str | None], body: bytes, url: str) -> _Caller | Fault:
        """The party that asks, once it has proven a key of its own over the request."""
        for name, code in (("authorization", FaultCode.TOKEN_MALFORMED), ("dpop", FaultCode.PROOF_MALFORMED)):
            if name in headers and headers[name] is None:
                return Fault(code, "AZN-1", f"the header {name} came more than once")
        scheme, _, token = (headers.get("authorization") or "").partition(" ")
        presented = PresentedRequest(token or None, headers.get("dpop"), "POST", url, body)
        if scheme.lower() == BEARER:
            return Fault(FaultCode.PROOF_MISSING, "AZN-1", "who asks proves a key")
        if scheme and (scheme.lower() != SCHEME or not token):
            return Fault(FaultCode.TOKEN_MALFORMED, "AZN-1", "another scheme than DPoP")
        if not token:
            pep = self._authority.check_pep(presented, self._peps())
            return pep if isinstance(pep, Fault) else _Caller(f"pep {pep}")
        credentials = await self._verified(presented, bearer=False, lease_ms=self._gate.lease_ms(None))
        return credentials.fault or _Caller(f"agent {credentials.holder}", credentials)

    async def _verified(self, presented: PresentedRequest, *, bearer: bool, lease_ms: int) -> Credentials:
        """Credentials of an agent or OAuth client, after steps 1 to 10; every failure is a fault."""
        token = presented.token or ""
        try:
            if not is_access_token(token):
                return self._authority.check(presented, lease_ms=lease_ms)
            if len(token) > TOKEN_BYTES:
                return Credentials(None, Fault(FaultCode.TOKEN_MALFORMED, "OAT-1", "too long"))
            looked = await self._access.look(token)
            if isinstance(looked, Fault):
                return Credentials(None, looked)
            return self._authority.check_access(presented, looked, bearer=bearer, lease_ms=lease_ms)
        except Exception as error:  # noqa: BLE001 - a verification that breaks has not verified
            return Credentials(None, Fault(FaultCode.TOKEN_MALFORMED, "AZN-3", type(error).__name__))

    # -- what is answered

    async def _answers(self, evaluations: Evaluations, caller: _Caller, *, arrived_ms: int) -> list[Answer]:
        """Answers in the order of the questions, up to the one that ends them [AZN-6]."""
        served = await self._served()
        answers: list[Answer] = []
        for question in evaluations.questions:
            if self._clock.monotonic_ms() - arrived_ms < DEADLINE_MS:
                answers.append(await self._answer(question, caller, served))
                await asyncio.sleep(0)  # others have their turn
            else:
                late = Reason.NOT_EVALUATED
                answers.append(self._undecided(question, NOBODY, late, evaluation_answer.denied(late, "")))
            permits, semantic = answers[-1].permits, evaluations.semantic
            if (semantic is Semantic.FIRST_DENY and not permits) or (semantic is Semantic.FIRST_PERMIT and permits):
                break
        return answers

    async def _answer(self, question: Question, caller: _Caller, served: Mapping[str, str]) -> Answer:
        arrived_ms, at = self._clock.monotonic_ms(), self._clock.wall_s()
        operation = self._tools.get(question.operation)
        if operation is not None and (question.resource_type, question.resource) != (OBJECT, operation.object):
            operation = None
        if operation is not None and operation.kind is OperationKind.STOP:
            # A stop is never subject to a permit: a gateway that asks about one is not to hold it.
            context = {"effect": str(Effect.PERMIT), "reason": str(Reason.PERMITTED), "primitive": "", "tier": 0}
            return self._undecided(question, NOBODY, Reason.PERMITTED, {**context, "obligations": []}, permits=True)
        # [AZN-3] of whom it is asked
        credentials = await self._credentials(question, caller, operation)
        fault, chain = credentials.fault, credentials.chain
        if fault is not None or not isinstance(chain, Chain):
            reason = Reason.TOKEN_MISSING if fault is None else Reason(fault.code)
            return self._undecided(question, credentials, reason, evaluation_answer.refused(reason))
        if (question.subject_type, question.subject) != (AGENT, chain.leaf.agent):
            return self._denied(question, credentials, Reason.SUBJECT_NOT_HOLDER, "AID-1")
        # [AZN-4] which act
        if operation is None:
            return self._denied(question, credentials, Reason.TOOL_UNKNOWN, "TEA-3")
        request = resolved_request(
            operation, question.properties, request_id=secrets.token_hex(16), audience=self._audience, at=at
        )
        if isinstance(request, Misfit):
            where = {"argument": request.argument, "detail": request.detail}
            return self._denied(question, credentials, request.reason, "TEA-2", **where)
        call = Call(
            request=request,
            operation=operation,
            # as it is registered, and as it is served at this moment
            tool=tool_reading(operation.name, self._registry.tool(operation.name), served.get(operation.name, "")),
            credentials=credentials,
            arrived_ms=arrived_ms,
            readiness=None,
            context=unvouched(request, (), operation=operation, chain=chain, at=at),
        )
        # [AZN-5] advice
        advice = await self._gate.advise(call)
        return Answer(
            advice.decision.effect is Effect.PERMIT,
            evaluation_answer.advised(advice),
            records.advice(call, advice.evidence, advice.decision),
        )

    async def _credentials(self, question: Question, caller: _Caller, operation: Operation | None) -> Credentials:
        """Credentials of the subject: those in the context, else the caller's own."""
        if question.token is None:
            return caller.credentials
        bare = None if operation is None else bare_request(operation, audience=self._audience)
        presented = PresentedRequest(question.token, question.proof, METHOD, self._audience, question.asked)
        return await self._verified(presented, bearer=question.proof is None, lease_ms=self._gate.lease_ms(bare))

    def _denied(
        self, question: Question, credentials: Credentials, reason: Reason, primitive: str, **detail: str
    ) -> Answer:
        return self._undecided(question, credentials, reason, evaluation_answer.denied(reason, primitive, **detail))

    def _undecided(
        self,
        question: Question,
        credentials: Credentials,
        reason: Reason,
        context: Mapping[str, Any],
        *,
        permits: bool = False,
    ) -> Answer:
        """Answer to a question about no request that could be decided."""
        where = {"operation": short(question.operation), "object": short(question.resource)}
        told = {name: context[name] for name in ("primitive", "argument", "detail") if name in context}
        record = records.refusal(
            at=self._clock.wall_s(),
            at_ms=self._clock.monotonic_ms(),
            reason=reason,
            status=200,
            credentials=credentials,
            where={**where, **told},
        )
        return Answer(permits, context, {**record, "effect": context["effect"]})

    async def _recorded(self, answers: list[Answer], common: Mapping[str, object]) -> list[Answer]:
        """The answers, each on record; what is not on record is no answer but DENY [AZN-7]."""
        try:
            await self._gate.record_all("advice", [{**each.record, "asked": dict(common)} for each in answers])
        except JournalError:
            unsaid = evaluation_answer.refused(Reason.RECORD_FAILED)
            return [Answer(permits=False, context=unsaid, record={}) for _ in answers]
        return answers

    async def _refuse(
        self,
        send: Send,
        status: int,
        reason: Reason,
        echoed: Sequence[tuple[bytes, bytes]],
        *,
        where: Mapping[str, object],
        detail: str = "",
        fault: Fault | None = None,
        known: Credentials | None = None,
    ) -> None:
        """Refuses the whole request, on record: no answer with a decision, so that none can be read as one."""
        credentials = known if fault is None else Credentials(None, fault)
        placed = {**where, "detail": detail} if detail else where
        await self._refusals.record(status, reason, credentials=credentials, where=placed)
        title = REASONS[reason].text
        problem = {
            "type": f"urn:ztpm:problem:{reason.value.lower()}",
            "title": title,
            "status": status,
            "code": str(reason),
            "detail": detail or title,
        }
        headers = list(echoed)
        if status == 401:
            kind = "invalid_dpop_proof" if reason.startswith("PROOF") or reason is Reason.REPLAYED else "invalid_token"
            challenge = f'DPoP error="{kind}", error_description="{reason}", algs="{" ".join(ALGORITHMS)}"'
            headers.append((b"www-authenticate", challenge.encode()))
        await answer(send, status, json.dumps(problem).encode(), headers, media=PROBLEM)


def _echoed(headers: Mapping[str, str | None]) -> list[tuple[bytes, bytes]]:
    """The header of the request's id, as it came; none where there is none that can be given back."""
    given = headers.get(REQUEST_ID)
    return [] if given is None or _unfit_id(given) else [(REQUEST_ID.encode(), given.encode("latin-1"))]


def _unfit_id(given: str) -> bool:
    return len(given) > REQUEST_ID_LENGTH or not given.isascii() or not given.isprintable()


def _screened(scope: Scope, headers: Mapping[str, str | None], body: bytes) -> dict[str, Any] | Unfit:
    """The body's one object, of a request with one meaning."""
    if scope["query_string"]:
        return Unfit(Reason.BODY_MALFORMED, "a query where none belongs")
    if REQUEST_ID in headers and ((given := headers[REQUEST_ID]) is None or _unfit_id(given)):
        return Unfit(Reason.BODY_MALFORMED, f"X-Request-ID: one, of at most {REQUEST_ID_LENGTH} ASCII characters")
    media, _, parameters = (headers.get("content-type") or "").partition(";")
    charset = parameters.replace(" ", "").lower()
    if media.strip().lower() != "application/json" or charset not in {"", "charset=utf-8"}:
        return Unfit(Reason.BODY_MALFORMED, "Content-Type: application/json is wanted")
    return screen(body)
