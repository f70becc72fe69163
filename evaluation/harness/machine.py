"""Machine of a measurement."""

from __future__ import annotations

import hashlib
import os
import platform
import subprocess
from pathlib import Path
from typing import Any, Final

PACKAGES: Final = ("capabilities", "evaluation", "pep", "policies", "ursim", "ztpm", "ztpm_idp")
"""Packages whose files decide what a run shows."""
RESULTS: Final = ("evaluation", "results")
"""Folder of what runs have shown."""


def machine() -> dict[str, Any]:
    """Machine that this process runs on: processor, cores, system, Python and load."""
    return {
        "processor": _processor(),
        "cores": os.cpu_count(),
        "system": platform.platform(),
        "python": platform.python_version(),
        "load": [round(load, 2) for load in os.getloadavg()],
    }


def commit() -> str:
    """Commit of the checkout that this code is in, with `-dirty` where it was changed; empty outside of one."""
    try:
        told = subprocess.run(  # noqa: S603 - git, with words of ours
            ("git", "-C", str(Path(__file__).parent), "describe", "--always", "--dirty", "--abbrev=40", "--exclude=*"),  # noqa: S607 - git of the path, as a developer has it
            capture_output=True, check=True, text=True,
        )  # fmt: skip
    except (OSError, subprocess.CalledProcessError):
        return ""
    return told.stdout.strip()


def code(top: Path = Path(__file__).parents[2]) -> str:
    """SHA-256 of every file of the packages as they are on disk, hexadecimal; results of an evaluation are left out.

    Args:
        top: folder of the packages.
    """
    digest = hashlib.sha256()
    for package in PACKAGES:
        for file in sorted((top / package).rglob("*")):
            name = file.relative_to(top)
            if file.is_file() and "__pycache__" not in name.parts and name.parts[:2] != RESULTS:
                content = hashlib.sha256(file.read_bytes()).hexdigest()
                digest.update(f"{name.as_posix()} {content}\n".encode())
    return digest.hexdigest()


def _processor() -> str:
    """The processor's name as Linux tells it; the architecture elsewhere."""
    try:
        lines = Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines()
    except OSError:
        return platform.machine()
    named = (line.partition(":")[2].strip() for line in lines if line.startswith("model name"))
    return next(named, platform.machine())
