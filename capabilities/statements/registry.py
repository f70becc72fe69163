"""The signed registry snapshot of one audience: tools, sensors, trust, approvers, and who enforces there."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from capabilities.keys import keys as key_forms
from capabilities.statements import statement_form
from capabilities.statements.claims import Claims, unique
from capabilities.values.scope import Tier

if TYPE_CHECKING:
    from collections.abc import Collection

    from capabilities.keys.keys import PrivateKey
    from capabilities.values.caps import Caps

KIND: Final = "registry"
TOOLS: Final = 256
SENSORS: Final = 64
AGENTS: Final = 1_024
APPROVERS: Final = 64
PEPS: Final = 16
"""Most tools, sensors, agents, approvers and enforcement points of one snapshot; with names of 63 bytes, the longest
that the identity provider registers, all of them together still fit a statement."""
TRANSIT_MS: Final = 10_000
"""Longest declared transit of a frame."""


@dataclass(frozen=True, slots=True)
class ToolEntry:
    """A registered tool: its name, the SHA-256 (hex) of its approved definition, its operation and base tier."""

    name: str
    definition_digest: str
    operation: str
    base_tier: Tier


@dataclass(frozen=True, slots=True)
class SensorEntry:
    """A registered sensor: its id, raw public key, SHA-256 (hex) of its calibration and longest transit in ms."""

    id: str
    key: bytes
    calibration: str
    transit_ms: int


@dataclass(frozen=True, slots=True)
class TrustEntry:
    """The static trust of an agent, in permille."""

    agent: str
    permille: int


@dataclass(frozen=True, slots=True)
class PartyEntry:
    """Somebody who signs: a person who may answer asks, an enforcement point. The id and raw public key."""

    id: str
    key: bytes


@dataclass(frozen=True, slots=True)
class RegistrySnapshot:
    """What the enforcement points of an audience are to know, and their callers of them.

    Attributes:
        issuer: canonical URL of the identity provider.
        version: grows with each change.
        audience: canonical URL of what is enforced on.
        as_of_ms: wall clock before the store was read, milliseconds since the epoch.
        tools, sensors, trust, approvers: each name once.
        peps: enforcement points that serve the audience; a caller knows by the key that it talks to one.
    """

    issuer: str
    version: int
    audience: str
    as_of_ms: int
    tools: tuple[ToolEntry, ...]
    sensors: tuple[SensorEntry, ...]
    trust: tuple[TrustEntry, ...]
    approvers: tuple[PartyEntry, ...]
    peps: tuple[PartyEntry, ...]

    def tool(self, name: str) -> ToolEntry | None:
        """The tool of this name, or None."""
        return next((tool for tool in self.tools if tool.name == name), None)

    def sensor(self, name: str) -> SensorEntry | None:
        """The sensor of this id, or None."""
        return next((sensor for sensor in self.sensors if sensor.id == name), None)

    def trust_permille(self, agent: str) -> int | None:
        """The stated trust of an agent, or None."""
        return next((entry.permille for entry in self.trust if entry.agent == agent), None)

    def approver(self, name: str) -> PartyEntry | None:
        """The approver of this id, or None."""
        return next((entry for entry in self.approvers if entry.id == name), None)


def sign(snapshot: RegistrySnapshot, key: PrivateKey) -> str:
    """The signed snapshot."""
    claims: dict[str, object] = {
        "issuer": snapshot.issuer,
        "version": snapshot.version,
        "audience": snapshot.audience,
        "as_of_ms": snapshot.as_of_ms,
        "tools": [
            {
                "name": tool.name,
                "definition_digest": tool.definition_digest,
                "operation": tool.operation,
                "base_tier": int(tool.base_tier),
            }
            for tool in snapshot.tools
        ],
        "sensors": [
            {
                "id": sensor.id,
                "key": key_forms.b64u(sensor.key),
                "calibration": sensor.calibration,
                "transit_ms": sensor.transit_ms,
            }
            for sensor in snapshot.sensors
        ],
        "trust": [{"agent": entry.agent, "permille": entry.permille} for entry in snapshot.trust],
        "approvers": [_stated(entry) for entry in snapshot.approvers],
        "peps": [_stated(entry) for entry in snapshot.peps],
    }
    return statement_form.sign(KIND, claims, key)


def open(text: str, keys: Collection[bytes], caps: Caps) -> RegistrySnapshot:  # noqa: A001 - read as registry.open
    """The snapshot, signed by one of these keys, with each name once.

    Raises:
        StatementError: as `sealed.open`.
    """
    members = statement_form.open(KIND, text, keys, caps)
    claims = Claims(
        members, "issuer", "version", "audience", "as_of_ms", "tools", "sensors", "trust", "approvers", "peps"
    )
    return RegistrySnapshot(
        issuer=claims.url("issuer"),
        version=claims.integer("version"),
        audience=claims.url("audience"),
        as_of_ms=claims.integer("as_of_ms"),
        tools=unique(claims.each("tools", _tool, most=TOOLS), lambda tool: tool.name, "a tool"),
        sensors=unique(claims.each("sensors", _sensor, most=SENSORS), lambda sensor: sensor.id, "a sensor"),
        trust=unique(claims.each("trust", _trust, most=AGENTS), lambda entry: entry.agent, "an agent"),
        approvers=unique(claims.each("approvers", _party, most=APPROVERS), lambda entry: entry.id, "an approver"),
        peps=unique(claims.each("peps", _party, most=PEPS), lambda entry: entry.id, "an enforcement point"),
    )


def _tool(value: object) -> ToolEntry:
    claims = Claims(value, "name", "definition_digest", "operation", "base_tier")
    return ToolEntry(
        name=claims.name("name"),
        definition_digest=claims.hex_digest("definition_digest"),
        operation=claims.name("operation"),
        base_tier=Tier(claims.integer("base_tier", high=int(max(Tier)))),
    )


def _sensor(value: object) -> SensorEntry:
    claims = Claims(value, "id", "key", "calibration", "transit_ms")
    return SensorEntry(
        id=claims.name("id"),
        key=claims.public_key("key"),
        calibration=claims.hex_digest("calibration"),
        transit_ms=claims.integer("transit_ms", high=TRANSIT_MS),
    )


def _trust(value: object) -> TrustEntry:
    claims = Claims(value, "agent", "permille")
    return TrustEntry(agent=claims.name("agent"), permille=claims.integer("permille", high=1_000))


def _stated(entry: PartyEntry) -> dict[str, object]:
    return {"id": entry.id, "key": key_forms.b64u(entry.key)}


def _party(value: object) -> PartyEntry:
    claims = Claims(value, "id", "key")
    return PartyEntry(id=claims.name("id"), key=claims.public_key("key"))
