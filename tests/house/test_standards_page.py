"""Lists of docs/standards: each id has a row, and each row evidence that exists, or a reason for none."""

from functools import cache
from pathlib import Path

import pytest
from docs import standards_page
from docs.standards_page import Fault
from tests.house import pages

COUNTED = {"agentic_top_10": 10, "aisvs_c9": 34, "sp_800_207": 7, "iec_62443_3_3": 52}
"""Number of ids of each list that is here as a whole; of ATLAS only some are."""


@cache
def lists() -> dict[str, standards_page.Standard]:
    """Every list, by its name."""
    return dict(zip(standards_page.ORDER, standards_page.standards(), strict=True))


def evidence() -> set[str]:
    """All that rows name."""
    return {named for each in lists().values() for row in each.row for named in row.shown}


# --- the lists


def test_every_list_is_on_the_page_and_whole() -> None:
    assert {path.stem for path in standards_page.FOLDER.glob("*.toml")} == set(standards_page.ORDER)
    assert {name: len(lists()[name].ids) for name in COUNTED} == COUNTED
    assert {row.verdict for each in lists().values() for row in each.row} == set(standards_page.VERDICTS)


def test_every_test_that_a_row_names_exists() -> None:
    tests = [named for named in evidence() if named.startswith("tests/")]
    assert len(tests) > 150
    assert {named: part for named in tests if (part := pages.missing(named))} == {}


def test_every_scenario_that_a_row_names_exists() -> None:
    named = {each for each in evidence() if standards_page.SCENARIO.fullmatch(each)}
    assert named <= pages.scenario_ids()


def test_readers_find_the_page() -> None:
    for name in ("README.md", "docs/evaluation.md"):
        assert "standards.md)" in (pages.TOP / name).read_text("utf-8"), name


# --- the rules of a list


GOOD = """
title = "A list: of two"
edition = "1"
read = "here"
note = "Note."
form = 'A\\d'
column = "id"
ids = ["A1", "A2", "A3"]

[[left_out]]
ids = ["A3"]
why = "Not ours."

[[row]]
id = "A1"
name = "one"
does = "Something."
shown = ["tests/house/test_standards_page.py::test_readers_find_the_page", "AC-4-017"]

[[row]]
id = "A2"
name = "two | three"
lacks = "Everything."
"""
BAD = {
    "no TOML": ("title =", "title", Fault.FORM),
    "a key too many": ('column = "id"', 'column = "id"\nlevel = 2', Fault.FORM),
    "a key too few": ('edition = "1"\n', "", Fault.FORM),
    "a row without a name": ('name = "one"\n', "", Fault.FORM),
    "an id of another form": ('"A3"]\n\n', '"A3", "B4"]\n\n', Fault.ID_OF_ANOTHER_FORM),
    "a row of an unknown id": ('id = "A2"', 'id = "A4"', Fault.ID_UNKNOWN),
    "a reason for an unknown id": ('ids = ["A3"]', 'ids = ["A3", "A4"]', Fault.ID_UNKNOWN),
    "an id twice": ('"A3"]\n\n', '"A3", "A1"]\n\n', Fault.ID_TWICE),
    "two rows of one id": ('id = "A2"', 'id = "A1"', Fault.ID_TWICE),
    "a row and a reason": ('ids = ["A3"]', 'ids = ["A3", "A2"]', Fault.ID_TWICE),
    "an id without a row": ('ids = ["A3"]', "ids = []", Fault.ID_WITHOUT_ROW),
    "rows in another order": ('ids = ["A1", "A2"', 'ids = ["A2", "A1"', Fault.ROW_OUT_OF_ORDER),
    "neither tests nor a reason": ('lacks = "Everything."', "", Fault.ROW_WITHOUT_EVIDENCE),
    "an empty reason": ('lacks = "Everything."', 'lacks = " "', Fault.ROW_WITHOUT_EVIDENCE),
    "tests and no deed": ('does = "Something."\n', "", Fault.ROW_WITHOUT_DEED),
    "a folder in the place of a test": ('"AC-4-017"', '"tests/house"', Fault.NOT_A_TEST),
    "a file in the place of a test": ('"AC-4-017"', '"tests/house/test_pages.py"', Fault.NOT_A_TEST),
    "a scenario of another class": ('"AC-4-017"', '"AC-6-017"', Fault.NOT_A_TEST),
}


