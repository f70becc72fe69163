"""Identity provider in this process, with clocks and stores of the test, and people and agents around it."""

from __future__ import annotations

import asyncio
import secrets
import threading
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from tempfile import TemporaryDirectory

import httpx2
import sqlalchemy as sa
from capabilities.values.scope import Grant, Limit, Range, Restriction, Scope, Tier
from capabilities.values.units import Parameter, Unit
from sqlalchemy.dialects.sqlite.aiosqlite import SQLiteDialect_aiosqlite
from sqlalchemy.util import LRUCache
from tests.ztpm_idp import postgres
from ztpm_idp.bootstrap import FirstPerson, initialise

from capabilities.keys import keys
from capabilities.statements import workload
from ztpm_idp import IdpKeys, Settings, create_app
from ztpm_idp.keys.oauth_keys import OAuthKeys
from ztpm_idp.client import Agent, Operator, ProofAuth
from ztpm_idp.store import Store, engine

COMPILED = LRUCache(5_000)
"""Statements that were compiled already: each provider would compile all of its own again."""


def shares_statements(url, *, engine_of=engine._sqlite_engine):
    """An engine over SQLite that shares them."""
    made = engine_of(url)
    made.sync_engine._compiled_cache = COMPILED
    return made


# All over SQLite are of one version and one kind, so that what one has compiled is what the others would compile.
SQLiteDialect_aiosqlite.__eq__ = lambda one, other: type(one) is type(other)
SQLiteDialect_aiosqlite.__hash__ = lambda one: hash(type(one))
engine._sqlite_engine = shares_statements

START_S = 1_800_000_000.0
ISSUER = "http://127.0.0.1:8700/ztpm"
AUDIENCE = "http://127.0.0.1:8800/mcp"
MEASUREMENT = bytes(range(32))
SPEED = Parameter("speed", Unit.MICRORADIAN_PER_SECOND)
MOVE_TO = Parameter("q0", Unit.MICRORADIAN)


@dataclass
class FakeClock:
    """Wall time that moves when told to."""

    at_s: float = START_S

    def __call__(self) -> float:
        return self.at_s


class Bridge(httpx2.BaseTransport):
    """A synchronous transport to an ASGI application that lives on another thread's loop."""

    def __init__(self, app, loop):
        self.inner = httpx2.ASGITransport(app=app)
        self.loop = loop

    def handle_request(self, request):
        async def go():
            response = await self.inner.handle_async_request(request)
            return response.status_code, response.headers, await response.aread()

        status, headers, content = asyncio.run_coroutine_threadsafe(go(), self.loop).result(60)
        return httpx2.Response(status, headers=headers, content=content)


def new_keys() -> IdpKeys:
    return IdpKeys(*(keys.generate() for _ in range(5)))


def settings_for(folder: Path, **changes) -> Settings:
    stated = {
        "issuer": ISSUER,
        "host": "127.0.0.1",
        "port": 8700,
        "database_url": f"sqlite+aiosqlite:///{folder}/idp.sqlite",
        "root_key_id": 1,
        # The clock of most tests stands still: their asks are all of one minute.
        "asks_a_minute": 10_000,
        "asks_an_hour": 10_000,
        # One address sends all that a test sends.
        "rates": {"caller_a_minute": 1_000_000, "address_a_minute": 1_000_000, "login_a_minute": 1_000_000},
    }
    return Settings(**(stated | changes))


@cache
def empty_store() -> bytes:
    """Migrated database without a row in it, made once: migrating takes longer than most tests."""

    async def migrate(folder: str) -> None:
        await (await Store.open(settings_for(Path(folder)).database_url)).close()

    with TemporaryDirectory() as folder:
        asyncio.run(migrate(folder))
        (file,) = Path(folder).iterdir()
        return file.read_bytes()


LATEST_COLUMNS = (
    ("counters", "revocation_line"),
    ("counters", "revocation_head"),
    ("counters", "restoring"),
    ("agents", "held"),
    ("agents", "suspended_ms"),
    ("peps", "heard"),
    ("hops", "mandate"),
    ("peps", "suspended_ms"),
    ("sensors", "suspended_ms"),
    ("tools", "suspended_ms"),
    ("asks", "picture_digest"),
    ("changes", "by_passkey"),
)
"""Columns that no database of an earlier release has."""


LATEST_TABLES = (
    "push_subscriptions",
    "pictures",
    "pushes",
    "enrolments",
    "envelopes",
    "latch_clearings",
    "latches",
    "spent_credentials",
    "feed_points",
    "ledger_tiles",
    "ledger_index",
    "ledger_followed",
    "heartbeat",
    "mandates",
    "former_keys",
    "sessions",
    "login_offers",
    "person_logins",
    "device_logins",
    "session_keys",
    "login_secret",
    *(f"oauth_{each}" for each in ("access_tokens", "refresh_tokens", "codes", "families", "templates", "clients")),
)
"""Tables that no database of an earlier release has."""


