"""A furnished provider as it lies on disk, and the requests that are tried on it."""

from __future__ import annotations

import asyncio
import hashlib
import json
from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import rfc8785
import sqlalchemy as sa
from capabilities.keys import keys
from capabilities.statements.revocation import first_head, next_head
from tests.ztpm_idp import postgres
from tests.ztpm_idp.asks import Cell
from tests.ztpm_idp.journals import Journal
from tests.ztpm_idp.world import LOWER, MEASUREMENT, SLOWER, World
from ztpm_idp.store.database import postgres as servers
from ztpm_idp.store.schema import metadata

from ztpm_idp import create_app
from ztpm_idp.client import delegate_request, issue_request
from ztpm_idp.store import Store

FORGETFUL = {"proofs", "heartbeat"}
"""Tables whose rows are no effect of a command."""
WAITS = 2_000
"""Times that the server is asked whether it still has a connection of a process that was killed."""


@dataclass(frozen=True)
class Prepared:
    """A request, ready but for its proof; `table` gains a row by it, where `rows` has the fewest."""

    name: str
    who: str
    path: str
    body: dict
    table: str
    token: str | None = None

    @property
    def content(self) -> bytes:
        return rfc8785.dumps(self.body)


class Scene:
    """A provider with people, agents, a point, an ask and a journal; stopped.

    Args:
        folder: for its files.
        database: "sqlite" or "postgres".
        many: number of further tokens and revocations that are prepared.
    """

    def __init__(self, folder: Path, database: str, *, many: int = 0) -> None:
        self.world, self.database = World(folder, database=database), database
        world = self.world
        world.__enter__()
        self.requests, self.more = self._prepared(), self._more(many)
        world.stop()
        world.loop.call_soon_threadsafe(world.loop.stop)
        world.thread.join(10)
        self.url = world.settings.database_url
        self.file = folder / "idp.sqlite"
        self.template = b"" if database == "postgres" else self.file.read_bytes()
        if database == "postgres":
            self.name, self.base = postgres.name_of(self.url), postgres.name_of(self.url) + "_base"
            asyncio.run(postgres.execute(f"CREATE DATABASE {self.base} TEMPLATE {self.name}"))
        self.app = create_app(world.settings, world.idp_keys, platform=world.platform, now=world.clock)
        self.before = self.rows()

    def _prepared(self) -> list[Prepared]:
        """One request of each kind that the bar names."""
        world = self.world
        alice, planner, mover, early = world.people["alice"], world.agent("planner"), None, None
        cell = Cell(world)
        mover, early = world.agents["mover"], world.agent("early", attested=False)
        scope = world.scope()
        lent = alice.issue(planner, scope, purpose="p")
        ask_id, text = cell.taken()
        journal = Journal(world, registered=True)
        journal.acted(lent.token)
        raw = keys.public_raw(keys.generate())
        registered = {
            "id": "late", "key": keys.b64u(raw), "software_digest": MEASUREMENT.hex(), "model": "m",
            "role": "actuator", "sponsor": "alice", "workload": "",
        }  # fmt: skip
        asked = issue_request("mover", scope, purpose="p")
        passed_on = delegate_request("mover", SLOWER, purpose="p")
        return [
            Prepared("register", "alice", "/agents", registered, "parties"),
            Prepared("attest", "early", "/agents/early/attestations", {"evidence": early._evidence("", bytes(32))}, "nonces"),
            Prepared("issue", "alice", "/tokens", {"request": asked, "evidence": mover.evidence("alice", asked)}, "hops"),
            Prepared(
                "delegate", "planner", "/tokens/delegate",
                {"request": passed_on, "evidence": mover.evidence("planner", passed_on)}, "hops", lent.token,
            ),
            Prepared("revoke", "alice", "/revocations", {"kind": "agent", "id": "mover", "reason": "r"}, "revocations"),
            Prepared("vote", "carol", f"/approvals/{ask_id}/votes", {"vote": cell.vote(text)}, "votes"),
            Prepared("append", "cell-1", "/ledger/records", {"records": journal.made}, "records"),
        ]  # fmt: skip

    def _more(self, many: int) -> list[Prepared]:
        """Tokens, hops and revocations, in turns."""
        world, more = self.world, []
        lent = world.people["alice"].issue(world.agents["planner"], world.scope(), purpose="p")
        for number in range(many):
            scope = world.scope()
            asked, passed_on = issue_request("mover", scope, purpose="p"), delegate_request("mover", LOWER, purpose="p")
            gone, mover = {"kind": "hop", "id": f"{number:032x}", "reason": "r"}, world.agents["mover"]
            more += [
                Prepared("issue", "alice", "/tokens", {"request": asked, "evidence": mover.evidence("alice", asked)}, "hops"),
                Prepared("revoke", "alice", "/revocations", gone, "revocations"),
                Prepared(
                    "delegate", "planner", "/tokens/delegate",
                    {"request": passed_on, "evidence": mover.evidence("planner", passed_on)}, "hops", lent.token,
                ),
            ]  # fmt: skip
        return more

    def reset(self) -> None:
        """The database is as it was when the scene was furnished."""
        if self.database == "postgres":
            asyncio.run(self._cloned())
            return
        for log in ("-wal", "-shm"):
            Path(f"{self.file}{log}").unlink(missing_ok=True)
        self.file.write_bytes(self.template)

    async def _cloned(self) -> None:
        await postgres.execute(f"DROP DATABASE IF EXISTS {self.name} WITH (FORCE)")
        await postgres.execute(f"CREATE DATABASE {self.name} TEMPLATE {self.base}")

    def close(self) -> None:
        if self.database == "postgres":
            for name in (self.name, self.base):
                asyncio.run(postgres.execute(f"DROP DATABASE IF EXISTS {name} WITH (FORCE)"))
        self.world.loop.close()

    def rows(self) -> dict[str, list[tuple]]:
        """Every row of the store, in one snapshot, once nobody else is at work on it."""

        async def go():
            if self.database == "postgres":
                await postgres.alone(self.name, WAITS)
            store = await Store.open(self.url)
            try:
                async with store.read() as view:
                    if self.database == "postgres":
                        await servers.without_limits(view._connection)
                    return {
                        table.name: [tuple(row) for row in await view._connection.execute(sa.select(table))]
                        for table in metadata.sorted_tables
                        if table.name not in FORGETFUL
                    }
            finally:
                await store.close()

        return asyncio.run(go())

    def change(self, now: dict[str, list[tuple]]) -> dict[str, tuple[int, int]]:
        """Numbers of rows that came and went, of each table that changed."""
        found = {}
        for table, rows in now.items():
            before, after = Counter(map(repr, self.before[table])), Counter(map(repr, rows))
            if before != after:
                found[table] = (sum((after - before).values()), sum((before - after).values()))
        return found


