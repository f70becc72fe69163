"""One of the four agents, a process with a key of its own.

    python -m cobot_claw.agent --config robotic.json

It answers two questions over HTTP: `/evidence`, fresh evidence for a party that would lend to it, and `/work`, a task.
A task is a signed message of the agent that lent (or, for the orchestrator, a person's signed intent); its words reach
the model only as the admission point gave them back.
"""

from __future__ import annotations

import argparse
import asyncio
import hashlib
import json
import secrets
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

import httpx2
import rfc8785
from pydantic_ai import Agent as ModelAgent
from pydantic_ai import ToolFailed
from pydantic_ai.models.instrumented import InstrumentationSettings
from starlette.applications import Starlette
from starlette.responses import JSONResponse, Response
from starlette.routing import Route

from capabilities.keys.trust import TrustBundle
from capabilities.statements.context import message as message_statement
from capabilities.token.token_text import token_from_text
from capabilities.token.verify import inspect_token
from capabilities.values.caps import DEFAULT as CAPS
from capabilities.values.errors import CapabilityError
from cobot_claw import roles
from cobot_claw.asking import Admissions
from cobot_claw.config_tools import rows
from cobot_claw.errors import ClawError
from cobot_claw.models import model_for, stated
from cobot_claw.point import serve
from cobot_claw.task import Work, guarded_tools, run
from cobot_claw.telemetry import begin, carried, traced, within_trace
from cobot_claw.witness import Witness
from cobot_claw.words import REPORT, TASK, TEXT_LENGTH, in_short
from pep.base.key_file import read_key
from pep.mcp.mapping import ARM_TOOLS
from ztpm_idp.client import Agent, ClientError
from ztpm_idp.client.callers import Evidence, delegate_request

if TYPE_CHECKING:
    from starlette.requests import Request as HttpRequest

    from capabilities.keys.keys import PrivateKey

TASK_S: Final = 240.0
"""Longest time of one task: some motions, and people who are asked."""
MESSAGE_S: Final = 60
"""Life of a message between agents: `message_age_s` of the policy set."""


def measurement() -> bytes:
    """SHA-256 over the software of the agents: every module of this package, by name."""
    digest = hashlib.sha256()
    for path in sorted(Path(__file__).parent.glob("*.py")):
        digest.update(f"{path.name}\0".encode() + hashlib.sha256(path.read_bytes()).digest())
    return digest.digest()


@dataclass(frozen=True, slots=True)
class AgentConfig:
    """An agent's own configuration.

    Attributes:
        id, role: as registered.
        key_file: its key, encrypted; the passphrase is in `ZTPM_PASSPHRASE`.
        issuer: of the identity provider.
        trust_file: its public trust bundle.
        host, port: where it answers.
        point: canonical URL of the admission point and the tools beside it.
        cell: canonical URL of the arm's tools.
        peers: URL and id of each other agent, by role.
        spans: file of its spans.
    """

    id: str
    role: str
    key_file: str
    issuer: str
    trust_file: str
    host: str
    port: int
    point: str
    cell: str
    spans: str
    peers: dict[str, dict[str, str]] = field(default_factory=dict)


