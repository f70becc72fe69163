"""Site for servers that others published: installed in environments of their own, behind one gateway as a process."""

from __future__ import annotations

import argparse
import asyncio
import json
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import tomllib
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from mcp import Client, StdioServerParameters
from mcp.client.stdio import stdio_client
from tests.e2e.test_any_tool import TOP, approve, told
from tests.e2e.test_tool_gateway import Front, in_time
from tests.progress import telling
from tests.ztpm_idp.test_process import PASSPHRASE
from ztpm.base.layout import Layout

from capabilities.keys import keys

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Mapping, Sequence
    from contextlib import AbstractContextManager

INSTALLED = TOP / ".public-servers"
"""Place where the servers are installed, and found again."""
MAPPINGS = TOP / "examples" / "mappings"
DONE = ("PERMIT", "PERMITTED")
LIMITED = ("DENY", "LIMIT_EXCEEDED_BY_REQUEST")
ASKED = ("DEFER", "TIER_NEEDS_APPROVAL")
USED = ("DEFER", "APPROVAL_USED")
DEADLINE_S = 90.0
"""Longest wait for all servers to be there, and for an approval to reach the gateway."""
START_S = 600
"""Longest installation of one server."""
END_S = 60
"""Longest end of a gateway with all its servers."""


@dataclass(frozen=True, kw_only=True)
class Package:
    """A server as it was published, and its process in a world.

    Attributes:
        package: on its registry, with its version.
        program: of the package.
        options: of the program.
        environment: of its process.
        also: requirements that the package forgets to state.
        npm: whether it is of npm, else of PyPI.
        checked: whether its requirements are its own; else `also` are all, in the Python that there is.
    """

    package: str
    program: str
    options: Callable[[Any], Sequence[str]] = field(default=lambda _: [])
    environment: Callable[[Any], Mapping[str, str]] = field(default=lambda _: {})
    also: tuple[str, ...] = ()
    npm: bool = False
    checked: bool = True

    @property
    def name(self) -> str:
        """Its name here, and of its mapping."""
        return self.package.rpartition("@")[0].rpartition("/")[2] if self.npm else self.package.partition("==")[0]

    @property
    def version(self) -> str:
        return re.split("==|@", self.package)[-1]

    @property
    def mapping(self) -> dict[str, Any]:
        return tomllib.loads((MAPPINGS / f"{self.name}.toml").read_text())

    def install(self, folder: Path) -> Path:
        """The program, in an environment of its own; one that is there already is taken."""
        home = folder / f"{self.name}-{self.version}"
        program = home / ("node_modules/.bin" if self.npm else "bin") / self.program
        if program.exists():
            return program
        python, uv = str(home / "bin" / "python"), shutil.which("uv") if self.checked else None
        if self.npm:
            commands = [["npm", "install", "--prefix", str(home), "--no-audit", "--no-fund", "--silent", self.package]]
        else:
            made = [uv, "venv", "-q", "--python", sys.executable] if uv else [sys.executable, "-m", "venv"]
            put = [uv, "pip", "install", "-q", "--python", python] if uv else [python, "-m", "pip", "install", "-q"]
            alone = [] if self.checked else ["--no-deps", "--ignore-requires-python"]
            commands = [[*made, str(home)], [*put, *alone, self.package], *([[*put, *self.also]] if self.also else [])]
        for command in commands:
            done = subprocess.run(command, capture_output=True, text=True, timeout=START_S, check=False)
            if done.returncode:
                raise SystemExit(f"{self.package} cannot be installed: {done.stderr[-500:]}")
        return program


class Site(Front):
    """The provider and one gateway, with all the servers behind it as processes."""

    def __init__(self, folder: Path, world: Any, programs: Mapping[Package, Path]) -> None:
        folder.mkdir()
        super().__init__(folder)
        # People are asked for all the servers within a minute.
        self.provider.end(signal.SIGTERM)
        with self.provider.config.open("a") as config:
            config.write("\nasks_a_minute = 60\n")
        self.provider.start()
        self.world, self.programs = world, programs
        self.own = {name: value for each in programs for name, value in each.environment(world).items()}

    @property
    def environment(self) -> dict[str, str]:
        return super().environment | self.own

    def write(self) -> None:
        lines = []
        for each, program in self.programs.items():
            lines += [
                f"[upstream.{each.name}]",
                f"command = {json.dumps([str(program), *each.options(self.world)])}",
                f"folder = {json.dumps(str(self.world.folder))}",
                f"mapping = {json.dumps(str(MAPPINGS / f'{each.name}.toml'))}",
                f"environment = {json.dumps(sorted(each.environment(self.world)))}",
            ]
        self.configure("\n".join(lines))

    def open(self) -> None:
        """Has the servers reviewed by a person, and serves them."""
        self.write()
        self.pinned(DEADLINE_S)
        self.start()

    def bridge(self, name: str, token: str, agent: Any) -> StdioServerParameters:
        """Command for a client that starts servers by one."""
        layout = Layout(self.folder / "data")
        layout.agent_key(agent.id).parent.mkdir(parents=True, exist_ok=True)
        layout.agent_key(agent.id).write_bytes(keys.to_pem(agent.key, PASSPHRASE.encode()))
        layout.agent_key(agent.id).chmod(0o600)
        layout.trust.write_bytes((self.folder / "trust.json").read_bytes())
        (self.folder / f"{name}.token").write_text(token)
        words = ["connect", agent.id, self.audience, "--token", str(self.folder / f"{name}.token")]
        return StdioServerParameters(
            command=sys.executable, args=["-m", "ztpm", "mcp", *words, "--data", str(layout.root)],
            env=self.environment, cwd=TOP,
        )  # fmt: skip

    def client(self, name: str, token: str, agent: Any, log: Any) -> Client:
        """A client that knows only stdio."""
        return Client(stdio_client(self.bridge(name, token, agent), errlog=log))

    def end(self) -> None:
        """The gateway ends its servers, of which some do not end with their input, and then all else ends."""
        if self.child is not None:
            self.child.terminate()
            self.child.wait(END_S)
        super().end()

    def done(self) -> int:
        """Acts that the gateway's journal has as carried out."""
        return sum(record["kind"] == "outcome" and record["body"]["outcome"] == "done" for record in self.records())


