"""The identity provider as people's and agents' programs see it: every request is signed by the caller's key.

Example::

    operator = Operator("alice", key, "http://127.0.0.1:8700/ztpm")
    planner = operator.new_agent("planner", "planner.py", role="planner")
    mover = operator.new_agent("mover", "mover.py", role="mover")
    lent = operator.lend(planner, grants, "https://cell.example/mcp", purpose="sweep the table", delegates=["mover"])
    narrower = planner.delegate(lent.token, mover, restriction, purpose="move the arm")
"""

from __future__ import annotations

import hashlib
import secrets
import time
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final
from urllib.parse import quote

import rfc8785

from capabilities.keys.keys import generate, public_raw, thumbprint
from capabilities.statements import attestation
from capabilities.statements.people import mandate, opening
from capabilities.values.errors import StatementError
from capabilities.values.scope import Scope, Tier
from capabilities.values.scope_json import restriction_to_json, scope_to_json
from capabilities.values.units import INT_LIMIT
from ztpm_idp.client import person_answers
from ztpm_idp.client.auditing import AuditingCaller
from ztpm_idp.client.caller import Caller, ClientError, Issued
from ztpm_idp.client.oauth import OAuthCaller
from ztpm_idp.client.person_answers import DEFAULT_TERMS
from ztpm_idp.client.registering import RegistryCaller
from ztpm_idp.client.renewal import Renewal
from ztpm_idp.client.signing import MetaAuth

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator, Mapping
    from pathlib import Path

    import httpx2

    from capabilities.keys.keys import PrivateKey
    from capabilities.values.scope import Grant, Restriction
    from ztpm_idp.client.tools import Command, StdioTools, Tools

    Asked = Callable[[str], None] | None


@dataclass(frozen=True, slots=True)
class Evidence:
    """Evidence of an agent for one request, to be handed to its delegator."""

    agent: str
    jws: str


DRAWN_S: Final = 3_600
"""Longest life of a drawn token, seconds: that of its evidence."""
LENT_S: Final = 900
"""Ours: life of a token that was lent for no stated time, seconds."""
PAGE_ENTRIES: Final = 2_000
"""Entries of the ledger that are asked for at once: some megabytes."""


