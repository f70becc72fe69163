"""A world with one of everything, and for each route a request that its right caller may make."""

from __future__ import annotations

import json
import secrets
from dataclasses import dataclass
from urllib.parse import urlencode, urlsplit

from capabilities.keys import keys
from capabilities.statements.people import mandate, picture
from capabilities.statements.people.clearing import Clearing
from capabilities.statements.people.latch import Latch, LatchCause
from capabilities.statements.people.vote import digest_of
from capabilities.values.caps import DEFAULT
from capabilities.values.scope import Tier
from msgspec import structs
from tests.capabilities.statements.people.test_pictures import SHOWN
from tests.unread import unread
from tests.ztpm_idp.asks import PEP, Cell
from tests.ztpm_idp.journals import Journal
from tests.ztpm_idp.login.browser import Browser
from tests.ztpm_idp.login.test_devices import Terminal, confirmed
from tests.ztpm_idp.oauth.speaking import READ, StockClient, declare, limits
from tests.ztpm_idp.oauth.test_code_flow import HIDDEN, Flow
from tests.ztpm_idp.routes.test_endpoints import known as marked
from tests.ztpm_idp.world import AUDIENCE, LOWER, MEASUREMENT, World
from ztpm_idp.client.envelopes import Bounds, around

from capabilities.statements.people import ask, clearing, envelope, latch
from ztpm_idp.client import ClientError, delegate_request, issue_request

OTHER = "http://127.0.0.1:8801/mcp"
FORM = "application/x-www-form-urlencoded"


@dataclass(frozen=True)
class Asked:
    """Path and query of a request below the issuer's, its body, and the token that goes with it."""

    path: str
    body: bytes = b""
    kind: str = "application/json"
    token: str | None = None


def fresh() -> str:
    return keys.b64u(keys.public_raw(keys.generate()))


