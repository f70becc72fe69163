"""An enforcement point on recorded evidence: real tokens, real policies, real journal; the world around it is made by hand."""

import asyncio
import json
import os
import secrets
import time
from dataclasses import dataclass, field
from pathlib import Path
from urllib.parse import parse_qs, urlsplit

import httpx2
from tests.unread import unread
from capabilities.keys import keys
from capabilities.keys.trust import TrustBundle
from capabilities.proof.proof import Proof, check_proof, prove
from capabilities.statements.people import answers as answers_statement
from capabilities.statements.people import ask as ask_statement
from capabilities.statements import conduct as conduct_statement
from capabilities.statements import mark as mark_statement
from capabilities.statements.people import opening as opening_statement
from capabilities.statements.people import picture as picture_statement
from capabilities.statements import registry as registry_statement
from capabilities.statements import revocation
from capabilities.statements.people import vote as vote_statement
from capabilities.statements.revocation import RevocationView
from capabilities.token.mint import mint
from capabilities.token.token_text import token_to_text
from capabilities.token.verify import Verifier
from capabilities.values.caps import DEFAULT as CAPS
from capabilities.values.chain import Attestation, EvidenceKind, HopGrant, Sponsor
from capabilities.values.scope import Each, Grant, Limit, Range, Scope, Tier
from msgspec import structs
from pep.base.operations import (
    FOLLOW_TRAJECTORY,
    GRIPPER_MOVE,
    JOINTS,
    MOVE_JOINT,
    MOVE_PATH,
    SET_DIGITAL_OUTPUT,
    SPEED_JOINT,
)
from pep.base.ports import Assessed, ConductWord, RegisteredSensor, RegisteredTool, Together
from pep.gate.gate import Gate, EffectResult
from pep.gate.robot_ports import RobotPorts
from pep.journal.budget_store import BUDGETS, BudgetStore
from pep.journal.file_journal import FileJournal
from pep.journal.replay_cache import ReplayCache
from pep.mcp.mapping import ARM_TOOLS, to_request
from pep.people.ask_composer import Asker
from pep.people.asks import Asks
from pep.provider.ask_client import AskClient
from pep.request.authority import Authority, PresentedRequest
from pep.request.call import Call
from pep.world.sequence import Sequence
from policies.decision.load import load_shipped
from policies.evidence.content_readings import ArgumentReading, ContextReading
from policies.evidence.evidence import ImpactReading, PerceptionReading, RobotReading, SensorReading, ToolReading
from policies.words.labels import Integrity, Label, Source
from ztpm.cell.survey import embedded

HOST = f"127.{64 + os.getpid() % 63}.{os.getpid() // 63 % 250}.9"
"""A loopback address of this test process alone."""
PORT = 8899
AUDIENCE = f"http://{HOST}:{PORT}/mcp"
ISSUER = "http://127.0.0.1:8898/ztpm"
PEP = "pep-1"
CALIBRATION = "ab" * 32
MOVE = {"q_rad": [0.1, -1.2, 1.0, -1.1, -1.57, 0.0], "speed_rad_s": 0.5, "acceleration_rad_s2": 1.4}


class ManualClock:
    """Two clocks that go only when they are told to."""

    def __init__(self, wall_s=None):
        self.wall = time.time() if wall_s is None else wall_s
        self.mono = 1_000_000

    def wall_s(self):
        return self.wall

    def monotonic_ms(self):
        return self.mono

    def advance(self, ms):
        self.mono += ms
        self.wall += ms / 1000


def issuer_keys():
    made = {name: keys.generate() for name in ("root", "attester", "feed", "registry", "ledger")}
    raw = {name: keys.public_raw(key) for name, key in made.items()}
    trust = TrustBundle(
        issuer=ISSUER,
        version=1,
        roots={1: raw["root"]},
        attesters=frozenset({raw["attester"]}),
        feed=frozenset({raw["feed"]}),
        registry=frozenset({raw["registry"]}),
        ledger=frozenset({raw["ledger"]}),
    )
    return made, trust


