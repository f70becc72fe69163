"""Enforcement point in a process of its own: says of each token whether it would act on it now."""

from __future__ import annotations

import asyncio
import json
import sys
import time
from pathlib import Path

from capabilities.token.token_text import token_from_text
from capabilities.values.caps import DEFAULT
from capabilities.values.errors import Fault
from pep.point.guard_config import GuardConfig
from pep.point.parts import PointParts, opened

LEASE_MS = 30_000
"""The lease of acts that move nothing: the load of this machine is no fault of a key."""


def say(**what):
    sys.stdout.write(json.dumps(what) + "\n")
    sys.stdout.flush()


class Point(PointParts):
    """The parts that every point has, and nothing that acts."""

    @property
    def edge(self):
        return self

    async def record(self, kind, body):
        say(incident=body)

    def close(self):
        """Nothing is open."""


async def main(path):
    config = GuardConfig.read(path)
    config.folder.mkdir(mode=0o700, parents=True, exist_ok=True)
    point = Point(config, **{name: value for name, value in opened(config).items() if name != "policies"})
    tasks = [asyncio.create_task(each) for each in point.beside().values()]
    point.follower.trusts.followers.append(lambda trust: say(version=trust.version, at=time.monotonic()))
    await point.first_view()
    say(ready=True)
    lines = asyncio.StreamReader(limit=2**20)
    await asyncio.get_running_loop().connect_read_pipe(lambda: asyncio.StreamReaderProtocol(lines), sys.stdin)
    while line := await lines.readline():
        asked = json.loads(line)
        found = point.authority.verifier.verify(
            token_from_text(asked["token"], DEFAULT), at=point.clock.wall_s(), audience=config.audience,
            view=point.follower.view(), lease_ms=LEASE_MS,
        )  # fmt: skip
        say(n=asked["n"], code=str(found.code) if isinstance(found, Fault) else "", at=time.monotonic())
    for task in tasks:
        task.cancel()
    await asyncio.gather(*tasks, return_exceptions=True)


if __name__ == "__main__":
    asyncio.run(main(Path(sys.argv[1])))
