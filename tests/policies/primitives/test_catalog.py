"""A primitive has six homes with one name, and nothing is in one of them alone."""

import ast
import dataclasses
import re
import tomllib
from pathlib import Path

import pytest
from capabilities.values.errors import FaultCode
from docs import generate
from policies.primitives.catalog_row import Attack, Defence
from policies.words.reason_table import PRECEDENCE
from tests.policies.world import VECTORS

import policies
from policies import CATALOG, PARAMETERS, REASONS, ROWS, Reason

EXPECTED = [
    f"{domain}-{i}"
    for domain, n in (("AID", 5), ("CII", 6), ("TEA", 6), ("CATP", 4), ("ABG", 4))
    for i in range(1, n + 1)
]


def test_the_catalog_has_the_papers_25_ids_in_order():
    assert [row.id for row in CATALOG] == EXPECTED
    assert list(ROWS) == EXPECTED


@pytest.mark.parametrize("row", CATALOG, ids=lambda row: row.id)
def test_home_one_the_class(row):
    assert row.decides.id == row.id
    assert row.decides.__doc__.startswith(f"{row.id}: ")
    assert row.decides.__dataclass_params__.frozen
    assert {f.name for f in dataclasses.fields(row.decides)} <= set(PARAMETERS)


def test_no_class_is_outside_the_catalog():
    """Every class with a method `judge` in the package is a row's class."""
    judging = {
        node.name
        for path in Path(policies.__file__).parent.rglob("*.py")
        for node in ast.walk(ast.parse(path.read_text("utf-8")))
        if isinstance(node, ast.ClassDef)
        and any(isinstance(m, ast.FunctionDef) and m.name == "judge" for m in node.body)
    }
    assert judging == {row.decides.__name__ for row in CATALOG} | {"Primitive"}


def test_home_two_the_row():
    for row in CATALOG:
        assert row.name
        assert row.must_hold.endswith(".")
        assert row.points
        assert row.evidence
        assert row.clause == f"POL-{row.id}"


def test_home_three_the_case_file():
    assert {tomllib.loads(path.read_text("utf-8"))["primitive"] for path in VECTORS.glob("*/*.toml")} == {
        row.id for row in CATALOG
    }


def test_homes_four_and_five_the_clause_and_the_row_of_the_page():
    page = generate.PAGE.read_text("utf-8")
    for row in CATALOG:
        assert page.count(f"**[{row.clause}]**") == 1
        assert len(re.findall(rf"^\| {row.id} \|", page, re.MULTILINE)) == 1


def test_the_page_is_what_the_catalog_generates():
    assert generate.PAGE.read_text("utf-8") == generate.page(), "run: python -m docs.generate"


@pytest.mark.parametrize("row", CATALOG, ids=lambda row: row.id)
def test_home_six_the_reason_codes(row):
    assert row.reasons
    assert all(REASONS[reason].owners for reason in row.reasons)


def test_reasons_repeat_the_fault_codes_name_by_name():
    for code in FaultCode:
        assert Reason[code.name].value == code.value


def test_every_reason_has_a_fixed_text_and_a_remedy():
    assert set(REASONS) == set(Reason)
    for row in REASONS.values():
        assert row.text.endswith(".")
        assert row.remedy.endswith(".")
        assert "{" not in row.text + row.remedy
        assert set(row.owners) <= set(ROWS)


def test_the_precedence_is_total_over_what_a_decision_can_find():
    assert len(set(PRECEDENCE)) == len(PRECEDENCE)
    enforcement = set(list(Reason)[list(Reason).index(Reason.APPROVAL_TIMEOUT) :]) - {Reason.BUSY}
    assert set(PRECEDENCE) == set(Reason) - enforcement - {Reason.PERMITTED}


def test_the_papers_coverage_table():
    """Attack, dimension -> primitives; with what the text claims beyond the table kept out, as the table is the claim."""
    table = {
        ("AC-1", "detection"): {"CII-4"},
        ("AC-1", "prevention"): {"CII-4", "TEA-4"},
        ("AC-1", "containment"): {"TEA-6", "ABG-2"},
        ("AC-2", "detection"): {"CII-2", "CII-6"},
        ("AC-2", "prevention"): {"CII-1", "CATP-4"},
        ("AC-2", "containment"): {"CATP-1", "CATP-2"},
        ("AC-3", "detection"): {"CII-2", "CII-3"},
        ("AC-3", "prevention"): {"CII-3", "CII-5"},
        ("AC-3", "containment"): {"ABG-1", "ABG-4"},
        ("AC-4", "detection"): {"AID-4", "TEA-1"},
        ("AC-4", "prevention"): {"AID-4", "CATP-2"},
        ("AC-4", "containment"): {"CATP-3", "ABG-4"},
        ("AC-5", "detection"): {"TEA-6"},
        ("AC-5", "prevention"): {"TEA-6", "TEA-4"},
        ("AC-5", "containment"): {"ABG-1", "ABG-2"},
    }
    for attack in Attack:
        for defence in Defence:
            assert {row.id for row in CATALOG if (attack, defence) in row.counters} == table[attack, defence]


def test_parameters_have_sane_rows():
    for row in PARAMETERS.values():
        assert row.low <= row.default <= row.high, row.name
        assert row.name.endswith(f"_{row.unit}"), row.name
        assert row.meaning
        assert row.source