def full_scope(at, *, audience=AUDIENCE, ceiling=Tier.HIGH_CONSEQUENCE, speed_high=1_050_000, lifetime_s=600):
    def limits(operation, ranges):
        return tuple(Limit(p, Range(*r)) for p, r in zip(operation.parameters, ranges, strict=True))

    move = limits(MOVE_JOINT, [(-6_500_000, 6_500_000)] * 6 + [(0, speed_high), (0, 2_000_000)])
    path = limits(MOVE_PATH, [(-6_500_000, 6_500_000)] * 24 + [(0, speed_high), (0, 2_000_000)])
    ends = (Range(-6_500_000, 6_500_000), Range(-2_000_000, 2_000_000))
    times, *joints, speed, hardest = FOLLOW_TRAJECTORY.parameters
    follow = (
        Limit(times, Each(Range(0, 20_000_000), 2, 256)),
        *(Limit(each, Each(ends[at >= JOINTS], 2 * (at < JOINTS), 256)) for at, each in enumerate(joints)),
        Limit(speed, Range(0, speed_high)),
        Limit(hardest, Range(0, 4_000_000)),
    )
    grip = limits(GRIPPER_MOVE, [(0, 85_000), (20_000, 150_000), (20_000, 100_000)])
    speeds = limits(SPEED_JOINT, [(-1_000_000, 1_000_000)] * 6 + [(0, 4_000_000), (0, 2_000)])
    outputs = limits(SET_DIGITAL_OUTPUT, [(0, 7), (0, 1)])
    grants = (
        Grant("ur3e", "follow_trajectory", follow),
        Grant("ur3e", "gripper_activate"),
        Grant("ur3e", "gripper_move", grip),
        Grant("ur3e", "move_joint", move),
        Grant("ur3e", "move_path", path),
        Grant("ur3e", "read_state"),
        Grant("ur3e", "set_digital_output", outputs),
        Grant("ur3e", "speed_joint", speeds),
        Grant("ur3e", "stop"),
    )
    return Scope(
        grants=grants,
        ceiling=ceiling,
        audiences=frozenset({audience}),
        delegates=frozenset(),
        depth=0,
        not_before=int(at) - 10,
        not_after=int(at) + lifetime_s,
    )


@dataclass
class Agent:
    """A holder with its key and token."""

    name: str
    key: object
    token: bytes
    hop_id: str

    @property
    def text(self):
        return token_to_text(self.token)

    def proof(self, body, *, at, url=AUDIENCE, method="POST", key=None, token=None, jti=None):
        return prove(
            key or self.key,
            method=method,
            url=url,
            body=body,
            token=token or self.text,
            at=int(at),
            jti=jti or secrets.token_urlsafe(16),
        )


def agent(made, at, *, name="robotic", scope=None, sponsor="alice", caps=CAPS, key=None, mandate_id=None):
    key, hop_id = key or keys.generate(), secrets.token_hex(16)
    hop = HopGrant(
        hop_id=hop_id,
        agent=name,
        key=keys.public_raw(key),
        delegator=sponsor,
        purpose="move",
        request_digest=b"\1" * 32,
        attestation=Attestation(EvidenceKind.KEY, b"\2" * 32, int(at) - 1),
        role="robotic",
    )
    token = mint(
        root=made["root"],
        root_key_id=1,
        token_id=keys.b64u(secrets.token_bytes(16)),
        sponsor=Sponsor(ISSUER, sponsor, "operator-key", int(at) - 1),
        hop=hop,
        scope=scope or full_scope(at),
        caps=caps,
        mandate_id=mandate_id,
    )
    return Agent(name, key, token, hop_id)


def survey(at, **changes):
    """The embedded cell's file, unsigned."""
    stated = embedded(audience=AUDIENCE, author="carol", sensor="camera-1", at=int(at))
    return structs.replace(stated, **changes)