class Agent(Caller):
    """An agent's side: it attests itself, receives authority and lends it on.

    Args:
        id, key, issuer: as registered.
        measurement: SHA-256 over its software; must be the registered software digest.
        workload: fetches a fresh workload token from the platform, for this identity provider and this key, as often as
            evidence is made, or has a publisher's release. None: evidence is of kind `key`, and no hop of it may carry
            tier 4.
        svid: proves an X.509-SVID over a nonce (`capabilities.statements.x509_svid.prove`); comes before `workload`.
        transport: of `httpx2`, for tests.
        now: wall clock, seconds since the epoch.
    """

    def __init__(
        self,
        id: str,  # noqa: A002  the word of the wire
        key: PrivateKey,
        issuer: str,
        measurement: bytes,
        *,
        workload: Callable[[], str] | None = None,
        svid: Callable[[str], str] | None = None,
        transport: httpx2.BaseTransport | None = None,
        now: Callable[[], float] = time.time,
    ) -> None:
        super().__init__(id, key, issuer, transport=transport, now=now)
        self.measurement = measurement
        self._workload = workload
        self._svid = svid

    @property
    def key(self) -> PrivateKey:
        """Private key of the agent, for statements to other parties than the identity provider."""
        return self._key

    def attest(self) -> None:
        """Attests the agent's key and software; it is active from then on."""
        self._post(f"/agents/{self.id}/attestations", {"evidence": self._evidence("", bytes(32))})

    def evidence(self, delegator: str, request: Mapping[str, object]) -> str:
        """Signed evidence, with a fresh nonce, for exactly this delegator and request. Good for one hop.

        Args:
            delegator: id of the sponsor or agent who will lend.
            request: the request as it will be sent.
        """
        return self._evidence(delegator, hashlib.sha256(rfc8785.dumps(dict(request))).digest())  # type: ignore[arg-type]

    def nonce(self) -> str:
        """A fresh attestation nonce."""
        return str(self._post("/nonces", {})["nonce"])

    def delegate(self, token: str, delegate: Agent | Evidence, restriction: Restriction, *, purpose: str) -> Issued:
        """A narrower token for another agent.

        Args:
            token: this agent's.
            delegate: the other agent, when it lives in this program; else evidence that it made for the very same
                request (see `delegate_request`).
            restriction: of the new hop.
            purpose: for the token and the ledger.

        Raises:
            ClientError: `NOT_NARROWER`, `DELEGATE_NOT_ALLOWED`, `HOP_NOT_ATTESTED`, `ATTESTATION_INVALID`,
                `REVOKED` and other codes of the identity provider.
        """
        match delegate:
            case Agent():
                evidence = delegate.evidence(self.id, delegate_request(delegate.id, restriction, purpose=purpose))
                return self.delegate_with(token, delegate.id, restriction, purpose=purpose, evidence=evidence)
            case Evidence(agent=agent, jws=jws):
                return self.delegate_with(token, agent, restriction, purpose=purpose, evidence=jws)

    def delegate_with(
        self, token: str, delegate: str, restriction: Restriction, *, purpose: str, evidence: str
    ) -> Issued:
        """Delegates as `delegate` does, with the delegate's id and evidence as they were received."""
        request = delegate_request(delegate, restriction, purpose=purpose)
        return self._issued(self._post("/tokens/delegate", {"request": request, "evidence": evidence}, token=token))

    def draw(self, mandate_id: str, *, lifetime_s: int = DRAWN_S) -> Issued:
        """A token from a mandate, for this agent, attested anew; nobody is asked.

        Args:
            mandate_id: as `mandates` lists it.
            lifetime_s: longest life of the token, 1 to `DRAWN_S`; it ends with its mandate at the latest.

        Raises:
            ClientError: `MANDATE_REVOKED`, `MANDATE_OVER`, `MANDATE_TOKENS_LIVE`, `MANDATE_NEEDS_PLATFORM`,
                `SPONSOR_INACTIVE`, `SCOPE_CONTRACTED` and other codes of the identity provider.
        """
        sponsor = str(self.mandate(mandate_id)["sponsor"])
        request: dict[str, object] = {"lifetime_s": lifetime_s, "mandate_id": mandate_id}
        body = {"request": request, "evidence": self.evidence(sponsor, request)}
        return self._issued(self._post(f"/mandates/{mandate_id}/tokens", body))

    def renewal(self, mandate_id: str, *, lifetime_s: int = DRAWN_S) -> Renewal:
        """Tokens of a mandate, one after another: the next is drawn before the last ends.

        Args:
            mandate_id: as `mandates` lists it.
            lifetime_s: longest life of each token, 1 to `DRAWN_S`.
        """
        return Renewal(self, mandate_id, lifetime_s=lifetime_s, now=self._now)

    def tools(self, url: str, token: str | Renewal, *, patience_s: float = 0.0, asked: Asked = None) -> Tools:
        """The tools of an MCP server, called with this agent's authority.

        Example::

            async with planner.tools("https://plant.example/mcp", lent.token) as tools:
                answer = await tools.call("open_valve", {"valve": 7, "percent": 40})

        Args:
            url: of the server: the audience of the token.
            token: this agent's; or the `renewal` of a mandate, for work that is longer than a token.
            patience_s: so long a deferred call waits for people before it raises `Deferred`.
            asked: told the page at which people answer, once for each deferred call.
        """
        from ztpm_idp.client.tools import Tools  # with the MCP SDK, whose import takes half a second

        renewal = token if isinstance(token, Renewal) else None
        auth = self.auth(token) if isinstance(token, str) else token.auth()
        return Tools(url, auth, patience_s=patience_s, asked=asked, renewal=renewal)

    def tools_stdio(
        self, command: Command, token: str | Renewal, *, audience: str, patience_s: float = 0.0, asked: Asked = None
    ) -> StdioTools:
        """The tools of an MCP server that is started here and spoken to over stdio; else as `tools`.

        Args:
            command: starts it, the `StdioServerParameters` of `mcp`; never one that came in a request.
            token: as for `tools`.
            audience: canonical URL of the server: the audience of the token.
            patience_s: as for `tools`.
            asked: likewise.
        """
        from ztpm_idp.client.tools import StdioTools  # with the MCP SDK, as above

        renewal = token if isinstance(token, Renewal) else None
        auth = MetaAuth(self._key, (lambda: token) if isinstance(token, str) else token.token, audience, now=self._now)
        return StdioTools(command, auth, audience=audience, patience_s=patience_s, asked=asked, renewal=renewal)

    def _beside(self, nonce: str) -> str:
        if self._svid is not None:
            return self._svid(nonce)
        return "" if self._workload is None else self._workload()

    def _evidence(self, delegator: str, request_digest: bytes) -> str:
        nonce = self.nonce()
        stated = attestation.Evidence(
            agent=self.id,
            key_thumbprint=thumbprint(public_raw(self._key)),
            nonce=nonce,
            delegator=delegator,
            request_digest=request_digest,
            measurement=self.measurement,
            at=int(self._now()),
            workload=self._beside(nonce),
        )
        return attestation.sign(stated, self._key)


