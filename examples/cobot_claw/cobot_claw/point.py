"""The admission point of the four agents, with the guarded tools of the Config agent beside it.

    python -m cobot_claw.point --config point.toml

The host of an agent asks here before anything reaches its model: a person's intent (e1), another agent's message
(e2), documents and memory (e3). Each question is an HTTP request under the agent's own token and proof, to
`/context/...` of the point's origin; the answer is the admitted value with its receipt, or the reason why there is
none. The same process guards the Config agent's tools (e4), so what entered a context is known where it acts.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import tomllib
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final
from urllib.parse import urlsplit

import uvicorn
from mcp.server.mcpserver.exceptions import ToolError
from starlette.requests import Request as HttpRequest
from starlette.responses import JSONResponse, Response

from capabilities.keys.keys import public_raw
from capabilities.statements.context.response import Call as Called
from capabilities.token.token_text import token_from_text
from capabilities.values import strict_json
from capabilities.values.caps import DEFAULT as CAPS
from capabilities.values.chain import Chain
from capabilities.values.errors import CapabilityError, Fault, FaultCode
from cobot_claw.depth import enclosing
from cobot_claw.telemetry import traced, within_trace
from cobot_claw.words import FORMS
from pep.base.errors import PepError
from pep.context import json_value as values
from pep.context import responses
from pep.context.admission import Admission, Admitted, NotAdmitted
from pep.context.flow import Context, Flow, Holder
from pep.context.json_value import Plain
from pep.context.memory import Memory, Written
from pep.context.messages import ConversationBook
from pep.context.retrieval import Curated
from pep.context.stores.sqlite import HighWaterMarkFile, MemoryFile
from pep.journal.replay_cache import ReplayCache
from pep.mcp.http_request import headers_of, token_in
from pep.mcp.provenance import Vouching
from pep.perception.receiver import FrameReceiver
from pep.perception.sensor_frames import Distrusted, Frames, Unseen
from pep.point.config_text import read_key
from pep.point.guard_config import GuardConfig
from pep.point.tool_server import GuardedServer
from pep.request.authority import Credentials, PresentedRequest
from policies.decision.load import load_shipped
from policies.evidence.evidence import NOT_COLLECTED
from policies.words.reason_table import REASONS, Reason

if TYPE_CHECKING:
    from collections.abc import Awaitable, Callable, Mapping, Sequence

    from mcp.server import MCPServer
    from starlette.types import Receive, Scope, Send

    from capabilities.statements.observation import Shape
    from pep.point.deciding_point import DecidingPoint

LEASE_MS: Final = 30_000
"""Oldest acceptable revocation view where nothing moves (DESIGN section 10)."""
BODY_BYTES: Final = 262_144
"""Largest question: a message of 64 kB with a token beside it."""
BODY_DEPTH: Final = 16
PREFIX: Final = "/context/"
CAMERA: Final = "claw-camera"
"""Registered id of the camera for this point."""
FRESH_MS: Final = 500
"""Oldest frame that is a view, as for facts of sensors (docs/guard.md)."""


class QuestionError(ValueError):
    """A question that is malformed; the text names the member."""


@dataclass(frozen=True, slots=True)
class _Known:
    """A fixed map of raw public keys by id: people whose word is an instruction, or curators."""

    keys: Mapping[str, bytes]

    def people(self) -> Mapping[str, bytes]:
        """Raw public key by person."""
        return self.keys

    def curators(self) -> Mapping[str, bytes]:
        """Raw public key by curator."""
        return self.keys


class _Standing:
    """The authority behind each context, as it was last shown, verified anew."""

    def __init__(self, point: ClawPoint) -> None:
        self._point = point
        self.shown: dict[Holder, Credentials] = {}

    def chain(self, context: Context) -> Chain | Fault:
        """The holder's chain as of now."""
        shown = self.shown.get(context.holder, Credentials(None))
        return self._point.authority.standing(shown, lease_ms=LEASE_MS)


@dataclass(frozen=True, slots=True)
class PointConfig:
    """`point.toml`: that of a guard, in its own file, and whose word counts.

    Attributes:
        guard: path of `guard.toml`.
        people, curators: raw public key, in hex, by id.
        store: directory of ChromaDB, with the signed manifest of each collection; "" for no retrieval.
        answering: raw public key of the gateway that vouches for the arm's tools, by its audience.
        approved: digest of the approved definition of each of these tools.
        perception_port: where the camera's frames come in; 0 for no camera.
    """

    guard: Path
    people: Mapping[str, bytes]
    curators: Mapping[str, bytes]
    store: str = ""
    perception_port: int = 0
    answering: Mapping[str, bytes] = field(default_factory=dict)
    approved: Mapping[str, str] = field(default_factory=dict)

    @classmethod
    def read(cls, path: Path) -> PointConfig:
        """The configuration of a file; paths begin at its folder."""
        given = tomllib.loads(path.read_text("utf-8"))

        def keys(name: str) -> dict[str, bytes]:
            return {id_: bytes.fromhex(raw) for id_, raw in given.get(name, {}).items()}

        store = given.get("store", "")
        return cls(
            path.parent / given["guard"],
            keys("people"),
            keys("curators"),
            str(path.parent / store) if store else "",
            given.get("perception_port", 0),
            keys("answering"),
            given.get("approved", {}),
        )