class Scene:
    """People, agents, points, clients and what was lent; a new request of each route when it is asked for."""

    def __init__(self, world: World) -> None:
        self.world = world
        alice, bob, dan = (world.people[name] for name in ("alice", "bob", "dan"))
        world.person("iris", "auditor")
        world.person("gone", "sponsor")
        for name in ("planner", "helper"):
            world.agent(name)
        world.agent("other", sponsor="bob")
        world.pep()
        for name, audience in (("cell-9", OTHER), ("held", AUDIENCE)):
            world.private[name] = keys.generate()
            alice.register_pep(name, keys.public_raw(world.private[name]), [audience])
        world.private |= {name: keys.generate() for name in ("camera", "stranger")}
        alice.register_sensor(
            "camera", keys.public_raw(world.private["camera"]), calibration="1" * 64, transit_ms=20, audience=AUDIENCE
        )  # fmt: skip
        alice.register_tool(audience=AUDIENCE, name="move", definition_digest="0" * 64, operation="move", base_tier=1)
        dan.confirm_change(bob.propose_login("bob", "https://op.example", "b"))
        self.cell, self.journal = Cell(world, furnished=True), Journal(world, registered=True)
        self.lent = alice.issue(world.agents["planner"], world.scope(), purpose="p")
        self.journal.acted(self.lent.token)
        self.mandate_id = alice.sign_mandate("helper", self.week(), purpose="p")
        declare(world)
        self.client = StockClient(world)
        self.client.register()
        self.browser, self.others = Browser(world), Browser(world)
        self.browser.log_in(alice)
        self.others.log_in(bob)
        terminal, _ = confirmed(world, browser=self.browser)
        world.private["terminal"] = terminal.key
        self.access = self.lend()["access_token"]
        (family, *_) = world.known("alice").get("/oauth/lent").json()
        self.family = family["id"]
        self.alices = (self.mandate_id, self.family, '"active":true')
        alice.disable_person("gone", "left")
        alice.suspend_part("pep", "held", "odd")

    def week(self):
        return self.world.scope(not_after=int(self.world.clock()) + 604_800)

    def log_in(self) -> None:
        """Both browsers are logged in, also where an earlier request ended their sessions."""
        for who, browser in (("alice", self.browser), ("bob", self.others)):
            if browser.get("/ztpm/login/account").status_code != 200:
                browser.cookies.clear()
                browser.log_in(self.world.people[who])

    def lend(self) -> dict:
        self.log_in()
        flow = Flow(self.world, self.browser, self.client)
        return flow.redeem(flow.code()).json()

    def change(self) -> str:
        return self.world.people["dan"].propose_person(
            f"p-{secrets.token_hex(4)}", "P", keys.public_raw(keys.generate()), ["admin"]
        )  # fmt: skip

    def agent(self) -> str:
        name = f"a-{secrets.token_hex(4)}"
        self.world.agent(name, attested=False)
        return name

    def part(self, kind: str) -> str:
        """A new enforcement point or sensor, for one request."""
        name, raw, alice = (
            f"{kind}-{secrets.token_hex(4)}",
            keys.public_raw(keys.generate()),
            self.world.people["alice"],
        )
        if kind == "pep":
            alice.register_pep(name, raw, [OTHER])
        else:
            alice.register_sensor(name, raw, calibration="1" * 64, transit_ms=20, audience=OTHER)
        return name

    def suspended(self, kind: str) -> str:
        name = self.part(kind)
        self.world.people["alice"].suspend_part(kind, name, "odd")
        return name

    def tool(self, *, suspended: bool = False) -> dict:
        name, alice = f"t-{secrets.token_hex(4)}", self.world.people["alice"]
        alice.register_tool(audience=AUDIENCE, name=name, definition_digest="0" * 64, operation="move", base_tier=1)
        if suspended:
            alice.change_tool("suspend", AUDIENCE, name, "odd")
        return {"audience": AUDIENCE, "name": name, "reason": "odd"}

    def person(self) -> str:
        name = f"s-{secrets.token_hex(4)}"
        self.world.person(name, "sponsor")
        return name

    def vote(self) -> tuple[str, str]:
        text = self.cell.text(agent="helper")
        return accepted(self.cell.post("cell-1", "/approvals", {"ask": text}))["ask_id"], text

    def named(self) -> str:
        """A new picture that a record in the ledger names."""
        text = picture.write(structs.replace(SHOWN, omitted=secrets.randbelow(1_000_000)))
        self.journal.pictured(self.journal.request(), text)
        self.journal.ship()
        return text

    def pictured(self) -> str:
        """The digest of a new picture that is kept."""
        digest: str = accepted(self.cell.post("cell-1", "/ledger/pictures", {"picture": self.named()}))["digest"]
        return digest

    def envelope(self) -> str:
        shown = ask.open(self.cell.text(agent="helper"), {keys.public_raw(self.world.private["cell-1"])}, DEFAULT)
        bounds = Bounds(index_milli=2_700, speed_um_s=250_000, uses=3, lifetime_s=300, room={"q0": 1_000})
        made = around(shown, bounds, approver="carol", envelope_id=secrets.token_hex(16), at=self.cell.now)
        return unread(envelope, made, self.world.private["carol"])

    def scope_name(self) -> str:
        name = f"camera.{secrets.token_hex(4)}"
        declare(self.world, name)
        return name

    def login_of(self, person: str) -> dict:
        subject = secrets.token_hex(4)
        change = self.world.people[person].propose_login(person, "https://op.example", subject)
        self.world.people["dan"].confirm_change(change)
        return {"issuer": "https://op.example", "subject": subject}

    def link(self) -> str:
        return urlsplit(self.world.people["alice"].login_link()).path.removeprefix("/ztpm")

    def waiting(self) -> str:
        self.world.clock.at_s += 1
        return Terminal(self.world).waiting.user_code

    def assent(self) -> Asked:
        found = dict(HIDDEN.findall(Flow(self.world, self.browser, self.client).page().text))
        asked = {name: found[name].replace("&amp;", "&") for name in ("asked", "shown")}
        return form_of("/oauth/authorize", **asked, answer="allow")

    def asked(self, at: str) -> Asked:
        """A request of a route, such as its right caller may make now."""
        made = (REQUESTS | PAGES | GRANTS)[at](self)
        return made if isinstance(made, Asked) else json_of(*made)


def accepted(answer) -> dict:
    """The answer to what was made.

    Raises:
        ClientError: for a refusal, as a store gives it that is full.
    """
    told = answer.json()
    if answer.status_code != 201:
        raise ClientError(told["code"], answer.status_code, told["detail"])
    return told


