"""Ten popular public MCP servers behind one gateway, driven by a client that knows only stdio.

Each is as it was published.

`python -m tests.e2e.public.servers [--folder DIR] [NAME...]` installs them in environments of their own, from PyPI and
npm, at the versions below. Of each server one call is permitted, one refused by a limit, and one deferred, approved by
a person, and done once; a table is said, and the figure last. What happened is read off the gateway's journal and, where
it can be, off the world: files, a repository, a database, requests at a web server.
"""

from __future__ import annotations

import asyncio
import contextlib
import json
import re
import sqlite3
import subprocess
import sys
import threading
import time
import zipfile
from dataclasses import dataclass
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from typing import TYPE_CHECKING, Any

from capabilities.values.scope import Each, Range, Stems, Tier, Words
from tests.e2e.public.site import (
    DEADLINE_S, DONE, LIMITED, START_S, Package, Site, Wrong, approved_once, expect, judged, run, text_of,
)  # fmt: skip
from tests.e2e.test_any_tool import TOP, told
from tests.e2e.test_tool_gateway import in_time

from pep import grant

if TYPE_CHECKING:
    from collections.abc import Callable, Iterator, Mapping


def under(folder: Path) -> Stems:
    return Stems(frozenset({str(folder)}), "/")


class Web:
    """A web server on loopback, whose pages are asked for by name."""

    def __init__(self) -> None:
        self.asked: list[str] = []
        asked = self.asked

        class Answering(BaseHTTPRequestHandler):
            def do_GET(self) -> None:
                asked.append(self.path)
                known = self.path != "/robots.txt"
                body = b"<html><body><h1>Pump</h1><p>The pump is 7 years old.</p></body></html>"
                self.send_response(200 if known else 404)
                self.send_header("content-type", "text/html")
                self.send_header("content-length", str(len(body) if known else 0))
                self.end_headers()
                self.wfile.write(body if known else b"")

            def log_message(self, *_: object) -> None:
                """Says nothing."""

        self._server = ThreadingHTTPServer(("127.0.0.1", 0), Answering)
        self.origin = f"http://127.0.0.1:{self._server.server_port}"
        threading.Thread(target=self._server.serve_forever, daemon=True).start()

    def end(self) -> None:
        self._server.shutdown()
        self._server.server_close()