def drop_latest_columns(base) -> None:
    for table in LATEST_TABLES:
        base.execute(f"DROP TABLE IF EXISTS {table}")
    if base.execute("SELECT 1 FROM sqlite_master WHERE name = 'changes'").fetchone():
        base.execute("ALTER TABLE changes DROP COLUMN login")
    if base.execute("SELECT 1 FROM sqlite_master WHERE name = 'person_keys'").fetchone():
        base.execute("DROP INDEX ix_person_keys_credential")
        for table in ("person_keys", "changes"):
            base.execute(f"ALTER TABLE {table} DROP COLUMN credential")
    if base.execute("SELECT 1 FROM sqlite_master WHERE name = 'asks'").fetchone():
        base.execute("ALTER TABLE asks DROP COLUMN trace_id")
    base.execute("ALTER TABLE counters ADD COLUMN beats BIGINT NOT NULL DEFAULT 0")
    base.execute("DROP INDEX IF EXISTS ix_agents_sponsor")
    base.execute("DROP INDEX ix_hops_mandate")
    base.execute("DROP INDEX ix_hops_lent")
    for table, column in LATEST_COLUMNS:
        if base.execute("SELECT 1 FROM sqlite_master WHERE name = ?", (table,)).fetchone():
            base.execute(f"ALTER TABLE {table} DROP COLUMN {column}")


TRUST_DOMAIN = "cell.example"


DATABASE = ["sqlite"]
"""Database that a `World` has when none is said: `--postgres` makes it the other one."""


