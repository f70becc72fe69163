"""Steps of a transaction on PostgreSQL, each as one statement.

A trip to the server costs more than what it does there. Lists are one parameter each, so that one text is prepared once
for every length. All but the first are given to the driver as they are.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final

import sqlalchemy as sa
from sqlalchemy.dialects import postgresql
from sqlalchemy.exc import DBAPIError, IntegrityError

from ztpm_idp.store.database import postgres

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from sqlalchemy.ext.asyncio import AsyncConnection

    from ztpm_idp.domain.locks import Locks

INTEGRITY: Final = "23"
"""Class of the SQLSTATEs of constraints that do not hold."""
_BEGIN: Final = sa.text(
    f"WITH taken AS MATERIALIZED ({postgres.TAKE}) "  # noqa: S608 - all of it is ours
    "INSERT INTO proofs (key, jti, forget_ms) SELECT use.key, use.jti, use.forget_ms "
    "FROM unnest(CAST(:keys AS bytea[]), CAST(:jtis AS text[]), CAST(:forget_ms AS bigint[])) "
    "AS use (key, jti, forget_ms) "
    # Locks first, as everybody does.
    "WHERE (SELECT count(*) FROM taken) >= 0 ON CONFLICT DO NOTHING RETURNING key, jti"
)
_SPEND: Final = (
    "UPDATE nonces SET spent_on = spent.purpose FROM unnest($1::text[], $2::text[]) AS spent (nonce, purpose) "
    "WHERE nonces.nonce = spent.nonce AND nonces.spent_on IS NULL RETURNING nonces.nonce"
)
_GIVE: Final = (
    "WITH old AS (DELETE FROM nonces WHERE agent = ANY ($2::text[]) AND given_ms < $4) "
    "INSERT INTO nonces (nonce, agent, given_ms) SELECT given.nonce, given.agent, given.given_ms "
    "FROM unnest($1::text[], $2::text[], $3::bigint[]) AS given (nonce, agent, given_ms)"
)
_APPEND: Final = (
    "WITH entries AS (INSERT INTO ledger (seq, hash, line) SELECT entry.seq, entry.hash, entry.line "
    "FROM unnest($1::bigint[], $2::text[], $3::bytea[]) AS entry (seq, hash, line)"
    "), counted AS (UPDATE counters SET {changes} RETURNING epoch) "
    "SELECT CASE WHEN $4 THEN pg_notify($5, epoch::text) END FROM counted"
)


async def fetch(connection: AsyncConnection, text: str, *values: object) -> Sequence[Any]:
    """Rows of a statement within a transaction that has begun, as the driver gives them.

    Raises: what SQLAlchemy would.
    """
    driver: Any = (await connection.get_raw_connection()).driver_connection
    try:
        rows: Sequence[Any] = await driver.fetch(text, *values)
    except postgres.driver_errors() as error:
        broken = str(getattr(error, "sqlstate", None) or "").startswith(INTEGRITY)
        raise (IntegrityError if broken else DBAPIError)(text, None, error, hide_parameters=True) from error
    return rows


async def begin(
    connection: AsyncConnection, locks: Locks, uses: Sequence[tuple[bytes, str, int]]
) -> list[tuple[bytes, str]]:
    """The locks are held, and the proofs are used up; those of them that were not used before.

    What is read after it is the newest.

    Args:
        connection: of a transaction that begins with it.
        locks: of `domain.locks`.
        uses: key, id, and when each is forgotten, milliseconds since the epoch; in one order, so that no two
            transactions wait for each other.
    """
    given = {
        "keys": [key for key, _, _ in uses],
        "jtis": [jti for _, jti, _ in uses],
        "forget_ms": [at_ms for _, _, at_ms in uses],
    }
    made = await connection.execute(_BEGIN, postgres.taken(locks) | given)
    return [(bytes(key), jti) for key, jti in made]


async def spend(connection: AsyncConnection, purposes: Mapping[str, str]) -> list[str]:
    """The nonces are spent, each on its purpose; those of them that were not spent before."""
    return [nonce for (nonce,) in await fetch(connection, _SPEND, list(purposes), list(purposes.values()))]


async def give(connection: AsyncConnection, nonces: Sequence[tuple[str, str, int]], *, old_ms: int) -> None:
    """Writes nonces (nonce, agent, when it was given); those of the same agents given before `old_ms` are forgotten."""
    await fetch(connection, _GIVE, *map(list, zip(*nonces, strict=True)), old_ms)


class Inserting:
    """New rows of one table, however many."""

    def __init__(self, table: sa.Table) -> None:
        self._names = tuple(table.columns.keys())
        kinds = [column.type.compile(postgresql.dialect()) for column in table.columns]  # type: ignore[no-untyped-call]
        arrays = ", ".join(f"${place}::{kind}[]" for place, kind in enumerate(kinds, start=1))
        names = ", ".join(f'"{name}"' for name in self._names)
        self._text = f'INSERT INTO "{table.name}" ({names}) SELECT * FROM unnest({arrays})'  # noqa: S608 - names of ours

    async def write(self, connection: AsyncConnection, rows: Sequence[Mapping[str, Any]]) -> None:
        """Writes the rows."""
        await fetch(connection, self._text, *([row[name] for row in rows] for name in self._names))


class Appending:
    """Entries of the ledger and the counters after them, written at once.

    Args:
        names: of all counters.
    """

    def __init__(self, names: Sequence[str]) -> None:
        changes = ", ".join(f"{name} = ${place}" for place, name in enumerate(names, start=6))
        self._names = tuple(names)
        self._text = _APPEND.format(changes=changes)

    async def write(
        self,
        connection: AsyncConnection,
        lines: Sequence[Mapping[str, Any]],
        counters: Mapping[str, Any],
        *,
        tell: bool,
    ) -> None:
        """Writes the entries and the counters; with `tell`, listeners hear of the epoch once it is committed."""
        entries = ([line[name] for line in lines] for name in ("seq", "hash", "line"))
        after = (counters[name] for name in self._names)
        await fetch(connection, self._text, *entries, tell, postgres.EPOCH_CHANNEL, *after)
