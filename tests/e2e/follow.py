"""Follower of a PEP in a process of its own, which prints when more is revoked in its view."""

from __future__ import annotations

import asyncio
import json
import sys
import time
from pathlib import Path

import httpx2
from cryptography.hazmat.primitives.asymmetric.ed25519 import Ed25519PrivateKey
from capabilities.keys.trust import TrustBundle
from capabilities.values.caps import DEFAULT
from pep.base.clock import SystemClock
from pep.provider.feed import ProviderFollower
from pep.provider.feed_mark import FeedMarkFile

LOOK_S = 0.0005
"""Interval between looks at the view, seconds: the resolution of the measurement."""


def say(**what):
    sys.stdout.write(json.dumps(what) + "\n")
    sys.stdout.flush()


async def main(issuer, folder, period_s):
    key = Ed25519PrivateKey.from_private_bytes((Path(folder) / "key").read_bytes())
    http = httpx2.AsyncClient()
    trust = TrustBundle.from_json((await http.get(issuer + "/trust")).content)
    follower = ProviderFollower(
        http, issuer=issuer, key=key, audience="http://127.0.0.1:8800/mcp", trust=trust, caps=DEFAULT, clock=SystemClock(),
        mark=FeedMarkFile(Path(folder) / "feed.json"), incident=lambda error: say(incident=str(error)),
    )  # fmt: skip
    running = asyncio.create_task(follower.run(period_s=period_s))
    shown = -1
    while not running.done():
        view = follower.view()
        if view.age_ms < 10**9 and len(view.revoked) > shown:
            shown = len(view.revoked)
            say(revoked=shown, at_ns=time.monotonic_ns())
        await asyncio.sleep(LOOK_S)


if __name__ == "__main__":
    asyncio.run(main(sys.argv[1], sys.argv[2], float(sys.argv[3])))