@dataclass
class World:
    """alice is sponsor, approver and administrator; bob only a sponsor; carol only an approver; dan only an administrator."""

    folder: Path
    clock: FakeClock = field(default_factory=FakeClock)
    ticks: Callable[[], float] = time.monotonic
    idp_keys: IdpKeys = field(default_factory=new_keys)
    oauth_keys: OAuthKeys | None = field(default_factory=lambda: OAuthKeys((keys.generate(),)))
    settings_changes: dict = field(default_factory=dict)
    platform_key: object = field(default_factory=keys.generate)
    platform: workload.Platform | None = None
    policies: object | None = None
    publishers: dict = field(default_factory=dict)
    webhooks: tuple = ()
    web_push: object | None = None
    people: dict[str, Operator] = field(default_factory=dict)
    database: str = field(default_factory=lambda: DATABASE[0])
    agents: dict[str, Agent] = field(default_factory=dict)
    peps: dict[str, Operator] = field(default_factory=dict)
    private: dict[str, object] = field(default_factory=dict)

    ROLES = {"alice": ("sponsor", "approver", "admin"), "bob": ("sponsor",), "carol": ("approver",), "dan": ("admin",)}

    def __enter__(self):
        self.loop = asyncio.new_event_loop()
        self.thread = threading.Thread(target=self.loop.run_forever, daemon=True)
        self.thread.start()
        self.settings = settings_for(self.folder, **({"database_url": self.new_database()} | self.settings_changes))
        self.private |= {name: keys.generate() for name in self.ROLES}
        self.platform = workload.Platform(
            TRUST_DOMAIN, workload.key_set(workload.jwks(keys.public_raw(self.platform_key)))[0]
        )
        first = [FirstPerson(n, n.title(), keys.public_raw(self.private[n]), roles) for n, roles in self.ROLES.items()]
        self.on_loop(initialise(self.settings.database_url, people=first, now=self.clock))
        self.start()
        self.people = {name: self.caller(Operator, name) for name in self.ROLES}
        self.trust = self.idp_keys.trust(issuer=self.issuer, root_key_id=1)
        return self

    def __exit__(self, *_):
        self.stop()
        self.loop.call_soon_threadsafe(self.loop.stop)
        self.thread.join(10)
        self.loop.close()
        if self.database == "postgres":
            postgres.drop(self.settings.database_url)

    def new_database(self) -> str:
        """URL of a database with the newest schema and no row in it."""
        if self.database == "postgres":
            return postgres.new_database()
        store = self.folder / "idp.sqlite"
        store.touch(0o600)
        store.write_bytes(empty_store())
        return settings_for(self.folder).database_url

    def lose(self, *, damaged: bool = False) -> None:
        """The stopped provider's database is gone, or nothing in it can be read."""
        store = self.folder / "idp.sqlite"
        if self.database == "postgres":
            postgres.lose(self.settings.database_url, damaged=damaged)
            return
        for path in self.folder.glob("idp.sqlite*"):
            path.unlink()
        if damaged:
            store.write_bytes(b"no database " * 999)

    @property
    def lost(self) -> bool:
        """True while the database is as `lose` left it."""
        if self.database == "postgres":
            return postgres.is_lost(self.settings.database_url)
        store = self.folder / "idp.sqlite"
        return not store.exists() or store.read_bytes().startswith(b"no database")

    def sql(self, statement: str, **values) -> list[tuple]:
        """Rows of a statement on the store's database, on a connection of its own; durable."""

        async def go():
            async with self.provider.store._engine.execution_options(ztpm_writes=True).begin() as connection:
                found = await connection.execute(sa.text(statement), values)
                return [tuple(row) for row in found] if found.returns_rows else []

        return self.on_loop(go())

    def rows(self, table: str) -> list[dict]:
        """Rows of a table, each by column."""

        async def go():
            async with self.provider.store._engine.connect() as connection:
                found = await connection.execute(sa.text(f"SELECT * FROM {table}"))
                return [dict(row) for row in found.mappings()]

        return self.on_loop(go())

    def start(self):
        self.app = create_app(
            self.settings,
            self.idp_keys,
            platform=self.platform,
            policies=self.policies,
            publishers=self.publishers,
            oauth_keys=self.oauth_keys,
            webhooks=self.webhooks,
            web_push=self.web_push,
            now=self.clock,
            ticks=self.ticks,
        )
        self.life = self.app.router.lifespan_context(self.app)
        self.on_loop(self.life.__aenter__())
        self.transport = Bridge(self.app, self.loop)

    def stop(self):
        self.on_loop(self.life.__aexit__(None, None, None))

    def on_loop(self, coroutine):
        async def go():
            return await coroutine

        return asyncio.run_coroutine_threadsafe(go(), self.loop).result(60)

    @property
    def issuer(self) -> str:
        return self.settings_changes.get("issuer", ISSUER)

    @property
    def provider(self):
        return self.app.state.provider

    def person(self, name, *roles, key=None) -> None:
        """Registers a person; an approver or administrator on the word of alice and dan."""
        self.private.setdefault(name, keys.generate())
        raw = keys.public_raw(self.private[name]) if key is None else key
        alice = self.people["alice"]
        if set(roles) == {"sponsor"}:
            alice.register_person(name, name.title(), raw, roles)
        else:
            self.people["dan"].confirm_change(alice.propose_person(name, name.title(), raw, roles))

    def end(self, name) -> None:
        """Ends an approver or administrator on the word of alice and dan."""
        self.people["dan"].confirm_change(self.people["alice"].propose_end(name, "left"))

    def caller(self, kind, name, *more):
        return kind(name, self.private[name], self.issuer, *more, transport=self.transport, now=self.clock)

    def anonymous(self) -> httpx2.Client:
        return httpx2.Client(transport=self.transport, base_url=self.issuer)

    def known(self, name="dan") -> httpx2.Client:
        """A client that signs as a registered party."""
        auth = ProofAuth(self.private[name], now=self.clock)
        return httpx2.Client(transport=self.transport, base_url=self.issuer, auth=auth)

    def workload_token(self, name, *, signer=None, **changes) -> str:
        """Workload token of the platform for an agent, with the changes of a test."""
        at = int(self.clock())
        stated = dict(
            id=f"spiffe://{TRUST_DOMAIN}/{name}",
            audience=self.issuer,
            key_thumbprint=keys.thumbprint(keys.public_raw(self.private[name])),
            measurement=MEASUREMENT,
            issued_at=at,
            expires_at=at + 300,
            token_id=secrets.token_hex(16),
        )
        return workload.sign(workload.Workload(**(stated | changes)), signer or self.platform_key)

    def agent(
        self, name, *, sponsor="alice", role="actuator", attested=True, measurement=MEASUREMENT, vouched=False
    ) -> Agent:
        self.private[name] = keys.generate()
        self.people[sponsor].register_agent(
            name, keys.public_raw(self.private[name]), software_digest=MEASUREMENT.hex(), model="scripted", role=role,
            workload=f"spiffe://{TRUST_DOMAIN}/{name}" if vouched else "",
        )  # fmt: skip
        self.agents[name] = self.caller(Agent, name, measurement)
        if vouched:
            self.agents[name]._workload = lambda: self.workload_token(name)
        if attested:
            self.agents[name].attest()
        return self.agents[name]

    def pep(self, name="cell-1") -> Operator:
        self.private[name] = keys.generate()
        self.people["alice"].register_pep(name, keys.public_raw(self.private[name]), [AUDIENCE])
        self.peps[name] = self.caller(Operator, name)
        return self.peps[name]

    def scope(self, **changes) -> Scope:
        now = int(self.clock())
        stated = dict(
            grants=(
                Grant(
                    "ur3e",
                    "move_joint",
                    (Limit(MOVE_TO, Range(-3_000_000, 3_000_000)), Limit(SPEED, Range(0, 1_000_000))),
                ),
                Grant("ur3e", "stop"),
            ),
            ceiling=Tier(3),
            audiences=frozenset({AUDIENCE}),
            delegates=frozenset({"mover", "helper", "role:actuator"}),
            depth=3,
            not_before=now - 5,
            not_after=now + 600,
        )
        return Scope(**(stated | changes))


SLOWER = Restriction(grants=(Grant("ur3e", "move_joint", (Limit(SPEED, Range(0, 500_000)),)), Grant("ur3e", "stop")))
LOWER = Restriction(ceiling=Tier(2))


def new_jti() -> str:
    return secrets.token_urlsafe(18)
