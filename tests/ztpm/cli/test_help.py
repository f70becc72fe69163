"""Help of each command, its example, and `ztpm explain`: every code that is answered has cause and next step."""

from __future__ import annotations

import ast
import importlib
import re
import os
import shlex
import subprocess
import sys
import tomllib
from enum import StrEnum
from functools import cache
from pathlib import Path

import pytest
import typer.main
from docs.command_page import leaves
from ztpm.cli.examples import EXAMPLES
from ztpm.cli.command_rows import PANELS, ROWS
from ztpm.codes.code_table import code_table

from ztpm.cli import app

TOP = Path(__file__).parents[3]
PACKAGES = ("capabilities", "policies", "pep", "ursim", "ztpm_idp", "ztpm", "evaluation")
LEAVES = {leaf.words: leaf.command for leaf in leaves(app)}
ENDING = {"fail": 0, "fail_at": 2, "UpError": 0, "LeaseError": 0, "ReplayError": 0, "DraftError": 0, "ClientError": 0,
          "StoreNotOpenedError": 0, "unavailable": None, "PitError": 0}  # fmt: skip
"""Place of the code among the arguments of each call that ends a command.

None where only a keyword has it.
"""
KEYWORD = "code"
ANSWERING = {"JSONResponse", "PlainTextResponse", "Response", "_refused"}
"""Calls by which a server of ours answers a request; a code in one is written out in capitals."""


@cache
def sources():
    """Tree of each source by its path; read by the worker that has these tests alone."""
    paths = (path for package in PACKAGES for path in sorted((TOP / package).rglob("*.py")))
    return {path: ast.parse(path.read_text()) for path in paths}


def codes_of_enums():
    """Members of every enumeration of reasons, found by its name."""
    found = {}
    for path, tree in sources().items():
        for node in tree.body:
            if isinstance(node, ast.ClassDef) and node.name.endswith(("Fault", "Code", "Reason")):
                module = importlib.import_module(".".join(path.relative_to(TOP).with_suffix("").parts))
                kind = getattr(module, node.name)
                if isinstance(kind, type) and issubclass(kind, StrEnum):
                    found[node.name, path.parent.name] = {str(member) for member in kind}
    return found


def codes_of_calls():
    """Codes that are written out where a command or process ends."""
    found = set()
    for tree in sources().values():
        for node in ast.walk(tree):
            name = getattr(getattr(node, "func", None), "id", None)
            if name not in ENDING:
                continue
            given = [word.value for word in node.keywords if word.arg == KEYWORD]
            if ENDING[name] is not None and len(node.args) > ENDING[name]:
                given.append(node.args[ENDING[name]])
            constants = (each for argument in given for each in ast.walk(argument) if isinstance(each, ast.Constant))
            found |= {each.value for each in constants if isinstance(each.value, str) and each.value.isupper()}
    return found


def codes_of_answers():
    """Codes that are written out where a server answers."""
    calls = (node for tree in sources().values() for node in ast.walk(tree) if isinstance(node, ast.Call))
    answers = (call for call in calls if getattr(call.func, "id", None) in ANSWERING)
    words = (each for call in answers for each in ast.walk(call) if isinstance(each, ast.Constant))
    said = (word.value.strip() for word in words if isinstance(word.value, str))
    return {code for code in said if re.fullmatch("[A-Z]+(_[A-Z]+)+", code)}


def test_every_code_is_explained():
    enums, calls, answers = codes_of_enums(), codes_of_calls(), codes_of_answers()
    assert len(enums) > 15 and len(calls) > 40
    assert answers >= {"WRONG_ORIGIN", "WRONG_HOST", "NOT_YOURS", "NOT_FOUND", "BODY_MALFORMED"}
    missing = set().union(*enums.values(), calls, answers) - code_table().keys()
    assert missing == set()
    for code, row in code_table().items():
        assert row.cause.endswith(".") and row.step.endswith("."), code
        assert len(row.cause) > 8 and len(row.step) > 4 and row.status in (1, 2, 3), code


