"""Each import contract holds, and each is seen to fail when it is broken."""

import shutil
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

import pytest

TOP = Path(__file__).parents[2]
PACKAGES = ("capabilities", "policies", "pep", "ztpm_idp", "ztpm", "evaluation")

BREAKS = [
    ("layers", "capabilities/units.py", "import policies.model"),
    ("layers", "policies/model.py", "import pep.ports"),
    ("layers", "pep/ports.py", "import ztpm_idp"),
    ("layers", "ztpm_idp/__init__.py", "import pep.ports"),
    ("layers", "pep/ports.py", "import ztpm.cell"),
    ("layers", "ztpm/cell.py", "import evaluation.stops"),
    ("physics-fence", "evaluation/stops.py", "import coal"),
    ("core-is-light", "policies/model.py", "import fastapi"),
    ("core-is-light", "capabilities/units.py", "import numpy"),
    ("core-is-light", "capabilities/units.py", "import socket"),
    ("biscuit-fence", "pep/ports.py", "import biscuit_auth"),
    ("biscuit-fence", "capabilities/units.py", "import biscuit_auth"),
    ("physics-fence", "pep/gate.py", "import pinocchio"),
    ("physics-fence", "ztpm/cell.py", "import coal"),
    ("mcp-fence", "pep/gate.py", "import mcp"),
    ("mcp-fence", "ztpm_idp/__init__.py", "import mcp"),
    ("domain-is-pure", "ztpm_idp/domain/__init__.py", "import sqlalchemy"),
    ("domain-is-pure", "ztpm_idp/domain/__init__.py", "import ztpm_idp.app"),
    ("web-fence", "pep/gate.py", "import fastapi"),
    ("web-fence", "ztpm/cell.py", "import sqlalchemy"),
    ("physics-fence", "pep/world.py", "import pinocchio"),
    ("mcp-fence", "pep/world.py", "import mcp"),
    ("stores-fence", "pep/mcp/guard.py", "import chromadb"),
    ("stores-fence", "pep/record.py", "import sqlite3"),
    ("admission-is-pure", "pep/context/memory.py", "import pep.context.stores"),
    ("admission-is-pure", "pep/context/retrieval.py", "import pep.context.chroma"),
    ("checker-alone", "pep/pit/checker/space.py", "import numpy"),
    ("checker-alone", "pep/pit/checker/laws.py", "import pep.pit.tier"),
    ("checker-alone", "pep/pit/checker/text.py", "import pep.ports"),
    ("shells-outside", "pep/gate.py", "import pep.mcp.guard"),
    ("shells-outside", "pep/gate.py", "import socket"),
    ("shells-outside", "pep/pit/tier.py", "import pep.rtde.drive"),
    ("shells-outside", "pep/sequence.py", "import pep.rtde.drive"),
    ("shells-outside", "pep/holding.py", "import socket"),
    ("shells-outside", "pep/world.py", "import pep.rtde.telemetry"),
    ("shells-outside", "pep/watch.py", "import pep.perception"),
    ("shells-outside", "pep/conduct.py", "import rtde_control"),
    ("admission-is-pure", "pep/context/frames.py", "import pep.context.chroma"),
    ("admission-is-pure", "pep/context/screening.py", "import sqlite3"),
]
SHELLS = {"pep.asking", "pep.feed", "pep.perception", "pep.ship"}
"""Modules of `pep` itself that talk to a network."""
STORES = {"pep.context.chroma", "pep.context.stores"}


def contract(name: str) -> dict[str, Any]:
    rows = tomllib.loads((TOP / "pyproject.toml").read_text())["tool"]["importlinter"]["contracts"]
    (row,) = [row for row in rows if row["id"] == name]
    return row


def modules(folder: str) -> set[str]:
    return {f"{folder.replace('/', '.')}.{file.stem}" for file in (TOP / folder).glob("[!_]*.py")}


def test_no_module_is_forgotten() -> None:
    """A new module is inside until somebody says that it is a shell or a store."""
    assert set(contract("shells-outside")["source_modules"]) == modules("pep") - SHELLS | {"pep.context", "pep.pit"}
    assert set(contract("admission-is-pure")["source_modules"]) == modules("pep/context") - STORES | {"pep.gate"}


def lint(tree: Path) -> subprocess.CompletedProcess[str]:
    return subprocess.run(
        [Path(sys.executable).with_name("lint-imports"), "--no-cache"], cwd=tree, capture_output=True, text=True, timeout=100,
        env={"PATH": "/usr/bin:/bin", "PYTHONPATH": str(tree), "COLUMNS": "200"},
    )  # fmt: skip


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    for package in PACKAGES:
        shutil.copytree(TOP / package, tmp_path / package, ignore=shutil.ignore_patterns("__pycache__"))
    shutil.copy(TOP / "pyproject.toml", tmp_path)
    return tmp_path


def test_kept(tree: Path) -> None:
    result = lint(tree)
    assert result.returncode == 0, result.stdout + result.stderr
    assert " 0 broken" in result.stdout


@pytest.mark.parametrize(("contract_id", "file", "line"), BREAKS, ids=[f"{c}-{f}-{i.split()[1]}" for c, f, i in BREAKS])
def test_broken_is_seen(tree: Path, contract_id: str, file: str, line: str) -> None:
    name = contract(contract_id)["name"]
    target = tree / file
    text = target.read_text()
    target.write_text(text + f"\n{line}\n")
    result = lint(tree)
    assert result.returncode == 1, result.stdout + result.stderr
    assert [row for row in result.stdout.splitlines() if row.startswith(name) and "BROKEN" in row], result.stdout
