"""Promises of every landing about the house itself."""

import importlib.metadata
import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

pytestmark = pytest.mark.long

TOP = Path(__file__).parents[2]


def tracked() -> list[Path]:
    listing = subprocess.run(["git", "ls-files", "-z"], cwd=TOP, capture_output=True, text=True, timeout=30)
    if listing.returncode:
        pytest.skip("not a git checkout")
    return [TOP / name for name in listing.stdout.split("\0") if name]


def test_no_file_names_a_package_index() -> None:
    hosts = re.compile(
        "|".join((r"py" r"pi\.org", r"files\.python" r"hosted", r"registry\.npm" r"js", r"deb\.debian" r"\.org"))
    )
    found = [str(path) for path in tracked() if path.is_file() and hosts.search(path.read_text("utf-8", "ignore"))]
    assert found == []


def test_modules_are_one_noun() -> None:
    long = {
        str(p.relative_to(TOP)): n
        for p in tracked()
        if p.suffix == ".py"
        and "tests" not in p.relative_to(TOP).parts
        and (n := len(p.read_text().splitlines())) > 500
    }
    assert long == {}


BANNED = re.compile(
    r"\b(?:class|def)\s+\w*(?:manager|helper|util|handler|data|info|process|misc)(?![a-z])\w*", re.IGNORECASE
)


OF_A_FRAMEWORK = {"def data_received"}
"""Names that are not ours to choose: asyncio calls this one."""


def test_banned_words_stay_out_of_identifiers() -> None:
    found = [
        f"{path.relative_to(TOP)}: {match.group()}"
        for path in tracked()
        if path.suffix == ".py" and "tests" not in path.relative_to(TOP).parts
        for match in BANNED.finditer(path.read_text())
        if match.group() not in OF_A_FRAMEWORK
    ]
    assert found == []


DECODES = re.compile(
    r"msgspec\.(?:json|msgpack|yaml|toml)\.(?:decode|Decoder)\(|from msgspec(?:\.\w+)? import .*\b(?:decode|Decoder|json)\b"
)
ENCODED_AGAIN = {"capabilities/token/fact.py", "capabilities/values/strict_json.py"}
"""Modules that decode and encode again, and take only the same bytes: no key twice, no other spelling."""


def test_no_bytes_reach_msgspec_past_our_strict_reader() -> None:
    """It keeps the last of two equal keys; `capabilities.values.form` takes what `strict_json` or `tomllib` has read."""
    found = {
        str(path.relative_to(TOP))
        for path in tracked()
        if path.suffix == ".py" and "tests" not in path.relative_to(TOP).parts and DECODES.search(path.read_text())
    }
    assert found == ENCODED_AGAIN


def test_each_clause_of_physics_has_a_number_of_its_own() -> None:
    """Each citation of a clause, in any file, is of one that exists."""
    clauses = re.findall(r"\*\*(PHY-\d+)", (TOP / "docs" / "physics.md").read_text())
    assert len(clauses) == len(set(clauses)) > 30
    cited = {
        number: str(path.relative_to(TOP))
        for path in tracked()
        if path.suffix in {".py", ".md", ".toml", ".js"}
        for number in re.findall(r"PHY-\d+", path.read_text())
    }
    assert {number: path for number, path in cited.items() if number not in clauses} == {}


def test_top_level_names_belong_to_us() -> None:
    """`capabilities`, `pep`, `policies` are plain words: no other installed distribution may claim them."""
    owners = importlib.metadata.packages_distributions()
    for name in ("capabilities", "policies", "pep", "ztpm_idp", "ztpm", "evaluation"):
        assert set(owners.get(name, ["ztpm"])) == {"ztpm"}, name


@pytest.mark.e2e
def test_tests_in_which_real_time_passes_are_in_two_groups(request: pytest.FixtureRequest) -> None:
    """`--dist loadgroup` keeps each group to one worker: three beside each other fail at random."""
    timed = [
        item
        for item in request.session.items
        if any(item.get_closest_marker(name) is not None for name in ("e2e", "real_time"))
    ]
    groups = {item.get_closest_marker("xdist_group").args[0] for item in timed}
    assert groups <= {"cells", "lines"}
    if request.config.getoption("loadgroup", default=False):
        assert all(item.nodeid.rpartition("@")[2] in groups for item in timed)


@pytest.mark.e2e
@pytest.mark.timeout(300)
def test_core_installs_alone(tmp_path: Path) -> None:
    """In an empty environment the bare distribution brings `capabilities` and `policies`, and no web, database or robot package."""
    uv = shutil.which("uv")
    if uv is None:
        pytest.skip("uv is not on the path")
    where = tmp_path / "env"
    subprocess.run([uv, "venv", "-q", "--python", sys.executable, where], check=True, timeout=60)
    python = where / "bin" / "python"
    subprocess.run([uv, "pip", "install", "-q", "--python", python, TOP], check=True, timeout=200)
    subprocess.run(
        [python, "-c", "import capabilities, policies; policies.load_shipped('paper-default')"],
        check=True,
        cwd=tmp_path,
        timeout=60,
    )
    listing = subprocess.run(
        [uv, "pip", "list", "--python", python, "--format", "freeze"],
        check=True,
        capture_output=True,
        text=True,
        timeout=60,
    )
    installed = {line.split("==")[0].lower() for line in listing.stdout.splitlines()}
    assert not installed & {
        "fastapi",
        "starlette",
        "sqlalchemy",
        "mcp",
        "numpy",
        "pin",
        "coal",
        "ur-rtde",
        "httpx2",
        "uvicorn",
        "typer",
    }
