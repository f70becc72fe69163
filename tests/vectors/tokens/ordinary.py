"""Ordinary case that every vector changes a little: keys, a sponsor, agents, a scope.

Its blocks are written as Datalog text.

The text is formatted here, which is for a forge alone: who issues tokens binds values (docs/spec.md, 2.2).
"""

from __future__ import annotations

import hashlib
import json
import re
from collections.abc import Callable
from typing import Any

import biscuit_auth
from capabilities.keys.keys import b64u
from capabilities.keys.trust import TrustBundle
from capabilities.keys.windows import Window
from capabilities.values.scope import (
    Bound,
    Each,
    Flags,
    Grant,
    Limit,
    OneOf,
    Range,
    Restriction,
    Scope,
    Stems,
    Tier,
    Words,
)
from capabilities.values.units import Parameter, Unit
from tests.vectors.tokens.sealing import Sealed, append, cut, inner, key_of, put, raw_of, seal

NOW = 1_800_000_000
ISSUER = "http://127.0.0.1:8000/ztpm"
CELL = "http://127.0.0.1:9000/mcp"
OTHER_CELL = "http://127.0.0.1:9001/mcp"
ROOT_ID = 7
TOKEN_ID = b64u(b"token-id-16bytes")
AUTHENTICATED_AT = ATTESTED_AT = NOW - 10


def bundle(
    version: int, roots: dict[int, str], attesters: list[str], windows: dict[str, Window] | None = None, **times: int
) -> TrustBundle:
    return TrustBundle(
        windows={raw_of(name): window for name, window in (windows or {}).items()},
        **times,
        issuer=ISSUER,
        version=version,
        roots={number: raw_of(name) for number, name in roots.items()},
        attesters=frozenset(map(raw_of, attesters)),
        feed=frozenset({raw_of("feed")}),
        registry=frozenset({raw_of("registry")}),
        ledger=frozenset({raw_of("ledger")}),
    )


TRUST = {
    "ordinary": bundle(1, {ROOT_ID: "root"}, ["attester", "attester-2"]),
    "attester withdrawn": bundle(2, {ROOT_ID: "root"}, ["attester-2"]),
    "two roots": bundle(3, {ROOT_ID: "root", 8: "root-8", 4_294_967_295: "root-max"}, ["attester", "attester-2"]),
    "root withdrawn": bundle(4, {8: "root-8"}, ["attester", "attester-2"]),
    "robotic attests": bundle(5, {ROOT_ID: "root"}, ["attester", "robotic"]),
    "root for a while": bundle(
        6, {ROOT_ID: "root"}, ["attester", "attester-2"], {"root": Window(not_before=NOW - 5, not_after=NOW + 5)}
    ),
    "attester for a while": bundle(
        7, {ROOT_ID: "root"}, ["attester", "attester-2"], {"attester": Window(not_before=NOW - 5, not_after=NOW + 5)}
    ),
    "root tainted": bundle(8, {ROOT_ID: "root"}, ["attester", "attester-2"], {"root": Window(tainted_at=ATTESTED_AT)}),
    "root tainted later": bundle(
        9, {ROOT_ID: "root"}, ["attester", "attester-2"], {"root": Window(tainted_at=ATTESTED_AT + 1)}
    ),
    "attester tainted": bundle(
        10, {ROOT_ID: "root"}, ["attester", "attester-2"], {"attester": Window(tainted_at=ATTESTED_AT)}
    ),
    "attester tainted later": bundle(
        11, {ROOT_ID: "root"}, ["attester", "attester-2"], {"attester": Window(tainted_at=ATTESTED_AT + 1)}
    ),
    "bundle for a while": bundle(12, {ROOT_ID: "root"}, ["attester", "attester-2"], valid_until=NOW + 5),
}

