"""Every scenario `auth/*` of the MCP conformance suite for clients, with DPoP around each of the SDK's providers."""

from __future__ import annotations

import asyncio
import json
import re

import pytest
from tests.ztpm_idp.client.suite_client import LONGEST_S, Stage
from tests.ztpm_idp.oauth.conformance import suite_command

pytestmark = [pytest.mark.e2e, pytest.mark.timeout(600)]
PROVEN = {"auth/dpop", "auth/dpop-nonce"}
"""Scenarios that a bearer token fails."""
NAMED = re.compile(r"(auth/.+)-20[0-9]{2}-[0-9]{2}-[0-9]{2}T")


async def verdicts(place, *asked, bound):
    """Checks that each scenario `auth/*` failed, by scenario; what is only warned of is among them."""
    place.mkdir()
    command = [*suite_command(), "client", "--timeout", str(round(1_000 * LONGEST_S)), "-o", str(place / "out"), *asked]
    async with Stage(place / "socket", bound=bound) as stage, asyncio.timeout(2 * LONGEST_S):
        run = await asyncio.create_subprocess_exec(
            *command, "--command", stage.command, stdout=asyncio.subprocess.PIPE, stderr=asyncio.subprocess.STDOUT
        )
        said = (await run.communicate())[0].decode()
    found = {}
    for kept in (place / "out").rglob("checks.json"):
        if (name := NAMED.search(kept.as_posix())) is not None:
            checks = json.loads(kept.read_text())
            lacks = [] if any(check["status"] == "SUCCESS" for check in checks) else ["nothing succeeded"]
            found[name[1]] = lacks + [each["id"] for each in checks if each["status"] in {"FAILURE", "WARNING"}]
    assert found.keys() == stage.ended.keys() != set(), said[-2_000:]
    return {name: failed for name, failed in found.items() if failed}, len(found)


@pytest.mark.parametrize(
    ("asked", "version", "least"),
    [(("--suite", "all"), (), 33), (("--requirements", "2026-07-28"), ("--spec-version", "2026-07-28", "--force"), 31)],
    ids=["all", "2026-07-28"],
)
def test_every_scenario_passes_with_dpop_around_the_sdks_provider(tmp_path, asked, version, least):
    failed, played = asyncio.run(verdicts(tmp_path / "all", *asked, bound=True))
    assert played >= least
    # The suite plays all at once; on a busy machine some of them end too early, and pass alone.
    for number, name in enumerate(failed):
        alone = verdicts(tmp_path / str(number), "--scenario", name, *version, bound=True)
        assert asyncio.run(alone) == ({}, 1), (name, failed)


def test_the_sdks_providers_alone_fail_where_a_proof_is_wanted(tmp_path):
    failed, _ = asyncio.run(verdicts(tmp_path / "bare", "--suite", "extensions", bound=False))
    assert failed.keys() == PROVEN
