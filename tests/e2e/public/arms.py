"""Servers for UR arms that others published, behind one gateway: the arm does what the token grants, and stands else.

`python -m tests.e2e.public.arms [--folder DIR] [NAME...]` installs both from PyPI in environments of their own and
gives each a simulated controller, to whose ports it speaks by itself. The arm's joints are read over RTDE, by a
connection of this program's: before and after each call, and for a second after one that is refused.
"""

from __future__ import annotations

import asyncio
import contextlib
import sys
import time
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

from capabilities.values.scope import Budget, Range, Tier, Words
from rtde_receive import RTDEReceiveInterface
from tests.e2e.public.site import (
    DONE, LIMITED, Package, Site, approved_once, expect, judged, run, text_of,
)  # fmt: skip
from tests.e2e.test_tool_gateway import in_time
from ursim.ports.launch import SimulatedController

from pep import grant

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping, Sequence
    from pathlib import Path

START = (0.0, -1.5708, 1.5708, -1.5708, -1.5708, 0.0)
REACH_URAD = 300_000
"""As far as the token lets each joint go from its start."""
STANDS_S = 1.0
"""An arm that stands this long after a call was refused did not heed it."""
ARRIVES_S = 15.0
NEAR_RAD = 0.002
STANDS_RAD = 1e-6


class World:
    """A controller for each server, and one that no token names."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder.absolute()
        self.folder.mkdir()
        self.stack = contextlib.ExitStack()

    def controller(self) -> str:
        """The address of another controller."""
        return self.stack.enter_context(SimulatedController.start(START)).host

    def joints(self, host: str) -> Callable[[], tuple[float, ...]]:
        """Reader of an arm's joints."""
        receive = RTDEReceiveInterface(host)
        self.stack.callback(receive.disconnect)
        return lambda: tuple(receive.getActualQ())


@dataclass(frozen=True, kw_only=True)
class ArmServer(Package):
    """One server.

    Attributes:
        connect: its tool that connects, and the argument with the address.
        move: its tool that moves the joints.
        grants: bounds of the token, by tool and parameter.
        call: arguments of a motion to these joints, at this address, fast or not.
        raw: a tool that takes whole programs, or more than can be limited; any call of it is refused.
        asks: whether each motion is asked for, or only a fast one.
    """

    connect: tuple[str, str]
    move: str
    grants: Callable[[str], Mapping[str, Mapping[str, Any]]]
    call: Callable[[str, Sequence[float], bool], dict[str, Any]]
    raw: tuple[str, ...]
    asks: bool


def around(urad: float) -> Range:
    return Range(round(urad * 1e6) - REACH_URAD, round(urad * 1e6) + REACH_URAD)


def far_from(joints: Sequence[float], at: Sequence[float]) -> float:
    return max(abs(a - b) for a, b in zip(joints, at, strict=True))


SERVERS = (
    ArmServer(
        package="universal-robot-mcp==0.1.4", program="universal-robot-mcp", also=("mcp<2", "numpy"),
        connect=("connect_robot", "robot_ip"), move="move_robot_joints",
        grants=lambda ip: {
            "connect_robot": {"robot_ip": Words(frozenset({ip}))}, "get_robot_status": {},
            "move_robot_joints": {f"joint{at + 1}": around(each) for at, each in enumerate(START)},
        },
        call=lambda ip, joints, fast: {f"joint{at + 1}": each for at, each in enumerate(joints)}
        | {"acceleration": 2.0, "velocity": 1.5 if fast else 0.5},
        raw=("move_robot_anywhere",), asks=False,
    ),
    ArmServer(
        package="nonead-universal-robots-mcp==0.1.1", program="nonead-universal-robots-mcp", checked=False,
        also=("mcp[cli]==1.6.0", "pydantic==2.11.3", "numpy==2.1.3", "pandas==2.2.3", "scipy==1.15.2", "six==1.17.0",
              "matplotlib==3.10.1", "paramiko==3.5.1", "seaborn==0.13.2", "scikit-learn==1.8.0", "lxml==5.4.0"),
        connect=("connect_ur", "ip"), move="movej",
        grants=lambda ip: {
            "connect_ur": {"ip": Words(frozenset({ip}))}, "get_actual_joint_pose": {"ip": Words(frozenset({ip}))},
            "movej": {"ip": Words(frozenset({ip}))} | {f"q_{at}": around(each) for at, each in enumerate(START)},
        },
        call=lambda ip, joints, fast: {"ip": ip, "q": list(joints)},
        raw=("send_program_script", "movel", "draw_circle"), asks=True,
    ),
)  # fmt: skip


