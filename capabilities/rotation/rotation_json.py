"""A key ring as JSON, in one spelling: what the identity provider keeps beside its private keys."""

from __future__ import annotations

from dataclasses import fields
from typing import Final

from capabilities.keys.keys import b64u
from capabilities.keys.windows import FOREVER, Role
from capabilities.rotation.rotation import KeyRecord, KeyRing
from capabilities.statements.claims import Claims
from capabilities.values import strict_json
from capabilities.values.errors import BadKeyError, CapabilityError, FaultCode

KEYS: Final = 4_096
"""Most keys of a ring: a rotation of every role in each week of fifteen years."""
_TIMES: Final = tuple(field.name for field in fields(KeyRecord) if field.name.endswith("_at"))
_ROLES: Final = frozenset(map(str, Role))


def ring_to_json(ring: KeyRing) -> bytes:
    """The canonical JSON (RFC 8785) of the ring."""
    return strict_json.canonical(
        {
            "issuer": ring.issuer,
            "version": ring.version,
            "issued_at": ring.issued_at,
            "keys": [
                {
                    "role": str(record.role),
                    "number": record.number,
                    "key": b64u(record.key),
                    **{name: getattr(record, name) for name in _TIMES},
                }
                for record in ring.records
            ],
        }
    )


def ring_from_json(raw: bytes) -> KeyRing:
    """The ring of its JSON.

    Raises:
        BadKeyError: `KEY_MALFORMED` for any other form; `KEY_WRONG_ROLE` when a key occurs twice.
    """
    try:
        claims = Claims(strict_json.parse_object(raw), "issuer", "version", "issued_at", "keys")
        return KeyRing(
            issuer=claims.url("issuer"),
            version=claims.integer("version", low=1),
            issued_at=claims.integer("issued_at", high=FOREVER),
            records=claims.each("keys", _record, most=KEYS),
        )
    except BadKeyError:
        raise
    except CapabilityError as error:
        raise BadKeyError(FaultCode.KEY_MALFORMED, error.detail) from None


def _record(value: object) -> KeyRecord:
    claims = Claims(value, "role", "number", "key", *_TIMES)
    return KeyRecord(
        role=Role(claims.one_of("role", _ROLES)),
        number=claims.integer("number", high=2**32 - 1),
        key=claims.public_key("key"),
        prepared_at=claims.integer("prepared_at", high=FOREVER),
        activated_at=_time(claims, "activated_at"),
        retired_at=_time(claims, "retired_at"),
        tainted_at=_time(claims, "tainted_at"),
        revoked_at=_time(claims, "revoked_at"),
    )


def _time(claims: Claims, name: str) -> int | None:
    return None if claims.raw(name) is None else claims.integer(name, high=FOREVER)
