"""Each import contract holds, and each is seen to fail when it is broken."""

import shutil
import subprocess
import sys
from copy import deepcopy
from functools import cache
from pathlib import Path

import grimp
import pytest
from importlinter.api import read_configuration
from importlinter.contracts.forbidden import ForbiddenContract
from importlinter.contracts.independence import IndependenceContract
from importlinter.contracts.layers import LayersContract
from importlinter.contracts.protected import ProtectedContract
from importlinter.domain.contract import Contract

pytestmark = pytest.mark.long

TOP = Path(__file__).parents[2]

KINDS: dict[str, type[Contract]] = {
    "forbidden": ForbiddenContract,
    "independence": IndependenceContract,
    "layers": LayersContract,
    "protected": ProtectedContract,
}
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
    ("referee-alone", "evaluation/redteam/referee/body.py", "import pep.pit.scene.adult_body"),
    ("referee-alone", "evaluation/harness/absent.py", "import capabilities.values.units"),
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
    ("kernel-fence", "pep/pit/search/engine.py", "import numba"),
    ("mcp-fence", "pep/world/world.py", "import mcp"),
    ("fastmcp-fence", "pep/mcp/guard.py", "import fastmcp"),
    ("stores-fence", "pep/mcp/guard.py", "import chromadb"),
    ("stores-fence", "pep/journal/file_journal.py", "import sqlite3"),
    ("admission-is-pure", "pep/context/memory.py", "import pep.context.stores.sqlite"),
    ("admission-is-pure", "pep/context/retrieval.py", "import pep.context.stores.chroma"),
    ("checker-alone", "pep/pit/checker/distances.py", "import numpy"),
    ("checker-alone", "pep/pit/checker/laws.py", "import pep.pit.base.tier"),
    ("checker-alone", "pep/pit/checker/text.py", "import pep.base.ports"),
    ("shells-outside", "pep/gate/gate.py", "import pep.mcp.guard"),
    ("shells-outside", "pep/gate/gate.py", "import socket"),
    ("shells-outside", "pep/pit/base/tier.py", "import pep.rtde.motion.motions"),
    ("shells-outside", "pep/world/sequence.py", "import pep.rtde.motion.motions"),
    ("shells-outside", "pep/world/held_object.py", "import socket"),
    ("shells-outside", "pep/world/world.py", "import pep.rtde.robot.readiness"),
    ("shells-outside", "pep/watch/watch.py", "import pep.perception.receiver"),
    ("shells-outside", "pep/journal/conduct.py", "import rtde_control"),
    ("admission-is-pure", "pep/perception/sensor_frames.py", "import pep.context.stores.chroma"),
    ("stores-fence", "pep/context/screening.py", "import sqlite3"),
    ("rtde-words-are-pure", "pep/rtde/command/fields.py", "import asyncio"),
]


CONFIGURED = read_configuration(str(TOP / "pyproject.toml"))
SESSION, ROWS = CONFIGURED["session_options"], CONFIGURED["contracts_options"]
PACKAGES = SESSION["root_packages"]
NAMES = {row["id"]: row["name"] for row in ROWS}


@cache
def graph() -> grimp.ImportGraph:
    """Imports of the house as the command reads them, read once."""
    assert SESSION.keys() == {"root_packages", "include_external_packages"}
    return grimp.build_graph(*PACKAGES, include_external_packages=True, cache_dir=None)


@cache
def contracts() -> dict[str, Contract]:
    """Contracts of the house, as the command reads them."""
    return {row["id"]: KINDS[row["type"]](row["name"], SESSION, row) for row in ROWS}


def is_kept(contract_id: str, imports: grimp.ImportGraph) -> bool:
    return contracts()[contract_id].check(deepcopy(imports), verbose=False).kept


def with_line(file: str, line: str) -> grimp.ImportGraph:
    """The graph as it would be with this line in this file."""
    imports = deepcopy(graph())
    importer, imported = file.removesuffix(".py").removesuffix("/__init__").replace("/", "."), line.split()[1]
    if importer not in imports.modules:
        imports.add_module(importer)
    if imported not in imports.modules:
        assert imported.split(".")[0] not in PACKAGES, imported
        imports.add_module(imported, is_squashed=True)
    assert not imports.direct_import_exists(importer=importer, imported=imported)
    imports.add_import(importer=importer, imported=imported)
    return imports


@pytest.mark.parametrize("contract_id", NAMES)
def test_kept(contract_id: str) -> None:
    assert is_kept(contract_id, graph())


@pytest.mark.parametrize(("contract_id", "file", "line"), BREAKS, ids=[f"{c}-{f}-{i.split()[1]}" for c, f, i in BREAKS])
def test_broken_is_seen(contract_id: str, file: str, line: str) -> None:
    assert not is_kept(contract_id, with_line(file, line))


def test_each_contract_is_seen_to_break() -> None:
    assert {contract_id for contract_id, _, _ in BREAKS} == set(NAMES)


# ---- the command itself


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


def test_the_command_keeps_all(tree: Path) -> None:
    result = lint(tree)
    assert result.returncode == 0, result.stdout + result.stderr
    assert f" {len(NAMES)} kept, 0 broken" in result.stdout


def test_the_command_breaks_what_the_graph_breaks(tree: Path) -> None:
    """Imports in a file, in an unnamed room and of a library break the same contracts in both."""
    added = {
        "pep/base/ports.py": "import ztpm_idp",
        "capabilities/attic/__init__.py": "import json",
        "ztpm_idp/__init__.py": "import mcp",
    }
    for file, line in added.items():
        target = tree / file
        target.parent.mkdir(exist_ok=True)
        target.write_text((target.read_text() if target.exists() else "") + f"\n{line}\n")
    result = lint(tree)
    assert result.returncode == 1, result.stdout + result.stderr
    broken = {
        each
        for each in NAMES
        if any(row.startswith(NAMES[each]) and "BROKEN" in row for row in result.stdout.splitlines())
    }
    assert broken == {each for each in NAMES if any(not is_kept(each, with_line(*row)) for row in added.items())}
    assert broken >= {"layers", "enforcement-and-provider", "capabilities-rooms", "mcp-fence"}
