"""Each import contract holds, and each is seen to fail when it is broken."""

import shutil
import subprocess
import sys
import tomllib
from pathlib import Path
from typing import Any

import pytest

pytestmark = pytest.mark.long

TOP = Path(__file__).parents[2]
PACKAGES = ("capabilities", "policies", "pep", "ursim", "ztpm_idp", "ztpm", "evaluation")

BREAKS = [
    ("layers", "capabilities/values/units.py", "import policies.evidence.model"),
    ("layers", "policies/evidence/model.py", "import pep.base.ports"),
    ("layers", "pep/base/ports.py", "import ztpm_idp"),
    ("enforcement-and-provider", "ztpm_idp/__init__.py", "import pep.base.ports"),
    ("capabilities-rooms", "capabilities/values/units.py", "import capabilities.keys.keys"),
    ("policies-rooms", "policies/evidence/model.py", "import policies.decision.pdp"),
    ("pep-rooms", "pep/base/ports.py", "import pep.gate.gate"),
    ("rtde-rooms", "pep/rtde/wire/codec.py", "import pep.rtde.line.relay"),
    ("pit-rooms", "pep/pit/geometry/shape.py", "import pep.pit.search.certify"),
    ("ursim-rooms", "ursim/motion/arm.py", "import ursim.ports.server"),
    ("ursim-alone", "ursim/motion/arm.py", "import pep.rtde.line.relay"),
    ("ursim-fence", "pep/gate/gate.py", "import ursim.motion.arm"),
    ("provider-rooms", "ztpm_idp/settings.py", "import ztpm_idp.app"),
    ("ztpm-rooms", "ztpm/base/lock.py", "import ztpm.cell.cell"),
    ("capabilities-rooms", "capabilities/attic/__init__.py", "import json"),
    ("layers", "pep/base/ports.py", "import ztpm.cell.cell"),
    ("layers", "ztpm/cell/cell.py", "import evaluation.stops"),
    ("physics-fence", "evaluation/cli.py", "import coal"),
    ("evaluation-rooms", "evaluation/harness/timing.py", "import evaluation.tokens.cell"),
    ("evaluation-rooms", "evaluation/conduct/agents.py", "import evaluation.tokens.cell"),
    ("core-is-light", "policies/evidence/model.py", "import fastapi"),
    ("core-is-light", "capabilities/values/units.py", "import numpy"),
    ("core-is-light", "capabilities/values/units.py", "import socket"),
    ("biscuit-fence", "pep/base/ports.py", "import biscuit_auth"),
    ("biscuit-fence", "capabilities/values/units.py", "import biscuit_auth"),
    ("physics-fence", "pep/gate/gate.py", "import pinocchio"),
    ("physics-fence", "ztpm/cell/cell.py", "import coal"),
    ("mcp-fence", "pep/gate/gate.py", "import mcp"),
    ("mcp-fence", "ztpm_idp/__init__.py", "import mcp"),
    ("domain-is-pure", "ztpm_idp/domain/__init__.py", "import sqlalchemy"),
    ("domain-is-pure", "ztpm_idp/domain/__init__.py", "import ztpm_idp.app"),
    ("web-fence", "pep/gate/gate.py", "import fastapi"),
    ("web-fence", "ztpm/cell/cell.py", "import sqlalchemy"),
    ("physics-fence", "pep/world/world.py", "import pinocchio"),
    ("mcp-fence", "pep/world/world.py", "import mcp"),
    ("stores-fence", "pep/mcp/guard.py", "import chromadb"),
    ("stores-fence", "pep/journal/file_journal.py", "import sqlite3"),
    ("admission-is-pure", "pep/context/memory.py", "import pep.context.stores.sqlite"),
    ("admission-is-pure", "pep/context/retrieval.py", "import pep.context.stores.chroma"),
    ("checker-alone", "pep/pit/checker/distances.py", "import numpy"),
    ("checker-alone", "pep/pit/checker/laws.py", "import pep.pit.base.tier"),
    ("checker-alone", "pep/pit/checker/text.py", "import pep.base.ports"),
    ("shells-outside", "pep/gate/gate.py", "import pep.mcp.guard"),
    ("shells-outside", "pep/gate/gate.py", "import socket"),
    ("shells-outside", "pep/pit/base/tier.py", "import pep.rtde.motion.drive"),
    ("shells-outside", "pep/world/sequence.py", "import pep.rtde.motion.drive"),
    ("shells-outside", "pep/world/held_object.py", "import socket"),
    ("shells-outside", "pep/world/world.py", "import pep.rtde.robot.telemetry"),
    ("shells-outside", "pep/watch/watch.py", "import pep.perception.receiver"),
    ("shells-outside", "pep/journal/conduct.py", "import rtde_control"),
    ("admission-is-pure", "pep/perception/sensor_frames.py", "import pep.context.stores.chroma"),
    ("stores-fence", "pep/context/screening.py", "import sqlite3"),
    ("rtde-words-are-pure", "pep/rtde/command/fields.py", "import asyncio"),
]


def contract(name: str) -> dict[str, Any]:
    rows = tomllib.loads((TOP / "pyproject.toml").read_text())["tool"]["importlinter"]["contracts"]
    (row,) = [row for row in rows if row["id"] == name]
    return row


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
    target.parent.mkdir(exist_ok=True)
    text = target.read_text() if target.exists() else ""
    target.write_text(text + f"\n{line}\n")
    result = lint(tree)
    assert result.returncode == 1, result.stdout + result.stderr
    assert [row for row in result.stdout.splitlines() if row.startswith(name) and "BROKEN" in row], result.stdout
