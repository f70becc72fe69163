"""Requests that schemathesis makes of the API's own description, and what every answer must be.

Cases are drawn from /openapi.json: right ones, and ones with one thing wrong. Each is sent as it was drawn by callers of
every role, signed over its exact body.
"""

from __future__ import annotations

import contextlib
import json
import warnings
from collections import Counter
from dataclasses import dataclass, field
from itertools import cycle

import schemathesis
import sqlalchemy as sa
from capabilities.keys import keys
from capabilities.values.scope_json import restriction_to_json, scope_to_json
from hypothesis import HealthCheck, Phase, Verbosity, given, seed, settings
from hypothesis.errors import Unsatisfiable
from policies.words.reason_table import Reason
from schemathesis import GenerationMode
from schemathesis.checks import (
    content_type_conformance,
    negative_data_rejection,
    response_schema_conformance,
    status_code_conformance,
)
from schemathesis.core.failures import Failure, FailureGroup
from schemathesis.core.transport import Response
from tests.ztpm_idp.hostile.callers import STRANGERS, Callers
from tests.ztpm_idp.hostile.wire import ORIGIN, Answer, send
from tests.ztpm_idp.oauth.speaking import limits
from tests.ztpm_idp.world import AUDIENCE, LOWER
from ztpm_idp.oauth.problem import OAuthError
from ztpm_idp.provider.problems import DECIDED, STATUS
from ztpm_idp.store.schema import metadata

MODES = {"right": GenerationMode.POSITIVE, "wrong": GenerationMode.NEGATIVE}
CHECKS = [status_code_conformance, content_type_conformance, response_schema_conformance]
OF_CLIENTS = {"/ztpm/oauth/token", "/ztpm/oauth/introspect", "/ztpm/oauth/revoke"}
ENDLESS = {"/ztpm/revocations/wait", "/ztpm/revocations/events"}
"""Answers that a client who hangs up does not hear."""
FORGETFUL = {"proofs", "nonces", "heartbeat", "ledger_tiles", "ledger_index", "ledger_followed", "feed_points"}
"""Tables that are written beside what is asked for: of uses, of beats, of what follows the ledger."""


@dataclass
class Found:
    """Figures of a run: requests by role and status, and what was wrong with answers."""

    sent: Counter = field(default_factory=Counter)
    statuses: Counter = field(default_factory=Counter)
    codes: Counter = field(default_factory=Counter)
    unsendable: int = 0
    wrong: dict[str, str] = field(default_factory=dict)

    def fault(self, what: str, where: str) -> None:
        self.wrong.setdefault(what, where)


def document(world) -> dict:
    """The description, as callers read it."""
    return world.anonymous().get("/openapi.json").json()


def operations(described: dict) -> list:
    """Every operation of the description; proofs are made by callers, not drawn."""
    warnings.simplefilter("ignore")
    for verbs in described["paths"].values():
        for operation in verbs.values():
            operation.pop("security", None)
    return [found.ok() for found in schemathesis.openapi.from_dict(described).get_all_operations()]


def near(described: dict, callers: Callers) -> dict:
    """The description with members whose values are those of the callers' world: what is drawn then goes further in."""
    world, fresh = callers.world, lambda: keys.b64u(keys.public_raw(keys.generate()))
    scope = scope_to_json(world.scope(delegates=frozenset({"helper"})))
    known = {
        "key": [fresh() for _ in range(8)],
        "sponsor": ["sponsor", "alice", "agent"],
        "agent": ["agent", "helper", "viewer", "nobody"],
        "delegate": ["helper", "agent"],
        "person": ["sponsor", "approver", "late", "new-person"],
        "id": ["agent", "helper", "pep", "new-party", "sponsor"],
        "audience": [AUDIENCE, "https://elsewhere.example/mcp"],
        "audiences": [[AUDIENCE], [AUDIENCE, AUDIENCE], ["https://elsewhere.example/mcp"]],
        "evidence": [world.agents[name].evidence("sponsor", {}) for name in ("agent", "helper")],
        "scope": [scope, scope | {"depth": 99}, {}],
        "restriction": [restriction_to_json(LOWER), {}],
        "grants": [limits()["grants"], []],
        "mandate_id": ["0" * 32],
        "unheard": [[], ["cell-1"], ["cell-1", "pep"]],
        "resource": [AUDIENCE],
        "client_id": ["viewer"],
        "grant_type": ["authorization_code", "refresh_token", "client_credentials", "urn:ietf:params:oauth:grant-type:token-exchange"],
    }  # fmt: skip

    def walk(schema):
        match schema:
            case dict():
                stated = schema.get("properties", {})
                inner = {name: {"enum": known[name]} if name in known else walk(of) for name, of in stated.items()}
                return {name: walk(of) for name, of in schema.items() if name != "properties"} | (
                    {"properties": inner} if stated else {}
                )
            case list():
                return [walk(of) for of in schema]
            case _:
                return schema

    return described | {
        "paths": {
            path: {
                verb: operation
                | ({"requestBody": walk(operation["requestBody"])} if "requestBody" in operation else {})
                for verb, operation in verbs.items()
            }
            for path, verbs in described["paths"].items()
        }
    }


