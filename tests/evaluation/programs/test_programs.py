"""The thirty programs: plain ur_rtde with a scope and a cell each, and a verdict on each."""

import ast
import json
import re
import subprocess
import sys
import time
from pathlib import Path

import pytest
from capabilities.values.algebra import narrows
from capabilities.values.scope import Scope, Tier
from evaluation.programs import catalog as programs
from evaluation.programs.bench import table_top_m
from evaluation.programs.catalog import HERE, CatalogError, ProgramRow, RefusedCall, by_cell, catalog, cell_text, chosen
from evaluation.programs.result import ProgramResult, ProgramsResult, last_line, tables
from evaluation.programs.verdict import Ended, ProgramOutcome, judged
from msgspec.structs import replace
from pep.base.operations import OPERATIONS
from pep.rtde.command.limits import widest
from ztpm.cell.survey import draft

PAGE = Path(__file__).parents[3] / "docs" / "programs.md"
ROWS = catalog()
EACH = pytest.mark.parametrize("row", ROWS, ids=[row.name for row in ROWS])
WHOSE = 'author = "carol"\naudience = "http://127.0.0.1:8800/mcp"\nsensors = ["camera-1"]\n'


def test_there_are_thirty_and_no_program_is_left_out():
    assert len(ROWS) == 30
    assert {row.path for row in ROWS} == set(HERE.glob("*/*.py"))
    assert sum(row.refused is None for row in ROWS) >= 24


@EACH
def test_a_program_is_plain_ur_rtde_with_an_address_as_its_one_argument(row):
    text = row.path.read_text(encoding="utf-8")
    tree = ast.parse(text)
    imported = {
        name.split(".")[0]
        for node in ast.walk(tree)
        if isinstance(node, ast.Import | ast.ImportFrom)
        for name in ([node.module] if isinstance(node, ast.ImportFrom) else [each.name for each in node.names])
    }
    theirs = {"rtde_control", "rtde_receive", "rtde_io", "dashboard_client"}
    assert imported & theirs
    assert imported - theirs <= set(sys.stdlib_module_names)
    assert re.findall(r"sys\.argv\[\d\]", text) == ["sys.argv[1]"]
    assert "HOST" in text
    assert not re.search(r"\b\d+\.\d+\.\d+\.\d+\b", text.replace("127.0.0.1", "") if row.refused else text)
    assert "sys.exit(" in text, "it says whether it did what it should"


@EACH
def test_a_scope_grants_no_more_than_the_robot_has(row):
    stated = programs.scope_of(row)
    rows = {(each.object, each.name): each for each in OPERATIONS}
    rest = {"audiences": frozenset({"https://a.example"}), "delegates": frozenset(), "depth": 0}
    at = {"not_before": 0, "not_after": 60}
    robots = tuple(widest(rows[grant.object, grant.operation]) for grant in stated.grants if grant.operation != "touch")
    own = tuple(grant for grant in stated.grants if grant.operation != "touch")
    whole = Scope(grants=robots, ceiling=Tier.HIGH_CONSEQUENCE, **rest, **at)
    assert not narrows(Scope(grants=own, ceiling=stated.ceiling, **rest, **at), whole).widenings


@pytest.mark.parametrize("name", sorted(by_cell(ROWS)))
def test_a_cell_is_one_that_a_person_can_sign(name):
    assert draft(WHOSE + cell_text(name), at=int(time.time()), days=1).name == name


@pytest.mark.parametrize("name", sorted(by_cell(ROWS)))
def test_the_table_that_the_simulated_tool_meets_is_where_the_cell_file_has_it(name):
    stands = draft(WHOSE + cell_text(name), at=int(time.time()), days=1)
    assert table_top_m(stands) == pytest.approx(-0.01)
    with pytest.raises(CatalogError, match="no box"):
        table_top_m(replace(stands, objects=()))


@EACH
def test_what_is_refused_is_in_the_table_of_what_is_never_granted(row):
    if row.refused is None:
        return
    table = PAGE.read_text().split("What no token grants", 1)[1].split("\n## ", 1)[0]
    never = [line.split("|")[1] for line in table.splitlines() if line.startswith("| `")]
    assert any(row.refused.call in calls for calls in never)


