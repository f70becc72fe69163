"""Commands that other packages bring to `ztpm`."""

import subprocess
import sys
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path

import pytest
from ztpm.cli.command_rows import PROVE, ROWS
from ztpm.cli.later_commands import GROUP, LaterCommands


def point(name: str, value: str = "evaluation.cli:app") -> EntryPoint:
    return EntryPoint(name, value, GROUP)


def commands(*points: EntryPoint) -> LaterCommands:
    """The commands of `ztpm`, and those that the entry points bring."""
    return LaterCommands(ROWS, lambda: points)


def test_a_command_is_there_under_its_name() -> None:
    found = commands(point("measure"))
    assert list(found)[-1] == "measure" and len(found) == len(ROWS) + 1
    assert (found["measure"].name, found["measure"].rich_help_panel) == ("measure", PROVE)
    assert "conduct" in found["measure"].commands
    assert found.shown()["measure"] is found["measure"]


@pytest.mark.parametrize("name", ["demo", "token"])
def test_no_command_of_our_own_is_replaced(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    found = commands(point(name))
    assert list(found) == [row.name for row in ROWS]
    assert f"COMMAND_LEFT_OUT: {name} " in capsys.readouterr().err
    assert found[name] is commands()[name]


@pytest.mark.parametrize("value", ["no.such.module:app", "evaluation.cli:nothing", "json:loads"])
def test_what_does_not_load_leaves_the_others_alone(value: str, capsys: pytest.CaptureFixture[str]) -> None:
    found = commands(point("broken", value), point("measure"))
    assert "broken" not in found and "measure" in found
    assert capsys.readouterr().err.startswith(f"COMMAND_LEFT_OUT: broken ({value}): ")


def test_two_of_one_name_are_one(capsys: pytest.CaptureFixture[str]) -> None:
    assert list(commands(point("measure"), point("measure"))).count("measure") == 1
    assert "COMMAND_LEFT_OUT: measure " in capsys.readouterr().err


def test_a_command_of_our_own_looks_for_no_others() -> None:
    def points() -> list[EntryPoint]:
        raise AssertionError

    assert LaterCommands(ROWS, points)["version"].name == "version"


@pytest.mark.long
def test_this_installation_brings_eval() -> None:
    assert [entry.value for entry in entry_points(group=GROUP, name="eval")] == ["evaluation.cli:app"]
    ztpm = Path(sys.executable).with_name("ztpm")
    done = subprocess.run([ztpm, "eval", "--help"], capture_output=True, text=True, timeout=60, check=True)
    assert "stops" in done.stdout
