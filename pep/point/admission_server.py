"""Server of admission: what may reach an agent (e1 to e3), asked over HTTP, with guarded tools beside it.

The host of an agent asks here before anything reaches its agent. A question is a POST of a JSON object to
`/context/NAME` at the audience's origin, under the agent's own token and proof. The answer is the admitted value with
its receipt, or the reason why there is none. The tools are guarded in the same process, so what entered a context is
known where its holder acts.
"""

from __future__ import annotations

import asyncio
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final
from urllib.parse import urlsplit

from starlette.requests import Request as HttpRequest
from starlette.responses import JSONResponse, Response

from capabilities.keys.keys import public_raw
from capabilities.statements.context.response import Call
from capabilities.token.token_text import token_from_text
from capabilities.values import strict_json
from capabilities.values.caps import DEFAULT as CAPS
from capabilities.values.chain import Chain
from capabilities.values.errors import Fault, FaultCode
from pep.context import json_value as values
from pep.context import responses
from pep.context.admission import Admission, Admitted, NotAdmitted
from pep.context.flow import Context, Flow, Holder
from pep.context.json_value import Plain
from pep.context.memory import Memory, Written
from pep.context.messages import ConversationBook
from pep.context.retrieval import Curated
from pep.journal.replay_cache import ReplayCache
from pep.mcp.http_request import headers_of, token_in
from pep.mcp.provenance import Vouching
from pep.point.config_text import read_key
from pep.point.tool_server import GuardedServer
from pep.request.authority import Credentials, PresentedRequest
from policies.decision.load import load_shipped
from policies.evidence.evidence import NOT_COLLECTED
from policies.words.reason_table import REASONS, Reason

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from starlette.types import Receive, Scope, Send

    from capabilities.values.chain import Hop
    from pep.context.collection import Collection
    from pep.context.forms import Forms
    from pep.context.high_water_marks import HighWaterMarks
    from pep.context.memory_rows import MemoryRows
    from pep.mcp.guard import AnyServer
    from pep.point.deciding_point import DecidingPoint
    from pep.point.guard_config import GuardConfig

LEASE_MS: Final = 30_000
"""Oldest acceptable view of revocations where nothing moves (DESIGN section 10)."""
BODY_BYTES: Final = 262_144
"""Largest question: a message of 64 kB with a token beside it."""
BODY_DEPTH: Final = 16
MOST: Final = 3
"""Most contents of one retrieval."""
PREFIX: Final = "/context/"

Question = dict[str, Any]
Answer = dict[str, object]


class QuestionError(ValueError):
    """Question that is malformed; the text names the member."""


@dataclass(frozen=True, slots=True)
class KnownKeys:
    """Raw public key by id: of people whose word is an instruction, or of curators."""

    keys: Mapping[str, bytes]

    def people(self) -> Mapping[str, bytes]:
        """Raw public key by person."""
        return self.keys

    def curators(self) -> Mapping[str, bytes]:
        """Raw public key by curator."""
        return self.keys


class _Standing:
    """Authority behind each context as it was last shown, verified anew at each question."""

    def __init__(self, point: AdmissionServer) -> None:
        self._point = point
        self.shown: dict[Holder, Credentials] = {}

    def chain(self, context: Context) -> Chain | Fault:
        """The holder's chain as of now."""
        shown = self.shown.get(context.holder, Credentials(None))
        return self._point.authority.standing(shown, lease_ms=LEASE_MS)


