"""The project's pages: their prose, their tables, the commands and tests that they name."""

import ast
import re
import shlex
import subprocess
import tomllib
from functools import cache
from pathlib import Path

import pytest
import typer.main
from ztpm.cli import app

TOP = Path(__file__).parents[2]
BLOCK = re.compile(r"^```(\w*)\n(.*?)^```", re.DOTALL | re.MULTILINE)


@cache
def pages() -> tuple[Path, ...]:
    """Every Markdown page of the repository."""
    listing = subprocess.run(["git", "ls-files", "-z", "*.md"], cwd=TOP, capture_output=True, text=True, timeout=30)
    if listing.returncode:
        pytest.skip("not a git checkout")
    return tuple(TOP / name for name in listing.stdout.split("\0") if name and (TOP / name).is_file())


def own() -> list[Path]:
    """The project's own pages: those at the top and in docs. The others explain data that lies beside them."""
    return [page for page in pages() if page.parent == TOP or TOP / "docs" in page.parents]


def prose(text: str) -> list[str]:
    """The lines of a page outside tables and code blocks, indented ones too; an HTML comment may be long."""
    lines = BLOCK.sub("", text).splitlines()
    return [line for line in lines if not line.startswith("    ") and not line.lstrip().startswith(("|", "<!--"))]


def rows(text: str, *heading: str) -> list[list[str]]:
    """The rows of the one table with this heading, cell by cell."""
    lines = text.splitlines()
    (at,) = (number for number, line in enumerate(lines) if cells(line) == list(heading))
    found = []
    for line in lines[at + 2 :]:
        if not line.startswith("|"):
            break
        found.append(cells(line))
    return found


def cells(line: str) -> list[str]:
    return [cell.strip().replace("\\|", "|") for cell in re.split(r"(?<!\\)\|", line)[1:-1]]


def code(text: str) -> list[str]:
    """Every piece of code inside a line."""
    return re.findall(r"`([^`\n]+)`", text)


@cache
def tests() -> frozenset[str]:
    """The name of every test function."""
    return frozenset(
        node.name
        for path in (TOP / "tests").rglob("test_*.py")
        for node in ast.walk(ast.parse(path.read_text("utf-8")))
        if isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef) and node.name.startswith("test_")
    )


@cache
def names_in(file: Path) -> dict[str, ast.FunctionDef | ast.AsyncFunctionDef]:
    """The tests of a file as pytest names them: `test_x`, or `TestY::test_x`."""
    found = {}
    for node in ast.parse(file.read_text("utf-8")).body:
        inner = [(f"{node.name}::", each) for each in node.body] if isinstance(node, ast.ClassDef) else [("", node)]
        for above, each in inner:
            if isinstance(each, ast.FunctionDef | ast.AsyncFunctionDef) and each.name.startswith("test_"):
                found[above + each.name] = each
    return found


def missing(node: str, top: Path = TOP) -> str:
    """Part of a test's name, as pytest spells it, that is not there: its file, its function or its case."""
    file, _, rest = node.partition("::")
    name, _, case = rest.removesuffix("]").partition("[")
    path = top / file
    if not path.is_file() or not path.name.startswith("test_"):
        return "file"
    if name and name not in names_in(path):
        return "function"
    return "case" if case and case not in _spelled(path, name) else ""


def _spelled(path: Path, name: str) -> set[str]:
    """Texts in a test's marks and in the tables that they name: the ids of its cases are among them."""
    tables = {
        target.id: node.value
        for node in ast.parse(path.read_text("utf-8")).body
        if isinstance(node, ast.Assign | ast.AnnAssign) and node.value is not None
        for target in (node.targets if isinstance(node, ast.Assign) else [node.target])
        if isinstance(target, ast.Name)
    }
    texts: set[str] = set()
    waiting: list[ast.AST] = list(names_in(path)[name].decorator_list)
    while waiting:
        for each in ast.walk(waiting.pop()):
            if isinstance(each, ast.Constant) and isinstance(each.value, str):
                texts.add(each.value)
            elif isinstance(each, ast.Name) and each.id in tables:
                waiting.append(tables.pop(each.id))
    return texts


def scenario_ids(folder: Path = TOP / "evaluation" / "scenarios") -> set[str]:
    """The ids of the red team's scenarios."""
    files = [tomllib.loads(path.read_text("utf-8")) for path in sorted(folder.glob("*.toml"))]
    return {one["id"] for file in files for one in file["scenario"]}


def commands(text: str) -> list[list[str]]:
    """The words of every `ztpm ...` line of a page's shell blocks, and of every one in its text."""
    blocks = [body for language, body in BLOCK.findall(text) if language == "sh"]
    lines = [line.split("#")[0] for block in blocks for line in block.splitlines()]
    lines += re.findall(r"`(ztpm [^`|\[…]*)`", BLOCK.sub("", text))
    return [words for line in lines if (words := shlex.split(line))[:1] == ["ztpm"]]


@cache
def grammar() -> object:
    """The whole command line, put together once."""
    return typer.main.get_command(app)


def assert_command(words: list[str]) -> None:
    """The command line knows these words and takes these options."""
    own = words[1 : words.index("--") if "--" in words else None]
    options = {word.split("=")[0] for word in own if word.startswith("--")}
    at = grammar()
    for word in own:
        if word.startswith("--") or not hasattr(at, "commands"):
            break
        assert word in at.commands, words
        at = at.commands[word]
    assert options <= {option for parameter in at.params for option in parameter.opts}, words
