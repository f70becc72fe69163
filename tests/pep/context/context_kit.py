"""Admission point by hand: real tokens, statements, policies; a told clock; a journal in memory."""

from __future__ import annotations

import dataclasses
import hashlib
import json
from dataclasses import dataclass, field

import rfc8785
from tests.unread import unread
from capabilities.values.caps import DEFAULT as CAPS
from capabilities.values.units import Quantity, Unit
from pep.base.errors import JournalError, PepFault
from pep.context.admission import Admission
from pep.context.flow import Flow
from pep.context.forms import Form, FormBody, Forms, RequestedOperation
from pep.context.messages import ConversationBook
from pep.journal.replay_cache import ReplayCache
from pep.request.authority import Credentials
from policies.decision.load import load_shipped
from policies.evidence.content_readings import ItemKind, ItemReading
from policies.words.labels import Integrity, Label, Source
from tests.capabilities.world import (
    CELL,
    LAST,
    NOW,
    QUIETER,
    SLOWER,
    add_hop,
    chain_of,
    grant_to,
    key_of,
    mint_root,
    raw_of,
)
from tests.pep.kit import ManualClock

from capabilities.keys import keys
from capabilities.statements.context import intent as intent_statement
from capabilities.statements.context import message as message_statement

PEOPLE = {"alice": raw_of("alice"), "bob": raw_of("bob")}
PEP_KEY = key_of("pep")
ADMITTERS = {CELL: raw_of("pep")}


class Sort(FormBody):
    """Wish of a person."""

    parts: tuple[str, ...]
    box: int
    note: str = ""


class Task(FormBody):
    """Task that one agent gives another."""

    operation: str
    speed_urad_s: int | None = None
    note: str = ""


def asked(task: Task) -> tuple[RequestedOperation, ...]:
    if task.speed_urad_s is None:
        return (RequestedOperation("ur3e", task.operation),)
    return (RequestedOperation("ur3e", task.operation, move(task.speed_urad_s)),)


def move(speed: int) -> tuple[Quantity, ...]:
    joints = tuple(Quantity(f"q{n}", Unit.MICRORADIAN, 0) for n in range(2))
    return (*joints, Quantity("speed", Unit.MICRORADIAN_PER_SECOND, speed))


FORMS = Forms((Form("sort/1", Sort, lambda _: ()), Form("task/1", Task, asked)))


def wanted(body: object = None, *, key=None, raw: bytes | None = None, **other) -> str:
    """A signed intent of alice's."""
    stated = rfc8785.dumps(body or {"box": 2, "parts": ["red"]}) if raw is None else raw
    fields = {
        "subject": "alice",
        "schema": "sort/1",
        "body": stated,
        "nonce": "n" * 22,
        "at": NOW,
        "not_after": NOW + 600,
    }
    return unread(intent_statement, intent_statement.Intent(**{**fields, **other}), key or key_of("alice"))


def lent(purpose: str = "sort the red parts", **other):
    """The orchestrator's token, issued for that purpose."""
    return mint_root(hop=grant_to("orchestrator", "alice", purpose=purpose, **other))


def for_intent(text: str):
    return chain_of(lent(intent_statement.purpose(intent_statement.digest_of(text), "sort the red parts")))


def chain_to(*agents: str, purpose: str = "sort the red parts"):
    token = lent(purpose)
    for agent, restriction in zip(agents, (SLOWER, QUIETER, LAST), strict=False):
        token = add_hop(token, agent, restriction)
    return chain_of(token)


def said(chain, body: object = None, *, hop: int = 0, key=None, **other) -> str:
    """A signed message of the orchestrator's to the robotic agent."""
    sender = chain.hops[hop]
    fields = {
        "sender": sender.agent,
        "addressee": "robotic",
        "token_id": chain.token_id,
        "hop_id": sender.hop_id,
        "conversation": "c" * 22,
        "sequence": 1,
        "in_reply_to": "",
        "schema": "task/1",
        "body": rfc8785.dumps({"operation": "read_state"} if body is None else body),
        "at": NOW,
        "not_after": NOW + 60,
    }
    return unread(message_statement, message_statement.Message(**{**fields, **other}), key or key_of(sender.agent))


class Journal:
    """In memory; fails when it is told to."""

    def __init__(self):
        self.records, self.broken = [], False

    def append(self, kind, body):
        if self.broken:
            raise JournalError(PepFault.JOURNAL_BROKEN)
        line = rfc8785.dumps({"kind": kind, "body": body})
        self.records.append(json.loads(line))
        return hashlib.sha256(line).hexdigest()

    def bodies(self, kind):
        return [record["body"] for record in self.records if record["kind"] == kind]


@dataclass
class People:
    known: dict = field(default_factory=lambda: dict(PEOPLE))

    def people(self):
        return self.known


@dataclass
class Standing:
    """Standing with any chain that a test gives."""

    answer: object = None

    def chain(self, _context):
        return self.answer


class Point:
    """One admission point."""

    def __init__(self, chain, *, policies=None, journal=None, clock=None):
        self.clock = clock or ManualClock(NOW)
        self.journal = journal or Journal()
        self.flow = Flow(self.clock)
        self.people = People()
        self.standing = Standing(chain)
        self.conversations = ConversationBook(self.clock)
        self.replay = ReplayCache(self.clock)
        self.admission = Admission(
            policies=policies or load_shipped("paper-default"),
            clock=self.clock,
            journal=self.journal,
            audience=CELL,
            key=PEP_KEY,
            flow=self.flow,
            standing=self.standing,
            people=self.people,
            forms=FORMS,
            conversations=self.conversations,
            replay=self.replay,
            caps=CAPS,
        )

    def context(self, chain, hop: int = -1):
        return self.flow.context(chain.hops[hop])


def held(chain, *, proof=True) -> Credentials:
    """The credentials of a chain's leaf."""
    return Credentials(b"token", chain, proof, "ab" * 32)


CURATED = Label(frozenset({Source.RETRIEVAL}), frozenset({"dora"}), Integrity.CURATED, 0)
SENSED = Label(frozenset({Source.SENSOR}), frozenset({"camera-1"}), Integrity.SENSED, 40)
UNVOUCHED = Label(frozenset({Source.RETRIEVAL}), frozenset(), Integrity.NONE, 0)


def document(label: Label = CURATED, **other) -> ItemReading:
    fields = {"kind": ItemKind.DOCUMENT, "id": "handbook/3", "label": label, "listed": True, "manifest_age_s": 60}
    return ItemReading(**{**fields, **other})


def response(label: Label | None = None, **other) -> ItemReading:
    recorded = label or Label(frozenset({Source.TOOL}), frozenset({"cell-1"}), Integrity.RECORDED, 0)
    fields = {"kind": ItemKind.TOOL_RESPONSE, "id": "r-0", "label": recorded, "of_request": True, "of_pin": True}
    return ItemReading(**{**fields, **other})


def resigned(text: str, change, key) -> str:
    """A statement with other claims or header, signed with that key: what `sign` would never write."""
    from capabilities.keys import jws
    from capabilities.values import strict_json

    parts = jws.split(text, most_bytes=10**6)
    header, claims = dict(parts.header), json.loads(parts.payload_raw)
    header["kid"] = keys.thumbprint(keys.public_raw(key))
    raw = change(claims)
    payload = raw if isinstance(raw, bytes) else strict_json.canonical(raw)
    return jws.sign({name: header[name] for name in ("typ", "kid")}, payload, key)


replaced = dataclasses.replace