class AdmissionServer(GuardedServer):
    """ASGI app of an admission point with a guarded tool server.

    Args:
        server: of the tools.
        guard: configuration of the guard.
        people: raw public key of each person whose word is an instruction.
        curators: raw public key of each curator.
        forms: of the words that people and agents say here.
        memory: store of what agents remember; it is not trusted.
        marks: the newest row and manifests that were ever seen, over restarts; nothing else writes there.
        answering: raw public key of each other enforcement point whose word for an answer counts, by its audience.

    Raises:
        PepError: as of `guard`.
    """

    def __init__(
        self,
        server: AnyServer,
        guard: GuardConfig,
        *,
        people: Mapping[str, bytes],
        curators: Mapping[str, bytes],
        forms: Forms,
        memory: MemoryRows,
        marks: HighWaterMarks,
        answering: Mapping[str, bytes] | None = None,
    ) -> None:
        self._key, self._curators = read_key(guard), KnownKeys(curators)
        self._answering = {guard.audience: public_raw(self._key), **(answering or {})}
        super().__init__(server, guard, vouching=self._vouched)
        parts = urlsplit(guard.audience)
        self._origin = f"{parts.scheme}://{parts.netloc}"
        self._standing, self._marks = _Standing(self), marks
        self._collections: dict[str, Curated] = {}
        self._admission = Admission(
            policies=load_shipped("paper-default"),
            clock=self.clock,
            journal=self.journal,
            audience=guard.audience,
            key=self._key,
            flow=self._flow,
            standing=self._standing,
            people=KnownKeys(people),
            forms=forms,
            conversations=ConversationBook(self.clock),
            replay=ReplayCache(self.clock),
            caps=CAPS,
        )
        self._admission.recover(self.journal.records())
        self._memory = Memory(
            memory,
            marks=marks,
            key=self._key,
            audience=guard.audience,
            verifier=self.authority.verifier,
            feed=self.follower,
            clock=self.clock,
            caps=CAPS,
        )

        self._acts: dict[str, Callable[[Credentials, Question], Answer]] = {
            "instruct": self._instruct,
            "hear": self._hear,
            "retrieve": self._retrieve,
            "remember": self._remember,
            "recall": self._recall,
            "respond": self._respond,
        }

    def _vouched(self, point: DecidingPoint) -> Vouching:
        """Provenance of the tools' values: what entered a context here is known where its holder acts."""
        self._flow = Flow(point.clock)
        return Vouching(
            key=self._key,
            audience=point.config.audience,
            admitters=self._answering.copy,
            flow=self._flow,
            caps=CAPS,
        )

    def curate(self, name: str, content: str, store: Collection, manifest: str = "") -> Fault | None:
        """Lets a collection be retrieved from, or adopts a newer manifest of it; the fault of a refused manifest.

        A collection without an adopted manifest gives nothing; one whose newer manifest was refused, what the earlier
        one lists.

        Args:
            name: of the collection.
            content: kind of content that it has.
            store: of the contents; it is not trusted.
            manifest: signed by a curator; empty for none as yet.
        """
        curated = self._collections.get(name)
        if curated is None:
            curated = self._collections[name] = Curated(
                store,
                name=name,
                content=content,
                curators=self._curators,
                feed=self.follower,
                marks=self._marks,
                clock=self.clock,
                caps=CAPS,
            )
        adopted = curated.adopt(manifest) if manifest else None
        if not isinstance(adopted, Fault):
            return None
        self.journal.append("incident", {"what": "manifest", "fault": str(adopted.code), "id": name})
        return adopted

    def collection(self, name: str) -> Curated:
        """Collection that is asked for.

        Raises:
            QuestionError: there is none of that name.
        """
        if name not in self._collections:
            raise QuestionError("collection: there is none of that name")
        return self._collections[name]

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """One ASGI connection, or the life of the whole app."""
        if scope["type"] == "http" and scope["path"].startswith(PREFIX):
            answer = await self._answered(HttpRequest(scope, receive), scope["path"])
            await answer(scope, receive, send)
        else:
            await super().__call__(scope, receive, send)

    async def _answered(self, request: HttpRequest, path: str) -> Response:
        name = path.removeprefix(PREFIX)
        if request.method != "POST" or name not in self._acts:
            return _problem(404, "NOT_FOUND", f"there is no such question; ask by POST for {', '.join(self._acts)}")
        body = bytearray()
        async for chunk in request.stream():
            body += chunk
            if len(body) > BODY_BYTES:
                return _problem(413, str(Reason.BODY_TOO_LARGE), f"at most {BODY_BYTES} bytes")
        headers = headers_of(request.scope)
        shown = PresentedRequest(token_in(headers), headers.get("dpop"), "POST", self._origin + path, bytes(body))
        credentials = await asyncio.to_thread(self.authority.check, shown, lease_ms=LEASE_MS)
        if credentials.fault is not None or not isinstance(credentials.chain, Chain):
            code = FaultCode.TOKEN_MISSING if credentials.fault is None else credentials.fault.code
            return _problem(401, str(code), "the token or its proof does not hold")
        self._standing.shown[Holder.of(credentials.chain.leaf)] = credentials
        try:
            return JSONResponse(await self.answer(name, credentials, _question(bytes(body)), request.headers))
        except QuestionError as error:
            return _problem(400, str(Reason.BODY_MALFORMED), str(error))

    async def answer(
        self,
        name: str,
        credentials: Credentials,
        question: Question,
        headers: Mapping[str, str],  # noqa: ARG002 - for spans of a trace, around this
    ) -> Answer:
        """Answer to a question whose token and proof hold.

        Args:
            name: of the question.
            credentials: of the agent.
            question: its members.
            headers: of the request.

        Raises:
            QuestionError: a member is malformed.
        """
        return await asyncio.to_thread(self._acts[name], credentials, question)

    # --- the questions -----------------------------------------------------------------------------------------------

    def _instruct(self, credentials: Credentials, question: Question) -> Answer:
        into = self._own(credentials)
        return _told(self._admission.instruct(_text(question, "intent"), credentials=credentials, into=into))

    def _hear(self, credentials: Credentials, question: Question) -> Answer:
        into, by = self._own(credentials), credentials
        if "chain" in question:  # the sender's own chain has its hop, and its message is the proof
            token = token_from_text(_text(question, "chain"), CAPS)
            chain = token if isinstance(token, Fault) else self.authority.verify(token, lease_ms=LEASE_MS)
            by = Credentials(token if isinstance(token, bytes) else None, chain, NOT_COLLECTED)
        intent = _text(question, "intent") if question.get("intent") is not None else None
        return _told(self._admission.hear(_text(question, "message"), credentials=by, into=into, intent=intent))

    def _retrieve(self, credentials: Credentials, question: Question) -> Answer:
        into, curated = self._own(credentials), self.collection(_text(question, "collection"))
        retrieval = curated.retrieve(_text(question, "query"), most=MOST, lease_ms=LEASE_MS)
        for incident in retrieval.incidents:
            self.journal.append("incident", {"what": "collection", "fault": incident.fault, "id": incident.id})
        items = [
            _told(self._admission.admit(each.reading, each.text, into=into)) | {"id": each.reading.id}
            for each in retrieval.items
        ]
        return {"admitted": True, "items": items}

    def _remember(self, credentials: Credentials, question: Question) -> Answer:
        chain = credentials.chain
        assert isinstance(chain, Chain)
        label = self._flow.label(self._own(credentials))
        written = self._memory.remember(_text(question, "name"), _plain(question), label=label, chain=chain)
        if isinstance(written, Written):
            return {"admitted": True, "sequence": written.sequence}
        return {"admitted": False, "reason": str(getattr(written, "code", written)), "primitive": "TEA-1"}

    def _recall(self, credentials: Credentials, question: Question) -> Answer:
        recalled = self._memory.recall(_text(question, "name"), lease_ms=LEASE_MS)
        value = None if recalled.value is None else recalled.value.value
        return _told(self._admission.admit(recalled.reading, value, into=self._own(credentials)))

    def _respond(self, credentials: Credentials, question: Question) -> Answer:
        leaf, tool, value = _leaf(credentials), _text(question, "tool"), _plain(question)
        audience = _text(question, "audience") if "audience" in question else self.config.audience
        receipts = question.get("receipts", [])
        if not isinstance(receipts, list) or not all(isinstance(each, str) for each in receipts):
            raise QuestionError("receipts: a list of texts")
        registered = self.follower.tool(tool)
        reading = responses.read(
            _text(question, "response"),
            value,
            call=Call(audience, leaf.agent, leaf.hop_id, _text(question, "proof"), _text(question, "request"), tool),
            approved=None if registered is None else registered.definition_digest,
            peps=self._answering,
            receipts=receipts,
            at=self.clock.wall_s(),
            caps=CAPS,
        )
        return _told(self._admission.admit(reading, value.value, into=self._own(credentials)))

    def _own(self, credentials: Credentials) -> Context:
        return self._flow.context(_leaf(credentials))


