"""What a PEP asks people: all that an approval would bind, and all that is shown to them."""

from __future__ import annotations

import re
from dataclasses import dataclass, fields
from typing import TYPE_CHECKING, Final

from capabilities.statements import statement_form
from capabilities.statements.claims import Claims, malformed, unique
from capabilities.values.scope import Tier
from capabilities.values.units import INT_LIMIT, Quantity, Unit

if TYPE_CHECKING:
    from collections.abc import Collection

    from capabilities.keys.keys import PrivateKey
    from capabilities.values.caps import Caps

KIND: Final = "ask"
ID: Final = re.compile(r"[0-9a-f]{32}", re.ASCII)
"""An id or nonce: 16 random bytes in hex."""
TOKEN_ID: Final = re.compile(r"[A-Za-z0-9_-]{1,64}", re.ASCII)
THUMBPRINT: Final = re.compile(r"[A-Za-z0-9_-]{43}", re.ASCII)
REASON: Final = re.compile(r"[A-Z][A-Z0-9_]{0,63}", re.ASCII)
PERCEPTIONS: Final = frozenset({"fresh", "stale", "missing"})
VALUES: Final = 32
CONTRIBUTORS: Final = 64
REASONS: Final = 16
"""Most parameters, contributors and reasons of one ask."""
JOINTS: Final = 6
APPROVERS_OF_TIER: Final = {Tier.SAFETY_CRITICAL: 2}
"""How many different people a tier wants; every other one, where somebody is asked at all, wants one."""


@dataclass(frozen=True, slots=True)
class Contributor:
    """One thing that raised the index: kind, link and object, index in thousandths, clearance and speed there.

    `source` is who says that the object is there: a sensor, or "" for the signed cell file and the robot itself.
    """

    kind: str
    link: str
    object: str
    index_milli: int
    clearance_um: int
    speed_um_s: int
    source: str = ""


@dataclass(frozen=True, slots=True)
class Ask:
    """What a PEP asks people, and all that they are shown.

    Attributes:
        ask_id: 32 hex digits, made by the PEP.
        nonce: 32 hex digits, fresh for this ask.
        pep, audience: who asks, and the canonical URL of its server.
        issuer, sponsor: of the chain's human root.
        token_id: of the root token.
        agent, agent_key: the chain's leaf and its key's thumbprint (RFC 7638).
        object, operation, values: the typed request, in the operation's order.
        request_digest: SHA-256 (hex) of the request (`policies.evidence.model.Request.digest`).
        start_urad: joint angles from which it was assessed, six integers, or none for what does not move the arm.
        model_digest, policy_digest, scene_digest: SHA-256 (hex) of what it was computed with and on.
        tier, index_milli: as computed.
        reasons: the deferral reasons that an approval would resolve, at least one.
        contributors: ranked, highest index first.
        perception: "fresh", "stale" or "missing"; `perception_age_ms` of the frame that was used, or None.
        approvers: how many different people must approve, 1 or 2.
        opening_id: the opening that a tier 4 ask rests on, else "".
        asked_at, expires_at: seconds since the epoch.
    """

    ask_id: str
    nonce: str
    pep: str
    audience: str
    issuer: str
    sponsor: str
    token_id: str
    agent: str
    agent_key: str
    object: str
    operation: str
    values: tuple[Quantity, ...]
    request_digest: str
    start_urad: tuple[int, ...]
    model_digest: str
    policy_digest: str
    scene_digest: str
    tier: Tier
    index_milli: int
    reasons: tuple[str, ...]
    contributors: tuple[Contributor, ...]
    perception: str
    perception_age_ms: int | None
    approvers: int
    opening_id: str
    asked_at: int
    expires_at: int


NAMES: Final = tuple(field.name for field in fields(Ask))


def sign(ask: Ask, key: PrivateKey) -> str:
    """The ask, signed by the PEP."""
    claims: dict[str, object] = {
        "ask_id": ask.ask_id,
        "nonce": ask.nonce,
        "pep": ask.pep,
        "audience": ask.audience,
        "issuer": ask.issuer,
        "sponsor": ask.sponsor,
        "token_id": ask.token_id,
        "agent": ask.agent,
        "agent_key": ask.agent_key,
        "object": ask.object,
        "operation": ask.operation,
        "values": [{"name": v.name, "unit": str(v.unit), "value": v.value} for v in ask.values],
        "request_digest": ask.request_digest,
        "start_urad": list(ask.start_urad),
        "model_digest": ask.model_digest,
        "policy_digest": ask.policy_digest,
        "scene_digest": ask.scene_digest,
        "tier": int(ask.tier),
        "index_milli": ask.index_milli,
        "reasons": list(ask.reasons),
        "contributors": [
            {
                "kind": c.kind,
                "link": c.link,
                "object": c.object,
                "index_milli": c.index_milli,
                "clearance_um": c.clearance_um,
                "speed_um_s": c.speed_um_s,
                **({"source": c.source} if c.source else {}),
            }
            for c in ask.contributors
        ],
        "perception": ask.perception,
        "perception_age_ms": ask.perception_age_ms,
        "approvers": ask.approvers,
        "opening_id": ask.opening_id,
        "asked_at": ask.asked_at,
        "expires_at": ask.expires_at,
    }
    return statement_form.sign(KIND, claims, key)


