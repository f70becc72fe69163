"""Admission point of the arena, in its own process, with the guarded tools beside it.

    python -m evaluation.redteam.admission.point --config point.toml

An agent's host asks here before anything reaches its agent: each question is a POST to `/context/NAME` under the
agent's own token and proof. The answer is the admitted value, or the reason why there is none. The tools are guarded in
the same process, so a taint that entered a context here is known where its holder acts.
"""

from __future__ import annotations

import argparse
import asyncio
import re
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final
from urllib.parse import urlsplit

import uvicorn
from starlette.requests import Request as HttpRequest
from starlette.responses import JSONResponse, Response

from capabilities.keys.keys import public_raw
from capabilities.statements.context.response import Call
from capabilities.token.token_text import token_from_text
from capabilities.values import strict_json
from capabilities.values.caps import DEFAULT as CAPS
from capabilities.values.chain import Chain
from capabilities.values.errors import CapabilityError, Fault, FaultCode
from evaluation.harness.announcing import Announcing
from evaluation.redteam.admission.shelves import MemoryFolder, Shelf
from evaluation.redteam.admission.tools import notes_server
from evaluation.redteam.admission.words import FORMS
from pep.context import json_value as values
from pep.context import responses
from pep.context.admission import Admission, Admitted, NotAdmitted
from pep.context.flow import Context, Flow, Holder
from pep.context.json_value import Plain
from pep.context.memory import Memory, Written
from pep.context.messages import ConversationBook
from pep.context.retrieval import Curated
from pep.context.stores.sqlite import HighWaterMarkFile
from pep.journal.replay_cache import ReplayCache
from pep.mcp.http_request import headers_of, token_in
from pep.mcp.provenance import Vouching
from pep.point.config_text import read_key
from pep.point.guard_config import GuardConfig
from pep.point.tool_server import GuardedServer
from pep.request.authority import Credentials, PresentedRequest
from policies.decision.load import load_shipped
from policies.evidence.evidence import NOT_COLLECTED
from policies.words.reason_table import Reason

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

    from starlette.types import Receive, Scope, Send

    from pep.point.deciding_point import DecidingPoint

LEASE_MS: Final = 30_000
"""Oldest acceptable revocation view where nothing moves."""
BODY_BYTES: Final = 262_144
BODY_DEPTH: Final = 16
MOST: Final = 3
"""Most contents of one retrieval."""
PREFIX: Final = "/context/"
SHELVES: Final = "shelves"
MEMORY: Final = "memory"
CONTENT_OF: Final = {"handbook": "document", "library": "scenario"}
"""Kind of content by the beginning of a collection's name."""
_COLLECTION: Final = re.compile(r"(handbook|library)-[0-9]{1,9}")


class QuestionError(ValueError):
    """A question that is malformed; the text names the member."""


@dataclass(frozen=True, slots=True)
class Known:
    """Raw public key by id: people whose word is an instruction, or curators."""

    keys: Mapping[str, bytes]

    def people(self) -> Mapping[str, bytes]:
        """Raw public key by person."""
        return self.keys

    def curators(self) -> Mapping[str, bytes]:
        """Raw public key by curator."""
        return self.keys


class PointStanding:
    """Authority behind each context as it was last shown, verified anew at each question.

    Args:
        point: that verifies.
    """

    def __init__(self, point: AdmissionPoint) -> None:
        self._point = point
        self.shown: dict[Holder, Credentials] = {}

    def chain(self, context: Context) -> Chain | Fault:
        """The holder's chain as of now."""
        shown = self.shown.get(context.holder, Credentials(None))
        return self._point.authority.standing(shown, lease_ms=LEASE_MS)


