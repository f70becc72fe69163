"""The extras `all`, `bench`, `viz` and `retrieval` together hold every package that a command of `ztpm eval` imports."""

import ast
import re
import sys
import tomllib
from collections.abc import Iterator
from importlib.metadata import packages_distributions
from pathlib import Path

import grimp
import pytest

TOP = Path(__file__).parents[2]
OWN = ("capabilities", "policies", "pep", "ztpm_idp", "ztpm", "evaluation")
EXTRAS = ("all", "bench", "viz", "retrieval")


def name_of(requirement: str) -> str:
    return re.split(r"[\[<>=!~; ]", requirement, maxsplit=1)[0].lower().replace("_", "-")


@pytest.fixture(scope="module")
def offered() -> set[str]:
    """Distributions that the project itself names: those of the core and of the extras, with the extras in them."""
    project = tomllib.loads((TOP / "pyproject.toml").read_text())["project"]
    extras, found = project["optional-dependencies"], {name_of(row) for row in project["dependencies"]}
    waiting = list(EXTRAS)
    while waiting:
        for row in extras[waiting.pop()]:
            if name_of(row) == project["name"]:
                waiting += re.search(r"\[(.*)\]", row)[1].split(",")
            found.add(name_of(row))
    return found


def delayed(file: Path) -> Iterator[str]:
    """Modules that a file imports by a text: by `package` or by `import_module`."""
    for node in ast.walk(ast.parse(file.read_text())):
        if isinstance(node, ast.Call) and node.args and isinstance(node.args[0], ast.Constant):
            called = node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")
            if called in {"package", "import_module"}:
                yield str(node.args[0].value).split(".")[0]


def test_every_import_is_in_an_extra(offered: set[str]) -> None:
    graph = grimp.build_graph(*OWN, include_external_packages=True, cache_dir=None)
    own = {module for module in graph.modules if module == "evaluation" or module.startswith("evaluation.")}
    reached = set().union(*(graph.find_upstream_modules(module) for module in own))
    imported = {module for module in reached if graph.is_module_squashed(module)}
    for file in (TOP / "evaluation").rglob("*.py"):
        imported |= set(delayed(file))
    imported -= set(sys.stdlib_module_names) | {"__future__"}
    assert {"typer", "numpy", "z3", "mujoco", "tenuo", "matplotlib"} <= imported
    distributions = packages_distributions()
    missing = {
        module
        for module in imported
        if not {name.lower().replace("_", "-") for name in distributions.get(module, [module])} & offered
    }
    assert not missing
