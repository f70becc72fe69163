"""Place of a run: a database with many agents, workers of the provider and of the bare endpoint."""

from __future__ import annotations

import asyncio
import secrets
import time
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from capabilities.keys import keys
from capabilities.values.chain import EvidenceKind
from evaluation.idp.lent import AUDIENCE, ROLE, access_records
from ztpm.base.layout import write_private
from ztpm.base.loopback import free_host, is_free
from ztpm.base.processes import Child
from ztpm.cell.cell import PASSPHRASE_VARIABLE
from ztpm_idp.bootstrap import ACTOR, FirstPerson, initialise
from ztpm_idp.domain.events import AgentAttested, PartyRegistered
from ztpm_idp.domain.parties import RegisteredAgent, RegisteredPep, Standing
from ztpm_idp.keys.oauth_keys import OAuthKeys
from ztpm_idp.oauth import access_token
from ztpm_idp.rate_settings import MOST
from ztpm_idp.store import Store

if TYPE_CHECKING:
    from collections.abc import Iterator, Sequence
    from pathlib import Path

    from capabilities.keys.keys import PrivateKey
    from ztpm_idp.domain.events import TokenIssued
    from ztpm_idp.domain.oauth.events import AccessMade

PROVIDER, BARE = 8890, 8880
"""Ports of the first worker of each; the next workers have the next ones."""
ROLES: Final = ("root", "attester", "feed", "registry", "ledger")
SPONSORS: Final = 20
AT_ONCE: Final = 1_000
"""Agents that are registered in one transaction."""
MEASUREMENT: Final = bytes(32)
POINT: Final = "point"


@dataclass(frozen=True, slots=True)
class IdpPlace:
    """Place of a run.

    Attributes:
        issuer: base URL of the provider; every proof is for it, whichever worker answers.
        bare_url: address of the bare endpoint, likewise.
        provider, bare: host and port of each worker.
        sponsors: names and keys.
        agents: likewise; two after each other have the same sponsor.
        feed_keys: raw public keys that sign the feed.
        point: key of an enforcement point.
        access: texts of access tokens of its audience.
        pids: processes of the provider, and of the bare endpoint.
    """

    issuer: str
    bare_url: str
    provider: tuple[tuple[str, int], ...]
    bare: tuple[tuple[str, int], ...]
    sponsors: tuple[tuple[str, PrivateKey], ...]
    agents: tuple[tuple[str, PrivateKey], ...]
    feed_keys: frozenset[bytes]
    point: PrivateKey
    access: tuple[str, ...]
    pids: tuple[tuple[int, ...], tuple[int, ...]]


@contextmanager
def place(folder: Path, database: str, *, workers: int, agents: int) -> Iterator[IdpPlace]:
    """A place whose processes live as long as the block.

    Args:
        folder: of all files, empty.
        database: URL of an empty one.
        workers: processes of each of the two.
        agents: registered and attested.
    """
    passphrase, ports = secrets.token_urlsafe(16), range(workers)
    host = free_host(
        secrets.token_bytes(16), lambda host: all(is_free(host, port + n) for port in (PROVIDER, BARE) for n in ports)
    )
    issuer = f"http://{host}:{PROVIDER}/ztpm"
    own = {role: keys.generate() for role in ROLES}
    for role, key in own.items():
        write_private(folder / f"{role}.key", keys.to_pem(key, passphrase.encode()))
    sponsors = tuple((f"sponsor-{n}", keys.generate()) for n in range(SPONSORS))
    lent_to = tuple((f"agent-{n}", keys.generate()) for n in range(agents))
    point, oauth = keys.generate(), keys.generate()
    write_private(folder / "oauth.key", keys.to_pem(oauth, passphrase.encode()))
    records = access_records(sponsors, lent_to, own["root"], issuer=issuer)
    asyncio.run(_filled(database, sponsors, lent_to, keys.public_raw(point), records))
    environment = {PASSPHRASE_VARIABLE: passphrase}
    with ExitStack() as running:
        provider, bare = [], []
        for n in ports:
            settings = folder / f"idp-{n}.toml"
            settings.write_text(
                f'issuer = "{issuer}"\nhost = "{host}"\nport = {PROVIDER + n}\ndatabase_url = "{database}"\n'
                'root_key_id = 1\naccess_log = false\noauth_key_files = ["oauth.key"]\n'
                + "".join(f'{role}_key_file = "{role}.key"\n' for role in ROLES)
                # One sponsor and one enforcement point make all the load.
                + f"[rates]\ncaller_a_minute = {MOST}\n"
            )
            provider.append(
                Child.start(
                    "provider", "ztpm.point.provider_server", "--config", str(settings), environment=environment
                )
            )
            running.callback(provider[-1].stop)
            bare.append(
                Child.start(
                    "bare", "evaluation.idp.served", database, issuer, host, str(BARE + n), environment=environment
                )
            )
            running.callback(bare[-1].stop)
        yield IdpPlace(
            issuer,
            f"http://{host}:{PROVIDER}/bare",
            tuple((host, PROVIDER + n) for n in ports),
            tuple((host, BARE + n) for n in ports),
            sponsors,
            lent_to,
            frozenset({keys.public_raw(own["feed"])}),
            point,
            tuple(access_token.sign(made.access, OAuthKeys((oauth,)), issuer=issuer) for _, made in records),
            (tuple(one.popen.pid for one in provider), tuple(one.popen.pid for one in bare)),
        )


async def _filled(
    database: str,
    sponsors: tuple[tuple[str, PrivateKey], ...],
    agents: tuple[tuple[str, PrivateKey], ...],
    point: bytes,
    records: Sequence[tuple[TokenIssued, AccessMade]],
) -> None:
    """Registers parties and writes access tokens by the provider's own store: its HTTP interface is measured later."""
    await initialise(
        database,
        people=[
            FirstPerson(name, name, keys.public_raw(key), ("sponsor",) if n else ("sponsor", "admin"))
            for n, (name, key) in enumerate(sponsors)
        ],
    )
    store, at_ms = await Store.open(database), int(time.time() * 1_000)
    try:
        for begin in range(0, len(agents), AT_ONCE):
            events = [
                event
                for n, (name, key) in enumerate(agents[begin : begin + AT_ONCE], begin)
                for event in _agent(name, keys.public_raw(key), sponsors[n // 2 % len(sponsors)][0])
            ]
            async with store.write() as transaction:
                await transaction.append(events, actor=ACTOR, at_ms=at_ms)
        async with store.write() as transaction:
            served = RegisteredPep(POINT, point, keys.thumbprint(point), Standing.ACTIVE, frozenset({AUDIENCE}))
            more = [PartyRegistered(served), *(event for pair in records for event in pair)]
            await transaction.append(more, actor=ACTOR, at_ms=at_ms)
    finally:
        await store.close()


def _agent(name: str, key: bytes, sponsor: str) -> tuple[PartyRegistered, AgentAttested]:
    agent = RegisteredAgent(
        id=name,
        key=key,
        thumbprint=keys.thumbprint(key),
        standing=Standing.REGISTERED,
        software_digest=MEASUREMENT,
        model="none",
        role=ROLE,
        sponsor=sponsor,
        trust_permille=None,
    )
    return PartyRegistered(agent), AgentAttested(name, MEASUREMENT, "", EvidenceKind.KEY)