class Feed:
    """A revocation view that is as old and as revoked as a test says."""

    def __init__(self):
        self.epoch, self.age_ms, self.revoked = 1, 0, frozenset()

    def view(self):
        return RevocationView(self.epoch, self.age_ms, self.revoked)

    def revoke(self, kind, identity):
        self.epoch += 1
        self.revoked |= {(kind, identity)}


def refusal_body(reason):
    """Body of a request that was refused at the door, for clients of MCP and for others."""
    error = {"code": -32_003, "message": reason}
    return {"decision": "DENY", "reason": reason, "jsonrpc": "2.0", "id": None, "error": error}


class Registry:
    """Registered tools, trust and sensors."""

    def __init__(self):
        self.tools = {n: RegisteredTool(n, "d" * 64, b.name, b.base_tier) for n, b in ARM_TOOLS.items()}
        self.trust, self.known, self.people, self.held = {}, {}, {}, {}
        self.word = ConductWord(0, {}, {})

    def conduct(self):
        return self.word

    def tool(self, name):
        return self.tools.get(name)

    def trust_permille(self, agent):
        return self.trust.get(agent)

    def sensors(self):
        return self.known

    def approvers(self):
        return self.people

    def passkeys(self):
        return self.held

    def add_sensor(self, name="camera-1", *, calibration=CALIBRATION, transit_ms=20):
        key = keys.generate()
        self.known = {**self.known, name: RegisteredSensor(name, keys.public_raw(key), calibration, transit_ms)}
        return key


def reading(tier=1, index_milli=900, **changes):
    fields = {
        "tier": Tier(tier),
        "index_milli": index_milli,
        "violations": (),
        "contributions": (),
        "lower_tier_speed": None,
        "tcp_speed_um_s": 100_000,
        "contact_permille": 0,
        "start_urad": (0, -1_620_000, 1_250_000, -1_200_000, -1_570_000, 0),
        "perception": "fresh",
        "perception_age_ms": 10,
        "scene_digest": "5c" * 32,
        "model_digest": "0d" * 32,
        "engine": "test",
    }
    return ImpactReading(**{**fields, **changes})


class Readiness:
    """A robot that is ready, until a test says otherwise."""

    def __init__(self):
        self.answer = RobotReading(7, 1, True, True, 1_000, 1_000, True)

    def reading(self):
        return self.answer


class Physics:
    """Says what a test says, and counts how often it was asked."""

    def __init__(self):
        self.answer, self.asked, self.touch = reading(), 0, None
        self.whole, self.joined, self.remembered = None, [], []
        self.perception = PerceptionReading((SensorReading("camera-1", "fresh", "", 10),))
        self.before = lambda: None

    def assess(self, request, *, touch):
        self.asked, self.touch = self.asked + 1, touch
        self.before()
        if isinstance(self.answer, Exception):
            raise self.answer
        return Assessed(self.answer, self.perception)

    def remember(self, request):
        self.remembered.append(request.request_id)

    def together(self, request, *, start_urad, touch):
        self.joined.append((request, start_urad))
        return Together(self.answer.index_milli) if self.whole is None else self.whole


class Slot:
    """One motion at a time."""

    def __init__(self):
        self.holder = None

    def reserve(self, request_id):
        if self.holder is None:
            self.holder = request_id
        return self.holder == request_id

    def joins(self, request, *, agent):
        return False

    def release(self, request_id):
        if self.holder == request_id:
            self.holder = None


class FailingJournal:
    """A journal on a disk that is full from some record on."""

    def __init__(self, inner, *, fail_from=0):
        self.inner, self.left = inner, fail_from

    def append(self, kind, body):
        from pep.base.errors import JournalError, PepFault

        if self.left <= 0:
            raise JournalError(PepFault.JOURNAL_BROKEN, "disk full")
        self.left -= 1
        return self.inner.append(kind, body)


