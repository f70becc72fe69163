"""The project's pages: their prose, their tables, the commands and tests that they name."""

import ast
import re
import shlex
import subprocess
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
