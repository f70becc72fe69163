"""Rooms of the house: no folder holds too much, no import goes round, no name says two things."""

import ast
import importlib
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

TOP = Path(__file__).parents[2]
PACKAGES = ("capabilities", "policies", "pep", "ursim", "ztpm_idp", "ztpm", "evaluation")
FILES = 25
"""Python files in one folder; a reader takes in no more."""
OF_THE_WHOLE = ("adapters", "e2e", "examples", "house", "model", "mutation", "properties", "vectors")
"""Folders of tests that are about no single package."""
CAMPAIGNS = {
    "pep/mcp/campaign", "pep/pit/campaign", "pep/rtde/campaign", "ztpm_idp/campaign", "ztpm_idp/hostile",
    "ztpm_idp/store/campaign",
}  # fmt: skip
"""Beside the tests that they vary: what a campaign draws, and a slice of it for the suite."""
RECORDED = {"MoveJ", "MoveL", "ServoJ", "SpeedJ", "SpeedL"}
"""Names of two classes of `pep`: the published schema of motions has the one, records of refused commands the other."""


def sources() -> dict[str, Path]:
    """Every product module by its dotted name."""
    found = {}
    for package in PACKAGES:
        for path in (TOP / package).rglob("*.py"):
            parts = path.relative_to(TOP).with_suffix("").parts
            found[".".join(parts[:-1] if parts[-1] == "__init__" else parts)] = path
    return found


def imported(name: str, path: Path, modules: dict[str, Path]) -> Iterator[str]:
    """Modules of ours that one module imports anywhere: at the top, in functions, for types."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names if alias.name in modules)
        elif isinstance(node, ast.ImportFrom) and node.module:
            for alias in node.names:
                inner = f"{node.module}.{alias.name}"
                yield inner if inner in modules else node.module


def circles(edges: dict[str, set[str]]) -> list[str]:
    """Modules that lead back to themselves: what is left when those that import nothing more are taken away."""
    left = dict(edges)
    while True:
        inner = {name: targets & left.keys() for name, targets in left.items()}
        ends = {name for name, targets in inner.items() if not targets}
        starts = inner.keys() - set().union(*inner.values())
        if not ends | starts:
            return sorted(inner)
        left = {name: targets for name, targets in inner.items() if name not in ends | starts}


@pytest.mark.long
def test_no_import_goes_round() -> None:
    modules = sources()
    edges = {
        name: {target for target in imported(name, path, modules) if target in modules and target != name}
        for name, path in modules.items()
    }
    assert circles(edges) == []


def test_a_circle_is_found() -> None:
    assert circles({"a": {"b"}, "b": {"c"}, "c": {"b"}, "d": {"a"}}) == ["b", "c"]


def folders(tree: Path) -> set[Path]:
    """Folders of modules: the tree itself and all below it, at any depth."""
    return {folder for path in tree.rglob("*.py") for folder in path.parents if folder.is_relative_to(tree)}


@pytest.mark.parametrize("tree", [*PACKAGES, "tests"])
def test_a_folder_holds_what_a_reader_takes_in(tree: str) -> None:
    crowded = {
        str(folder.relative_to(TOP)): count
        for folder in folders(TOP / tree)
        if (count := len(list(folder.glob("*.py")))) > FILES
    }
    assert crowded == {}


@pytest.mark.parametrize("package", PACKAGES)
def test_tests_stand_in_the_rooms_of_what_they_test(package: str) -> None:
    rooms = {str(folder.relative_to(TOP)) for folder in folders(TOP / package)}
    mirrored = {str(folder.relative_to(TOP / "tests")) for folder in folders(TOP / "tests" / package)}
    assert mirrored - rooms - CAMPAIGNS == set()
    assert package in mirrored


def test_every_folder_of_tests_is_a_packages_or_one_that_is_told() -> None:
    named = {path.name for path in folders(TOP / "tests") if path.parent == TOP / "tests"}
    assert named == {*PACKAGES, *OF_THE_WHOLE}


@pytest.mark.long
@pytest.mark.parametrize("package", PACKAGES)
def test_a_public_class_has_a_name_of_its_own(package: str) -> None:
    places: dict[str, list[str]] = {}
    for path in (TOP / package).rglob("*.py"):
        for node in ast.parse(path.read_text()).body:
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                places.setdefault(node.name, []).append(str(path.relative_to(TOP)))
    shared = {name: where for name, where in places.items() if len(where) > 1 and name not in RECORDED}
    assert shared == {}


def test_the_architecture_names_every_room_and_no_other() -> None:
    page = (TOP / "ARCHITECTURE.md").read_text()
    rooms = {
        str(path.parent.relative_to(TOP))
        for package in PACKAGES
        for path in (TOP / package).rglob("__init__.py")
        if path.parent != TOP / package
    }
    named = set(re.findall(rf"`((?:{'|'.join(PACKAGES)})(?:/\w+)+)`", page))
    assert named == rooms


@pytest.mark.parametrize("package", ["capabilities", "policies", "pep", "ztpm_idp"])
def test_a_name_that_is_loaded_when_asked_for_is_the_one_that_type_checkers_see(package: str) -> None:
    module = importlib.import_module(package)
    seen: dict[str, str] = {}
    for block in ast.parse((TOP / package / "__init__.py").read_text()).body:
        for node in block.body if isinstance(block, ast.If) else ():
            if isinstance(node, ast.ImportFrom):
                for name in node.names:
                    seen[name.asname or name.name] = f"{node.module}:{name.name}"
    homes = {name: home if ":" in home else f"{home}:{name}" for name, home in module._HOMES.items()}
    assert homes == seen and homes.keys() == set(module.__all__)
    for name, home in homes.items():
        where, _, theirs = home.partition(":")
        assert getattr(module, name) is getattr(importlib.import_module(where), theirs)
    with pytest.raises(AttributeError):
        module.nothing  # noqa: B018
