"""Vectors as files and back: strict values for the verifier, and JSON that a person can read."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from capabilities.keys.keys import b64u
from capabilities.keys.trust import TrustBundle
from capabilities.statements.revocation import RevocationView
from capabilities.values.arguments import Argument, Value, fingerprint
from capabilities.values.bounds import bound_to_json, kind_to_json
from capabilities.values.chain import Chain, Refusal
from capabilities.values.errors import Fault
from capabilities.values.scope import Tier
from capabilities.values.scope_json import scope_to_json
from capabilities.values.units import Quantity, Sort, kind_of

FOLDER = Path(__file__).parent
WORLD = FOLDER / "world.json"
WIDTH = 140


def read_world() -> dict[str, Any]:
    return json.loads(WORLD.read_text("utf-8"))


def files() -> list[Path]:
    return sorted(path for path in FOLDER.glob("*.json") if path != WORLD)


def read_groups() -> dict[str, dict[str, Any]]:
    """Each file by the name of its group."""
    return {path.stem: json.loads(path.read_text("utf-8")) for path in files()}


def text_of(group: dict[str, Any], vector: dict[str, Any]) -> str:
    """The token of a vector: its own, or that of another one of the same file."""
    if "token" in vector:
        return vector["token"]
    (found,) = [other["token"] for other in group["vectors"] if other["id"] == vector["token_of"]]
    return found


def trust_of(bundle: dict[str, Any]) -> TrustBundle:
    return TrustBundle.from_json(json.dumps(bundle).encode())


def view_of(view: dict[str, Any]) -> RevocationView:
    return RevocationView(view["epoch"], view["age_ms"], frozenset((kind, name) for kind, name in view["revoked"]))


def request_of(request: dict[str, Any]) -> dict[str, Any]:
    """Arguments of `Verifier.check_request`; the values exactly as they stand in the file, of their kinds or not."""
    values = tuple(map(_given, request["values"]))
    return {
        "object": request["object"],
        "operation": request["operation"],
        "values": values,
        "base_tier": Tier(request["base_tier"]),
    }


def _given(stated: dict[str, Any]) -> Value:
    value = tuple(stated["value"]) if isinstance(stated["value"], list) else stated["value"]
    if "unit" in stated:
        return Quantity(stated["name"], kind_of(stated["unit"]), value)
    kind = kind_of(stated["kind"])
    return Argument(stated["name"], kind, fingerprint(stated["value"]) if kind is Sort.FREE else value)


# --- results ---------------------------------------------------------------------------------------------------------------


def fault_json(fault: Fault) -> dict[str, Any]:
    return {"fault": {"code": str(fault.code), "clause": fault.clause}}


def refusal_json(refusal: Refusal) -> dict[str, Any]:
    found: dict[str, Any] = {"code": str(refusal.code), "hop": refusal.hop}
    if refusal.bound is not None:
        found |= {
            "parameter": refusal.parameter,
            "value": list(refusal.value) if isinstance(refusal.value, tuple) else refusal.value,
            **kind_to_json(refusal.unit),
            "bound": bound_to_json(refusal.bound),
            "nearest": list(refusal.nearest) if isinstance(refusal.nearest, tuple) else refusal.nearest,
        }
    return {"refusal": found}


def chain_json(chain: Chain) -> dict[str, Any]:
    return {
        "chain": {
            "token_id": chain.token_id,
            "digest": chain.digest.hex(),
            "sponsor": {
                "issuer": chain.sponsor.issuer,
                "subject": chain.sponsor.subject,
                "method": chain.sponsor.method,
                "authenticated_at": chain.sponsor.authenticated_at,
            },
            "root_key_id": chain.root_key_id,
            **({} if chain.mandate_id is None else {"mandate_id": chain.mandate_id}),
            "epoch": chain.epoch,
            "view_age_ms": chain.view_age_ms,
            "hops": [
                {
                    "index": hop.index,
                    "hop_id": hop.hop_id,
                    "agent": hop.agent,
                    "role": hop.role,
                    "key": b64u(hop.key),
                    "delegator": hop.delegator,
                    "purpose": hop.purpose,
                    "request_digest": hop.request_digest.hex(),
                    "attestation": {
                        "kind": str(hop.attestation.kind),
                        "measurement": hop.attestation.measurement.hex(),
                        "at": hop.attestation.at,
                    },
                    "scope": scope_to_json(hop.scope),
                }
                for hop in chain.hops
            ],
        }
    }


# --- files -----------------------------------------------------------------------------------------------------------------


def written(value: object, indent: int = 0) -> str:
    """JSON whose short parts stand on one line; ASCII, so that what is odd in a text is seen."""
    flat = json.dumps(value)
    if indent + len(flat) <= WIDTH or not isinstance(value, dict | list) or not value:
        return flat
    pad, end = " " * (indent + 2), " " * indent
    if isinstance(value, dict):
        parts = [f"{pad}{json.dumps(key)}: {written(each, indent + 2)}" for key, each in value.items()]
        return "{\n" + ",\n".join(parts) + f"\n{end}}}"
    return "[\n" + ",\n".join(pad + written(each, indent + 2) for each in value) + f"\n{end}]"
