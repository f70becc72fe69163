"""Two thousand half-open connections of one address for a minute: revocations and stops of another one come through."""

import asyncio
import json
import os
import subprocess
import sys
import time

import httpx2
import pytest
from tests.pep.kit import HOST, PORT
from tests.pep.mcp.test_mcp import HEADERS, call_body
from tests.ztpm.point.test_tool_door import Surroundings, surroundings  # noqa: F401 - the second is a fixture
from tests.ztpm_idp.test_process import PASSPHRASE, Process
from ztpm_idp.client import ProofAuth

pytestmark = [pytest.mark.e2e, pytest.mark.campaign, pytest.mark.timeout(300)]
STRANGER, HONEST = "127.0.0.2", "127.0.0.3"
COUNT = 2_000
SECONDS = float(os.environ.get("ZTPM_CROWD_SECONDS", "60"))
LOG_BYTES = 100_000


async def in_a_crowd(host, port, request):
    """Milliseconds and status of each request, made one after the other on a connection of its own, by a crowd."""
    crowd = await asyncio.create_subprocess_exec(
        sys.executable, "-m", "tests.ztpm.point.crowd", host, str(port), STRANGER, str(COUNT), str(SECONDS),
        stdout=subprocess.PIPE,
    )  # fmt: skip
    took, statuses = [], []
    try:
        async with asyncio.timeout(SECONDS):
            await crowd.stdout.readline()
        ended = asyncio.create_task(crowd.stdout.readline())
        while not ended.done():
            began = time.perf_counter()
            try:
                transport = httpx2.AsyncHTTPTransport(local_address=HONEST)
                async with httpx2.AsyncClient(transport=transport, timeout=10) as http:
                    statuses.append((await request(http)).status_code)
            except httpx2.HTTPError as error:
                statuses.append(type(error).__name__)
            took.append((time.perf_counter() - began) * 1_000)
            await asyncio.sleep(0.05)
        return sorted(took), statuses, json.loads(ended.result())["opened"]
    finally:
        if crowd.returncode is None:
            crowd.kill()
        await crowd.wait()


def judged(what, took, statuses, opened, log):
    """Holds the figures to what was promised, and tells them."""
    p99 = took[int(len(took) * 0.99)]
    size = log.stat().st_size
    print(
        f"\n{what}: {len(took)} requests beside {COUNT} half-open connections ({opened} opened in {SECONDS:.0f} s): "
        f"median {took[len(took) // 2]:.0f} ms, p99 {p99:.0f} ms, slowest {took[-1]:.0f} ms, "
        f"refused {sum(status != 200 for status in statuses)}; log {size} bytes"
    )
    assert len(took) > SECONDS
    assert set(statuses) == {200}
    assert p99 < 1_000
    assert size < LOG_BYTES


def test_revocations_come_through(tmp_path):
    made = Process(tmp_path)
    log = tmp_path / "idp.log"
    with log.open("wb") as told:
        made.popen = subprocess.Popen(
            [sys.executable, "-m", "ztpm.point.provider_server", "--config", str(tmp_path / "idp.toml")],
            stdout=subprocess.PIPE, stderr=told, env=os.environ | {"ZTPM_PASSPHRASE": PASSPHRASE},
        )  # fmt: skip
    try:
        assert json.loads(made.popen.stdout.readline())["ready"]
        number = iter(range(10**6))

        async def revoke(http):
            body = {"kind": "hop", "id": f"{next(number):032x}", "reason": "a crowd"}
            return await http.post(
                made.issuer + "/revocations", content=json.dumps(body), auth=ProofAuth(made.private["alice"])
            )

        judged("revocations", *asyncio.run(in_a_crowd("127.0.0.1", made.port, revoke)), log)
    finally:
        made.popen.kill()
        made.popen.wait()


def test_stops_come_through(surroundings):  # noqa: F811 - the fixture
    cell: Surroundings = surroundings
    log = cell.tmp / "tools.log"

    async def stop(http):
        return await http.post(
            f"http://{HOST}:{PORT}/mcp",
            content=json.dumps(call_body("stop", {})),
            headers={**HEADERS, "mcp-name": "stop"},
        )

    async def scenario():
        async with cell.running():
            return await in_a_crowd(HOST, PORT, stop)

    with log.open("wb") as told:
        cell.log = told
        judged("stops", *asyncio.run(scenario()), log)
    assert cell.arm.stops > SECONDS