def json_of(path: str, body: object = None, token: str | None = None) -> Asked:
    return Asked(path, b"" if body is None else json.dumps(body).encode(), token=token)


def form_of(path: str, **fields: str) -> Asked:
    return Asked(path, urlencode(fields).encode(), FORM)


def _reason(path):
    return lambda s: (path(s), {"reason": "odd"})


def _tokens(s: Scene):
    request = issue_request("helper", s.world.scope(), purpose="p")
    return "/tokens", {"request": request, "evidence": s.world.agents["helper"].evidence("alice", request)}


def _delegated(s: Scene):
    request = delegate_request("helper", LOWER, purpose="p")
    evidence = s.world.agents["helper"].evidence("planner", request)
    return "/tokens/delegate", {"request": request, "evidence": evidence}, s.lent.token


def _mandate(s: Scene):
    text = s.world.people["alice"].mandate(s.mandate_id)["mandate"]
    promised = structs.replace(mandate.read_again(text), mandate_id=secrets.token_hex(16))
    return "/mandates", {"mandate": mandate.sign(promised, s.world.private["alice"])}


def _drawn(s: Scene):
    request = {"lifetime_s": 60, "mandate_id": s.mandate_id}
    evidence = s.world.agents["helper"].evidence("alice", request)
    return f"/mandates/{s.mandate_id}/tokens", {"request": request, "evidence": evidence}


def _vote(s: Scene):
    ask_id, text = s.vote()
    return f"/approvals/{ask_id}/votes", {"vote": s.cell.vote(text)}


def _passkey_vote(s: Scene):
    ask_id, _ = s.vote()
    nothing = {"credential": "AA", "authenticator": "AA", "client": "AA", "signature": "AA"}
    return f"/approvals/{ask_id}/passkey-votes", {"vote": {}, "assertion": nothing}


def _opened(s: Scene):
    opened = s.world.people["carol"].open_tier_4(
        audience=AUDIENCE, agent="helper", object="ur3e", operation="move_joint"
    )  # fmt: skip
    return f"/openings/{opened}/withdraw", {"reason": "odd"}


def _enveloped(s: Scene):
    text = s.envelope()
    accepted(s.cell.post("carol", "/envelopes", {"envelope": text}))
    found = next(row for row in s.world.people["carol"].envelopes() if row["envelope"] == text)
    return f"/envelopes/{found['envelope_id']}/revoke", {"reason": "odd"}


def _fallen(s: Scene) -> str:
    stated = Latch(
        latch_id=secrets.token_hex(16), issuer=s.world.issuer, pep=PEP, audience=AUDIENCE, robot="ur3e",
        cause=LatchCause.WATCH, reason="", tier=Tier(1), approvers=1, request_id="", at=s.cell.now, no_retreat="BUSY",
    )  # fmt: skip
    return unread(latch, stated, s.world.private[PEP])


def _latched(s: Scene) -> tuple[str, str]:
    text = _fallen(s)
    return accepted(s.cell.post(PEP, "/latches", {"latch": text}))["latch_id"], text


def _cleared(s: Scene):
    latch_id, text = _latched(s)
    at = s.cell.now
    stated = Clearing(latch_id, digest_of(text), AUDIENCE, "ur3e", LatchCause.WATCH, "carol", at + 60, at)
    return f"/latches/{latch_id}/clearings", {"clearing": unread(clearing, stated, s.world.private["carol"])}


def _passkey_clearing(s: Scene):
    nothing = {"credential": "AA", "authenticator": "AA", "client": "AA", "signature": "AA"}
    return f"/latches/{_latched(s)[0]}/passkey-clearings", {"clearing": {}, "assertion": nothing}


def _lent(s: Scene):
    lent = lambda: {row["id"] for row in s.world.known("alice").get("/oauth/lent").json()}
    before = lent()
    s.lend()
    (family,) = lent() - before
    return f"/oauth/lent/{family}/end", {"reason": "odd"}


def _agent(**more):
    return lambda s: (
        "/agents",
        {"id": f"a-{secrets.token_hex(4)}", "key": fresh(), "software_digest": MEASUREMENT.hex(), "model": "m", "role": "r", "sponsor": "alice"} | more,
    )  # fmt: skip


def _restorable(s: Scene) -> str:
    name = s.agent()
    s.world.people["alice"].suspend_agent(name, "odd")
    return f"/agents/{name}/restore"