class Wrong(Exception):
    """One thing that is not as it should be."""


def expect(what: str, found: object, wanted: object) -> None:
    if found != wanted:
        raise Wrong(f"{what}: {found!r} in place of {wanted!r}")


def judged(answer: Any) -> tuple[str, str]:
    """Decision and reason of an answer."""
    return told(answer)["decision"], told(answer)["reason"]


def first(error: BaseException) -> BaseException:
    """The first error within a group, or the error itself."""
    while isinstance(error, BaseExceptionGroup):
        error = error.exceptions[0]
    return error


async def approved_once(
    site: Site, client: Client, call: tuple[str, dict[str, Any]], state: Callable[[], object]
) -> Any:
    """Answer to a call that a person approved: it is deferred, done once after the approval, and then deferred again.

    Args:
        site: of the gateway.
        client: of the call.
        call: of which people are asked.
        state: all that is seen of acts.

    Raises:
        Wrong: it is otherwise.
    """
    before = state()
    answer = await in_time(client, *call)
    expect("deferred", judged(answer), ASKED)
    expect("state while people are asked", state(), before)
    await asyncio.to_thread(approve, site, told(answer)["approval_id"])
    until = time.monotonic() + DEADLINE_S
    while judged(answer := await in_time(client, *call)) != DONE:
        if time.monotonic() > until:
            expect("approved", told(answer), DONE)
        await asyncio.sleep(0.1)
    expect("approved", answer.is_error, False)
    after = state()
    expect("the same again", judged(await in_time(client, *call)), USED)
    expect("state after the same again", state(), after)
    return answer


def text_of(answer: Any) -> str:
    return "\n".join(getattr(each, "text", "") for each in answer.content)


def run(
    servers: Sequence[Package],
    about: str,
    tried: Callable[[Site, Any], Any],
    world_in: Callable[[Path, Mapping[Any, Path]], AbstractContextManager[Any]],
) -> tuple[int, int]:
    """Installs the servers that the command line names, and tries them behind one gateway.

    Args:
        servers: that there are.
        about: description of the command.
        tried: tries one of them at the site.
        world_in: makes all that the servers act on in a folder, given their programs; it ends with the block.

    Returns:
        The numbers of servers that were tried and with which something is wrong.
    """
    parser = argparse.ArgumentParser(description=about.partition("\n")[0])
    parser.add_argument("names", nargs="*", help="servers (default: all)")
    parser.add_argument("--folder", type=Path, default=INSTALLED, help="where they are installed, and found again")
    stated = parser.parse_args()
    chosen = [each for each in servers if not stated.names or each.name in stated.names]
    stage = [""]
    with tempfile.TemporaryDirectory() as folder, telling(lambda: stage[0]):
        programs = {}
        for each in chosen:
            stage[0] = f"installing {each.package}"
            programs[each] = each.install(stated.folder.resolve())
        stage[0] = "the servers are reviewed, begun and tried"
        with world_in(Path(folder) / "world", programs) as world:
            site = Site(Path(folder) / "site", world, programs)
            try:
                site.open()
                return len(chosen), report(chosen, partial(tried, site))
            finally:
                site.end()


def report(chosen: Iterable[Package], tried: Callable[[Any], Any]) -> int:
    """Says what is found of each server; the number of those with which something is wrong."""
    wrong = 0
    for each in chosen:
        lines = len((MAPPINGS / f"{each.name}.toml").read_text().splitlines())
        began = time.monotonic()
        try:
            found = asyncio.run(tried(each))
        except Exception as error:
            wrong += 1
            found = [f"WRONG: {first(error)}"]
        took = f"{time.monotonic() - began:5.1f} s"
        sys.stdout.write(f"{each.package:60} {lines:2} lines {took}  {', '.join(found)}\n")
        sys.stdout.flush()
    return wrong
