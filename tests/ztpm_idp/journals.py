"""An enforcement point's journal for tests: the records that the gate writes, of tokens that this world lent."""

from __future__ import annotations

import hashlib
import secrets

import rfc8785
from capabilities.statements.people import picture
from capabilities.statements.revocation import RevocationView
from capabilities.token.verify import token_from_text, verify
from capabilities.values.caps import DEFAULT
from capabilities.values.chain import Chain
from capabilities.values.scope import Tier
from capabilities.values.units import Quantity
from pep.base.operations import MOVE_JOINT
from pep.request.authority import Credentials
from pep.request.call import Call
from policies.evidence.evidence import Evidence, ToolReading
from policies.evidence.model import Decision, Effect, Finding, Point, Request
from policies.words.reason_table import Reason
from tests.ztpm_idp.world import AUDIENCE, MOVE_TO, SPEED, World

from pep.gate import records


class Journal:
    """Journal of one enforcement point; `made` holds every record, shipped or not."""

    def __init__(self, world: World, pep: str = "cell-1", *, registered: bool = False) -> None:
        self.world, self.pep = world, pep
        self.made, self.shipped, self.prev = [], 0, "0" * 64
        if not registered:
            world.pep(pep)

    def chain(self, token: str) -> Chain:
        found = verify(
            token_from_text(token, DEFAULT), at=self.world.clock(), audience=AUDIENCE,
            view=RevocationView(0, 0, frozenset()), lease_ms=1, trust=self.world.trust, caps=DEFAULT,
        )  # fmt: skip
        assert isinstance(found, Chain), found
        return found

    def record(self, kind: str, body: dict, *, at_s: float | None = None, **changes) -> str:
        """One more record; its hash."""
        at_s = self.world.clock() if at_s is None else at_s
        record = {
            "v": 1, "pep": self.pep, "seq": len(self.made) + 1, "prev": self.prev, "at_ms": int(at_s * 1_000),
            "kind": kind, "body": body,
        } | changes  # fmt: skip
        self.made.append(record)
        self.prev = hashlib.sha256(rfc8785.dumps(record)).hexdigest()
        return self.prev

    def request(self, **changes) -> Request:
        values = (
            Quantity(MOVE_TO.name, MOVE_TO.unit, changes.pop("q0", 300_000)),
            Quantity(SPEED.name, SPEED.unit, changes.pop("speed", 200_000)),
        )
        stated = dict(
            request_id=secrets.token_hex(16), points=frozenset({Point.TOOL, Point.ACTUATION}), audience=AUDIENCE,
            object="ur3e", operation="move_joint", values=values, at=self.world.clock(),
        )  # fmt: skip
        return Request(**(stated | changes))

    def decision(
        self, token: str, effect="PERMIT", reason="PERMITTED", *, tier=1, proof=True, chain=None, at_s=None, **changes
    ) -> tuple[Request, dict]:
        """The body of a decision's record, written by the gate's own writer."""
        request = self.request(**changes)
        tool = ToolReading(request.operation, "d" * 64, "d" * 64, Tier.REVERSIBLE)
        evidence = Evidence(
            at=request.at, at_ms=1, chain=chain or self.chain(token), proof=proof, tool=tool, request_fault=None
        )
        decided = Decision(
            request_id=request.request_id, request_digest=request.digest, effect=Effect(effect), reason=Reason(reason),
            primitive="", findings=() if effect == "PERMIT" else (Finding("", Reason(reason)),), tier=Tier(tier),
            index=None, obligations=(), policy_digest="", evidence=evidence, lifetime_ms=50,
        )  # fmt: skip
        call = Call(request, MOVE_JOINT, tool, Credentials(b"", evidence.chain, proof), 0, None)
        return request, records.decision(call, evidence, decided)

    def acted(self, token: str, outcome: str | None = "done", *, why=None, at_s=None, **changes) -> Request:
        """A PERMIT on record and, unless None, its outcome."""
        request, body = self.decision(token, at_s=at_s, **changes)
        digest = self.record("decision", body, at_s=at_s)
        if outcome is not None:
            self.record("outcome", records.outcome(request, digest, outcome, reason=why), at_s=at_s)
        return request

    def refused(self, token: str, reason: str = "NOT_GRANTED", effect: str = "DENY", **changes) -> Request:
        """A DENY or DEFER on record."""
        at_s = changes.get("at_s")
        request, body = self.decision(token, effect, reason, **changes)
        self.record("decision", body, at_s=at_s)
        return request

    def pictured(self, request: Request, text: str, **changes) -> str:
        """A record that names the picture of a request's motion; its digest."""
        digest = picture.digest_of(text)
        self.record("picture", {"request_id": request.request_id, "digest": digest} | changes)
        return digest

    def ship(self, made: list | None = None) -> int:
        """Ships the records that were not shipped yet, or these, into the ledger."""
        batch = self.made[self.shipped :] if made is None else made
        through = self.world.peps[self.pep]._post("/ledger/records", {"records": batch})["accepted_through"]
        self.shipped = max(self.shipped, through)
        return through