SPEED = Parameter("speed", Unit.MICRORADIAN_PER_SECOND)
FORCE = Parameter("force", Unit.MILLINEWTON)
WIDTH = Parameter("width", Unit.MICROMETRE)
Q0, Q1 = (Parameter(name, Unit.MICRORADIAN) for name in ("q0", "q1"))
FORCES = OneOf(frozenset({10, 20, 40}))
GRIPPER = Grant("ur3e", "gripper_move", (Limit(WIDTH, Range(0, 85_000)), Limit(FORCE, FORCES)))
MOVE = Grant(
    "ur3e",
    "move_joint",
    (
        Limit(Q0, Range(-3_000_000, 3_000_000)),
        Limit(Q1, Range(-3_000_000, 3_000_000)),
        Limit(SPEED, Range(1, 1_000_000)),
    ),
)
READ = Grant("ur3e", "read_state")
STOP = Grant("ur3e", "stop")
SCOPE = Scope(
    grants=(GRIPPER, MOVE, READ, STOP),
    ceiling=Tier.HIGH_CONSEQUENCE,
    audiences=frozenset({CELL, OTHER_CELL}),
    delegates=frozenset({"robotic", "vision", "gripper", "role:planner"}),
    depth=4,
    not_before=NOW - 60,
    not_after=NOW + 3_000,
)
SMALL = Scope(
    grants=(READ,),
    ceiling=Tier.REVERSIBLE,
    audiences=frozenset({CELL}),
    delegates=frozenset({"robotic", "vision"}),
    depth=2,
    not_before=NOW - 60,
    not_after=NOW + 600,
)
LESS = Restriction(ceiling=Tier.NO_EFFECT)
SLOWER = Restriction(
    grants=(Grant("ur3e", "move_joint", (Limit(SPEED, Range(1, 500_000)),)), READ, STOP),
    delegates=frozenset({"vision", "gripper"}),
    not_after=NOW + 2_000,
)

Says = Callable[[dict[str, Any]], bytes | dict[str, Any] | None]
Terms = Callable[[list[str]], list[str]]
Texts = Callable[[list[str]], list[str]]
Bytes = Callable[[bytes], bytes]


def _same(found: Any) -> Any:
    return found


# --- Datalog ---------------------------------------------------------------------------------------------------------------


def hexed(raw: bytes) -> str:
    return f"hex:{raw.hex()}"


def hop_id_of(agent: str) -> bytes:
    return hashlib.sha256(b"hop " + agent.encode()).digest()[:16]


def _bound(position: int, bound: Bound | None) -> list[str]:
    name = f"$v{position}"
    match bound:
        case Each(element, least, most):
            members = [] if element is None else [f"{name}.all($x -> {test})" for test in _tests("$x", element)]
            return [f"{name}.length() >= {least}", f"{name}.length() <= {most}", *members]
        case None:
            return []
    return _tests(name, bound)


def _tests(name: str, bound: Bound) -> list[str]:
    match bound:
        case Range(low, high):
            return [f"{name} >= {low}", f"{name} <= {high}"]
        case OneOf(values) | Flags(values) | Words(values):
            return [f"{_set(values)}.contains({name})"]
        case Stems(values, ""):
            return [f"{_set(values)}.any($p -> {name}.starts_with($p))"]
        case Stems(values):
            return [
                f'{_set({f"{stem}/" if stem else "" for stem in values})}.any($p -> ({name} + "/").starts_with($p))'
            ]
    raise TypeError("no such bound")


def _set(values: Any) -> str:
    return "{" + ", ".join(json.dumps(value, ensure_ascii=False) for value in sorted(values)) + "}"


def request_check(stated: tuple[Grant, ...], signatures: tuple[Grant, ...]) -> str:
    """The check over the request: the bounds that are stated, over the signatures of the parent."""
    known = {(grant.object, grant.operation): grant for grant in signatures}
    alternatives = []
    for grant in stated:
        bounds = {limit.parameter: limit.bound for limit in grant.limits}
        order = [limit.parameter for limit in known.get((grant.object, grant.operation), grant).limits]
        head = ", ".join(
            [json.dumps(grant.object), json.dumps(grant.operation), *(f"$v{i}" for i in range(len(order)))]
        )
        demands = [text for i, parameter in enumerate(order) for text in _bound(i, bounds.get(parameter))]
        alternatives.append(", ".join([f"req({head})", *demands]))
    return "check if " + " or ".join(alternatives)