class AdmissionPoint(GuardedServer):
    """The guarded tools, and the gate of admission beside them.

    Args:
        guard: configuration of the guard.
        people, curators: raw public key by id.
    """

    def __init__(self, guard: GuardConfig, *, people: Mapping[str, bytes], curators: Mapping[str, bytes]) -> None:
        self._key, self._curators, self._folder = read_key(guard), Known(curators), guard.folder
        super().__init__(notes_server(guard.folder), guard, vouching=self._vouched)
        parts = urlsplit(guard.audience)
        self._origin = f"{parts.scheme}://{parts.netloc}"
        self._standing = PointStanding(self)
        self._marks = HighWaterMarkFile(guard.folder / "marks.json")
        self._collections: dict[str, Curated] = {}
        self._adopted: dict[str, str] = {}
        self._admission = Admission(
            policies=load_shipped("paper-default"),
            clock=self.clock,
            journal=self.journal,
            audience=guard.audience,
            key=self._key,
            flow=self._flow,
            standing=self._standing,
            people=Known(people),
            forms=FORMS,
            conversations=ConversationBook(self.clock),
            replay=ReplayCache(self.clock),
            caps=CAPS,
        )
        self._admission.recover(self.journal.records())
        self._memory = Memory(
            MemoryFolder(guard.folder / MEMORY),
            marks=self._marks,
            key=self._key,
            audience=guard.audience,
            verifier=self.authority.verifier,
            feed=self.follower,
            clock=self.clock,
            caps=CAPS,
        )

    def _vouched(self, point: DecidingPoint) -> Vouching:
        """Provenance of the tools' values: a context that grew here is known where its holder acts."""
        self._flow = Flow(point.clock)
        audience = point.config.audience
        own = {audience: public_raw(self._key)}
        return Vouching(key=self._key, audience=audience, admitters=own.copy, flow=self._flow, caps=CAPS)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """One ASGI connection, or the life of the whole app."""
        if scope["type"] == "http" and scope["path"].startswith(PREFIX):
            answer = await self._answered(HttpRequest(scope, receive), scope["path"])
            await answer(scope, receive, send)
        else:
            await super().__call__(scope, receive, send)

    async def _answered(self, request: HttpRequest, path: str) -> Response:
        acts: dict[str, Callable[[Credentials, dict[str, Any]], dict[str, object]]] = {
            "instruct": self._instruct,
            "hear": self._hear,
            "retrieve": self._retrieve,
            "remember": self._remember,
            "recall": self._recall,
            "respond": self._respond,
        }
        act = acts.get(path.removeprefix(PREFIX))
        body = await request.body()
        if request.method != "POST" or act is None or len(body) > BODY_BYTES:
            return _problem(404, "NOT_FOUND", "there is no such question")
        headers = headers_of(request.scope)
        shown = PresentedRequest(token_in(headers), headers.get("dpop"), "POST", self._origin + path, body)
        credentials = await asyncio.to_thread(self.authority.check, shown, lease_ms=LEASE_MS)
        if credentials.fault is not None or not isinstance(credentials.chain, Chain):
            code = FaultCode.TOKEN_MISSING if credentials.fault is None else credentials.fault.code
            return _problem(401, str(code), "the token or its proof does not hold")
        self._standing.shown[Holder.of(credentials.chain.leaf)] = credentials
        try:
            return JSONResponse(await asyncio.to_thread(act, credentials, _question(body)))
        except CapabilityError as error:
            return _problem(400, str(error.code), "the body is no JSON of ours")
        except QuestionError as error:
            return _problem(400, str(Reason.BODY_MALFORMED), str(error))

    # --- the questions -----------------------------------------------------------------------------------------------

    def _instruct(self, credentials: Credentials, question: dict[str, Any]) -> dict[str, object]:
        into = self._own(credentials)
        return _told(self._admission.instruct(_text(question, "intent"), credentials=credentials, into=into))

    def _hear(self, credentials: Credentials, question: dict[str, Any]) -> dict[str, object]:
        into, by = self._own(credentials), credentials
        if "chain" in question:  # the sender's own chain has its hop, and its message is the proof
            token = token_from_text(_text(question, "chain"), CAPS)
            chain = token if isinstance(token, Fault) else self.authority.verify(token, lease_ms=LEASE_MS)
            by = Credentials(token if isinstance(token, bytes) else None, chain, NOT_COLLECTED)
        return _told(self._admission.hear(_text(question, "message"), credentials=by, into=into))

    def _retrieve(self, credentials: Credentials, question: dict[str, Any]) -> dict[str, object]:
        into, curated = self._own(credentials), self._collection(_text(question, "collection"))
        retrieval = curated.retrieve(_text(question, "query"), most=MOST, lease_ms=LEASE_MS)
        for incident in retrieval.incidents:
            self.journal.append("incident", {"what": "collection", "fault": incident.fault, "id": incident.id})
        items = [
            _told(self._admission.admit(each.reading, each.text, into=into)) | {"id": each.reading.id}
            for each in retrieval.items
        ]
        return {"admitted": True, "items": items}

    def _remember(self, credentials: Credentials, question: dict[str, Any]) -> dict[str, object]:
        chain = credentials.chain
        assert isinstance(chain, Chain)
        label = self._flow.label(self._own(credentials))
        written = self._memory.remember(_text(question, "name"), _plain(question), label=label, chain=chain)
        if isinstance(written, Written):
            return {"admitted": True, "sequence": written.sequence}
        return {"admitted": False, "reason": str(getattr(written, "code", written)), "primitive": "TEA-1"}

    def _recall(self, credentials: Credentials, question: dict[str, Any]) -> dict[str, object]:
        recalled = self._memory.recall(_text(question, "name"), lease_ms=LEASE_MS)
        value = None if recalled.value is None else recalled.value.value
        return _told(self._admission.admit(recalled.reading, value, into=self._own(credentials)))

    def _respond(self, credentials: Credentials, question: dict[str, Any]) -> dict[str, object]:
        leaf, tool, value = _leaf(credentials), _text(question, "tool"), _plain(question)
        audience = self.config.audience
        registered = self.follower.tool(tool)
        reading = responses.read(
            _text(question, "response"),
            value,
            call=Call(audience, leaf.agent, leaf.hop_id, _text(question, "proof"), _text(question, "request"), tool),
            approved=None if registered is None else registered.definition_digest,
            peps={audience: public_raw(self._key)},
            at=self.clock.wall_s(),
            caps=CAPS,
        )
        return _told(self._admission.admit(reading, value.value, into=self._own(credentials)))

    # --- the parts ---------------------------------------------------------------------------------------------------

    def _own(self, credentials: Credentials) -> Context:
        return self._flow.context(_leaf(credentials))

    def _collection(self, name: str) -> Curated:
        """The collection, with its manifest as it lies there now adopted or refused."""
        found = _COLLECTION.fullmatch(name)
        if found is None:
            raise QuestionError("collection: there is none of that name")
        shelf = Shelf(self._folder / SHELVES / name)
        if name not in self._collections:
            self._collections[name] = Curated(
                shelf,
                name=name,
                content=CONTENT_OF[found[1]],
                curators=self._curators,
                feed=self.follower,
                marks=self._marks,
                clock=self.clock,
                caps=CAPS,
            )
        signed = shelf.manifest
        if signed and self._adopted.get(name) != signed:
            adopted = self._collections[name].adopt(signed)
            self._adopted[name] = signed
            if isinstance(adopted, Fault):
                self.journal.append("incident", {"what": "manifest", "fault": str(adopted.code), "id": name})
        return self._collections[name]


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


