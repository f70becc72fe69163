"""Mutated modules, the tests that concern them, and the copy of the tree in which both run."""

import ast
import shutil
import subprocess
from pathlib import Path

TREE = Path(__file__).parents[2]

BAR = ("combine", "pdp", "tiers", "primitives/base", "primitives/cognition", "primitives/governance", "primitives/identity") + (
    "primitives/propagation", "primitives/sequence", "primitives/tools",
)  # fmt: skip
"""The modules of `policies` whose score has a threshold."""
BESIDE = ("approval", "shape", "labels", "obligations")
"""Those whose score is told beside it."""

TESTS = [
    "tests/policies/primitives/test_primitives.py",
    "tests/policies/test_properties.py",
    "tests/policies/decision/test_approval.py",
    "tests/policies/words/test_labels.py",
    "tests/policies/decision/test_obligations.py",
    "tests/policies/decision/test_combine.py",
    "tests/policies/evidence/test_tiers.py",
    "tests/policies/decision/test_decision.py",
    "tests/policies/test_default_set.py",
    "tests/model/test_twin.py",
    "tests/model/test_bad_evidence.py",
]
LEFT_OUT = [
    "tests/model/test_twin.py::test_the_random_triples_reach_every_effect_and_most_reasons",
    "tests/policies/test_properties.py::test_decisions_are_the_same_in_every_process_and_on_every_hash_seed",
]
"""Tests that ask nothing of a single decision, and take long."""
ROUNDS = {"ZTPM_TWIN_ROUNDS": "60", "ZTPM_BAD_DRAWS": "2"}

PYTEST = [
    "-p",
    "no:cacheprovider",
    "-p",
    "no:xdist",
    "-p",
    "tests.mutation.steady",
    *(f"--deselect={test}" for test in LEFT_OUT),
]

SETTINGS = """
[tool.mutmut]
source_paths = ["policies"]
only_mutate = {modules}
also_copy = {beside}
pytest_add_cli_args = {pytest}
pytest_add_cli_args_test_selection = {tests}
process_isolation = "forkserver"  # what one test run leaves behind in a process is no other's
track_dependencies = false
use_git_change_detection = false
timeout_constant = 20.0  # seconds: machines are shared
do_not_mutate_patterns = ['assert_never']  # arms that mypy proves are never reached
"""


def path_of(module):
    """Path of a module of `policies` from the top of the tree."""
    return f"policies/{module}.py"


def copied(to, modules):
    """Everything that git tracks or would track, as it stands in the working tree, with mutmut's settings."""
    listed = subprocess.run(
        ["git", "ls-files", "-coz", "--exclude-standard"], cwd=TREE, capture_output=True, check=True, text=True
    ).stdout
    names = [name for name in listed.split("\0") if name and (TREE / name).is_file()]
    for name in names:
        (to / name).parent.mkdir(parents=True, exist_ok=True)
        shutil.copy2(TREE / name, to / name)
    beside = sorted({Path(name).parts[0] for name in names} - {"policies", "tests", "pyproject.toml"})
    settings = SETTINGS.format(
        modules=[path_of(module) for module in modules],
        beside=beside,
        pytest=PYTEST,
        tests=[test for test in TESTS if (to / test).exists()],
    )
    project = to / "pyproject.toml"
    project.write_text(project.read_text("utf-8") + settings, "utf-8")
    for module in modules:
        source = to / path_of(module)
        source.write_text(bare(source.read_text("utf-8")), "utf-8")


def bare(source):
    """The same module with `f = cache(f)` instead of a decorator: mutmut leaves decorated functions alone."""
    lines = source.splitlines(keepends=True)
    for node in reversed(ast.parse(source).body):
        if isinstance(node, ast.FunctionDef) and [ast.unparse(each) for each in node.decorator_list] == ["cache"]:
            lines.insert(node.end_lineno, f"\n\n{node.name} = cache({node.name})\n")
            del lines[node.decorator_list[0].lineno - 1]
    return "".join(lines)