@dataclass
class Person:
    """Person who answers."""

    name: str
    key: object = field(default_factory=keys.generate)

    @property
    def raw(self):
        return keys.public_raw(self.key)

    def vote(self, text, *, at, answer="approve", key=None, **changes):
        """A signed vote on the ask of this text; a test may spoil any member of it."""
        asked = Claimed(text)
        fields = {
            "ask_id": asked["ask_id"],
            "nonce": asked["nonce"],
            "ask_digest": vote_statement.digest_of(text),
            "answer": answer,
            "approver": self.name,
            "sees_clear": False,
            "uses": 1,
            "not_after": int(at) + 120,
            "at": int(at),
        }
        return unread(vote_statement, vote_statement.Vote(**{**fields, **changes}), key or self.key)

    def opening(self, *, at, key=None, **changes):
        fields = {
            "opening_id": secrets.token_hex(16),
            "opener": self.name,
            "audience": AUDIENCE,
            "agent": "robotic",
            "object": "ur3e",
            "operation": "move_joint",
            "reason": "maintenance",
            "uses": 1,
            "not_before": int(at) - 1,
            "not_after": int(at) + 600,
        }
        return unread(opening_statement, opening_statement.Opening(**{**fields, **changes}), key or self.key)


def Claimed(text):
    """The claims of a statement, unverified."""
    return json.loads(keys.unb64u(text.split(".")[1]))


class Still(Sequence):
    """Sequence of an arm that stays where the test puts it, after any command."""

    def ended(self, request, *, arrived):
        super().ended(request, arrived=False)


def own_choice(request):
    """Origin of the parameters of a call without receipts: its holder chose them."""
    label = Label(frozenset({Source.AGENT}), frozenset(), Integrity.AGENT, 0)
    return ContextReading((), tuple(ArgumentReading(value.name, label) for value in request.values))


