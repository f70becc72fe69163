"""The signed registry snapshot of one audience: tools, sensors, trust, approvers, and who enforces there."""

from __future__ import annotations

from typing import TYPE_CHECKING, Annotated, Final

from capabilities.keys import keys as key_forms
from capabilities.statements import statement_form
from capabilities.statements.claims import AgentId, HexDigest, Name, PublicKey, Url, Whole, read, unique
from capabilities.values.form import Form, plain, upto, within
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
SUSPENDED: Final = 128
"""Most tools, sensors, agents with trust, approvers, enforcement points and suspended agents of one snapshot.

With names of 63 bytes, the longest that the identity provider registers, all of them together still fit a statement.
"""
TRANSIT_MS: Final = 10_000
"""Longest declared transit of a frame."""


class ToolEntry(Form, frozen=True):
    """A registered tool: its name, the SHA-256 (hex) of its approved definition, its operation and base tier."""

    name: Name
    definition_digest: HexDigest
    operation: Name
    base_tier: Tier


class SensorEntry(Form, frozen=True):
    """A registered sensor: its id, raw public key, SHA-256 (hex) of its calibration and longest transit in ms."""

    id: Name
    key: PublicKey
    calibration: HexDigest
    transit_ms: Annotated[int, within(0, TRANSIT_MS)]


class TrustEntry(Form, frozen=True):
    """The static trust of an agent, in permille."""

    agent: Name
    permille: Annotated[int, within(0, 1_000)]


class PartyEntry(Form, frozen=True):
    """Party that signs, by id and raw public key: a person who may answer asks, or an enforcement point."""

    id: Name
    key: PublicKey


class RegistrySnapshot(Form, frozen=True):
    """Registry as the enforcement points of one audience, and their callers, are to know it.

    Attributes:
        issuer: canonical URL of the identity provider.
        version: grows with each change.
        audience: canonical URL of the server that is enforced on.
        as_of_ms: wall clock before the store was read, milliseconds since the epoch.
        tools, sensors, trust: each name once.
        approvers: each key once. A person may have several, and is one approver.
        peps: enforcement points that serve the audience; a caller knows by the key that it talks to one.
        suspended: agents that a person suspended: until it is restored, each is as one that is revoked.
        passkeys: of approvers, each key once and none of it an approver's other key; they make votes by passkey alone.
    """

    issuer: Url
    version: Whole
    audience: Url
    as_of_ms: Whole
    tools: Annotated[tuple[ToolEntry, ...], upto(TOOLS)]
    sensors: Annotated[tuple[SensorEntry, ...], upto(SENSORS)]
    trust: Annotated[tuple[TrustEntry, ...], upto(AGENTS)]
    approvers: Annotated[tuple[PartyEntry, ...], upto(APPROVERS)]
    peps: Annotated[tuple[PartyEntry, ...], upto(PEPS)]
    suspended: Annotated[tuple[AgentId, ...], upto(SUSPENDED)] = ()
    passkeys: Annotated[tuple[PartyEntry, ...], upto(APPROVERS)] = ()

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
        """The first entry of the approver of this id, or None."""
        return next((entry for entry in self.approvers if entry.id == name), None)


def sign(snapshot: RegistrySnapshot, key: PrivateKey) -> str:
    """The signed snapshot."""
    members = plain(snapshot)
    with_keys = {
        name: [{**entry, "key": key_forms.b64u(entry["key"])} for entry in members[name]]
        for name in ("sensors", "approvers", "peps", "passkeys")
        if name in members
    }
    return statement_form.seal(KIND, members | with_keys, key, _read)


def open(text: str, keys: Collection[bytes], caps: Caps) -> RegistrySnapshot:  # noqa: A001 - read as registry.open
    """The snapshot, signed by one of these keys, with each name once.

    Raises:
        StatementError: as `sealed.open`.
    """
    return _read(statement_form.open(KIND, text, keys, caps))


def _read(claims: dict[str, object]) -> RegistrySnapshot:
    snapshot = read(RegistrySnapshot, claims)
    unique(snapshot.tools, lambda tool: tool.name, "a tool")
    unique(snapshot.sensors, lambda sensor: sensor.id, "a sensor")
    unique(snapshot.trust, lambda entry: entry.agent, "an agent")
    unique(snapshot.approvers + snapshot.passkeys, lambda entry: entry.key, "an approver's key")
    unique(snapshot.peps, lambda entry: entry.id, "an enforcement point")
    unique(snapshot.suspended, lambda agent: agent, "a suspended agent")
    return snapshot