@pytest.mark.parametrize("name", BAD)
def test_a_bad_list_is_refused(name: str) -> None:
    old, new, fault = BAD[name]
    assert GOOD.count(old) == 1
    with pytest.raises(standards_page.StandardsError) as refused:
        standards_page.read("here", GOOD.replace(old, new))
    assert refused.value.fault is fault
    assert refused.value.place.startswith("here")


def test_every_fault_has_a_bad_list() -> None:
    assert {fault for _, _, fault in BAD.values()} == set(Fault)


def test_the_page_has_a_line_for_each_row() -> None:
    good = standards_page.read("here", GOOD)
    text = standards_page.page([good])
    assert pages.rows(text, "id", "name", "how far") == [
        ["[A1](#a1-one)", "one", "shown"],
        ["[A2](#a2-two--three)", "two | three", "not covered"],
    ]
    first, second = text.split("### ")[1:]
    assert first == "\n".join(["A1: one\n\nSomething.\n", "```text", *good.row[0].shown, "```\n\n"])
    assert second == "A2: two | three\n\n*Not covered*: Everything.\n"
    assert "Left out: A3 (Not ours)." in text
    assert "[A list: of two](#a-list-of-two) | 1 | here | 2 | 1 | 0 | 1 |" in text


# --- what a row names


SAMPLE = """
import pytest

NAMES = {"spelled": 1}
OTHER = {"elsewhere": 2}
CASES = sorted(NAMES)

def test_plain(): ...

async def test_late(): ...

@pytest.mark.parametrize("case", CASES)
def test_cases(case): ...

@pytest.mark.parametrize("case", [pytest.param(1, id="by id")])
def test_ids(case): ...

class TestMore:
    def test_inner(self): ...

def helper(): ...
"""


@pytest.mark.parametrize(
    ("named", "part"),
    [
        ("tests/test_sample.py::test_plain", ""),
        ("tests/test_sample.py::test_late", ""),
        ("tests/test_sample.py::TestMore::test_inner", ""),
        ("tests/test_sample.py::test_cases[spelled]", ""),
        ("tests/test_sample.py::test_ids[by id]", ""),
        ("tests/test_sample.py", ""),
        ("tests/test_absent.py::test_plain", "file"),
        ("tests/sample.py::test_plain", "file"),
        ("tests/test_sample.py::test_absent", "function"),
        ("tests/test_sample.py::test_inner", "function"),
        ("tests/test_sample.py::helper", "function"),
        ("tests/test_sample.py::test_cases[elsewhere]", "case"),
        ("tests/test_sample.py::test_plain[spelled]", "case"),
        ("tests/test_sample.py::test_ids[by]", "case"),
    ],
)
def test_a_name_that_names_nothing_is_seen(tmp_path: Path, named: str, part: str) -> None:
    (tmp_path / "tests").mkdir()
    for name in ("test_sample.py", "sample.py"):
        (tmp_path / "tests" / name).write_text(SAMPLE)
    assert pages.missing(named, tmp_path) == part


def test_scenarios_are_found_by_their_ids(tmp_path: Path) -> None:
    (tmp_path / "ac4.toml").write_text('[[scenario]]\nid = "AC-4-017"\n[[scenario]]\nid = "AC-4-B002"\n')
    (tmp_path / "ac5.toml").write_text('[[scenario]]\nid = "AC-5-001"\n[[scenario.act]]\nid = "AC-9-999"\n')
    assert pages.scenario_ids(tmp_path) == {"AC-4-017", "AC-4-B002", "AC-5-001"}
    assert pages.scenario_ids(tmp_path / "none") == set()
