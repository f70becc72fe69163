"""Key ring as JSON, in one spelling, as the identity provider keeps it beside its private keys."""

from __future__ import annotations

from typing import Annotated, Final

from msgspec.structs import astuple

from capabilities.keys.keys import b64u
from capabilities.keys.windows import FOREVER, Role
from capabilities.rotation.rotation import KeyRecord, KeyRing
from capabilities.statements.claims import Positive, PublicKey, Url, read
from capabilities.values import strict_json
from capabilities.values.errors import BadKeyError, CapabilityError, FaultCode
from capabilities.values.form import Form, plain, upto, within

KEYS: Final = 4_096
"""Most keys of a ring: a rotation of every role in each week of fifteen years."""
_Time = Annotated[int, within(0, FOREVER)]


class _Record(Form, frozen=True):
    """A `KeyRecord`, member by member."""

    role: Role
    number: Annotated[int, within(0, 2**32 - 1)]
    key: PublicKey
    prepared_at: _Time
    activated_at: _Time | None
    retired_at: _Time | None
    tainted_at: _Time | None
    revoked_at: _Time | None


class _Ring(Form, frozen=True):
    issuer: Url
    version: Positive
    issued_at: _Time
    keys: Annotated[tuple[_Record, ...], upto(KEYS)]


def ring_to_json(ring: KeyRing) -> bytes:
    """The canonical JSON (RFC 8785) of the ring."""
    return strict_json.canonical(
        {
            "issuer": ring.issuer,
            "version": ring.version,
            "issued_at": ring.issued_at,
            "keys": [{**plain(record), "key": b64u(record.key)} for record in ring.records],
        }
    )


def ring_from_json(raw: bytes) -> KeyRing:
    """The ring of its JSON.

    Raises:
        BadKeyError: `KEY_MALFORMED` for any other form; `KEY_WRONG_ROLE` when a key occurs twice.
    """
    try:
        stated = read(_Ring, strict_json.parse_object(raw))
        records = tuple(KeyRecord(*astuple(record)) for record in stated.keys)
        return KeyRing(stated.issuer, stated.version, stated.issued_at, records)
    except BadKeyError:
        raise
    except CapabilityError as error:
        raise BadKeyError(FaultCode.KEY_MALFORMED, error.detail) from None