class World:
    """All that the servers act on, and what an onlooker sees of it."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder.absolute()
        self.documents, self.repository = self.folder / "documents", self.folder / "repository"
        self.database, self.duck = self.folder / "pump.sqlite", self.folder / "pump.duckdb"
        self.memory, self.books = self.folder / "memory.jsonl", self.folder / "books"
        self.folder.mkdir()
        for each in (self.documents, self.repository, self.books):
            each.mkdir()
        (self.documents / "pump.txt").write_text("The pump is 7 years old.\n")
        for words in (("init", "-q"), ("config", "user.name", "A"), ("config", "user.email", "a@plant.example")):
            self.git(*words)
        (self.repository / "pump.txt").write_text("7\n")
        self.git("add", "pump.txt")
        self.git("commit", "-q", "-m", "The pump")
        (self.repository / "pump.txt").write_text("8\n")
        self.git("add", "pump.txt")
        with contextlib.closing(sqlite3.connect(self.database)) as database, database:
            database.execute("CREATE TABLE pump (years INTEGER)")
            database.execute("INSERT INTO pump VALUES (7)")
        self.web = Web()

    def git(self, *words: str) -> str:
        command = ["git", "-C", str(self.repository), *words]
        return subprocess.run(command, capture_output=True, text=True, check=True).stdout

    def commits(self) -> int:
        return int(self.git("rev-list", "--count", "HEAD"))

    def make_duck(self, python: Path) -> None:
        """Makes the DuckDB file, which an onlooker cannot read while its server has it."""
        words = "import duckdb, sys; duckdb.connect(sys.argv[1]).execute('CREATE TABLE pump AS SELECT 7 AS years')"
        subprocess.run([str(python), "-c", words, str(self.duck)], check=True, timeout=START_S)

    def written(self) -> str:
        path = self.documents / "new.txt"
        return path.read_text() if path.exists() else ""

    def known(self) -> list[str]:
        lines = self.memory.read_text().splitlines() if self.memory.exists() else []
        return sorted(json.loads(line)["name"] for line in lines if line)

    def rows(self) -> int:
        with contextlib.closing(sqlite3.connect(self.database)) as database:
            return int(database.execute("SELECT count(*) FROM pump").fetchone()[0])

    def fetched(self) -> int:
        return sum(path != "/robots.txt" for path in self.web.asked)

    def sheets(self) -> int:
        path = self.books / "a.xlsx"
        if not path.exists():
            return 0
        with zipfile.ZipFile(path) as book:
            return len(re.findall(rb"<(?:\w+:)?sheet ", book.read("xl/workbook.xml")))


@dataclass(frozen=True, kw_only=True)
class PublicServer(Package):
    """One server, and what is tried of it in a world.

    Attributes:
        tighter: bounds of the token, by tool and parameter.
        permitted, refused, deferred: calls.
        parameter: whose limit refuses.
        answer: part of the permitted call's answer.
        unmapped: a tool that no mapping names.
        seen: what an onlooker sees of its effects; None where there is nothing to be seen.
        prepare: makes what it acts on, with the interpreter of its environment.
    """

    tighter: Callable[[World], Mapping[str, Mapping[str, Any]]]
    permitted: Callable[[World], tuple[str, dict[str, Any]]]
    refused: Callable[[World], tuple[str, dict[str, Any]]]
    deferred: Callable[[World], tuple[str, dict[str, Any]]]
    parameter: str
    answer: str
    unmapped: str
    seen: Callable[[World], object] | None = None
    prepare: Callable[[World, Path], None] | None = None


SERVERS = (
    PublicServer(
        package="@modelcontextprotocol/server-filesystem@2026.8.31", program="mcp-server-filesystem", options=lambda w: [str(w.documents)],
        tighter=lambda w: {"read_text_file": {"path": under(w.documents)}, "write_file": {"path": under(w.documents)}},
        permitted=lambda w: ("read_text_file", {"path": str(w.documents / "pump.txt")}),
        refused=lambda w: ("read_text_file", {"path": str(w.database)}),
        deferred=lambda w: ("write_file", {"path": str(w.documents / "new.txt"), "content": "two\nlines\n"}),
        parameter="path", answer="7 years old", unmapped="move_file", seen=World.written, npm=True,
    ),
    PublicServer(
        package="@modelcontextprotocol/server-memory@2026.8.31", program="mcp-server-memory",
        tighter=lambda w: {"delete_entities": {"entityNames": Each(Stems(frozenset({""}), ""), 1, 2)}},
        permitted=lambda w: ("create_entities", {"entities": [
            {"name": name, "entityType": "machine", "observations": ["old"]} for name in ("pump", "oven", "valve")]}),
        refused=lambda w: ("delete_entities", {"entityNames": ["pump", "oven", "valve"]}),
        deferred=lambda w: ("delete_entities", {"entityNames": ["pump"]}),
        parameter="entityNames", answer="machine", unmapped="read_graph", seen=World.known, npm=True,
        environment=lambda w: {"MEMORY_FILE_PATH": str(w.memory)},
    ),
    PublicServer(
        package="@modelcontextprotocol/server-everything@2026.8.31", program="mcp-server-everything",
        tighter=lambda w: {"get-sum": {"a": Range(0, 100)}},
        permitted=lambda w: ("get-sum", {"a": 40, "b": 2}), refused=lambda w: ("get-sum", {"a": 101, "b": 2}),
        deferred=lambda w: ("echo", {"message": "the pump is old"}),
        parameter="a", answer="42", unmapped="get-env", npm=True,
    ),
    PublicServer(
        package="@modelcontextprotocol/server-sequential-thinking@2026.8.31", program="mcp-server-sequential-thinking",
        tighter=lambda w: {"sequentialthinking": {"thoughtNumber": Range(1, 30)}},
        permitted=lambda w: thought(1), refused=lambda w: thought(31), deferred=lambda w: thought(21),
        parameter="thoughtNumber", answer="thoughtHistoryLength", unmapped="another", npm=True,
    ),
    PublicServer(
        package="mcp-server-fetch==2026.10.24", program="mcp-server-fetch", options=lambda w: ["--allow-private-ips"],
        tighter=lambda w: {"fetch": {"url": Stems(frozenset({w.web.origin}), "/")}},
        permitted=lambda w: ("fetch", {"url": f"{w.web.origin}/pump", "max_length": 1000}),
        refused=lambda w: ("fetch", {"url": "http://127.0.0.1:9/pump", "max_length": 1000}),
        deferred=lambda w: ("fetch", {"url": f"{w.web.origin}/pump", "max_length": 50000}),
        parameter="url", answer="7 years old", unmapped="another", seen=World.fetched,
    ),
    PublicServer(
        package="mcp-server-git==2026.10.19", program="mcp-server-git", options=lambda w: ["--repository", str(w.repository)],
        tighter=lambda w: {tool: {"repo_path": Words(frozenset({str(w.repository)}))} for tool in ("git_log", "git_commit")},
        permitted=lambda w: ("git_log", {"repo_path": str(w.repository), "max_count": 5}),
        refused=lambda w: ("git_log", {"repo_path": str(TOP), "max_count": 5}),
        deferred=lambda w: ("git_commit", {"repo_path": str(w.repository), "message": "The pump, a year later\n\nIt runs."}),
        parameter="repo_path", answer="The pump", unmapped="git_reset", seen=World.commits,
    ),
    PublicServer(
        package="mcp-server-time==2026.10.19", program="mcp-server-time", options=lambda w: ["--local-timezone", "UTC"],
        tighter=lambda w: {"get_current_time": {"timezone": Words(frozenset({"UTC", "Europe/Vienna"}))}},
        permitted=lambda w: ("get_current_time", {"timezone": "Europe/Vienna"}),
        refused=lambda w: ("get_current_time", {"timezone": "Asia/Tokyo"}),
        deferred=lambda w: (
            "convert_time", {"source_timezone": "UTC", "time": "12:00", "target_timezone": "Europe/Vienna"}),
        parameter="timezone", answer="Europe/Vienna", unmapped="another",
    ),
    PublicServer(
        package="mcp-server-sqlite==2025.4.25", program="mcp-server-sqlite", options=lambda w: ["--db-path", str(w.database)],
        tighter=lambda w: {"read_query": {"query": Stems(frozenset({"SELECT years FROM pump"}), "")}},
        permitted=lambda w: ("read_query", {"query": "SELECT years FROM pump"}),
        refused=lambda w: ("read_query", {"query": "SELECT sql FROM sqlite_master"}),
        deferred=lambda w: ("write_query", {"query": "INSERT INTO pump VALUES (8)"}),
        parameter="query", answer="7", unmapped="create_table", seen=World.rows, also=("mcp<2",),
    ),
    PublicServer(
        package="mcp-server-motherduck==1.1.0", program="mcp-server-motherduck", options=lambda w: ["--db-path", str(w.duck), "--read-write"],
        tighter=lambda w: {"list_columns": {"table": Words(frozenset({"pump"}))}},
        permitted=lambda w: ("list_columns", {"table": "pump"}),
        refused=lambda w: ("list_columns", {"table": "secrets"}),
        deferred=lambda w: ("execute_query", {"sql": "INSERT INTO pump VALUES (8)"}),
        parameter="table", answer="years", unmapped="list_databases", prepare=World.make_duck,
    ),
    PublicServer(
        package="excel-mcp-server==2.2.2", program="excel-mcp-server", options=lambda w: ["stdio", "--allow-dir", str(w.books)],
        tighter=lambda w: {tool: {"path": under(w.books)} for tool in ("create_workbook", "create_sheet")},
        permitted=lambda w: ("create_workbook", {"path": str(w.books / "a.xlsx")}),
        refused=lambda w: ("create_workbook", {"path": str(w.documents / "a.xlsx")}),
        deferred=lambda w: ("create_sheet", {"path": str(w.books / "a.xlsx"), "new_name": "Pump"}),
        parameter="path", answer="a.xlsx", unmapped="delete_sheet", seen=World.sheets,
    ),
)  # fmt: skip


def thought(number: int) -> tuple[str, dict[str, Any]]:
    said = f"Thought {number}:\nthe pump is old"
    return "sequentialthinking", {
        "thought": said, "nextThoughtNeeded": True, "thoughtNumber": number, "totalThoughts": 40,
    }  # fmt: skip


async def tried(site: Site, server: PublicServer) -> list[str]:
    """Findings of one server: permitted, refused, deferred, approved once.

    Raises:
        Wrong: something is not as it should be.
    """
    world, tools = site.world, sorted(server.mapping["tool"])
    agent = site.agent(server.name)
    tighter = server.tighter(world)
    grants = [grant(site.rows[name], **tighter.get(name, {})) for name in tools]
    token = site.lend(agent, *grants, ceiling=Tier.HIGH_CONSEQUENCE)

    def state() -> tuple[int, object]:
        return site.done(), None if server.seen is None else server.seen(world)

    with (site.folder / f"{server.name}.log").open("w") as log:
        async with site.client(server.name, token, agent, log) as client:
            until = time.monotonic() + DEADLINE_S
            while (listed := sorted(each.name for each in (await client.list_tools()).tools)) != tools:
                if time.monotonic() > until:
                    expect("listed", listed, tools)
                await asyncio.sleep(0.2)
            expect(server.unmapped, told(await client.call_tool(server.unmapped, {}))["reason"], "TOOL_UNKNOWN")

            answer = await in_time(client, *server.permitted(world))
            said = text_of(answer)
            expect(f"permitted, and answered {said[:300]!r}", (answer.is_error, judged(answer)), (False, DONE))
            if server.answer not in said:
                raise Wrong(f"answer: {said[:300]!r} has no {server.answer!r}")
            before = state()

            answer = await in_time(client, *server.refused(world))
            expect("refused", judged(answer), LIMITED)
            expect("refused for", told(answer)["parameter"], server.parameter)
            expect("state after the refusal", state(), before)

            await approved_once(site, client, server.deferred(world), state)
            after = state()
            expect("acts after the approval", after[0], before[0] + 1)
            if server.seen is not None and after[1] == before[1]:
                raise Wrong(f"nothing is seen of the approved act: {after[1]!r}")
    return ["permitted", f"refused by {server.parameter}", "deferred", "approved once"]


@contextlib.contextmanager
def world_in(folder: Path, programs: Mapping[PublicServer, Path]) -> Iterator[World]:
    """All that the servers act on, as long as the block."""
    world = World(folder)
    for each, program in programs.items():
        if each.prepare is not None:
            each.prepare(world, program.with_name("python"))
    try:
        yield world
    finally:
        world.web.end()


def main() -> int:
    """Runs it; the exit status."""
    count, wrong = run(SERVERS, __doc__, tried, world_in)
    whole = f"{count - wrong} of {count} public servers behind the gateway"
    sys.stdout.write(f"{whole}: permitted, refused by limit, deferred and approved once each\n")
    return 1 if wrong or not count else 0


if __name__ == "__main__":
    sys.exit(main())