RAN = ProgramRow("a/one.py", "does", "arm", "bench")
REFUSED = ProgramRow("a/two.py", "does", "arm", "bench", refused=RefusedCall("jogStart", "NOT_GRANTED"))
SAID = "ztpm: NOT_GRANTED: The token does not grant this operation. (jogStart: no operation stands for it)\nno jog\n"


@pytest.mark.parametrize(
    ("row", "status", "errors", "outcome"),
    [
        (RAN, 0, "", ProgramOutcome.RAN),
        (RAN, 1, "not home\n", ProgramOutcome.FAILED),
        (RAN, 0, SAID, ProgramOutcome.RAN),
        (RAN, None, "", ProgramOutcome.FAILED),
        (REFUSED, 1, SAID, ProgramOutcome.REFUSED_CLEARLY),
        (REFUSED, 0, SAID, ProgramOutcome.FAILED),
        (REFUSED, None, SAID, ProgramOutcome.FAILED),
        (REFUSED, 134, SAID, ProgramOutcome.FAILED),
        (REFUSED, 1, "no jog\n", ProgramOutcome.FAILED),
        (REFUSED, 1, "ztpm: VERDICT_EXPIRED: Late.\n" + SAID, ProgramOutcome.FAILED),
        (REFUSED, 1, SAID.replace("jogStart: ", ""), ProgramOutcome.FAILED),
        (REFUSED, 1, SAID.replace("NOT_GRANTED", "BUSY"), ProgramOutcome.FAILED),
    ],
)
def test_only_a_program_that_ran_or_was_refused_clearly_has_not_failed(row, status, errors, outcome):
    verdict = judged(row, Ended(status, errors))
    assert verdict.outcome is outcome
    assert (verdict.why == "") is (outcome is ProgramOutcome.RAN)


def test_a_failure_says_what_the_program_said_last():
    errors = "Traceback\nnot home\nRTDEReceiveInterface boost system Exception: End of file\n"
    assert judged(RAN, Ended(1, errors)).why == "status 1; not home"


def test_names_choose_and_unknown_ones_are_told():
    assert [row.name for row in chosen(["jog_tool", "pick_and_place"])] == ["pick_and_place", "jog_tool"]
    assert chosen(()) == ROWS
    with pytest.raises(CatalogError, match="no program nothing"):
        chosen(["nothing"])


@pytest.mark.parametrize("text", ["[[program]]\nfile = 7", "[[program]]\nfiles = 'a'", "program ="])
def test_a_catalog_of_another_form_is_refused(monkeypatch, tmp_path, text):
    monkeypatch.setattr(programs, "ROWS", tmp_path / "programs.toml")
    programs.ROWS.write_text(text)
    with pytest.raises(CatalogError):
        catalog()


def test_counts_are_integers_at_the_top_level():
    each = [
        ProgramResult("a", ProgramOutcome.RAN, "", 2, 1, 1.0),
        ProgramResult("b", ProgramOutcome.REFUSED_CLEARLY, "why", 0, 1, 1.0),
    ]
    result = ProgramsResult(tuple(each), seconds=2.0, machine={})
    told = result.to_json()
    assert {key: told[key] for key in ("ran", "refused_clearly", "failed", "asked")} == {
        "ran": 1,
        "refused_clearly": 1,
        "failed": 0,
        "asked": 2,
    }
    assert result.ok
    assert tables(result)[0].row_count == 2
    assert "1 ran, 1 refused_clearly, 0 failed" in last_line(result)
    json.dumps(told)


def measured(*names):
    """Words of `ztpm eval programs --json`."""
    command = [str(Path(sys.executable).with_name("ztpm")), "eval", "programs", "--json", *names]
    done = subprocess.run(command, capture_output=True, text=True, check=False)
    assert done.stdout, done.stderr
    said = json.loads(done.stdout)
    assert done.returncode == (1 if said["failed"] else 0)
    return said


@pytest.mark.campaign
@pytest.mark.e2e
@pytest.mark.timeout(180)
def test_programs_run_and_are_refused_in_a_cell_of_their_own():
    said = measured("stop_half_way", "gripper_by_socket", "jog_tool")
    assert (said["ran"], said["refused_clearly"], said["failed"]) == (2, 1, 0), said["programs"]


@pytest.mark.e2e
@pytest.mark.campaign
@pytest.mark.timeout(2_400)
def test_twenty_four_of_thirty_run_and_none_fails():
    said = measured()
    assert said["failed"] == 0, said["programs"]
    assert said["ran"] >= 24
