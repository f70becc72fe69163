"""Health of an enforcement point: alive always, ready while its view of revocations permits anything."""

import asyncio

import httpx2
import pytest
from ztpm.point.health import health

from capabilities.statements.revocation import NEVER_MS


def asked(path, age_ms, method="GET"):
    app = health(lambda: age_ms, lambda: 30_000)[path]

    async def go():
        async with httpx2.AsyncClient(transport=httpx2.ASGITransport(app=app), base_url="http://h") as http:
            return await http.request(method, path)

    return asyncio.run(go())


@pytest.mark.parametrize("age_ms", [0, 30_001, NEVER_MS])
@pytest.mark.parametrize("path", ["/livez", "/healthz"])
def test_it_lives_however_old_its_view(path, age_ms):
    answer = asked(path, age_ms)
    assert (answer.status_code, answer.json()) == (200, {"alive": True})


@pytest.mark.parametrize(("age_ms", "ready"), [(0, True), (30_000, True), (30_001, False), (NEVER_MS, False)])
def test_it_is_ready_while_its_view_is_young(age_ms, ready):
    answer = asked("/readyz", age_ms)
    assert (answer.status_code, answer.json()["ready"]) == (200 if ready else 503, ready)
    assert ready or set(answer.json()["causes"]) == {"revocation_view"}


def test_it_is_only_read():
    assert asked("/readyz", 0, "POST").status_code == 405
    assert asked("/livez", 0, "HEAD").content == b""
