"""The extras that are listed here together hold every package that a command of `ztpm eval` imports."""

import ast
import re
import sys
from collections.abc import Iterator
from importlib.metadata import PackageNotFoundError, packages_distributions, requires
from pathlib import Path

import grimp
import pytest
from packaging.requirements import Requirement

TOP = Path(__file__).parents[2]
OWN = ("capabilities", "policies", "pep", "ursim", "ztpm_idp", "ztpm", "evaluation")
EXTRAS = ("all", "bench", "viz", "retrieval", "fastmcp", "postgres", "pkcs11", "otel")


ELSEWHERE = {
    "pinocchio": "pin",
    "coal": "coal",
    "fastmcp": "fastmcp-slim",
    "rtde_control": "ur-rtde",
    "rtde_io": "ur-rtde",
    "rtde_receive": "ur-rtde",
    "script_client": "ur-rtde",
}
"""Packages whose distributions do not say what they install."""

APART = Path("dojo", "their_side.py")
"""File that runs in an environment of its own, which the command makes: it requires what ours excludes."""


def plain(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()


@pytest.fixture(scope="module")
def offered() -> set[str]:
    """Distributions that the core and the extras install, with all that those require in turn."""
    found: set[tuple[str, str]] = set()
    waiting = [("ztpm", extra) for extra in ("", *EXTRAS)]
    while waiting:
        each = waiting.pop()
        if each in found:
            continue
        found.add(each)
        name, extra = each
        try:
            rows = requires(name) or ()
        except PackageNotFoundError:
            continue  # an extra that this environment was made without
        for row in map(Requirement, rows):
            if row.marker is None or row.marker.evaluate({"extra": extra}):
                waiting += [(plain(row.name), part) for part in ("", *row.extras)]
    return {name for name, _ in found}


def delayed(file: Path) -> Iterator[tuple[str, str]]:
    """Modules that a file imports by a text, each with its distribution: by `package` or by `import_module`."""
    for node in ast.walk(ast.parse(file.read_text())):
        if isinstance(node, ast.Call) and node.args and isinstance(node.args[0], ast.Constant):
            called = node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")
            if called in {"package", "import_module"}:
                module, distribution = node.args[0].value.split(".")[0], node.args[-1]
                named = called == "package" and isinstance(distribution, ast.Constant)
                yield module, distribution.value if named else ELSEWHERE.get(module, module)


@pytest.mark.long
def test_every_import_is_in_an_extra(offered: set[str]) -> None:
    graph = grimp.build_graph(*OWN, include_external_packages=True, cache_dir=None)
    own = {module for module in graph.modules if module == "evaluation" or module.startswith("evaluation.")}
    reached = set().union(*(graph.find_upstream_modules(module) for module in own))
    external = {module for module in reached if graph.is_module_squashed(module)}
    imported = {module: ELSEWHERE.get(module, module) for module in external}
    for file in (TOP / "evaluation").rglob("*.py"):
        imported |= {} if file.relative_to(TOP / "evaluation") == APART else dict(delayed(file))
    for standard in (*sys.stdlib_module_names, "__future__"):
        imported.pop(standard, None)
    assert {"typer", "numpy", "z3", "mujoco", "tenuo", "matplotlib"} <= imported.keys()
    distributions = packages_distributions()
    missing = {
        module
        for module, distribution in imported.items()
        if not {plain(name) for name in distributions.get(module, [distribution])} & offered
    }
    assert not missing
