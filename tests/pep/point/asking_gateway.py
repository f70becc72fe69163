"""A gateway that exists, and the enforcement point that it asks, in one process over the real gate."""

import asyncio
import json
import secrets
from dataclasses import dataclass, replace

import httpx2
from capabilities.proof.evaluation import prove_evaluation
from capabilities.proof.proof import prove
from capabilities.values.errors import Fault, FaultCode
from capabilities.values.scope import Budget, Grant, Limit, Range
from pep.base.declaration import Within, row
from pep.base.ports import RegisteredTool
from pep.mcp.mapping import ARM_TOOLS, to_request
from pep.point.evaluation_layer import ONE, SEVERAL, EvaluationLayer
from pep.request.call import Call
from policies.decision.load import load_shipped
from policies.evidence.evidence import ToolReading
from tests.pep.kit import AUDIENCE, Rig, full_scope, own_choice

from capabilities.keys import keys

POUR = row("tank", "pour", {"volume": Within(0, 1_000, "mL", scale=1, above={900: 3})}, base_tier=1, exact=False)
ORIGIN = AUDIENCE.rpartition("/")[0]
GATEWAY = "gateway"
LIMIT = 950


def pouring(volume=1, *, agent="robotic", **changes):
    """The evaluation of one act."""
    return {
        "subject": {"type": "agent", "id": agent},
        "action": {"name": "pour", "properties": {"volume": volume}},
        "resource": {"type": "object", "id": "tank"},
        **changes,
    }


async def bare(scope, receive, send):
    """The guarded app, which says that a request came through."""
    await send({"type": "http.response.start", "status": 299, "headers": []})
    await send({"type": "http.response.body", "body": b"inner"})


class Access:
    """The identity provider's answers about access tokens."""

    def __init__(self):
        self.known = {}

    async def look(self, token):
        return self.known.get(token, Fault(FaultCode.TOKEN_MALFORMED, "OAT-2", "unknown"))


@dataclass
class Asked(Rig):
    """A gate before a tank, asked by a gateway of its audience and by agents themselves."""

    def __post_init__(self):
        super().__post_init__()
        self.policies = load_shipped("tools")
        self.gate.close()
        self.build()
        self.registry.tools["pour"] = RegisteredTool("pour", "d" * 64, "pour", POUR.base_tier)
        self.key, self.peps, self.access = keys.generate(), {}, Access()
        self.peps[GATEWAY] = keys.public_raw(self.key)
        self.digests = {"pour": "d" * 64, **dict.fromkeys(ARM_TOOLS, "d" * 64)}
        self.holder = self.held()
        self.layer = EvaluationLayer(
            bare,
            gate=self.gate,
            authority=self.authority,
            registry=self.registry,
            peps=lambda: self.peps,
            tools={"pour": POUR, **ARM_TOOLS},
            served=self.served,
            audience=AUDIENCE,
            access=self.access,
            clock=self.clock,
        )

    async def served(self):
        return self.digests

    def held(self, *budgets, **changes):
        """An agent that may pour so much."""
        own = full_scope(self.clock.wall_s())
        grant = Grant("tank", "pour", (Limit(POUR.limits[0].parameter, Range(0, LIMIT)),), tuple(budgets))
        grants = tuple(sorted((*own.grants, grant), key=lambda each: (each.object, each.operation)))
        return self.agent(scope=replace(own, grants=grants), **changes)

    def headers(self, content, *, path, holder=None, key=None, **spoil):
        """Credentials of who asks: an agent's token and proof, or the gateway's own key."""
        token = None if holder is None else holder.text
        proof = prove(
            key or (self.key if holder is None else holder.key),
            **{
                "method": "POST",
                "url": ORIGIN + path,
                "body": content,
                "token": token,
                "at": int(self.clock.wall_s()),
                "jti": secrets.token_urlsafe(16),
                **spoil,
            },
        )
        told = {"content-type": "application/json", "dpop": proof}
        return told if token is None else {**told, "authorization": f"DPoP {token}"}

    def credentials_of(self, evaluation, holder=None, **spoil):
        """Token and proof of an agent over one evaluation, as it hands them to the gateway."""
        holder = holder or self.holder
        options = {"audience": AUDIENCE, "token": holder.text, "at": int(self.clock.wall_s())}
        options |= {"jti": secrets.token_urlsafe(16), **spoil}
        proof = prove_evaluation(options.pop("key", holder.key), options.pop("over", evaluation), **options)
        return {"token": holder.text, "proof": proof}

    def forwarded(self, evaluation, holder=None, **spoil):
        """The evaluation with what the gateway was handed."""
        return {**evaluation, "context": {"credentials": self.credentials_of(evaluation, holder, **spoil)}}

    def post(self, content, *, path=ONE, holder=None, headers=None, method="POST", **spoil):
        """The response."""
        raw = content if isinstance(content, bytes) else json.dumps(content).encode()
        sent = self.headers(raw, path=path, holder=holder, **spoil)
        sent = {name: value for name, value in {**sent, **(headers or {})}.items() if value is not None}

        async def once():
            transport = httpx2.ASGITransport(app=self.layer)
            async with httpx2.AsyncClient(transport=transport) as http:
                return await http.request(method, ORIGIN + path, content=raw, headers=sent)

        return asyncio.run(once())

    def ask(self, body, *, path=ONE, **options):
        """The told answer, of a request that has one."""
        answer = self.post(body, path=path, **options)
        assert answer.status_code == 200, answer.text
        return answer.json()

    def several(self, evaluations, **members):
        """Answers of a batch that the holder asks about itself."""
        body = {"evaluations": evaluations, **members}
        return self.ask(body, path=SEVERAL, holder=self.holder)["evaluations"]

    def pour(self, volume=1, holder=None):
        """The act itself, decided and done."""
        holder = holder or self.holder
        at = self.clock.wall_s()
        request = to_request(POUR, {"volume": volume}, request_id=secrets.token_hex(16), audience=AUDIENCE, at=at)
        call = Call(
            request=request,
            operation=POUR,
            tool=ToolReading("pour", "d" * 64, "d" * 64, POUR.base_tier),
            credentials=self.credentials(holder),
            arrived_ms=self.clock.monotonic_ms(),
            readiness=None,
            context=own_choice(request),
        )
        return asyncio.run(self.gate.run(call, self.effect)).decision

    def kinds(self):
        return [each["kind"] for each in self.records()]


def few(most):
    """A budget of so many acts."""
    return Budget("", AUDIENCE, 600, most)


def why(answer):
    return answer["decision"], answer["context"]["reason"]