def test_every_explained_code_is_answered_and_stands_once():
    tables = tomllib.loads((TOP / "ztpm/codes/codes.toml").read_text())
    rows = [code for table in tables.values() for code in table]
    written = "\n".join(path.read_text() for path in sources())
    assert len(rows) == len(set(rows))
    assert [code for code in rows if f'"{code}"' not in written and f'"{code}: ' not in written] == []


@pytest.mark.parametrize("words", LEAVES)
def test_every_command_has_help_and_an_example_that_it_takes(run, monkeypatch, words):
    _, *names = words.split()
    monkeypatch.setenv("COLUMNS", "80")
    told = run(*names, "-h")
    assert told.status == 0 and "Example: " in told.out and "Usage: " in told.out
    assert max(map(len, told.out.splitlines())) <= 80
    for parameter in LEAVES[words].params:
        assert parameter.help, f"{words}: {parameter.name}"
    example = LEAVES[words].epilog.removeprefix(f"Example: {words}")
    assert example != LEAVES[words].epilog
    LEAVES[words].make_context(words, shlex.split(example.partition(" -- ")[0]), resilient_parsing=True)


def test_no_example_is_left_over():
    assert {f"ztpm {words}" for words in EXAMPLES} <= LEAVES.keys()


def test_every_command_stands_in_a_group(run):
    root = typer.main.get_command(app)
    assert {command.rich_help_panel for command in root.commands.values()} == set(PANELS)
    told = run("-h").out
    assert told == run("--help").out
    assert [told.index(panel) for panel in PANELS] == sorted(told.index(panel) for panel in PANELS)


def test_the_help_lists_each_command_as_it_describes_itself():
    for row in ROWS:
        command = typer.main.get_command(app).commands[row.name]
        assert (command.help.split("\n\n")[0], command.rich_help_panel) == (row.help, row.panel)
        assert {name for name, _ in row.joined} <= set(getattr(command, "commands", ()))


STARTS = """
import sys
from ztpm.cli import main
for words in (["--help"], ["explain", "NOT_NARROWER"], ["agent", "list", "--help"]):
    sys.argv = ["ztpm", *words]
    try:
        main()
    except SystemExit as end:
        assert end.code == 0, words
print(*{name.partition(".")[0] for name in sys.modules})
"""


def test_a_command_loads_nothing_that_it_does_not_need():
    """Each of these costs a tenth of a second of a processor, or more."""
    told = subprocess.run([sys.executable, "-c", STARTS], capture_output=True, text=True, timeout=60, check=True)
    loaded = set(told.stdout.splitlines()[-1].split())
    assert {"typer", "rich", "ztpm"} <= loaded
    assert loaded & {
        "biscuit_auth", "cryptography", "fastapi", "httpx2", "jwt", "markdown_it", "mcp", "numpy", "pinocchio",
        "pydantic", "pygments", "sqlalchemy", "starlette",
    } == set()  # fmt: skip


def test_version(run):
    assert run("--version").out == run("version").out
    assert run("--version").out.startswith("ztpm ")


def test_a_shell_completes_commands():
    completing = {"_ZTPM_COMPLETE": "complete_bash", "COMP_WORDS": "ztpm ag", "COMP_CWORD": "1"}
    told = subprocess.run(
        [Path(sys.executable).with_name("ztpm")],
        env=os.environ | completing,
        capture_output=True,
        text=True,
        timeout=60,
    )
    assert told.stdout.split() == ["agent"]


def test_explain(run):
    told = run("explain", "not_narrower")
    row = code_table()["NOT_NARROWER"]
    assert told.status == 0 and row.cause in told.out and row.step in told.out and "AID-4" in told.out
    assert run("explain", "NOT_NARROWER", "--json").json == {
        "ok": True, "code": "NOT_NARROWER", "cause": row.cause, "next": row.step, "primitives": ["CATP-2", "AID-4"],
        "status": 3,
    }  # fmt: skip
    assert run("explain", "--json").json["codes"].keys() == code_table().keys()
    for code in ("DISK_FULL", "VOTED_BEFORE"):
        assert code_table()[code].step in run("explain", code).out


def test_explain_names_what_is_near(run):
    told = run("explain", "UNREACHEABLE")
    assert told.status == 2 and told.err.startswith("CODE_UNKNOWN: ") and "UNREACHABLE" in told.err