async def tried(site: Site, server: ArmServer) -> list[str]:
    """Findings of one server.

    Raises:
        Wrong: something is not as it should be.
    """
    host, other = site.world.controller(), site.world.controller()
    joints, others = site.world.joints(host), site.world.joints(other)
    agent = site.agent(server.name)
    bounds = server.grants(host)
    budgets = {server.move: (Budget("", site.audience, 600, 3),)}
    grants = [grant(site.rows[name], *budgets.get(name, ()), **bounds[name]) for name in bounds]
    token = site.lend(agent, *grants, ceiling=Tier.HIGH_CONSEQUENCE)
    near, far = ((*START[:5], START[5] + by) for by in (0.2, 0.4))

    def state() -> tuple[int, tuple[float, ...]]:
        """Acts that were carried out, and where the arm stands once it does."""
        at = joints()
        while time.sleep(0.2) or far_from(now := joints(), at) > STANDS_RAD:
            at = now
        return site.done(), tuple(round(each, 4) for each in now)

    async def stands(what: str, at: Sequence[float]) -> None:
        until = time.monotonic() + STANDS_S
        while time.monotonic() < until:
            expect(f"{what}: the arm stands at {at}, not {joints()}", far_from(joints(), at) < STANDS_RAD, True)
            await asyncio.sleep(0.02)

    async def arrives(what: str, at: Sequence[float]) -> None:
        until = time.monotonic() + ARRIVES_S
        while far_from(joints(), at) > NEAR_RAD:
            if time.monotonic() > until:
                expect(f"{what}: joints", joints(), tuple(at))
            await asyncio.sleep(0.05)
        state()

    async def refused(what: str, call: tuple[str, dict[str, Any]], wanted: tuple[str, str]) -> None:
        at = joints()
        answer = await in_time(client, *call)
        expect(what, judged(answer), wanted)
        await stands(what, at)

    with (site.folder / f"{server.name}.log").open("w") as log:
        async with site.client(server.name, token, agent, log) as client:
            expect("listed", sorted(each.name for each in (await client.list_tools()).tools), sorted(bounds))
            tool, argument = server.connect
            # A controller that the token does not name is not even spoken to.
            await refused("another address", (tool, {argument: other}), LIMITED)
            answer = await in_time(client, tool, {argument: host})
            expect(f"connected: {text_of(answer)}", (judged(answer), answer.is_error), (DONE, False))

            for raw in server.raw:
                await refused(raw, (raw, {"ip": host, "script": "movej([1,-1,1,-1,-1,0])"}), ("DENY", "TOOL_UNKNOWN"))
            await refused("beyond the token", (server.move, server.call(host, far, False)), LIMITED)

            moved = (server.move, server.call(host, near, False))
            answer = await (approved_once(site, client, moved, state) if server.asks else in_time(client, *moved))
            expect(f"permitted: {text_of(answer)}", judged(answer), DONE)
            await arrives("permitted", near)

            # By a person's leave: while people are asked, and once it was used, the arm stands.
            before = site.done()
            await approved_once(site, client, (server.move, server.call(host, START, True)), state)
            expect("acts", site.done(), before + 1)
            await arrives("approved", START)
            if not server.asks:
                answer = await in_time(client, *moved)
                expect("within the budget", judged(answer), DONE)
                await arrives("within the budget", near)
                back = (server.move, server.call(host, START, False))
                await refused("beyond the budget", back, ("DENY", "BUDGET_SPENT"))
            expect(f"the other arm: {others()}", far_from(others(), START) < STANDS_RAD, True)
    return ["moved when permitted", "stood when refused", "moved once when approved"]


@contextlib.contextmanager
def world_in(folder: Path, _: object) -> Iterator[World]:
    """The controllers, as long as the block."""
    world = World(folder)
    with world.stack:
        yield world


def main() -> int:
    """Runs it; the exit status."""
    count, wrong = run(SERVERS, __doc__, tried, world_in)
    sys.stdout.write(f"{count - wrong} of {count} servers move the arm by the token, and never beyond it\n")
    return 1 if wrong or not count else 0


if __name__ == "__main__":
    sys.exit(main())