@dataclass
class Rig:
    """A gate with everything injected."""

    tmp: Path
    clock: object = field(default_factory=ManualClock)
    timeout_ms: int = 60_000
    caps: object = CAPS
    pictures = None

    def __post_init__(self):
        self.made, self.trust = issuer_keys()
        self.people = {name: Person(name) for name in ("alice", "bob", "carol")}
        self.pep_key = keys.generate()
        self.issuer = FakeIssuer(self.made, self.clock, pep_key=keys.public_raw(self.pep_key))
        self.incidents = []
        self.path = self.tmp / "journal.ndjson"
        self.journal = FileJournal.open(self.path, pep_id=PEP, clock=self.clock)
        self.feed, self.registry, self.physics, self.slot = Feed(), Registry(), Physics(), Slot()
        self.readiness, self.latch_id = Readiness(), None
        self.registry.people = {person.raw: person.name for person in self.people.values()}
        self.policies = load_shipped("paper-default")
        self.replay = ReplayCache(self.clock)
        self.sent = []
        self.before_effect = lambda: None
        self.pictured = lambda request_id, record, moves: None
        self.build()

    def build(self, journal=None):
        journal = journal or self.journal
        asker = Asker(pep=PEP, audience=AUDIENCE, issuer=ISSUER, key=self.pep_key, pictures=self.pictures)
        self.asks = Asks(
            clock=self.clock,
            journal=journal,
            timeout_ms=self.timeout_ms,
            asker=asker,
            approvers=self.registry,
            caps=CAPS,
        )
        self.asking = AskClient(
            self.asks,
            self.issuer.client(),
            asker=asker,
            trust=self.trust,
            caps=CAPS,
            clock=self.clock,
            incident=self.incidents.append,
        )
        self.authority = Authority(
            verifier=Verifier(self.trust, self.caps),
            feed=self.feed,
            replay=self.replay,
            clock=self.clock,
            caps=self.caps,
            audience=AUDIENCE,
            started_s=self.clock.wall_s() - 100,
        )
        self.budgets = BudgetStore(self.tmp / BUDGETS)
        self.gate = Gate(
            clock=self.clock,
            authority=self.authority,
            registry=self.registry,
            robot=RobotPorts(
                slot=self.slot,
                sequence=Still(self.clock),
                physics=self.physics,
                latched=lambda: self.latch_id,
                pictured=lambda *about, moves: self.pictured(*about, moves),
            ),
            policies=self.policies,
            journal=journal,
            budgets=self.budgets,
            asks=self.asks,
            announcer=self.asking,
        )
        return self

    def pull(self):
        """The provider's word, now."""
        asyncio.run(self.asking.pull())

    def restart(self, content=None):
        """Killed, and started again on what is on disk, or on this much of it."""
        self.gate.close()
        self.journal.close()
        if content is not None:
            self.path.write_bytes(content)
        self.journal = FileJournal.open(self.path, pep_id=PEP, clock=self.clock)
        self.build()
        self.asks.recover(self.journal.records())
        self.asks.expire()
        return self

    def agent(self, **options):
        return agent(self.made, self.clock.wall_s(), caps=self.caps, **options)

    def credentials(self, holder, *, lease_ms=30_000):
        body = b"{}"
        presented = PresentedRequest(holder.text, holder.proof(body, at=self.clock.wall_s()), "POST", AUDIENCE, body)
        return self.authority.check(presented, lease_ms=lease_ms)

    def call(self, holder, tool="move_joint", arguments=None, *, credentials=None, digest="d" * 64):
        operation = ARM_TOOLS[tool]
        if arguments is None:
            arguments = MOVE if tool == "move_joint" else {}
        request = to_request(
            operation, arguments, request_id=secrets.token_hex(16), audience=AUDIENCE, at=self.clock.wall_s()
        )
        registered = self.registry.tool(tool)
        return Call(
            request=request,
            operation=operation,
            tool=ToolReading(
                tool,
                registered.definition_digest if registered else None,
                digest,
                registered.base_tier if registered else None,
            ),
            credentials=credentials or self.credentials(holder),
            arrived_ms=self.clock.monotonic_ms(),
            readiness=self.readiness,
            context=own_choice(request),
        )

    async def effect(self, permit):
        self.before_effect()
        permit.spend(digest=permit.digest, stopped_ms=None)
        self.sent.append(permit.request_id)
        return EffectResult(value={"moved": True})

    def records(self, kind=None):
        return [r for r in self.journal.records() if kind is None or r["kind"] == kind]

    async def ended(self):
        """Outcome of the one motion, told when its slot is free again and all of it is on record.

        It is the last outcome: a decision whose record takes longer than it lasts is taken anew, and leaves a `refused`
        of its own before.
        """
        async with asyncio.timeout(10):
            while self.slot.holder is not None:
                await asyncio.sleep(0.01)
        self.gate.close()
        return self.records("outcome")[-1]["body"]["outcome"]


