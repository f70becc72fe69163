"""Desk as a process: served bare, or guarded at a cell's identity provider."""

from __future__ import annotations

import socket
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Final

from capabilities.keys import keys
from evaluation.redteam.desk.papers import Papers
from evaluation.redteam.desk.tools import desk_server
from evaluation.redteam.guarding import FOLDER, JOURNAL, KEY, registered
from ztpm.base.layout import read_key
from ztpm.base.processes import Child, ChildError
from ztpm.cell.cell import PASSPHRASE_VARIABLE

if TYPE_CHECKING:
    from collections.abc import Iterator

    from ztpm.stage.stage import Stage

MODULE: Final = "evaluation.redteam.desk.tools"
POINT_ID: Final = "desk-point"
LOOPBACK: Final = "127.0.0.1"


@dataclass
class Desk:
    """A running desk.

    Attributes:
        papers: its folder.
        url: canonical URL.
        child: its process.
        point_key: public key of its enforcement point; empty without one.
        guard: `guard.toml`, or None without a guard.
    """

    papers: Papers
    url: str
    child: Child
    point_key: bytes = b""
    guard: Path | None = None


def _free_port(host: str) -> int:
    with socket.socket() as taken:
        taken.bind((host, 0))
        return int(taken.getsockname()[1])


@contextmanager
def bare_desk() -> Iterator[Desk]:
    """A desk with no guard, ended afterwards."""
    with TemporaryDirectory(prefix="ztpm-desk-") as folder:
        papers = Papers(Path(folder))
        papers.lay_out()
        listen = f"{LOOPBACK}:{_free_port(LOOPBACK)}"
        child = Child.start("desk", MODULE, "--folder", folder, "--listen", listen, environment={})
        try:
            yield Desk(papers, f"http://{listen}/mcp", child)
        finally:
            child.stop()


@contextmanager
def guarded_desk(stage: Stage) -> Iterator[Desk]:
    """A desk that a person has registered at the stage's identity provider, ended afterwards."""
    with TemporaryDirectory(prefix="ztpm-desk-") as name:
        folder, cell = Path(name), stage.cell
        papers = Papers(folder / "papers")
        papers.root.mkdir()
        papers.lay_out()
        listen = f"{cell.addresses.host}:{_free_port(cell.addresses.host)}"
        url = f"http://{listen}/mcp"
        guard = registered(stage, folder, pep=POINT_ID, audience=url, server=desk_server(papers))
        stage.further_journals.append(folder / FOLDER / JOURNAL)
        key = keys.public_raw(read_key(folder / KEY, cell.passphrase))
        desk = Desk(papers, url, _guarded(stage, papers, guard, listen), key, guard)
        try:
            yield desk
        finally:
            desk.child.stop()


def _guarded(stage: Stage, papers: Papers, guard: Path, listen: str, *options: str) -> Child:
    """Process of a guarded desk, ready."""
    cell = stage.cell
    child = cell.begin_child(
        "desk", MODULE, "--folder", str(papers.root), "--guard", str(guard), "--listen", listen, *options,
        environment={PASSPHRASE_VARIABLE: cell.passphrase.decode()},
    )  # fmt: skip
    return child.until_ready()


def replaced(desk: Desk, stage: Stage | None, *options: str) -> str:
    """Replaces the process of a desk by one with these options; the reason code where that does not start."""
    desk.child.stop()
    listen = desk.url.removeprefix("http://").removesuffix("/mcp")
    try:
        if desk.guard is None or stage is None:
            desk.child = Child.start(
                "desk", MODULE, "--folder", str(desk.papers.root), "--listen", listen, *options, environment={}
            )
        else:
            desk.child = _guarded(stage, desk.papers, desk.guard, listen, *options)
    except ChildError as error:
        return next(
            (word for word in str(error).replace(":", " ").split() if word.isupper() and "_" in word), "UNKNOWN"
        )
    return ""