def _question(body: bytes) -> Question:
    try:
        question = strict_json.read(body, limit_bytes=BODY_BYTES, limit_depth=BODY_DEPTH)
    except strict_json.JsonError as error:
        raise QuestionError(f"the body: {error}") from error
    if not isinstance(question, dict):
        raise QuestionError("the body is no object")
    return question


def _leaf(credentials: Credentials) -> Hop:
    assert isinstance(credentials.chain, Chain)
    return credentials.chain.leaf


def _text(question: Question, name: str) -> str:
    found = question.get(name)
    if not isinstance(found, str) or not found:
        raise QuestionError(f"{name}: a text")
    return found


def _plain(question: Question) -> Plain:
    value = values.plain(question.get("value"))
    if not isinstance(value, Plain):
        raise QuestionError(f"value: {value}")
    return value


def _told(judged: Admitted | NotAdmitted) -> Answer:
    if isinstance(judged, Admitted):
        label = judged.label
        return {
            "admitted": True,
            "value": judged.value,
            "receipt": judged.receipt,
            "label": {"integrity": str(label.integrity.name).lower(), "tainted": label.tainted},
        }
    decision = judged.decision
    return {
        "admitted": False,
        "reason": str(decision.reason),
        "primitive": decision.primitive,
        "remedy": REASONS[decision.reason].remedy,
    }


def _problem(status: int, code: str, detail: str) -> Response:
    """A refusal in the form of RFC 9457."""
    body = {"type": f"urn:ztpm:{code}", "title": code, "status": status, "detail": detail, "code": code}
    return JSONResponse(body, status_code=status, media_type="application/problem+json")
