"""Parties: people, agents, enforcement points and sensors, each with a key; and the audiences' tools.

Ids are unique over all kinds, so that a delegator's name in a token can mean one party only. One key has one owner
and one role; people alone may have several keys.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from capabilities.values.scope import Tier


class PersonRole(StrEnum):
    """Role of a person. A person may hold several."""

    SPONSOR = "sponsor"
    APPROVER = "approver"
    ADMIN = "admin"
    AUDITOR = "auditor"
    """It reads the ledger, and all that people read; it changes nothing."""


class Standing(StrEnum):
    """Standing of a party in its life.

    There is no way back from `REVOKED`: an id is never used again.
    """

    REGISTERED = "registered"
    """An agent that has not been attested yet."""
    ACTIVE = "active"
    SUSPENDED = "suspended"
    """An agent, enforcement point or sensor that may do nothing until a person restores it.

    Then it stands as it stood before.
    """
    REVOKED = "revoked"


@dataclass(frozen=True, slots=True)
class Passkey:
    """A person's passkey: its raw public key, and the id by which an authenticator knows it, in base64url."""

    key: bytes
    credential: str


@dataclass(frozen=True, slots=True)
class RegisteredPerson:
    """A human principal.

    Attributes:
        id: unique over all parties.
        key: Ed25519 public key, 32 raw bytes; thumbprint: its RFC 7638 name.
        standing: `ACTIVE` or `REVOKED`.
        name: as shown to people.
        roles: at least one.
        further: raw keys that the person has beside the first.
        first_ended: the first key is revoked alone; the person goes on with a further one.
        passkeys: those that have not ended; they sign no request and no statement, and make assertions alone.
    """

    id: str
    key: bytes
    thumbprint: str
    standing: Standing
    name: str
    roles: frozenset[PersonRole]
    further: frozenset[bytes] = frozenset()
    first_ended: bool = False
    passkeys: frozenset[Passkey] = frozenset()

    @property
    def passkey_keys(self) -> frozenset[bytes]:
        """Raw keys of its passkeys."""
        return frozenset(passkey.key for passkey in self.passkeys)

    @property
    def keys(self) -> frozenset[bytes]:
        """Every key that signs for the person now. However many they are, the person has one voice."""
        return self.further if self.first_ended else self.further | {self.key}

    @property
    def privileged(self) -> bool:
        """True for an approver or administrator, whom two people make and change."""
        return bool(self.roles & {PersonRole.APPROVER, PersonRole.ADMIN})


@dataclass(frozen=True, slots=True)
class RegisteredAgent:
    """A software agent, vouched for by its sponsor.

    Attributes:
        id, key, thumbprint, standing: as for a person; an agent starts `REGISTERED`.
        software_digest: SHA-256 of the software that it should run; evidence must state the same.
        model: the language model behind it, as declared.
        role: its purpose; `role:NAME` in a scope's delegates means agents of the same sponsor with this role.
        sponsor: id of the person who answers for it.
        trust_permille: signed static trust, or None when nobody stated one.
        workload: the platform's name of it (a SPIFFE ID), or "": such an agent has evidence of kind `key` alone.
        held: since a restore nobody has vouched for it, so it receives and lends nothing.
    """

    id: str
    key: bytes
    thumbprint: str
    standing: Standing
    software_digest: bytes
    model: str
    role: str
    sponsor: str
    trust_permille: int | None
    workload: str = ""
    held: bool = False


@dataclass(frozen=True, slots=True)
class RegisteredPep:
    """An enforcement point.

    Attributes:
        id, key, thumbprint, standing: as above.
        audiences: those that it serves.
        heard: False since a restore until it has told what it knows to be revoked.
    """

    id: str
    key: bytes
    thumbprint: str
    standing: Standing
    audiences: frozenset[str]
    heard: bool = True


@dataclass(frozen=True, slots=True)
class RegisteredSensor:
    """Sensor that signs its observations.

    Attributes:
        id, key, thumbprint, standing: as above. A sensor never calls.
        calibration: SHA-256 of its calibration.
        transit_ms: longest time from exposure to arrival.
        audience: the audience whose cell it watches.
    """

    id: str
    key: bytes
    thumbprint: str
    standing: Standing
    calibration: bytes
    transit_ms: int
    audience: str


Party = RegisteredPerson | RegisteredAgent | RegisteredPep | RegisteredSensor


@dataclass(frozen=True, slots=True)
class RegisteredTool:
    """A tool of an audience: its reviewed definition and the base tier of its operation."""

    audience: str
    name: str
    definition_digest: bytes
    operation: str
    base_tier: Tier


def kind_of(party: Party) -> str:
    """The word for a party's kind, as the store and the ledger spell it."""
    match party:
        case RegisteredPerson():
            return "person"
        case RegisteredAgent():
            return "agent"
        case RegisteredPep():
            return "pep"
        case RegisteredSensor():
            return "sensor"
