"""Rows to values and back."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any, assert_never

import sqlalchemy as sa

from ztpm_idp.domain.events import RevocationKind
from ztpm_idp.domain.ledger import FIRST_PREV
from ztpm_idp.domain.parties import (
    Party,
    Passkey,
    PersonRole,
    RegisteredAgent,
    RegisteredPep,
    RegisteredPerson,
    RegisteredSensor,
    Standing,
    kind_of,
)
from ztpm_idp.store import schema as t

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

REVOKED_KEYS = sa.select(t.revocations.c.id).where(t.revocations.c.kind == RevocationKind.KEY.value)
"""Thumbprints of the keys that have ended."""


def _ended(thumbprint: sa.Column[str]) -> sa.Exists:
    """Condition that the key of this thumbprint has ended: one look into the index, however many have."""
    ended = REVOKED_KEYS.where(t.revocations.c.id == thumbprint)
    return ended.correlate(thumbprint.table).exists()


PARTY_COLUMNS = sa.select(
    t.parties,
    t.people.c.name,
    t.people.c.roles,
    t.agents.c.software_digest,
    t.agents.c.model,
    t.agents.c.role,
    t.agents.c.sponsor,
    t.agents.c.trust_permille,
    t.agents.c.workload,
    t.agents.c.suspended_ms,
    t.agents.c.held,
    t.peps.c.audiences,
    t.peps.c.heard,
    t.peps.c.suspended_ms.label("pep_suspended_ms"),
    t.sensors.c.calibration,
    t.sensors.c.transit_ms,
    t.sensors.c.audience,
    t.sensors.c.suspended_ms.label("sensor_suspended_ms"),
    t.person_keys.c.key.label("further"),
    t.person_keys.c.credential,
    _ended(t.parties.c.thumbprint).label("first_ended"),
).select_from(
    t.parties.outerjoin(t.people, t.people.c.id == t.parties.c.id)
    .outerjoin(t.agents, t.agents.c.id == t.parties.c.id)
    .outerjoin(t.peps, t.peps.c.id == t.parties.c.id)
    .outerjoin(t.sensors, t.sensors.c.id == t.parties.c.id)
    .outerjoin(
        t.person_keys,
        sa.and_(t.person_keys.c.person == t.parties.c.id, ~_ended(t.person_keys.c.thumbprint)),
    )
)
"""Every party with the columns of its kind: one row, and of a person one for each living further key."""


def parties(found: Iterable[sa.Row[Any]]) -> list[Party]:
    """The parties of rows of `PARTY_COLUMNS`, which are in the order of their ids."""
    made = list[Party]()
    for row in found:
        match made:
            case [*_, RegisteredPerson() as last] if last.id == row.id:
                further, passkeys = _further(row.further, row.credential)
                made[-1] = replace(last, further=last.further | further, passkeys=last.passkeys | passkeys)
            case _:
                made.append(party(row))
    return made


def party(row: sa.Row[Any]) -> Party:
    """The party of one row of `PARTY_COLUMNS`, with that row's further key."""
    r = row._asdict()
    id_, key, thumbprint, standing = r["id"], bytes(r["key"]), r["thumbprint"], Standing(r["standing"])
    match r["kind"]:
        case "person":
            further, passkeys = _further(r["further"], r["credential"])
            roles, ended = frozenset(PersonRole(x) for x in r["roles"]), bool(r["first_ended"])
            return RegisteredPerson(id_, key, thumbprint, standing, r["name"], roles, further, ended, passkeys)
        case "agent":
            digest = bytes(r["software_digest"])
            standing = _suspended(standing, r["suspended_ms"])
            return RegisteredAgent(
                id_, key, thumbprint, standing, digest, r["model"], r["role"], r["sponsor"], r["trust_permille"],
                r["workload"] or "", r["held"],
            )  # fmt: skip
        case "pep":
            standing = _suspended(standing, r["pep_suspended_ms"])
            return RegisteredPep(id_, key, thumbprint, standing, frozenset(r["audiences"]), r["heard"])
        case "sensor":
            standing = _suspended(standing, r["sensor_suspended_ms"])
            return RegisteredSensor(
                id_, key, thumbprint, standing, bytes(r["calibration"]), r["transit_ms"], r["audience"]
            )
        case other:
            raise AssertionError(other)


def _further(key: bytes | None, credential: str | None) -> tuple[frozenset[bytes], frozenset[Passkey]]:
    """The further key or the passkey of one row, among none of the other."""
    match key, credential:
        case None, _:
            return frozenset(), frozenset()
        case bytes(key), None:
            return frozenset({bytes(key)}), frozenset()
        case _:
            return frozenset(), frozenset({Passkey(bytes(key), credential)})


def _suspended(standing: Standing, since_ms: int | None) -> Standing:
    """The standing, suspended since then: the one to return to stays in its column; an end outlives a suspension."""
    return standing if since_ms is None or standing is Standing.REVOKED else Standing.SUSPENDED


def party_inserts(party: Party, at_ms: int) -> Sequence[sa.Insert]:
    """The rows that make a party."""
    common = sa.insert(t.parties).values(
        id=party.id,
        kind=kind_of(party),
        key=party.key,
        thumbprint=party.thumbprint,
        standing=party.standing.value,
        registered_ms=at_ms,
    )
    match party:
        case RegisteredPerson(name=name, roles=roles):
            own = sa.insert(t.people).values(id=party.id, name=name, roles=sorted(role.value for role in roles))
        case RegisteredAgent():
            own = sa.insert(t.agents).values(
                id=party.id,
                software_digest=party.software_digest,
                model=party.model,
                role=party.role,
                sponsor=party.sponsor,
                workload=party.workload or None,
            )
        case RegisteredPep(audiences=audiences):
            own = sa.insert(t.peps).values(
                id=party.id, audiences=sorted(audiences), journal_seq=0, journal_head=FIRST_PREV
            )  # fmt: skip
        case RegisteredSensor():
            own = sa.insert(t.sensors).values(
                id=party.id, calibration=party.calibration, transit_ms=party.transit_ms, audience=party.audience
            )  # fmt: skip
        case _:
            assert_never(party)
    return (common, own)
