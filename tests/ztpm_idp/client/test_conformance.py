"""Every scenario `auth/*` of the MCP conformance suite for clients, with DPoP around each of the SDK's providers."""

from __future__ import annotations

import asyncio
import json
import re

import pytest
from tests.ztpm_idp.client.suite_client import Stage
from tests.ztpm_idp.oauth.conformance import suite_command

pytestmark = [pytest.mark.e2e, pytest.mark.xdist_group("conformance")]
LONGEST_S = 120
PROVEN = {"auth/dpop", "auth/dpop-nonce"}
"""Scenarios that a bearer token fails."""


async def verdicts(place, *asked, bound):
    """Checks that each scenario `auth/*` failed, by scenario; what is only warned of is among them."""
    async with Stage(place / "socket", bound=bound) as stage, asyncio.timeout(LONGEST_S):
        run = await asyncio.create_subprocess_exec(
            *suite_command(), "client", "--command", stage.command, *asked, "-o", str(place / "out"),
            stdout=asyncio.subprocess.PIPE, stderr=asyncio.subprocess.STDOUT,
        )  # fmt: skip
        said = (await run.communicate())[0].decode()
    summary = said.partition("=== SUITE SUMMARY ===")[2]
    counted = {name: int(passed) for name, passed in re.findall(r"^\S (auth/\S+): (\d+) passed", summary, re.MULTILINE)}
    found = {}
    for name in counted:
        (kept,) = (place / "out").glob(f"{name}-20[0-9][0-9]-*/checks.json")
        checks = json.loads(kept.read_text())
        assert counted[name] == sum(check["status"] == "SUCCESS" for check in checks) > 0, name
        found[name] = [check["id"] for check in checks if check["status"] in {"FAILURE", "WARNING"}]
    assert counted.keys() == stage.ended.keys(), said[-2_000:]
    return found


@pytest.mark.parametrize(
    ("asked", "least"), [(("--suite", "all"), 33), (("--requirements", "2026-07-28"), 24)], ids=["all", "2026-07-28"]
)
def test_every_scenario_passes_with_dpop_around_the_sdks_provider(tmp_path, asked, least):
    found = asyncio.run(verdicts(tmp_path, *asked, bound=True))
    assert len(found) >= least
    assert {name: failed for name, failed in found.items() if failed} == {}


def test_the_sdks_providers_alone_fail_where_a_proof_is_wanted(tmp_path):
    found = asyncio.run(verdicts(tmp_path, "--suite", "extensions", bound=False))
    assert {name for name, failed in found.items() if failed} == PROVEN