class Holder:
    """An agent: its key, its place among the others, its model.

    Args:
        config: its own.
        key: its own.
    """

    def __init__(self, config: AgentConfig, key: PrivateKey) -> None:
        self.config = config
        self.role = roles.OF[config.role]
        self.agent = Agent(config.id, key, config.issuer, measurement())
        self._trust = TrustBundle.from_json(Path(config.trust_file).read_bytes())
        self.model = model_for(config.role, stated())

    # --- the two questions -------------------------------------------------------------------------------------------

    async def evidence(self, request: HttpRequest) -> Response:
        """Fresh evidence for exactly this delegator and request, which must be about this agent."""
        asked = await _body(request)
        wanted, delegator = asked.get("request"), asked.get("delegator")
        if not isinstance(wanted, dict) or not isinstance(delegator, str):
            return _problem(400, "BODY_MALFORMED", "delegator and request")
        if self.config.id not in (wanted.get("delegate"), wanted.get("agent")):
            return _problem(400, "BODY_MALFORMED", f"the request is not about {self.config.id}")
        try:
            return JSONResponse({"evidence": await asyncio.to_thread(self.agent.evidence, delegator, wanted)})
        except ClientError as error:
            return _problem(502, error.code, error.detail)

    async def work(self, request: HttpRequest) -> Response:
        """The task is carried out; the answer is a signed report (for a person, its body)."""
        asked = await _body(request)
        token, intent = asked.get("token"), asked.get("intent")
        message = asked.get("message")
        if (
            not isinstance(token, str)
            or not isinstance(intent, str)
            or (message is not None and not isinstance(message, str))
        ):
            return _problem(400, "BODY_MALFORMED", "token, intent and message")
        with within_trace(request.headers), traced(f"work of {self.config.role}", agent=self.config.id) as span:
            report = await self._report(token, intent, message)
            span.set_attribute("claw.done", report["done"])
        told: dict[str, object] = {"report": report}
        if message is not None:
            told |= {"token": token, "message": self.say(token, message, REPORT, report)}
        return JSONResponse(told)

    async def _report(self, token: str, intent: str, message: str | None) -> dict[str, Any]:
        work = Work(self, token, intent, Admissions(self.agent, token, self.config.point))
        try:
            async with asyncio.timeout(TASK_S):
                if message is None:
                    said = await work.admissions.admitted("instruct", intent=intent)
                else:
                    said = await work.admissions.admitted("hear", message=message, intent=intent)
                text = await self._run(work, said["text"])
            return {"done": work.done, "text": text[:TEXT_LENGTH]}
        except ClawError as error:
            return {"done": False, "text": str(error)[:TEXT_LENGTH]}
        except TimeoutError:
            return {
                "done": False,
                "text": str(ClawError("AGENT_LOOPS", f"{self.config.role}: no end after {TASK_S:.0f} s.")),
            }

    async def _run(self, work: Work, text: str) -> str:
        toolsets = [
            guarded_tools(self.agent.auth(work.token), url, witness)
            for url, used, witness in (
                (self.config.cell, self.role.cell, Witness(self.agent.key, self.config.cell, ARM_TOOLS)),
                (self.config.point, self.role.point, Witness(self.agent.key, self.config.point, rows())),
            )
            if used
        ]
        return await run(self.model, self.config.role, text, work=work, toolsets=toolsets)

    # --- what it says and lends --------------------------------------------------------------------------------------

    def say(self, token: str, answered: str, schema: str, body: dict[str, Any], *, to: str | None = None) -> str:
        """A signed message under this agent's hop: to `to`, or back to who said `answered`."""
        raw = token_from_text(token, CAPS)
        if not isinstance(raw, bytes):
            raise ClawError("NOT_LENT", f"{self.config.role}: a token that is none.")
        described: Any = inspect_token(raw, self._trust, CAPS)
        hops = described["hops"]
        own = next(hop for hop in hops if hop["agent"] == self.config.id)
        addressee = to or next(hop["agent"] for before, hop in zip(hops[1:], hops, strict=False) if before is own)
        now = int(time.time())
        said = message_statement.Message(
            sender=self.config.id,
            addressee=addressee,
            token_id=described["token_id"],
            hop_id=own["hop_id"],
            conversation=secrets.token_urlsafe(18),
            sequence=1,
            in_reply_to=hashlib.sha256(answered.encode()).hexdigest() if answered else "",
            schema=schema,
            body=rfc8785.dumps(body),
            at=now,
            not_after=now + MESSAGE_S,
        )
        return message_statement.sign(said, self.agent.key)

    async def hand_on(self, work: Work, role: str, task: str) -> str:
        """Another agent's report of a task, under what it is lent for it.

        Raises:
            ToolFailed: it was not lent, not done, or must not be heard; the model is told which.
        """
        peer, needed = self.config.peers[role], roles.OF[role]
        purpose = in_short(task)
        with traced(f"hand on to {role}"):
            request = delegate_request(peer["id"], needed.restriction, purpose=purpose)
            evidence = (await self._post(role, "evidence", {"delegator": self.config.id, "request": request}))[
                "evidence"
            ]
            try:
                lent = await asyncio.to_thread(
                    self.agent.delegate,
                    work.token,
                    Evidence(peer["id"], evidence),
                    needed.restriction,
                    purpose=purpose,
                )
            except ClientError as error:
                raise ClawError("NOT_LENT", f"{role}: {error.code}.") from error
            message = self.say(work.token, "", TASK, {"text": task, "needs": list(needed.needs)}, to=peer["id"])
            told = await self._post(role, "work", {"token": lent.token, "intent": work.intent, "message": message})
            report = await work.admissions.admitted("hear", message=told["message"], chain=told["token"])
        if not report["done"]:
            work.refusals.append(report["text"])
            raise ToolFailed(report["text"])
        return str(report["text"])

    async def _post(self, role: str, path: str, body: dict[str, object]) -> dict[str, Any]:
        url = f"{self.config.peers[role]['url']}/{path}"
        try:
            async with httpx2.AsyncClient(timeout=TASK_S + 10.0, trust_env=False) as http:
                answer = await http.post(url, json=body, headers=carried())
                told = answer.json()
        except (httpx2.HTTPError, ValueError) as error:
            raise ClawError("AGENT_UNREACHABLE", f"{role}: {type(error).__name__}.") from error
        if answer.status_code != 200 or not isinstance(told, dict):
            raise ClawError("NOT_LENT", f"{role}: {told.get('code')} ({told.get('detail')}).")
        return told


async def _body(request: HttpRequest) -> dict[str, Any]:
    try:
        found = json.loads(await request.body())
    except ValueError:
        return {}
    return found if isinstance(found, dict) else {}


def _problem(status: int, code: str, detail: str) -> Response:
    """A refusal in the form of RFC 9457."""
    body = {"type": f"urn:ztpm:{code}", "title": code, "status": status, "detail": detail, "code": code}
    return JSONResponse(body, status_code=status, media_type="application/problem+json")


def main() -> None:
    """The command line."""
    parser = argparse.ArgumentParser(prog="python -m cobot_claw.agent", description=__doc__)
    parser.add_argument("--config", required=True, type=Path)
    options = parser.parse_args()
    config = AgentConfig(**json.loads(options.config.read_text("utf-8")))
    begin(config.role, Path(config.spans))
    ModelAgent.instrument_all(InstrumentationSettings(include_content=True))
    try:
        holder = Holder(config, read_key(Path(config.key_file), name="key_file"))
        holder.agent.attest()
    except (ClawError, CapabilityError, ClientError) as error:
        parser.exit(1, f"{error}\n")
    app = Starlette(
        routes=[
            Route("/evidence", holder.evidence, methods=["POST"]),
            Route("/work", holder.work, methods=["POST"]),
        ]
    )
    serve(app, host=config.host, port=config.port)


if __name__ == "__main__":
    main()