class ClawPoint(GuardedServer):
    """The guarded tool server, and beside it the gate of admission.

    Args:
        server: of the tools.
        guard: of the guard.
        config: of the rest.
    """

    def __init__(self, server: MCPServer[Any], guard: GuardConfig, config: PointConfig) -> None:
        self._guard, self._config = guard, config
        super().__init__(server, guard, vouching=self._vouched)
        parts = urlsplit(guard.audience)
        self._origin = f"{parts.scheme}://{parts.netloc}"
        self._standing = _Standing(self)
        key, folder = read_key(guard), guard.folder
        self._answering = {guard.audience: public_raw(key), **config.answering}
        self._admission = Admission(
            policies=load_shipped("paper-default"),
            clock=self.clock,
            journal=self.journal,
            audience=guard.audience,
            key=key,
            flow=self._flow,
            standing=self._standing,
            people=_Known(config.people),
            forms=FORMS,
            conversations=ConversationBook(self.clock),
            replay=ReplayCache(self.clock),
            caps=CAPS,
        )
        self._admission.recover(self.journal.records())
        marks = HighWaterMarkFile(folder / "marks.json")
        self._memory = Memory(
            MemoryFile(folder / "memory.sqlite"),
            marks=marks,
            key=key,
            audience=guard.audience,
            verifier=self.authority.verifier,
            feed=self.follower,
            clock=self.clock,
            caps=CAPS,
        )
        self._perception_port = config.perception_port
        self._frames = Frames(sensors=self.follower, named=frozenset({CAMERA}), clock=self.clock, caps=CAPS)
        self._receiver = FrameReceiver(self._frames, clock=self.clock, incident=self._frame_incident)
        self._curated: dict[str, Curated] = {}
        if config.store:
            from cobot_claw.knowledge import collections_at

            for content, collection in collections_at(Path(config.store)).items():
                self._curated[content] = Curated(
                    collection.store,
                    name=collection.name,
                    content=content,
                    curators=_Known(config.curators),
                    feed=self.follower,
                    marks=marks,
                    clock=self.clock,
                    caps=CAPS,
                )
                adopted = self._curated[content].adopt((Path(config.store) / f"{content}.jws").read_text("ascii"))
                if isinstance(adopted, Fault):
                    raise QuestionError(f"{content}.jws: {adopted.code}")

    def _vouched(self, point: DecidingPoint) -> Vouching:
        """Provenance of the guarded tools' values: what entered a context here is known where its holder acts."""
        key, audience = read_key(self._guard), self._guard.audience
        self._flow = Flow(point.clock)
        admitters = {audience: public_raw(key), **self._config.answering}
        return Vouching(key=key, audience=audience, admitters=admitters.copy, flow=self._flow, caps=CAPS)

    async def declare(self) -> None:
        """Lets the declared tools be called, and hears the camera."""
        await super().declare()
        if self._perception_port:
            await self._receiver.listen(urlsplit(self._origin).hostname or "127.0.0.1", self._perception_port)

    async def release(self) -> None:
        """Ends the reception, and releases everything."""
        await self._receiver.close()
        await super().release()

    def view(self) -> dict[str, Any]:
        """View of the camera by its newest frame: signed by the registered key, in order, fresh (CII-4's recipe).

        Raises:
            ToolError: the newest frame must not be believed, is too old, or there is none.
        """
        seen, now_ms = self._frames.view(), self.clock.monotonic_ms()
        if isinstance(seen, Distrusted):
            raise ToolError(f"PERCEPTION_INVALID: {seen.rejected.fault}. Nothing is seen.")
        if isinstance(seen, Unseen):
            raise ToolError("PERCEPTION_MISSING: no frame has come. Nothing is seen.")
        (frame,) = seen.frames
        age_ms = frame.age_ms(now_ms)
        if not age_ms <= FRESH_MS:
            raise ToolError(f"PERCEPTION_STALE: the newest frame is {age_ms} ms old. Nothing is seen.")
        scene = frame.observation
        people = [{"id": each.id, **_middle([s for _, s in each.regions])} for each in scene.people]
        objects = [{"id": each.id, "kind": each.kind, **_middle([each.shape])} for each in scene.objects]
        return {"age_ms": age_ms, "people": people, "objects": objects}

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """One ASGI connection, or the life of the whole app."""
        if scope["type"] == "http" and scope["path"].startswith(PREFIX):
            answer = await self._answered(HttpRequest(scope, receive), scope["path"])
            await answer(scope, receive, send)
        else:
            await super().__call__(scope, receive, send)

    async def _answered(self, request: HttpRequest, path: str) -> Response:
        acts: dict[str, Callable[[Credentials, dict[str, Any]], Awaitable[dict[str, object]]]] = {
            f"{PREFIX}{name}": act
            for name, act in (
                ("instruct", self._instruct),
                ("hear", self._hear),
                ("retrieve", self._retrieve),
                ("remember", self._remember),
                ("recall", self._recall),
                ("respond", self._respond),
            )
        }
        act = acts.get(path)
        if request.method != "POST" or act is None:
            return _problem(404, "NOT_FOUND", "there is no such question")
        chunks, size = [], 0
        async for chunk in request.stream():
            size += len(chunk)
            if size > BODY_BYTES:
                return _problem(413, str(Reason.BODY_TOO_LARGE), f"at most {BODY_BYTES} bytes")
            chunks.append(chunk)
        body, headers = b"".join(chunks), headers_of(request.scope)
        shown = PresentedRequest(token_in(headers), headers.get("dpop"), "POST", self._origin + path, body)
        credentials = await asyncio.to_thread(self.authority.check, shown, lease_ms=LEASE_MS)
        chain = credentials.chain
        fault = credentials.fault
        if fault is not None or not isinstance(chain, Chain):
            code = FaultCode.TOKEN_MISSING if fault is None else fault.code
            return _problem(401, str(code), "the token or its proof does not hold")
        try:
            question = _question(body)
            with (
                within_trace(request.headers),
                traced(f"admit {path.removeprefix(PREFIX)}", agent=chain.leaf.agent) as span,
            ):
                self._standing.shown[Holder.of(chain.leaf)] = credentials
                answer = await act(credentials, question)
                span.set_attribute("ztpm.reason", str(answer.get("reason", Reason.PERMITTED)))
                return JSONResponse(answer)
        except CapabilityError as error:
            return _problem(400, str(error.code), "the body is no JSON of ours")
        except QuestionError as error:
            return _problem(400, str(Reason.BODY_MALFORMED), str(error))

    async def _instruct(self, credentials: Credentials, question: dict[str, Any]) -> dict[str, object]:
        text = _text(question, "intent")
        into = self._flow.context(_leaf(credentials))
        return _told(await asyncio.to_thread(self._admission.instruct, text, credentials=credentials, into=into))

    async def _hear(self, credentials: Credentials, question: dict[str, Any]) -> dict[str, object]:
        text, intent = _text(question, "message"), question.get("intent")
        into, by = self._flow.context(_leaf(credentials)), credentials
        if "chain" in question:  # the sender stands below: its own chain has its hop, and its message is the proof
            token = token_from_text(_text(question, "chain"), CAPS)
            chain = token if isinstance(token, Fault) else self.authority.verify(token, lease_ms=LEASE_MS)
            by = Credentials(token if isinstance(token, bytes) else None, chain, NOT_COLLECTED)
        hear = self._admission.hear
        return _told(await asyncio.to_thread(hear, text, credentials=by, into=into, intent=intent))

    async def _retrieve(self, credentials: Credentials, question: dict[str, Any]) -> dict[str, object]:
        query, content = _text(question, "query"), _text(question, "content")
        curated = self._curated.get(content)
        if curated is None:
            raise QuestionError("content: there is no such collection")
        into = self._flow.context(_leaf(credentials))

        def found() -> list[dict[str, object]]:
            retrieval = curated.retrieve(query, most=3, lease_ms=LEASE_MS)
            for incident in retrieval.incidents:
                self.journal.append("incident", {"what": "collection", "fault": incident.fault, "id": incident.id})
            told = []
            for each in retrieval.items:
                judged = self._admission.admit(each.reading, each.text, into=into)
                told.append(_told(judged) | {"id": each.reading.id})
            return told

        items = await asyncio.to_thread(found)
        return {"admitted": True, "items": items}

    async def _respond(self, credentials: Credentials, question: dict[str, Any]) -> dict[str, object]:
        leaf, value = _leaf(credentials), values.plain(question.get("value"))
        if not isinstance(value, Plain):
            raise QuestionError(f"value: {value}")
        text, tool, receipts = _text(question, "response"), _text(question, "tool"), question.get("receipts")
        if not isinstance(receipts, list) or not all(isinstance(each, str) for each in receipts):
            raise QuestionError("receipts: a list of texts")
        proof, request = _text(question, "proof"), _text(question, "request")
        audience = _text(question, "audience")
        reading = responses.read(
            text,
            value,
            call=Called(audience, leaf.agent, leaf.hop_id, proof, request, tool),
            approved=self._approved(audience, tool),
            peps=self._answering,
            receipts=receipts,
            at=self.clock.wall_s(),
            caps=CAPS,
        )
        into = self._flow.context(leaf)
        return _told(await asyncio.to_thread(self._admission.admit, reading, value.value, into=into))

    def _approved(self, audience: str, tool: str) -> str | None:
        """Digest of the approved definition of a tool here, or of one behind the cell's gateway."""
        if audience != self.config.audience:
            return self._config.approved.get(tool)
        registered = self.follower.tool(tool)
        return None if registered is None else registered.definition_digest

    async def _remember(self, credentials: Credentials, question: dict[str, Any]) -> dict[str, object]:
        name, value = _text(question, "name"), values.plain(question.get("value"))
        if not isinstance(value, Plain):
            raise QuestionError(f"value: {value}")
        chain = credentials.chain
        assert isinstance(chain, Chain)
        label = self._flow.label(self._flow.context(chain.leaf))
        written = await asyncio.to_thread(self._memory.remember, name, value, label=label, chain=chain)
        if isinstance(written, Written):
            return {"admitted": True, "sequence": written.sequence}
        return {"admitted": False, "reason": str(getattr(written, "code", written)), "primitive": "TEA-1"}

    async def _recall(self, credentials: Credentials, question: dict[str, Any]) -> dict[str, object]:
        name = _text(question, "name")
        into = self._flow.context(_leaf(credentials))

        def found() -> dict[str, object]:
            recalled = self._memory.recall(name, lease_ms=LEASE_MS)
            value = None if recalled.value is None else recalled.value.value
            return _told(self._admission.admit(recalled.reading, value, into=into))

        return await asyncio.to_thread(found)


