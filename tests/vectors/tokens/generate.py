"""Writes the conformance vectors.

    python -m tests.vectors.tokens.generate          expectations again, from the tokens in the files, by our verifier
    python -m tests.vectors.tokens.generate --mint   new tokens as well (of the groups that are named behind, or all)

An author states by hand what is expected (`groups`); nothing is written when our verifier says otherwise.
"""

from __future__ import annotations

import argparse
import json
import sys
from typing import Any

from capabilities.token import biscuit, scope_check, wire
from capabilities.token.token_text import token_from_text, token_to_text
from capabilities.token.verify import Verifier
from capabilities.values.caps import DEFAULT
from capabilities.values.errors import Fault
from capabilities.values.scope_json import scope_from_json, scope_to_json
from tests.vectors.tokens import codec
from tests.vectors.tokens.cases import Accepted, Case, Faulty, Group, Permitted, Refused
from tests.vectors.tokens.ordinary import CELL, NOW, TRUST
from tests.vectors.tokens.sealing import Sealed


def all_groups() -> tuple[Group, ...]:
    from tests.vectors.tokens.groups import (  # noqa: PLC0415 - what is minted from is needed here alone
        accepted,
        agreement,
        budgets,
        chain,
        checks,
        container,
        contents,
        kinds,
        moment,
        requests,
        values,
    )

    modules = (container, contents, values, checks, chain, moment, requests, agreement, accepted, kinds, budgets)
    return tuple(group for module in modules for group in module.GROUPS)


def new_world() -> dict[str, Any]:
    return {
        "time": NOW,
        "audience": CELL,
        "lease_ms": 2_000,
        "view": {"epoch": 3, "age_ms": 100, "revoked": []},
        "trust": {name: json.loads(bundle.to_json()) for name, bundle in TRUST.items()},
    }


# --- our verifier's word ---------------------------------------------------------------------------------------------------


def outcome(world: dict[str, Any], text: str, vector: dict[str, Any]) -> dict[str, Any]:
    """Answer of our verifier to a vector, in the form of a file."""
    trust = codec.trust_of(world["trust"][vector.get("trust", "ordinary")])
    if "claimed" in vector:
        return _claim(trust, text, vector)
    token = token_from_text(text, DEFAULT)
    if isinstance(token, Fault):
        return codec.fault_json(token)
    at = vector.get("time", world["time"])
    checker = Verifier(trust, DEFAULT)
    chain = checker.verify(
        token,
        at=at,
        audience=vector.get("audience", world["audience"]),
        view=codec.view_of(vector.get("view", world["view"])),
        lease_ms=vector.get("lease_ms", world["lease_ms"]),
    )
    if isinstance(chain, Fault):
        return codec.fault_json(chain)
    if "request" not in vector:
        return codec.chain_json(chain)
    asked = vector["request"]
    found = checker.check_request(chain, **codec.request_of(asked), at=asked.get("time", at))
    if found is None:
        return {"permitted": True}
    return codec.fault_json(found) if isinstance(found, Fault) else codec.refusal_json(found)


def _claim(trust: Any, text: str, vector: dict[str, Any]) -> dict[str, Any]:
    """Step 12 alone: does Biscuit's authorizer draw the lines of this token where the claimed scope does?"""
    token = token_from_text(text, DEFAULT)
    assert isinstance(token, bytes)
    root = trust.roots[wire.read(token).root_key_id]
    scope = scope_from_json(vector["claimed"])
    grant = scope.find(vector["request"]["object"], vector["request"]["operation"])
    fault = scope_check.disagreement(biscuit.open_token(token, root), scope, grant, DEFAULT)
    return {"permitted": True} if fault is None else codec.fault_json(fault)


def differs(case: Case, found: dict[str, Any]) -> bool:
    """True where our verifier finds something else than the author of the case expects."""
    match case.expected:
        case Faulty(code, clause):
            return found != {"fault": {"code": str(code), "clause": clause}}
        case Permitted():
            return found != {"permitted": True}
        case Refused(code, hop, of):
            return found != {"refusal": {"code": str(code), "hop": hop, **of}}
        case Accepted(scope):
            return "chain" not in found or found["chain"]["hops"][-1]["scope"] != scope_to_json(scope)


# --- files -----------------------------------------------------------------------------------------------------------------


def mint(group: Group) -> dict[str, Any]:
    """The file of a group with new tokens and no expectation yet."""
    by_title = {case.title: case for case in group.cases}
    vectors = []
    for case in group.cases:
        vector: dict[str, Any] = {"id": case.id, "shows": case.title, "clause": case.clause}
        if isinstance(case.token, str):
            vector["token_of"] = by_title[case.token].id
        else:
            made = case.token()
            raw = made.encode() if isinstance(made, Sealed) else made
            vector["token"] = raw if isinstance(raw, str) else token_to_text(raw)
        vectors.append(vector)
    return {"group": group.name, "says": group.says, "vectors": vectors}


def complete(world: dict[str, Any], group: Group, frozen: dict[str, Any]) -> dict[str, Any]:
    """File of a group from its frozen tokens, with its author's inputs and our verifier's answers."""
    cases = {case.id: case for case in group.cases}
    assert list(cases) == [vector["id"] for vector in frozen["vectors"]], "other vectors than cases: mint again"
    assert len(cases) == len(group.cases), "two cases of one id"
    wrong, vectors = [], []
    for kept in frozen["vectors"]:
        case = cases[kept["id"]]
        vector = {"id": case.id, "shows": case.title, "clause": case.clause}
        vector |= {name: kept[name] for name in ("token", "token_of") if name in kept}
        vector |= case.given
        if case.request is not None:
            vector["request"] = case.request
        if case.claimed is not None:
            vector["claimed"] = scope_to_json(case.claimed)
        vector["expect"] = outcome(world, codec.text_of(frozen, vector), vector)
        if differs(case, vector["expect"]):
            wrong.append(f"{case.id}: {case.expected}, found {json.dumps(vector['expect'])[:300]}")
        vectors.append(vector)
    if wrong:
        raise SystemExit("\n".join(wrong))
    return {"group": group.name, "says": group.says, "vectors": vectors}


def main(arguments: list[str]) -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--mint", action="store_true", help="make new tokens")
    parser.add_argument("groups", nargs="*", help="mint these groups alone")
    chosen = parser.parse_args(arguments)
    world = new_world()
    if not chosen.mint:
        assert world == codec.read_world(), "another world than that of the files: mint again"
    groups = all_groups()
    found = {}
    for group in groups:
        fresh = chosen.mint and (not chosen.groups or group.name in chosen.groups)
        frozen = mint(group) if fresh else json.loads((codec.FOLDER / f"{group.name}.json").read_text("utf-8"))
        found[group.name] = complete(world, group, frozen)
    codec.WORLD.write_text(codec.written(world) + "\n", "utf-8")
    for name, file in found.items():
        (codec.FOLDER / f"{name}.json").write_text(codec.written(file) + "\n", "utf-8")
    print(f"{sum(len(file['vectors']) for file in found.values())} vectors in {len(found)} groups")


if __name__ == "__main__":
    main(sys.argv[1:])
