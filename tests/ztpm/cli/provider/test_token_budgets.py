"""Budgets on the command line: read strictly, put beside those of the grant, refused with their place."""

import pytest
import typer
from capabilities.values.scope import Budget, Grant, Limit, Range
from capabilities.values.units import Parameter, Unit
from ztpm.cli.provider.token import with_budgets

HERE, THERE = "http://127.0.0.1:1/mcp", "http://127.0.0.1:2/mcp"
ONE = frozenset({HERE})
POUR = Grant("tank/north", "pour", (Limit(Parameter("in", Unit.MILLILITRE), Range(0, 9)),))


def test_a_budget_of_acts_and_one_of_a_quantity():
    stated = ("tank/north/pour: 20 in 3600", "tank/north/pour: 500 in in 3600", f"tank/north/pour: 3 in 9 at {THERE}")
    (made,) = with_budgets((POUR,), stated, audiences=ONE)
    assert set(made.budgets) == {Budget("", HERE, 3_600, 20), Budget("in", HERE, 3_600, 500), Budget("", THERE, 9, 3)}
    assert with_budgets((POUR,), (), audiences=None) == (POUR,)
    assert with_budgets(None, (), audiences=None) is None


@pytest.mark.parametrize(
    ("stated", "audiences"),
    [
        ("tank/north/pour: 20 in 3600", None),
        ("tank/north/pour: 20 in 3600", frozenset({HERE, THERE})),
        ("tank/south/pour: 20 in 3600", ONE),
        ("tank/north/pour: 0 in 3600", ONE),
        ("tank/north/pour: -1 in 3600", ONE),
        ("tank/north/pour: 1.5 in 3600", ONE),
        ("tank/north/pour: 20 in 3600 s", ONE),
        ("tank/north/pour:20 in 3600", ONE),
        ("tank/north/pour: 20 in 604801", ONE),
        ("tank/north/pour: 9999999999999999 in 1", ONE),
        ("tank/north/pour: 20 in 3600 at nowhere", ONE),
        ("tank/north/pour: ２０ in 3600", ONE),
        ("tank/north/pour: 2０ in 3600", ONE),
        ("", ONE),
    ],
)
def test_another_text_is_refused(stated, audiences, capsys):
    with pytest.raises(typer.Exit) as caught:
        with_budgets((POUR,), (stated,), audiences=audiences)
    assert caught.value.exit_code == 2
    assert "UNREADABLE" in capsys.readouterr().err


def test_one_that_another_implies_is_told(capsys):
    pace, loose = "tank/north/pour: 3 in 9", "tank/north/pour: 30 in 9"
    for texts in ((pace, loose), (loose, pace), (pace, pace)):
        with pytest.raises(typer.Exit):
            with_budgets((POUR,), texts, audiences=ONE)
    assert "implies" in capsys.readouterr().err
