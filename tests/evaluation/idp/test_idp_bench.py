"""The benchmark of the identity provider: its figures, and its peer, which does what it is said to do."""

import asyncio
import time

import httpx2
import jwt
import pytest
import sqlalchemy as sa
from capabilities.proof.proof import prove
from evaluation.idp.bare import ACTS, bare_app
from evaluation.idp.bench import IdpResult, OperationRow, PlaceRow, last_line, percentile, slope, tables

from capabilities.keys import keys

ISSUER = "http://127.0.0.1:8890/ztpm"
URL = "http://127.0.0.1:8890/bare"
RESULT = IdpResult(
    (
        OperationRow("sqlite", 1, "bare", 100, 400.0, None, 2.0, 9.0, 1.4),
        OperationRow("sqlite", 1, "issue", 100, 200.0, 0.5, 4.0, 9.0, 3.0),
        OperationRow("sqlite", 1, "introspect", why="the provider has none"),
        OperationRow("sqlite", 2, "issue", 100, 300.0, 0.75, 4.0, 9.0, 3.0),
    ),
    (
        PlaceRow("sqlite", 1, 10_000, 20.0, 300.0, 4, 110.0, -2.0),
        PlaceRow("sqlite", 2, 10_000, 20.0, 200.0, 4, 220.0, 5.0),
        PlaceRow("postgresql", 1, 10_000, why="not installed"),
    ),
    clients=8,
    seconds=1.0,
    machine={},
)


def test_the_worst_row_of_an_operation_is_its_ratio():
    told = RESULT.to_json()
    assert told["ratios"] == {"issue": 0.5, "introspect": None, "revoke": None, "delegate": None}
    assert told["revocation_ms"]["p99"] == 300.0 and told["memory_slope_kib"] == 5.0 and told["agents"] == 10_000
    assert len(told["rows"]) == 7
    assert [table.row_count for table in tables(RESULT)] == [4, 3]
    assert "issue 0.50 (bar 0.5)" in last_line(RESULT) and "introspect none" in last_line(RESULT)


def test_percentiles_and_slopes():
    assert percentile([3.0, 1.0, 2.0], 99) == 3.0
    assert percentile(list(range(200)), 99) == 198
    assert slope([(0.0, 5.0), (1.0, 7.0), (2.0, 9.0)]) == pytest.approx(2.0)
    assert slope([(0.0, 5.0)]) == 0.0


def test_the_peer_proves_signs_and_commits(tmp_path):
    key, signer, database = keys.generate(), keys.generate(), f"sqlite+aiosqlite:///{tmp_path}/peer.sqlite"
    app = bare_app(database, ISSUER, signer)

    def proof(jti, **changes):
        made = dict(method="POST", url=URL, body=b"{}", token=None, at=int(time.time()), jti=jti * 22) | changes
        return {"dpop": prove(key, **made)}

    async def asked():
        async with (
            app.router.lifespan_context(app),
            httpx2.AsyncClient(transport=httpx2.ASGITransport(app=app)) as http,
        ):
            good = await http.post(URL, content=b"{}", headers=proof("a"))
            wrong = [
                await http.post(URL, content=b"{}", headers=headers)
                for headers in (
                    proof("a"),
                    proof("b", body=b"[]"),
                    proof("c", url=f"{URL}/"),
                    proof("d", at=int(time.time()) - 60),
                    {"dpop": proof("e")["dpop"][:-8] + "AAAAAAAA"},
                    {},
                )
            ]
            return good, wrong

    good, wrong = asyncio.run(asked())
    assert [each.status_code for each in wrong] == [401] * len(wrong)
    claims = jwt.decode(good.json()["token"], signer.public_key(), algorithms=["EdDSA"])
    assert claims["iss"] == ISSUER and claims["sub"] == keys.b64u(keys.public_raw(key))
    with sa.create_engine(f"sqlite:///{tmp_path}/peer.sqlite").connect() as connection:
        assert [row.jti for row in connection.execute(sa.select(ACTS))] == ["a" * 22]
        assert connection.execute(sa.text("PRAGMA journal_mode")).scalar() == "wal"