def context_check(not_before: int | None, not_after: int | None, ceiling: int | None) -> str:
    """The check over its context."""
    demands = [
        *([] if not_before is None else [f"$time >= {not_before}"]),
        *([] if not_after is None else [f"$time < {not_after}"]),
        *([] if ceiling is None else [f"$tier <= {ceiling}"]),
    ]
    return ", ".join(["check if req_ctx($time, $tier)", *demands])


_WITHOUT_LITERAL = {"none": b"", "true": {True}, "false": {False}}
"""Values that Datalog text has no spelling for: no bytes, and a set of one truth value."""


def compiled(statements: list[str], version: int) -> bytes:
    """Message of a block with these statements, as the library writes it.

    It is of this version of Datalog or the later one that it needs.
    """
    text = re.sub(r"\bhex:(?![0-9a-f])", "{none}", ";\n".join(statements) + ";")
    bound = {name: value for name, value in _WITHOUT_LITERAL.items() if f"{{{name}}}" in text}
    builder = biscuit_auth.BiscuitBuilder(text, bound)
    private = biscuit_auth.PrivateKey.from_bytes(key_of("any").private_bytes_raw(), biscuit_auth.Algorithm.Ed25519)
    signed = next(raw for number, raw in cut(bytes(builder.build(private).to_bytes())) if number == 2)
    fields = cut(inner(cut(inner(signed))[0][1]))
    return b"".join(put(3, max(version, raw[1])) if number == 3 else raw for number, raw in fields)


def stating(*statements: str, version: int = 3) -> bytes:
    return compiled(list(statements), version)


# --- blocks ----------------------------------------------------------------------------------------------------------------


def canonical(value: object) -> bytes:
    return json.dumps(value, ensure_ascii=False, sort_keys=True, separators=(",", ":")).encode("utf-8", "surrogatepass")


def _payload(
    *,
    index: int,
    agent: str,
    key: bytes | None,
    hop_id: bytes | None,
    evidence: str,
    at: int,
    purpose: str,
    role: str,
    members: dict[str, Any],
    checks: list[str],
    says: Says,
    terms: Terms,
    texts: Texts,
    payload: Bytes,
    version: int,
) -> bytes:
    members = {"agent": agent, "at": at, "evidence": evidence, "purpose": purpose, **members}
    if role:
        members["role"] = role
    other = says(members)
    stated = members if other is None else other
    spelled = stated if isinstance(stated, bytes) else canonical(stated)
    found = [
        str(index),
        hexed(hop_id_of(agent) if hop_id is None else hop_id),
        hexed(raw_of(agent) if key is None else key),
        hexed(b"\2" * 32),
        hexed(b"\1" * 32),
        hexed(spelled),
    ]
    statements = [f"hop({', '.join(terms(found))})", *texts(checks)]
    return payload(compiled(statements, version))


def authority_payload(
    scope: Scope = SCOPE,
    *,
    agent: str = "orchestrator",
    key: bytes | None = None,
    hop_id: bytes | None = None,
    evidence: str = "key",
    at: int = ATTESTED_AT,
    purpose: str = "pick the red part",
    role: str = "",
    authenticated_at: int = AUTHENTICATED_AT,
    says: Says = lambda _: None,
    terms: Terms = _same,
    texts: Texts = _same,
    payload: Bytes = _same,
    index: int = 0,
) -> bytes:
    """The message of an authority block for this scope, changed where it is told."""
    return _payload(
        index=index,
        agent=agent,
        key=key,
        hop_id=hop_id,
        evidence=evidence,
        at=at,
        purpose=purpose,
        role=role,
        members={
            "audiences": sorted(scope.audiences),
            "delegates": sorted(scope.delegates),
            "depth": scope.depth,
            "profile": "ztpm/1",
            "token": TOKEN_ID,
            "sponsor": {
                "authenticated_at": authenticated_at,
                "issuer": ISSUER,
                "method": "operator-key",
                "subject": "alice",
            },
            "parameters": [[f"{x.parameter.name}:{x.parameter.kind}" for x in grant.limits] for grant in scope.grants],
        },
        checks=[
            request_check(scope.grants, scope.grants),
            context_check(scope.not_before, scope.not_after, int(scope.ceiling)),
        ],
        says=says,
        terms=terms,
        texts=texts,
        payload=payload,
        version=3,
    )