ENTRIES = {
    "hops": {"token-issued", "token-drawn", "token-delegated"},
    "revocations": {"revoked"},
    "votes": {"vote-cast"},
    "asks": {"ask-taken"},
    "records": {"pep-record"},
    "agents": {"agent-registered"},
}
"""Kinds of ledger entries of which each has a row in this table, and each row one of them."""


def contradictions(rows: dict[str, list[tuple]]) -> list[str]:
    """Contradictions within one store: half effects, and chains that are broken."""
    found, head, kinds = [], "0" * 64, Counter()
    named = {table.name: [column.name for column in table.columns] for table in metadata.sorted_tables}
    of = lambda table: [dict(zip(named[table], row, strict=True)) for row in rows[table]]
    (counters,) = of("counters")
    for seq, entry in enumerate(sorted(of("ledger"), key=lambda row: row["seq"]), start=1):
        line, told = bytes(entry["line"]), json.loads(bytes(entry["line"]))
        if (entry["seq"], told["seq"], told["prev"]) != (seq, seq, head):
            found.append(f"ledger entry {seq} does not follow")
        head = hashlib.sha256(line).hexdigest()
        kinds[told["kind"]] += 1
    if (counters["ledger_size"], counters["ledger_head"]) != (len(rows["ledger"]), head):
        found.append("the counters and the ledger differ")
    chain = first_head(counters["revocation_line"])
    for epoch, row in enumerate(sorted(of("revocations"), key=lambda row: row["epoch"]), start=1):
        if row["epoch"] != epoch:
            found.append(f"epoch {epoch} is missing")
        chain = next_head(chain, row["epoch"], row["kind"], row["id"])
    if (counters["epoch"], counters["revocation_head"]) != (len(rows["revocations"]), chain):
        found.append("the counters and the revocations differ")
    for table, entries in ENTRIES.items():
        told = sum(kinds[kind] for kind in entries)
        if told != len(rows[table]):
            found.append(f"{len(rows[table])} {table}, {told} in the ledger")
    return found