def play(callers: Callers, operation, roles, found: Found, *, mode: str, cases: int, number: int, known: bool) -> None:
    """Sends cases of one operation, each by every role that signs and by the strangers in turn.

    Args:
        mode: of `MODES`.
        number: seed.
        known: the path names things that are there.
    """
    path = {
        name: callers.known[name][number % len(callers.known[name])]
        for name in callers.known
        if f"{{{name}}}" in operation.path
    }
    strategy = operation.as_strategy(
        generation_mode=MODES[mode], **({"path_parameters": path} if known and path else {})
    )

    turns = cycle([role for role in roles if role in STRANGERS])

    @seed(number)
    @settings(
        max_examples=cases, database=None, deadline=None, phases=[Phase.generate], verbosity=Verbosity.quiet,
        suppress_health_check=list(HealthCheck),
    )  # fmt: skip
    @given(case=strategy)
    def each(case) -> None:
        for role in (*(role for role in roles if role not in STRANGERS), next(turns)):
            one(callers, case, role, found, mode=mode)

    with contextlib.suppress(Unsatisfiable):
        each()


def one(callers: Callers, case, role: str, found: Found, *, mode: str) -> None:
    """One case by one role."""
    prepared = _prepared(case)
    if prepared is None:
        found.unsendable += 1
        return
    method, url, headers, body = prepared
    world = callers.world
    headers = [(name, value) for name, value in headers if name.lower() not in {"dpop", "cookie"}]
    headers += callers.headers(role, method, url, body)
    idle = role in STRANGERS and case.operation.label not in CHANGING
    before = counted(world) if idle else {}
    answer = world.on_loop(send(world.app, method, url, headers, body))
    found.sent[role] += 1
    found.statuses[answer.status] += 1
    where = f"{role} {mode} {method} {url} {body[:300]!r} -> {answer.status} {answer.body[:300]!r}"
    if what := wrong(case, answer, found, (method, url, headers, body)):
        found.fault(f"{case.operation.label}: {what}", where)
    if mode == "wrong" and 200 <= answer.status < 300 and (what := _conforms(case, answer, [negative_data_rejection])):
        found.fault(f"{case.operation.label}: {what}", where)
    if idle and (after := counted(world)) != before:
        found.fault(f"{case.operation.label}: {role} changed the state", f"{where} {before} {after}")
    if role in STRANGERS and case.operation.label not in OPEN and 200 <= answer.status < 300:
        found.fault(f"{case.operation.label}: {role} was let in", where)


OPEN = {
    "GET /ztpm/healthz", "GET /ztpm/livez", "GET /ztpm/metrics", "GET /ztpm/readyz", "GET /ztpm/trust", "GET /ztpm/trust/signed",
    "GET /ztpm/passkeys/passkey.js", "GET /ztpm/passkeys/enrolments/{enrolment_id}/page", "GET /ztpm/approvals/{ask_id}/page",
    "GET /ztpm/approvals/{ask_id}/picture", "GET /ztpm/approvals/{ask_id}/state", "GET /ztpm/approvals/assets/{name}",
    "GET /ztpm/latches/{latch_id}/page",
    "GET /ztpm/revocations", "GET /ztpm/revocations/wait", "GET /ztpm/revocations/events", "GET /ztpm/oauth/jwks",
    "GET /ztpm/.well-known/oauth-authorization-server", "GET /ztpm/.well-known/oauth-protected-resource",
    "GET /ztpm/.well-known/openid-configuration",
    "POST /ztpm/login/devices", "POST /ztpm/oauth/revoke",
}  # fmt: skip
"""Operations that answer everybody."""
CHANGING = {"POST /ztpm/login/devices"}
"""Operations that keep what a stranger asks.

A command line waits under a key that nobody knows, one of few, until a person confirms it.
"""


