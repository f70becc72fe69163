"""Place of a run: an identity provider, one person, one agent, and enforcement points that are registered."""

from __future__ import annotations

import asyncio
import secrets
import tempfile
import time
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Final

import httpx2

from capabilities.keys import keys
from capabilities.values.scope import Grant, Limit, Scope, Tier
from pep.base.declaration import declared
from ztpm.base.layout import write_private
from ztpm.base.loopback import free_host, is_free
from ztpm.base.processes import Child
from ztpm.cell.cell import PASSPHRASE_VARIABLE
from ztpm_idp.bootstrap import FirstPerson, initialise
from ztpm_idp.client import Agent, Operator

if TYPE_CHECKING:
    from collections.abc import Callable, Iterable, Iterator
    from typing import Any

    from pep.mcp.tool_digest import ToolPin

PROVIDER, SERVER, PROGRAM = 8898, 8899, 8897
"""Ports of a run at an address of its own; nothing listens at the program's."""
FRONTS: Final = {"http": (8895, 8896), "stdio": (8893, 8894)}
"""Ports of a gateway and of another proxy, by what is between them and the server."""
ROLES: Final = ("root", "attester", "feed", "registry", "ledger")
PERSON: Final = "alice"
MEASUREMENT: Final = bytes(32)
LIFETIME_S: Final = 3_000


@dataclass(frozen=True, slots=True)
class Place:
    """Place of a run.

    Attributes:
        host: loopback address of this run alone.
        folder: of all files.
        issuer: base URL of the identity provider.
        person: sponsor and administrator.
        passphrase: of every key file.
    """

    host: str
    folder: Path
    issuer: str
    person: Operator
    passphrase: str

    @property
    def environment(self) -> dict[str, str]:
        """Variables that open the keys."""
        return {PASSPHRASE_VARIABLE: self.passphrase}

    def point(self, name: str, port: int, tools: Iterable[ToolPin]) -> Path:
        """Configuration file of a new enforcement point, registered with its tools."""
        folder, key = self.folder / name, keys.generate()
        folder.mkdir()
        write_private(folder / "pep.key", keys.to_pem(key, self.passphrase.encode()))
        with httpx2.Client(trust_env=False) as http:
            (folder / "trust.json").write_bytes(http.get(f"{self.issuer}/trust").content)
        audience = f"http://{self.host}:{port}/mcp"
        file = folder / "guard.toml"
        file.write_text(
            f'audience = "{audience}"\npep_id = "{name}"\nissuer = "{self.issuer}"\n'
            'trust_file = "trust.json"\npep_key_file = "pep.key"\nfolder = "state"\n'
        )
        self.person.register_pep(name, keys.public_raw(key), [audience])
        self.register(audience, tools)
        return file

    def register(self, audience: str, tools: Iterable[ToolPin]) -> None:
        """Registers the tools of an enforcement point as they are."""
        for pin in tools:
            self.person.register_tool(
                audience=audience,
                name=pin.name,
                definition_digest=pin.definition_digest,
                operation=pin.operation,
                base_tier=int(pin.base_tier),
            )

    def agent(self, name: str) -> Agent:
        """Agent of that name, attested."""
        key = keys.generate()
        self.person.register_agent(
            name, keys.public_raw(key), software_digest=MEASUREMENT.hex(), model="none", role=name
        )
        made = Agent(name, key, self.issuer, MEASUREMENT)
        made.attest()
        return made

    def lent(self, agent: Agent, function: Callable[..., Any], audience: str) -> str:
        """Text of a token for a declared function, as wide as its row.

        Raises:
            ValueError: the function declares nothing.
        """
        row = declared(function)
        if row is None:
            raise ValueError(function.__name__)
        limits = tuple(Limit(each.parameter, each.bound) for each in row.limits)
        now = int(time.time())
        scope = Scope(
            grants=(Grant(row.object, row.name, limits),),
            ceiling=Tier.CONSEQUENTIAL,
            audiences=frozenset({audience}),
            delegates=frozenset(),
            depth=0,
            not_before=now - 5,
            not_after=now + LIFETIME_S,
        )
        return self.person.issue(agent, scope, purpose="benchmark").token


@contextmanager
def place() -> Iterator[Place]:
    """A place with a provider of its own, which lives as long as the block."""
    passphrase = secrets.token_urlsafe(16)
    ports = (PROVIDER, SERVER, PROGRAM, *FRONTS["http"], *FRONTS["stdio"])
    host = free_host(secrets.token_bytes(16), lambda host: all(is_free(host, port) for port in ports))
    issuer = f"http://{host}:{PROVIDER}/ztpm"
    with tempfile.TemporaryDirectory(prefix="ztpm-bench-") as name:
        folder = Path(name)
        for role in ROLES:
            write_private(folder / f"{role}.key", keys.to_pem(keys.generate(), passphrase.encode()))
        database = f"sqlite+aiosqlite:///{folder}/idp.sqlite"
        settings = folder / "idp.toml"
        settings.write_text(
            f'issuer = "{issuer}"\nhost = "{host}"\nport = {PROVIDER}\ndatabase_url = "{database}"\nroot_key_id = 1\n'
            + "".join(f'{role}_key_file = "{role}.key"\n' for role in ROLES)
        )
        key = keys.generate()
        first = FirstPerson(PERSON, "Alice", keys.public_raw(key), ("sponsor", "admin"))
        asyncio.run(initialise(database, people=[first]))
        provider = Child.start(
            "identity provider",
            "ztpm.point.provider_server",
            "--config",
            str(settings),
            environment={PASSPHRASE_VARIABLE: passphrase},
        )
        try:
            with Operator(PERSON, key, issuer) as person:
                yield Place(host, folder, issuer, person, passphrase)
        finally:
            provider.stop()