def authority(scope: Scope = SCOPE, *, signer: str = "root", root_key_id: int | None = ROOT_ID, **other: Any) -> Sealed:
    """A token of one block."""
    return seal(authority_payload(scope, **other), signer=signer, root_key_id=root_key_id)


def hop(
    token: Sealed,
    restriction: Restriction = SLOWER,
    *,
    parent: Scope = SCOPE,
    index: int | None = None,
    agent: str = "robotic",
    key: bytes | None = None,
    hop_id: bytes | None = None,
    evidence: str = "key",
    at: int = ATTESTED_AT,
    purpose: str = "pick the red part",
    role: str = "",
    says: Says = lambda _: None,
    terms: Terms = _same,
    texts: Texts = _same,
    payload: Bytes = _same,
    attester: str | None = "attester",
    version: int | None = 1,
) -> Sealed:
    """The token with one more hop, past every rule."""
    stated = restriction
    members: dict[str, Any] = {}
    if stated.audiences is not None:
        members["audiences"] = sorted(stated.audiences)
    if stated.delegates is not None:
        members["delegates"] = sorted(stated.delegates)
    if stated.depth is not None:
        members["depth"] = stated.depth
    checks = [] if stated.grants is None else [request_check(stated.grants, parent.grants)]
    if not stated.not_before is stated.not_after is stated.ceiling is None:
        ceiling = None if stated.ceiling is None else int(stated.ceiling)
        checks.append(context_check(stated.not_before, stated.not_after, ceiling))
    written = _payload(
        index=len(token.blocks) if index is None else index,
        agent=agent,
        key=key,
        hop_id=hop_id,
        evidence=evidence,
        at=at,
        purpose=purpose,
        role=role,
        members=members,
        checks=checks,
        says=says,
        terms=terms,
        texts=texts,
        payload=payload,
        version=5,
    )
    return append(token, written, attester=attester, version=version)


# --- changes ---------------------------------------------------------------------------------------------------------------


def term(position: int, value: str) -> Terms:
    return lambda found: [*found[:position], value, *found[position + 1 :]]


def member(**changed: Any) -> Says:
    return lambda found: found.update(changed)


def sponsor(**changed: Any) -> Says:
    return lambda found: found["sponsor"].update(changed)


def named_limits(*parameters: Any) -> Says:
    """Other names for the parameters of the only grant."""
    return member(parameters=[list(parameters)])


def without(name: str) -> Says:
    return lambda found: {key: value for key, value in found.items() if key != name}


def spelled(raw: bytes) -> Says:
    return lambda _: raw


def respelled(old: bytes, new: bytes) -> Says:
    def change(found: dict[str, Any]) -> bytes:
        text = canonical(found)
        assert old in text
        return text.replace(old, new, 1)

    return change


def replaced(old: str, new: str) -> Texts:
    """Checks in which the first place of `old` reads `new`."""

    def change(checks: list[str]) -> list[str]:
        text = "\0".join(checks)
        assert old in text, (old, text)
        return text.replace(old, new, 1).split("\0")

    return change


def message(change: Callable[[list[tuple[int, bytes]]], list[tuple[int, bytes]]]) -> Bytes:
    """A block's message with its fields changed."""
    return lambda payload: b"".join(raw for _, raw in change(cut(payload)))


def one_operation(*limits: Limit, name: str = "go", object: str = "arm") -> tuple[Grant, ...]:
    return (Grant(object, name, limits),)


def slug(title: str) -> str:
    return re.sub(r"[^a-z0-9]+", "-", title.lower()).strip("-")