def wrong(case, answer: Answer, found: Found, sent) -> str:
    """Fault of an answer, or nothing."""
    path = case.operation.path
    if answer.status == 0:
        return "" if path in ENDLESS else "no answer"
    if answer.status >= 500:
        return "an error of ours"
    if answer.status >= 400:
        return refused(path, answer, found) or _conforms(case, answer, CHECKS, sent)
    return _conforms(case, answer, CHECKS, sent)


def refused(path: str, answer: Answer, found: Found) -> str:
    """Fault of the form of a refusal, or nothing."""
    kind = answer.header("content-type")
    if kind == "application/json" and path in OF_CLIENTS:
        told = json.loads(answer.body)
        found.codes[told.get("error")] += 1
        return (
            ""
            if told.keys() == {"error", "error_description"} and told["error"] in set(OAuthError)
            else "no OAuth error"
        )
    if kind != "application/problem+json":
        return f"a refusal as {kind or 'nothing'}"
    told = json.loads(answer.body)
    if (
        not {"type", "title", "status", "code", "detail"}
        <= told.keys()
        <= {"type", "title", "status", "code", "detail", "explanation"}
    ):
        return "members of a problem"
    found.codes[told["code"]] += 1
    right = {status for code, (status, _) in STATUS.items() if code.value == told["code"]}
    right |= {DECIDED[0] for reason in Reason if reason.value == told["code"]}
    if told["status"] != answer.status or answer.status not in right:
        return f"{told['code']} is in no table, or with another status"
    return "" if answer.header("cache-control") == "no-store" else "a refusal that may be kept"


def _prepared(case) -> tuple[str, str, list[tuple[str, str]], bytes] | None:
    """Method, URL, headers and body of a case, or None for one that no client can send."""
    try:
        asked = case.as_transport_kwargs(base_url=ORIGIN)
        import requests

        made = requests.Request(
            **{k: v for k, v in asked.items() if k not in {"timeout", "verify", "allow_redirects"}}
        ).prepare()
        body = made.body or b""
        body = body.encode() if isinstance(body, str) else bytes(body)
        headers = [
            (str(name), value if isinstance(value, str) else value.decode("latin-1"))
            for name, value in made.headers.items()
        ]
        for name, value in headers:
            (name + value).encode("latin-1")
        made.url.encode("ascii")
    except (ValueError, TypeError, UnicodeError, requests.RequestException):
        return None
    return made.method, made.url, headers, body


def _conforms(case, answer: Answer, checks, sent=None) -> str:
    import requests

    method, url, headers, body = sent or ("GET", ORIGIN, [], b"")
    request = requests.PreparedRequest()
    request.method, request.url, request.body = method, url, body
    request.headers = requests.structures.CaseInsensitiveDict(headers)
    response = Response(answer.status, answer.headers, answer.body, request, 0.0, False)
    try:
        case.validate_response(response, checks=checks)
    except FailureGroup as failures:
        return "; ".join(sorted({each.title for each in failures.exceptions}))
    except Failure as failure:
        return failure.title
    return ""


def counted(world) -> dict[str, int]:
    """Number of rows of every table that holds an effect."""
    names = [table.name for table in metadata.sorted_tables if table.name not in FORGETFUL]
    select = " UNION ALL ".join(f"SELECT '{name}', (SELECT count(*) FROM {name})" for name in names)

    async def go():
        async with world.provider.store._engine.connect() as connection:
            return {row[0]: row[1] for row in await connection.execute(sa.text(select))}

    return world.on_loop(go())