PEOPLE_LISTS = (
    "/people",
    "/changes",
    "/openings",
    "/envelopes",
    "/latches",
    "/mandates",
    "/agents",
    "/peps",
    "/sensors",
    "/tools",
)
OPEN_READS = (
    "/livez", "/healthz", "/readyz", "/trust", "/trust/signed", "/passkeys/passkey.js", "/oauth/jwks",
    "/.well-known/oauth-authorization-server", "/.well-known/oauth-protected-resource", "/openapi.json", "/metrics",
    "/.well-known/openid-configuration",
)  # fmt: skip
NONCE = "n" * 32
REQUESTS = {
    **{f"GET {path}": (lambda path: lambda s: (path,))(path) for path in (*PEOPLE_LISTS, *OPEN_READS)},
    "GET /.well-known/oauth-authorization-server{path:path}": lambda s: ("/.well-known/oauth-authorization-server/ztpm",),
    "GET /.well-known/openid-configuration{path:path}": lambda s: ("/.well-known/openid-configuration/ztpm",),
    "GET /.well-known/oauth-protected-resource{path:path}": lambda s: ("/.well-known/oauth-protected-resource/ztpm",),
    "GET /people/{id_}/allowances": lambda s: ("/people/alice/allowances",),
    "POST /agents": _agent(),
    "POST /agents/{id_}/attestations": lambda s: ("/agents/helper/attestations", {"evidence": s.world.agents["helper"]._evidence("", bytes(32))}),
    "POST /agents/{id_}/suspend": _reason(lambda s: f"/agents/{s.agent()}/suspend"),
    "POST /agents/{id_}/retire": _reason(lambda s: f"/agents/{s.agent()}/retire"),
    "POST /agents/{id_}/restore": _reason(_restorable),
    "POST /agents/{id_}/vouch": _reason(lambda s: f"/agents/{s.agent()}/vouch"),
    "POST /agents/{id_}/trust": lambda s: ("/agents/helper/trust", {"permille": 500}),
    "POST /agents/{id_}/key": lambda s: (f"/agents/{s.agent()}/key", {"key": fresh(), "reason": "odd"}),
    "POST /peps": lambda s: ("/peps", {"id": f"p-{secrets.token_hex(4)}", "key": fresh(), "audiences": [OTHER]}),
    "POST /peps/{id_}/suspend": _reason(lambda s: f"/peps/{s.part('pep')}/suspend"),
    "POST /peps/{id_}/restore": _reason(lambda s: f"/peps/{s.suspended('pep')}/restore"),
    "POST /peps/{id_}/retire": _reason(lambda s: f"/peps/{s.part('pep')}/retire"),
    "POST /peps/{id_}/key": lambda s: (f"/peps/{s.part('pep')}/key", {"key": fresh(), "reason": "odd"}),
    "POST /sensors": lambda s: (
        "/sensors",
        {"id": f"c-{secrets.token_hex(4)}", "key": fresh(), "calibration": "0" * 64, "transit_ms": 20, "audience": OTHER},
    ),
    "POST /sensors/{id_}/suspend": _reason(lambda s: f"/sensors/{s.part('sensor')}/suspend"),
    "POST /sensors/{id_}/restore": _reason(lambda s: f"/sensors/{s.suspended('sensor')}/restore"),
    "POST /sensors/{id_}/retire": _reason(lambda s: f"/sensors/{s.part('sensor')}/retire"),
    "POST /sensors/{id_}/key": lambda s: (f"/sensors/{s.part('sensor')}/key", {"key": fresh(), "reason": "odd"}),
    "POST /tools": lambda s: (
        "/tools",
        {"audience": OTHER, "name": f"t-{secrets.token_hex(4)}", "definition_digest": "0" * 64, "operation": "move", "base_tier": 1},
    ),
    "POST /tools/suspend": lambda s: ("/tools/suspend", s.tool()),
    "POST /tools/restore": lambda s: ("/tools/restore", s.tool(suspended=True)),
    "POST /tools/retire": lambda s: ("/tools/retire", s.tool()),
    "POST /nonces": lambda s: ("/nonces", {}),
    "GET /registry": lambda s: (f"/registry?audience={AUDIENCE}",),
    "POST /people": lambda s: ("/people", {"id": f"e-{secrets.token_hex(4)}", "name": "Eve", "key": fresh(), "roles": ["sponsor"]}),
    "POST /people/{id_}/disable": _reason(lambda s: f"/people/{s.person()}/disable"),
    "POST /changes/person": lambda s: (
        "/changes/person", {"id": f"e-{secrets.token_hex(4)}", "name": "Eve", "key": fresh(), "roles": ["approver"]},
    ),
    "POST /changes/key": lambda s: ("/changes/key", {"key": fresh()}),
    "POST /changes/login": lambda s: ("/changes/login", {"person": "carol", "issuer": "https://op.example", "subject": secrets.token_hex(4)}),
    "POST /changes/roles": lambda s: ("/changes/roles", {"person": s.person(), "roles": ["auditor"]}),
    "POST /changes/end": lambda s: ("/changes/end", {"person": s.person(), "reason": "left"}),
    "POST /changes/{change_id}/confirm": lambda s: (f"/changes/{s.change()}/confirm", {}),
    "POST /changes/{change_id}/decline": _reason(lambda s: f"/changes/{s.change()}/decline"),
    "POST /changes/passkey": lambda s: ("/changes/passkey", {"enrolment_id": "0" * 32, "key": fresh()}),
    "POST /logins/end": lambda s: ("/logins/end", s.login_of("bob")),
    "POST /recoveries": lambda s: ("/recoveries", {"person": f"r-{secrets.token_hex(4)}", "name": "R", "key": fresh()}),
    "POST /passkeys/enrolments": lambda s: ("/passkeys/enrolments", {}),
    "GET /passkeys/enrolments/{enrolment_id}": lambda s: (f"/passkeys/enrolments/{'0' * 32}",),
    "GET /passkeys/enrolments/{enrolment_id}/page": lambda s: (f"/passkeys/enrolments/{'0' * 32}/page",),
    "POST /passkeys/enrolments/{enrolment_id}/credential": lambda s: (f"/passkeys/enrolments/{'0' * 32}/credential", {"credential": {}}),
    "POST /approvals/{ask_id}/passkey-votes": _passkey_vote,
    "POST /tokens": _tokens,
    "POST /tokens/delegate": _delegated,
    "POST /revocations": lambda s: ("/revocations", {"kind": "agent", "id": s.agent(), "reason": "odd"}),
    "GET /revocations": lambda s: (f"/revocations?since=0&nonce={NONCE}",),
    "GET /revocations/wait": lambda s: ("/revocations/wait?since=0",),
    "GET /revocations/events": lambda s: ("/revocations/events?since=-",),
    "GET /revocations/points": lambda s: ("/revocations/points",),
    "POST /revocations/marks": lambda s: ("/revocations/marks", {"mark": marked(s.world)}),
    "POST /mandates": _mandate,
    "GET /mandates/{mandate_id}": lambda s: (f"/mandates/{s.mandate_id}",),
    "POST /mandates/{mandate_id}/tokens": _drawn,
    "POST /ledger/records": lambda s: ("/ledger/records", {"records": s.journal.made}),
    "POST /ledger/pictures": lambda s: ("/ledger/pictures", {"picture": s.named()}),
    "GET /ledger/pictures/{digest}": lambda s: (f"/ledger/pictures/{s.pictured()}",),
    "GET /ledger/export": lambda s: ("/ledger/export",),
    "GET /ledger/checkpoint": lambda s: ("/ledger/checkpoint",),
    "GET /ledger/proofs/inclusion": lambda s: ("/ledger/proofs/inclusion?entry=1",),
    "GET /ledger/proofs/consistency": lambda s: ("/ledger/proofs/consistency?old=1",),
    "GET /ledger/entries/{number}": lambda s: ("/ledger/entries/1",),
    "GET /ledger/search": lambda s: ("/ledger/search?actor=alice",),
    "POST /approvals": lambda s: ("/approvals", {"ask": s.cell.text(agent="helper")}),
    "GET /approvals/answers": lambda s: (f"/approvals/answers?audience={AUDIENCE}&nonce={NONCE}",),
    "GET /approvals": lambda s: ("/approvals?state=open",),
    "GET /approvals/{ask_id}": lambda s: (f"/approvals/{s.vote()[0]}",),
    "GET /approvals/{ask_id}/page": lambda s: (f"/approvals/{s.vote()[0]}/page",),
    "GET /approvals/{ask_id}/picture": lambda s: (f"/approvals/{s.vote()[0]}/picture",),
    "GET /approvals/{ask_id}/state": lambda s: (f"/approvals/{s.vote()[0]}/state",),
    "GET /approvals/assets/{name}": lambda s: ("/approvals/assets/ask.js",),
    "POST /approvals/{ask_id}/votes": _vote,
    "POST /openings": lambda s: ("/openings", {"opening": s.cell.opening("carol", agent="helper")}),
    "POST /openings/{opening_id}/withdraw": _opened,
    "POST /latches": lambda s: ("/latches", {"latch": _fallen(s)}),
    "GET /latches": lambda s: ("/latches",),
    "GET /latches/{latch_id}": lambda s: (f"/latches/{_latched(s)[0]}",),
    "GET /latches/{latch_id}/page": lambda s: (f"/latches/{_latched(s)[0]}/page",),
    "POST /latches/{latch_id}/clearings": _cleared,
    "POST /latches/{latch_id}/passkey-clearings": _passkey_clearing,
    "POST /envelopes": lambda s: ("/envelopes", {"envelope": s.envelope()}),
    "POST /envelopes/{envelope_id}/revoke": _enveloped,
    "GET /conduct": lambda s: (f"/conduct?since=0&nonce={NONCE}",),
    "POST /restoring/marks": lambda s: ("/restoring/marks", {"mark": marked(s.world)}),
    "POST /restoring/resume": lambda s: ("/restoring/resume", {"unheard": []}),
    "POST /oauth/clients": lambda s: (
        "/oauth/clients", {"client_id": f"v-{secrets.token_hex(4)}", "name": "V", "sponsor": "alice", "redirect_uris": []},
    ),
    "GET /oauth/clients": lambda s: ("/oauth/clients",),
    "POST /oauth/scopes/{name}": lambda s: (
        f"/oauth/scopes/{s.scope_name()}", {"words": "see", "audience": AUDIENCE, **limits(READ)},
    ),
    "POST /oauth/scopes/{name}/end": lambda s: (f"/oauth/scopes/{s.scope_name()}/end", {}),
    "GET /oauth/scopes": lambda s: ("/oauth/scopes",),
    "GET /oauth/lent": lambda s: ("/oauth/lent",),
    "POST /oauth/lent/{family}/end": _lent,
    "POST /oauth/introspect": lambda s: form_of("/oauth/introspect", token=s.access),
    "POST /oauth/token": lambda s: form_of("/oauth/token", grant_type="refresh_token", client_id="viewer", refresh_token="A" * 43),
    "POST /oauth/revoke": lambda s: form_of("/oauth/revoke", client_id="viewer", token="A" * 43),
    "OPTIONS /oauth/token": lambda s: ("/oauth/token",),
    "OPTIONS /oauth/revoke": lambda s: ("/oauth/revoke",),
    "POST /login/links": lambda s: ("/login/links", {}),
    "POST /login/devices": lambda s: ("/login/devices", {"name": "laptop"}),
    "POST /login/devices/poll": lambda s: ("/login/devices/poll", {"device_code": "A" * 43}),
}  # fmt: skip
"""A request of each route that is no page."""
SECRET = "A" * 43
PAGES = {
    "GET /login": lambda s: Asked("/login"),
    "GET /approvals/page": lambda s: Asked("/approvals/page"),
    "GET /approvals/page/open": lambda s: Asked("/approvals/page/open"),
    "POST /approvals/page/devices": lambda s: form_of("/approvals/page/devices", endpoint="A", p256dh="A", auth="A"),
    "POST /approvals/page/devices/end": lambda s: form_of("/approvals/page/devices/end", device="A"),
    "GET /login/account": lambda s: Asked("/login/account"),
    "GET /login/device": lambda s: Asked("/login/device"),
    "GET /login/links/{secret}": lambda s: Asked(s.link()),
    "POST /login/links/{secret}": lambda s: form_of(s.link()),
    "POST /login/passkey": lambda s: form_of(
        "/login/passkey", credential="AA", authenticator="AA", client="AA", signature="AA"
    ),
    "POST /login/device": lambda s: form_of("/login/device", code=s.waiting()),
    "POST /login/device/answer": lambda s: form_of("/login/device/answer", code=s.waiting(), answer="confirm"),
    "POST /login/keys/end": lambda s: form_of("/login/keys/end", thumbprint="A" * 43),
    "POST /login/providers/{name}": lambda s: form_of("/login/providers/none", fresh_s=""),
    "GET /login/providers/{name}/callback": lambda s: Asked(
        f"/login/providers/none/callback?code={SECRET}&state={SECRET}"
    ),
    "GET /oauth/authorize": lambda s: Asked(f"/oauth/authorize?{urlencode(Flow(s.world, s.browser, s.client).asked)}"),
    "POST /oauth/authorize": lambda s: s.assent(),
    "POST /login/end": lambda s: form_of("/login/end"),
    "GET /console": lambda s: Asked("/console"),
    "GET /console/assets/{name}": lambda s: Asked("/console/assets/console.css"),
    "GET /console/tree": lambda s: Asked("/console/tree"),
    "GET /console/tree/sponsors/{id_}": lambda s: Asked("/console/tree/sponsors/alice"),
    "GET /console/tree/hops/{hop_id}": lambda s: Asked(f"/console/tree/hops/{s.lent.hop_id}"),
    "GET /console/revoke": lambda s: Asked(f"/console/revoke?kind=hop&id={s.lent.hop_id}"),
    "GET /console/revocations/{epoch}": lambda s: Asked(
        f"/console/revocations/{s.world.people['alice'].revoke('agent', s.agent(), 'odd')}"
    ),
    "POST /console/revocations": lambda s: form_of(
        "/console/revocations",
        kind="hop",
        id=s.lent.hop_id,
        reason="odd",
        sealed="AA",
        credential="AA",
        authenticator="AA",
        client="AA",
        signature="AA",
    ),  # fmt: skip
    "GET /console/acts/{name}": lambda s: Asked("/console/acts/suspend-agent?agent=helper&reason=odd"),
    "POST /console/acts": lambda s: form_of(
        "/console/acts", sealed="AAAA.AAAA", credential="AAAA", authenticator="AAAA", client="AAAA", signature="AAAA"
    ),
    "GET /console/trail": lambda s: Asked("/console/trail"),
    "GET /console/trail/export": lambda s: Asked("/console/trail/export?kind=revoked"),
    "GET /console/trail/entries/{number}": lambda s: Asked("/console/trail/entries/1"),
    "GET /console/trail/entries/{number}/line": lambda s: Asked("/console/trail/entries/1/line"),
    "GET /console/trail/entries/{number}/proof": lambda s: Asked("/console/trail/entries/1/proof"),
    "GET /console/trail/pictures/{digest}": lambda s: Asked(f"/console/trail/pictures/{s.pictured()}"),
    "GET /console/trail/requests/{request_id}": lambda s: Asked(f"/console/trail/requests/{s.vote()[0]}"),
    "GET /console/people": lambda s: Asked("/console/people"),
    "GET /console/agents": lambda s: Asked("/console/agents"),
    "GET /console/agents/{id_}": lambda s: Asked("/console/agents/helper"),
}
"""A request of each page and form, without the token of its page."""


def _code(s: Scene) -> Asked:
    s.log_in()
    flow = Flow(s.world, s.browser, s.client)
    form = {
        "grant_type": "authorization_code",
        "client_id": "viewer",
        "code": flow.code(),
        "code_verifier": flow.verifier,
    }
    return form_of("/oauth/token", **form, redirect_uri=flow.asked["redirect_uri"], resource=AUDIENCE)


def _refreshed(s: Scene) -> Asked:
    form = {"grant_type": "refresh_token", "client_id": "viewer", "refresh_token": s.lend()["refresh_token"]}
    return form_of("/oauth/token", **form)


GRANTS = {
    "POST /oauth/token by code": _code,
    "POST /oauth/token by refresh token": _refreshed,
    "POST /oauth/revoke of a refresh token": lambda s: form_of(
        "/oauth/revoke", client_id="viewer", token=s.lend()["refresh_token"]
    ),
    "POST /oauth/revoke of an access token": lambda s: form_of(
        "/oauth/revoke", client_id="viewer", token=s.lend()["access_token"]
    ),
}
"""Requests of a client that change the state."""