class FakeIssuer:
    """The provider's feed, registry and ledger on the wire, with every lie that a test wants told."""

    def __init__(self, made, clock, *, tools=(), sensors=(), pep_key=None):
        self.made, self.clock = made, clock
        self.epoch, self.registry_version, self.entries, self.line = 0, 1, [], 0
        self.tools, self.sensors, self.trust, self.approvers = tuple(tools), tuple(sensors), (), ()
        self.peps, self.suspended = (), ()
        self.edges, self.agents, self.conduct_version, self.conduct_lie = (), (), 0, {}
        self.down = False
        self.lie = {}
        self.signer = made["feed"]
        self.registry_audience = None
        self.shipped, self.through = [], 0
        self.pep_key, self.asks, self.votes, self.openings, self.pictures = pep_key, {}, {}, [], {}
        self.envelopes, self.clearings, self.latches, self.motion_pictures, self.latch_status = [], [], [], [], 201
        self.refuses, self.answers_lie, self.answers_signer, self.spoil = None, {}, made["registry"], None
        self.traces = []
        self.asked = []
        self.restoring, self.marks, self.mark_status = False, [], 200
        self.bundles, self.trust_hint = [], None
        self.confirmed = []
        self.base_epoch, self.ended, self.heads = 0, frozenset(), {}

    def revoke(self, kind, identity):
        self.epoch += 1
        self.entries.append(revocation.RevocationEntry(self.epoch, kind, identity))

    def client(self):
        return httpx2.AsyncClient(transport=httpx2.MockTransport(self.handle))

    def handle(self, request):
        if self.down:
            raise httpx2.ConnectError("down")
        parts = urlsplit(str(request.url))
        query = {k: v[0] for k, v in parse_qs(parts.query).items()}
        path = parts.path.removeprefix(urlsplit(ISSUER).path)
        self.asked.append(path)
        match path:
            case "/revocations" | "/registry" | "/conduct" if self.restoring:
                return httpx2.Response(503, json={"code": "RESTORING"})
            case "/revocations":
                text = self.index(**query)
                headers = {} if self.trust_hint is None else {"ztpm-trust": self.trust_hint}
                return httpx2.Response(409 if text is None else 200, text=text or "", headers=headers)
            case "/trust/signed":
                return httpx2.Response(200, json={"statements": self.bundles})
            case "/revocations/wait":
                return self.hint(**query)
            case "/registry":
                return self.proven(request) or httpx2.Response(200, text=self.snapshot(**query))
            case "/conduct":
                return self.proven(request) or httpx2.Response(200, text=self.conduct(**query))
            case "/approvals":
                self.traces.append(request.headers.get("traceparent"))
                return self.take_ask(request)
            case "/latches":
                self.latches.append(json.loads(request.content)["latch"])
                return self.proven(request) or httpx2.Response(self.latch_status, json={})
            case "/approvals/answers":
                return self.proven(request) or httpx2.Response(200, text=self.answers(**query))
            case "/revocations/marks":
                self.confirmed.append(json.loads(request.content)["mark"])
                return httpx2.Response(self.mark_status)
            case "/restoring/marks":
                return self.proven(request) or self.take_mark(json.loads(request.content)["mark"])
            case "/ledger/records":
                return self.take(json.loads(request.content)["records"])
            case "/ledger/pictures":
                self.motion_pictures.append(json.loads(request.content)["picture"])
                return self.proven(request) or httpx2.Response(201, json={})
        return httpx2.Response(404)

    def hint(self, *, since, news):
        """No hints, unless a test gives them."""
        return httpx2.Response(404)

    def index(self, *, since, nonce, base=None):
        """The index, with a base at `base_epoch` where it is asked for; `ended` is then left out up to there."""
        begun = self.base_epoch if base is not None else 0
        since, head = int(since), revocation.first_head(self.line)
        if since > self.epoch:
            return None
        self.heads = {}
        for entry in self.entries:
            self.heads[entry.epoch] = head = revocation.next_head(head, entry.epoch, entry.kind, entry.id)
        fields = {
            "issuer": ISSUER,
            "line": self.line,
            "head": head,
            "epoch": self.epoch,
            "since": since,
            "as_of_ms": int(self.clock.wall_s() * 1000),
            "nonce": nonce,
            "registry_version": self.registry_version,
            "entries": tuple(
                e for e in self.entries if e.epoch > since and (e.epoch > begun or (e.kind, e.id) not in self.ended)
            )[: revocation.ENTRIES],
        }
        if begun:
            through = fields["entries"][-1].epoch if len(fields["entries"]) == revocation.ENTRIES else self.epoch
            fields["base"] = revocation.RevocationBase(begun, self.heads[begun], through)
        return unread(revocation, revocation.RevocationIndex(**{**fields, **self.lie}), self.signer)

    def conduct(self, *, since, nonce):
        since, told = int(since), (*self.edges, *self.agents)
        fields = {
            "issuer": ISSUER,
            "version": self.conduct_version,
            "since": since,
            "through": self.conduct_version,
            "as_of_ms": int(self.clock.wall_s() * 1000),
            "nonce": nonce,
            "edges": tuple(e for e in told if isinstance(e, conduct_statement.EdgeEntry) and e.version > since),
            "agents": tuple(a for a in told if isinstance(a, conduct_statement.AgentEntry) and a.version > since),
        }
        return unread(conduct_statement, conduct_statement.Conduct(**{**fields, **self.conduct_lie}), self.signer)

    def snapshot(self, *, audience):
        return unread(
            registry_statement,
            registry_statement.RegistrySnapshot(
                issuer=ISSUER,
                version=self.registry_version,
                audience=self.registry_audience or audience,
                as_of_ms=int(self.clock.wall_s() * 1000),
                tools=self.tools,
                sensors=self.sensors,
                trust=self.trust,
                approvers=self.approvers,
                peps=self.peps,
                suspended=self.suspended,
            ),
            self.made["registry"],
        )

    def proven(self, request):
        """None for a request with a proof over exactly it, by the PEP's known key; else the refusal."""
        url = str(request.url).split("?")[0]
        proof = check_proof(
            request.headers.get("dpop", ""),
            key=self.pep_key,
            method=request.method,
            url=url,
            body=request.content,
            token=None,
            at=self.clock.wall_s(),
            caps=CAPS,
        )
        if not isinstance(proof, Proof):
            return httpx2.Response(401, json={"code": str(proof.code)})
        self.prover = proof.key
        return None

    def take_ask(self, request):
        if refused := self.proven(request):
            return refused
        if self.refuses is not None:
            return httpx2.Response(self.refuses[0], json={"code": self.refuses[1]})
        text = json.loads(request.content)["ask"]
        asked = ask_statement.open(text, [self.prover], CAPS)
        if self.asks.get(asked.ask_id, text) != text:
            return httpx2.Response(409, json={"code": "ASK_DIFFERS"})
        status = 200 if asked.ask_id in self.asks else 201
        sent = json.loads(request.content).get("picture")
        if status == 201 and (picture_statement.digest_of(sent) if sent else "") != asked.picture_digest:
            return httpx2.Response(409, json={"code": "ASK_PICTURE_DIFFERS"})
        self.asks[asked.ask_id] = text
        self.pictures[asked.ask_id] = sent
        return httpx2.Response(status, json={"ask_id": asked.ask_id, "url": f"{ISSUER}/approvals/{asked.ask_id}/page"})

    def answers(self, *, audience, nonce):
        fields = {
            "issuer": ISSUER,
            "audience": audience,
            "nonce": nonce,
            "as_of_ms": int(self.clock.wall_s() * 1000),
            "asks": tuple(
                answers_statement.AnsweredAsk(ask_id, "open", tuple(self.votes.get(ask_id, ()))) for ask_id in self.asks
            ),
            "openings": tuple(self.openings),
            "envelopes": tuple(self.envelopes),
            "clearings": tuple(self.clearings),
        }
        lie = self.answers_lie
        text = unread(answers_statement, answers_statement.Answers(**{**fields, **lie}), self.answers_signer)
        return text if self.spoil is None else self.spoil(text)

    def take_mark(self, text):
        self.marks.append(mark_statement.open(text, [self.prover], CAPS))
        return httpx2.Response(self.mark_status, json={"taken": True})

    def cast(self, ask_id, *votes):
        self.votes.setdefault(ask_id, []).extend(votes)

    def take(self, records):
        for record in records:
            if record["seq"] == self.through + 1:
                self.shipped.append(record)
                self.through += 1
            elif record["seq"] > self.through + 1:
                return httpx2.Response(409, json={"code": "RECORD_GAP"})
        return httpx2.Response(200, json={"accepted_through": self.through})