class Operator(RegistryCaller, AuditingCaller, OAuthCaller):
    """A person's side: registering, lending, ending, reading the ledger.

    Args:
        id, key, issuer: as registered.
        transport: of `httpx2`, for tests.
        now: wall clock, seconds since the epoch.
    """

    def new_agent(
        self,
        id: str,  # noqa: A002
        software: Path | str,
        *,
        role: str,
        model: str = "none",
    ) -> Agent:
        """An agent that lives in this program: with a new key, registered under this person, and attested.

        Args:
            id: not yet used.
            software: the file that it runs; its SHA-256 is what is attested.
            role: its purpose, as planner.
            model: the language model behind it.

        Raises:
            OSError: the file cannot be read.
            ClientError: `ALREADY_REGISTERED`, and other codes of the identity provider.
        """
        with open(software, "rb") as file:  # noqa: PTH123 - a path in either form
            measurement = hashlib.file_digest(file, "sha256").digest()
        made = Agent(id, generate(), self.issuer, measurement, transport=self._transport, now=self._now)
        self.register_agent(id, public_raw(made.key), software_digest=measurement.hex(), model=model, role=role)
        made.attest()
        return made

    def lend(
        self,
        agent: Agent,
        grants: Iterable[Grant],
        audience: str,
        *,
        purpose: str,
        ceiling: Tier = Tier.REVERSIBLE,
        delegates: Iterable[str] = (),
        depth: int = 1,
        lifetime_s: int = LENT_S,
    ) -> Issued:
        """A token for an agent of this program, from now on, at one server; `issue` takes any scope.

        Args:
            agent: of this program.
            grants: each pair once, in any order.
            audience: canonical URL of the server.
            purpose: for the token and the ledger.
            ceiling: highest tier of an act.
            delegates: agent ids, or `role:NAME`, that may receive the next hop.
            depth: so many further hops, where there are delegates.
            lifetime_s: of the token, seconds.

        Raises:
            ClientError: when it is refused.
        """
        at, to = int(self._now()), frozenset(delegates)
        ordered = tuple(sorted(grants, key=lambda each: (each.object, each.operation)))
        hops = depth if to else 0
        scope = Scope(ordered, ceiling, frozenset({audience}), to, hops, at, at + lifetime_s)
        return self.issue(agent, scope, purpose=purpose)

    def issue(self, agent: Agent | Evidence, scope: Scope, *, purpose: str) -> Issued:
        """A token for an agent: this person lends it `scope`.

        Args:
            agent: the agent, when it lives in this program; else evidence that it made for the very same request
                (see `issue_request`).
            scope: all that it may do.
            purpose: for the token and the ledger.

        Raises:
            ClientError: when it is refused.
        """
        if isinstance(agent, Agent):
            request = issue_request(agent.id, scope, purpose=purpose)
            evidence = agent.evidence(self.id, request)
        else:
            request, evidence = issue_request(agent.agent, scope, purpose=purpose), agent.jws
        return self._issued(self._post("/tokens", {"request": request, "evidence": evidence}))

    def sign_mandate(self, agent: str, scope: Scope, *, purpose: str) -> str:
        """A mandate: the agent may draw tokens of `scope` until its window ends, with nobody asked; its id.

        Args:
            agent: id of a registered agent; the mandate is for the key with which it is registered now.
            scope: all that a drawn token may allow; its window ends at most seven days from now.
            purpose: of each token that is drawn.

        Raises:
            ClientError: `NOT_FOUND` for an agent that is not registered, and other codes of the identity provider.
            StatementError: for a scope that lasts longer, or is malformed.
        """
        keys = [str(each["key"]) for each in self.agents() if each["id"] == agent]
        if not keys:
            raise ClientError("NOT_FOUND", 404, f"no agent {agent}")
        promised = mandate.Mandate(
            mandate_id=secrets.token_hex(16),
            issuer=self.issuer,
            sponsor=self.id,
            agent=agent,
            agent_key=keys[0],
            purpose=purpose,
            scope=scope,
            at=int(self._now()),
        )
        return str(self._post("/mandates", {"mandate": mandate.sign(promised, self._key)})["mandate_id"])

    def approvals(self, state: str = "open") -> list[dict[str, Any]]:
        """The asks in one state ("open", "granted", "denied", "withdrawn", "expired"), the oldest first."""
        found: list[dict[str, Any]] = self._json(self._send("GET", f"/approvals?state={quote(state)}", b"", None))
        return found

    def approval(self, ask_id: str) -> dict[str, Any]:
        """An ask, how it stands and its votes.

        Returns:
            `ask` (its signed text), `shown` (all that the text says, parsed strictly from it), `ask_digest` (of that
            text: give it to `approve` as `shown`), `state`, `votes` (texts), `expires_at`.

        Raises:
            ClientError: `ASK_UNKNOWN`; `ANSWER_MALFORMED` when the answer holds no such ask.
        """
        answer, shown = self._shown(ask_id)
        return answer | {"shown": person_answers.plain(shown.ask), "ask_digest": shown.digest}

    def approve(
        self,
        ask_id: str,
        *,
        uses: int = 1,
        lifetime_s: int = person_answers.LIFETIME_S,
        sees_clear: bool = False,
        shown: str | None = None,
    ) -> dict[str, Any]:
        """Approves the ask: exactly the text that the identity provider holds, parsed strictly first.

        Args:
            ask_id: which.
            uses: how often, 1 to 100.
            lifetime_s: for how long, seconds, at most 3600.
            sees_clear: this person sees the cell clear; needed where perception was not fresh.
            shown: digest of the text that this person read; nothing is signed when the ask has another text.

        Returns:
            `ask_id` and the `state` after it.

        Raises:
            ClientError: `ASK_CHANGED` when the text is not the one shown; codes of the identity provider.
        """
        return self._vote(ask_id, "approve", person_answers.Terms(uses, lifetime_s, sees_clear=sees_clear), shown)

    def deny(self, ask_id: str) -> dict[str, Any]:
        """Denies the ask, and so ends it; `ask_id` and `state`."""
        return self._vote(ask_id, "deny")

    def withdraw(self, ask_id: str) -> dict[str, Any]:
        """Takes this person's approval back, and so ends the ask; `ask_id` and `state`."""
        return self._vote(ask_id, "withdraw")

    def open_tier_4(
        self,
        *,
        audience: str,
        agent: str,
        object: str,  # noqa: A002  the word of the wire
        operation: str,
        uses: int = 1,
        lifetime_s: int = 600,
        reason: str = "",
    ) -> str:
        """A safety-critical act may be asked for, from now on; the opening's id. It approves nothing.

        Args:
            audience: canonical URL of the enforcement point's server.
            agent: the leaf of the chain that will act.
            object: the object of the act.
            operation: the operation of the act.
            uses: how many acts, 1 to 100.
            lifetime_s: for how long, seconds, at most 3600.
            reason: for the record, in the form of a name (letters, digits, `._:@/|+=~%-`).
        """
        at = int(self._now())
        opened = opening.Opening(
            opening_id=secrets.token_hex(16),
            opener=self.id,
            audience=audience,
            agent=agent,
            object=object,
            operation=operation,
            reason=reason,
            uses=uses,
            not_before=at,
            not_after=at + lifetime_s,
        )
        return str(self._post("/openings", {"opening": opening.sign(opened, self._key)})["opening_id"])

    def openings(self) -> list[dict[str, Any]]:
        """The openings that are not over, each with its signed text as `opening`."""
        found: list[dict[str, Any]] = self._json(self._send("GET", "/openings", b"", None))
        return found

    def close_opening(self, opening_id: str, reason: str) -> None:
        """The opening is over."""
        self._post(f"/openings/{quote(opening_id, safe='')}/withdraw", {"reason": reason})

    def picture(self, ask_id: str) -> str:
        """Text of the picture that the ask names, by the digest in the ask itself; "" where it names none."""
        _, shown = self._shown(ask_id)
        if not shown.ask.picture_digest:
            return ""
        return person_answers.pictured(shown, self._send("GET", f"/approvals/{ask_id}/picture", b"", None).text)

    def _shown(self, ask_id: str) -> tuple[dict[str, Any], person_answers.ShownAsk]:
        found = self._json(self._send("GET", f"/approvals/{quote(ask_id, safe='')}", b"", None))
        answer: dict[str, Any] = found if isinstance(found, dict) else {}
        try:
            return answer, person_answers.read(answer, ask_id)
        except StatementError as error:
            raise ClientError("ANSWER_MALFORMED", 200, error.detail) from None

    def _vote(
        self, ask_id: str, answer: str, terms: person_answers.Terms = DEFAULT_TERMS, expected: str | None = None
    ) -> dict[str, Any]:
        _, shown = self._shown(ask_id)
        if expected is not None and expected != shown.digest:
            raise ClientError("ASK_CHANGED", 0, "the ask is not the one that was shown")
        vote = person_answers.sign_vote(shown, answer, terms, self._key, approver=self.id, at=int(self._now()))
        return self._post(f"/approvals/{ask_id}/votes", {"vote": vote})

    def export_ledger(self) -> bytes:
        """The whole ledger as JSON lines, the last one its signed checkpoint."""
        return b"".join(self.ledger_pages())

    def ledger_pages(self, *, first: int = 1, last: int = INT_LIMIT) -> Iterator[bytes]:
        """Lines of the entries from `first` to `last`, then the checkpoint of the last.

        They end where the ledger does.
        """
        while True:
            through = min(last, first + PAGE_ENTRIES - 1)
            path = f"/ledger/export?first={first}&last={through}"
            answer = self._send("GET", path, b"", None)
            if not (lines := answer.content.splitlines(keepends=True)):
                raise ClientError("ANSWER_MALFORMED", answer.status_code)
            signed = lines.pop()
            yield b"".join(lines)
            first += len(lines)
            if first <= through or first > last:  # there are no more, or none is wanted
                yield signed
                return


def issue_request(agent: str, scope: Scope, *, purpose: str) -> dict[str, object]:
    """Request of a sponsor for a token: the agent's evidence names its digest."""
    return {"agent": agent, "purpose": purpose, "scope": scope_to_json(scope)}


def delegate_request(delegate: str, restriction: Restriction, *, purpose: str) -> dict[str, object]:
    """Request of a holder to delegate: the delegate's evidence names its digest."""
    return {"delegate": delegate, "purpose": purpose, "restriction": restriction_to_json(restriction)}