def open(text: str, keys: Collection[bytes], caps: Caps) -> Ask:  # noqa: A001 - read as ask.open
    """The ask, signed by one of these keys.

    Raises:
        StatementError: as `sealed.open`; also for an ask that ends before it begins, gives no reason, or asks fewer
            people than its tier wants.
    """
    claims = Claims(statement_form.open(KIND, text, keys, caps), *NAMES)
    age = claims.raw("perception_age_ms")
    ask = Ask(
        ask_id=claims.token("ask_id", ID),
        nonce=claims.token("nonce", ID),
        pep=claims.name("pep"),
        audience=claims.url("audience"),
        issuer=claims.url("issuer"),
        sponsor=claims.name("sponsor"),
        token_id=claims.token("token_id", TOKEN_ID),
        agent=claims.name("agent"),
        agent_key=claims.token("agent_key", THUMBPRINT),
        object=claims.name("object"),
        operation=claims.name("operation"),
        values=unique(claims.each("values", _quantity, most=VALUES), lambda value: value.name, "a parameter"),
        request_digest=claims.hex_digest("request_digest"),
        start_urad=claims.each("start_urad", _angle, most=JOINTS),
        model_digest=claims.hex_digest("model_digest"),
        policy_digest=claims.hex_digest("policy_digest"),
        scene_digest=claims.hex_digest("scene_digest"),
        tier=Tier(claims.integer("tier", high=int(max(Tier)))),
        index_milli=claims.integer("index_milli", high=4_000),
        reasons=unique(claims.each("reasons", _reason, most=REASONS), lambda reason: reason, "a reason"),
        contributors=claims.each("contributors", _contributor, most=CONTRIBUTORS),
        perception=claims.one_of("perception", PERCEPTIONS),
        perception_age_ms=None if age is None else claims.integer("perception_age_ms"),
        approvers=claims.integer("approvers", low=1, high=2),
        opening_id="" if claims.raw("opening_id") == "" else claims.token("opening_id", ID),
        asked_at=claims.integer("asked_at"),
        expires_at=claims.integer("expires_at"),
    )
    if not ask.reasons:
        raise malformed("no reason")
    if len(ask.start_urad) not in (0, JOINTS):
        raise malformed("start_urad has not six angles")
    if not ask.asked_at < ask.expires_at:
        raise malformed("it ends before it begins")
    if ask.approvers < APPROVERS_OF_TIER.get(ask.tier, 1):
        raise malformed("it asks fewer people than its tier wants")
    if (ask.tier is Tier.SAFETY_CRITICAL) != (ask.opening_id != ""):
        raise malformed("tier 4, and nothing else, rests on an opening")
    return ask


def _quantity(value: object) -> Quantity:
    claims = Claims(value, "name", "unit", "value")
    unit = Unit(claims.one_of("unit", frozenset(str(unit) for unit in Unit)))
    return Quantity(claims.name("name"), unit, claims.integer("value", low=-INT_LIMIT))


def _angle(value: object) -> int:
    return Claims({"angle": value}, "angle").integer("angle", low=-INT_LIMIT)


def _reason(value: object) -> str:
    return Claims({"reason": value}, "reason").token("reason", REASON)


def _contributor(value: object) -> Contributor:
    """One contributor. Where no sensor speaks the member is left out, so that it has one spelling."""
    said = isinstance(value, dict) and "source" in value
    names = ("source",) if said else ()
    claims = Claims(value, "kind", "link", "object", "index_milli", "clearance_um", "speed_um_s", *names)
    return Contributor(
        kind=claims.name("kind"),
        link=claims.name_or_empty("link"),
        object=claims.name_or_empty("object"),
        index_milli=claims.integer("index_milli", high=4_000),
        clearance_um=claims.integer("clearance_um", low=-INT_LIMIT),
        speed_um_s=claims.integer("speed_um_s"),
        source=claims.name("source") if said else "",
    )
