"""Commands of `ztpm eval` before they measure anything."""

import pytest
from evaluation.cli import app
from typer.testing import CliRunner


@pytest.mark.parametrize("command", ["law", "dojo", "paper", "stops"])
def test_a_place_that_cannot_be_written_is_told_before_anything_is_measured(command):
    told = CliRunner().invoke(app, [command, "--out", "/proc/nobody/there"])
    assert told.exit_code == 2
    assert "UNWRITABLE" in told.stderr