def _middle(shapes: Sequence[Shape]) -> dict[str, float]:
    """Middle and top of some shapes, m in the base frame."""
    low, high = enclosing(shapes)
    x, y, z = ((a + b) / 2 for a, b in zip(low, high, strict=True))
    return {"x_m": round(x, 4), "y_m": round(y, 4), "z_m": round(z, 4), "top_m": round(high[2], 4)}


def _question(body: bytes) -> dict[str, Any]:
    question = strict_json.read(body, limit_bytes=BODY_BYTES, limit_depth=BODY_DEPTH)
    if not isinstance(question, dict):
        raise QuestionError("the body is no object")
    return question


def _leaf(credentials: Credentials) -> Any:
    assert isinstance(credentials.chain, Chain)
    return credentials.chain.leaf


def _text(question: dict[str, Any], name: str) -> str:
    found = question.get(name)
    if not isinstance(found, str) or not found:
        raise QuestionError(f"{name}: a text")
    return found


def _told(judged: Admitted | NotAdmitted) -> dict[str, object]:
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


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(prog="python -m cobot_claw.point", description=__doc__)
    parser.add_argument("--config", required=True, type=Path)
    options = parser.parse_args()
    from cobot_claw.config_tools import Profile, config_server
    from cobot_claw.telemetry import begin

    try:
        config = PointConfig.read(options.config)
        guard = GuardConfig.read(config.guard)
    except (OSError, ValueError, KeyError, AttributeError, TypeError, PepError) as error:
        parser.exit(2, f"CONFIG_INVALID: {options.config}: {type(error).__name__}: {error}\n")
    begin("point", guard.folder / "spans.ndjson")
    point: ClawPoint | None = None

    def view() -> dict[str, Any]:
        assert point is not None
        return point.view()

    profile = Profile(guard.folder / "profile.json")
    point = ClawPoint(config_server(profile, view), guard, config)
    parts = urlsplit(guard.audience)
    serve(point, host=parts.hostname or "127.0.0.1", port=parts.port or 80)


def serve(app: Any, *, host: str, port: int) -> None:
    """Serves until SIGINT or SIGTERM, and says on standard output when it is ready."""

    class Told(uvicorn.Server):
        async def startup(self, sockets: Any = None) -> None:
            await super().startup(sockets)
            if self.started:
                print(json.dumps({"ready": True}), flush=True)

    settings = uvicorn.Config(
        app, host=host, port=port, loop="asyncio", ws="none", log_level="warning", access_log=False, server_header=False
    )
    Told(settings).run()


if __name__ == "__main__":
    main()