def _plain(question: dict[str, Any]) -> Plain:
    value = values.plain(question.get("value"))
    if not isinstance(value, Plain):
        raise QuestionError(f"value: {value}")
    return value


def _told(judged: Admitted | NotAdmitted) -> dict[str, object]:
    if isinstance(judged, Admitted):
        return {"admitted": True, "value": judged.value, "tainted": judged.label.tainted}
    return {"admitted": False, "reason": str(judged.decision.reason), "primitive": judged.decision.primitive}


def _problem(status: int, code: str, detail: str) -> Response:
    """A refusal in the form of RFC 9457."""
    body = {"type": f"urn:ztpm:{code}", "title": code, "status": status, "detail": detail, "code": code}
    return JSONResponse(body, status_code=status, media_type="application/problem+json")


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(prog="python -m evaluation.redteam.admission.point", description=__doc__)
    parser.add_argument("--config", required=True, type=Path)
    path = parser.parse_args().config
    given = tomllib.loads(path.read_text("utf-8"))
    known = {name: {id_: bytes.fromhex(raw) for id_, raw in given[name].items()} for name in ("people", "curators")}
    point = AdmissionPoint(GuardConfig.read(path.parent / given["guard"]), **known)

    parts = urlsplit(point.config.audience)
    settings = uvicorn.Config(
        point,
        host=parts.hostname or "127.0.0.1",
        port=parts.port or 80,
        loop="asyncio",
        ws="none",
        log_level="warning",
        access_log=False,
        server_header=False,
    )
    Announcing(settings).run()


if __name__ == "__main__":
    main()
