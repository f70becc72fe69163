"""The peer: a bare FastAPI endpoint that proves, signs and commits, and does nothing else.

It verifies the same DPoP proof by PyJWT (EdDSA), signs one EdDSA JWT, and commits one row durably to the same database
under the same settings. It knows no parties, no scopes, no attestation, no revocation and no ledger.
"""

from __future__ import annotations

import asyncio
import base64
import hashlib
import time
from contextlib import asynccontextmanager, nullcontext
from typing import TYPE_CHECKING, Any, Final

import jwt
import sqlalchemy as sa
from fastapi import FastAPI, HTTPException, Request
from sqlalchemy.exc import IntegrityError
from sqlalchemy.ext.asyncio import AsyncConnection, create_async_engine

if TYPE_CHECKING:
    from collections.abc import AsyncIterator

    from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey

PATH: Final = "/bare"
AGE_S: Final = 35
"""Age of a proof with skew: that of the profile (docs/spec.md, [PRF-4])."""
LIFETIME_S: Final = 600

METADATA: Final = sa.MetaData()
ACTS: Final = sa.Table(
    "bench_acts",
    METADATA,
    sa.Column("jti", sa.Text, primary_key=True),
    sa.Column("key", sa.Text, nullable=False),
    sa.Column("at", sa.BigInteger, nullable=False),
)


def bare_app(database: str, issuer: str, key: Ed25519PrivateKey) -> FastAPI:
    """The endpoint `POST /bare`.

    Args:
        database: URL of the provider's own database.
        issuer: in the JWT; its origin and `PATH` are what a proof is for.
        key: signs the JWT.
    """
    engine = create_async_engine(database)
    sqlite = engine.dialect.name == "sqlite"
    # As the provider does: waiting here is fair and cheap, waiting inside of SQLite is neither.
    turn: asyncio.Lock | nullcontext[None] = asyncio.Lock() if sqlite else nullcontext()
    if sqlite:
        _as_the_provider_sets_it(engine.sync_engine)

    @asynccontextmanager
    async def lifespan(_: FastAPI) -> AsyncIterator[None]:
        async with engine.begin() as connection:
            await connection.run_sync(METADATA.create_all)
        yield
        await engine.dispose()

    app = FastAPI(lifespan=lifespan, docs_url=None, redoc_url=None, openapi_url=None)
    url = f"{issuer.rpartition('/')[0]}{PATH}"

    @app.post(PATH)
    async def act(request: Request) -> dict[str, Any]:
        """Proves, signs, commits."""
        said, now = _proven(request.headers.get("dpop", ""), url, await request.body()), int(time.time())
        holder = said["holder"]
        claims = {"iss": issuer, "sub": holder, "iat": now, "exp": now + LIFETIME_S, "jti": said["jti"]}
        token = jwt.encode(claims, key, algorithm="EdDSA")
        try:
            async with turn, engine.begin() as connection:
                await _commit(connection, jti=said["jti"], key=holder, at=now)
        except IntegrityError:
            raise HTTPException(401) from None
        return {"token": token}

    return app


async def _commit(connection: AsyncConnection, **row: object) -> None:
    await connection.execute(sa.insert(ACTS).values(**row))


def _proven(proof: str, url: str, body: bytes) -> dict[str, Any]:
    """Claims of a proof for exactly this request, with its key as `holder`."""
    try:
        head = jwt.get_unverified_header(proof)
        said: dict[str, Any] = jwt.decode(
            proof, jwt.PyJWK(head["jwk"], algorithm="EdDSA"), algorithms=["EdDSA"], options={"verify_iat": False}
        )
        wanted = {"typ": "dpop+jwt", "htm": "POST", "htu": url, "bdg": _digest(body)}
        found = {"typ": head["typ"], "htm": said["htm"], "htu": said["htu"], "bdg": said["bdg"]}
        if found != wanted or not abs(time.time() - said["iat"]) <= AGE_S:
            raise HTTPException(401)
    except (jwt.PyJWTError, KeyError, TypeError):
        raise HTTPException(401) from None
    return {**said, "holder": head["jwk"]["x"]}


def _digest(body: bytes) -> str:
    return base64.urlsafe_b64encode(hashlib.sha256(body).digest()).rstrip(b"=").decode()


def _as_the_provider_sets_it(engine: sa.Engine) -> None:
    """WAL, synchronous FULL, and a write lock from the first statement on, as in `ztpm_idp.store.engine`."""

    @sa.event.listens_for(engine, "connect")
    def _connect(connection: Any, _: Any) -> None:
        connection.isolation_level = None
        cursor = connection.cursor()
        for pragma in ("journal_mode = WAL", "synchronous = FULL", "foreign_keys = ON", "busy_timeout = 5000"):
            cursor.execute(f"PRAGMA {pragma}")
        cursor.close()

    @sa.event.listens_for(engine, "begin")
    def _begin(connection: sa.Connection) -> None:
        connection.exec_driver_sql("BEGIN IMMEDIATE")
