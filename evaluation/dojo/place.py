"""Environment of AgentDojo, apart from ours: its requirements and ours exclude each other."""

from __future__ import annotations

import os
import subprocess
import venv
from importlib.resources import files
from pathlib import Path
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from collections.abc import Callable, Mapping

PACKAGE: Final = "agentdojo==0.1.35"
"""Release that is replayed, as `requirements.txt` has it."""
LOOK_S: Final = 60.0
"""Longest start of that environment's interpreter, at a cold disk."""
INSTALL_S: Final = 1_800.0
"""Longest installation of 72 packages, over a slow line."""
_LOOK: Final = "from importlib.metadata import version as v; print('agentdojo==' + v('agentdojo'))"


class NoEnvironmentError(Exception):
    """Environment that cannot be made; the text says why, and what to do."""


def usual_folder(variables: Mapping[str, str]) -> Path:
    """Folder of the environment where none is named: in the user's cache.

    Args:
        variables: of this process.
    """
    cache = variables.get("XDG_CACHE_HOME", "")
    return (Path(cache) if cache else Path.home() / ".cache") / "ztpm" / PACKAGE


def interpreter(folder: Path) -> Path | None:
    """Interpreter of the environment; None where it has not the release in question."""
    python = folder / "bin" / "python"
    if not python.exists():
        return None
    found = _run([str(python), "-I", "-c", _LOOK], LOOK_S)
    return python if found.returncode == 0 and found.stdout.strip() == PACKAGE else None


def prepared(folder: Path, told: Callable[[str], None]) -> Path:
    """Interpreter of the environment, which is made where it is missing (from the configured package index).

    Args:
        folder: of the environment.
        told: of the progress.

    Raises:
        NoEnvironmentError: it cannot be made.
    """
    if (found := interpreter(folder)) is not None:
        return found
    if folder.exists() and not (folder / "pyvenv.cfg").exists() and any(folder.iterdir()):
        raise NoEnvironmentError(f"{folder} has something else in it; name another folder")
    told(f"installing {PACKAGE} in {folder}")
    try:
        venv.EnvBuilder(with_pip=True, symlinks=True).create(folder)
    except (OSError, subprocess.CalledProcessError) as error:
        raise NoEnvironmentError(f"no environment in {folder}: {error}") from error
    pins = files("evaluation.dojo").joinpath("requirements.txt")
    command = [str(folder / "bin" / "python"), "-m", "pip", "install", "--quiet", "--disable-pip-version-check"]
    done = _run([*command, "-r", str(pins)], INSTALL_S)
    if done.returncode != 0:
        last = " ".join(done.stderr.strip().splitlines()[-2:])
        raise NoEnvironmentError(f"{PACKAGE} was not installed in {folder}: {last}; try again with a package index")
    if (found := interpreter(folder)) is None:
        raise NoEnvironmentError(f"{folder} has no {PACKAGE}; remove it and try again")
    return found


def _run(command: list[str], most_s: float) -> subprocess.CompletedProcess[str]:
    """The command, ended; one that takes too long has failed."""
    try:
        return subprocess.run(  # noqa: S603 - an interpreter that we made, and our own words
            command, capture_output=True, text=True, timeout=most_s, check=False, env={**os.environ, "NO_COLOR": "1"}
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        return subprocess.CompletedProcess(command, 1, "", f"{type(error).__name__}: {error}")
