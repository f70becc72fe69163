"""Commands that other packages bring to `ztpm`."""

import subprocess
import sys
from importlib.metadata import EntryPoint, entry_points
from pathlib import Path

import pytest
import typer
from typer.testing import CliRunner
from ztpm.cli.brought import GROUP, add_brought


def point(name: str, value: str = "evaluation.cli:app") -> EntryPoint:
    return EntryPoint(name, value, GROUP)


@pytest.fixture
def own() -> typer.Typer:
    """A command line with a command and a group of commands of its own."""
    app = typer.Typer()
    app.command("demo")(lambda: typer.echo("own demo"))
    tokens = typer.Typer()
    tokens.command("show")(lambda: typer.echo("own token"))
    app.add_typer(tokens, name="token")
    return app


def run(app: typer.Typer, *arguments: str) -> str:
    done = CliRunner().invoke(app, arguments)
    assert done.exit_code == 0, done.output
    return done.output


def test_a_command_is_there_under_its_name(own: typer.Typer) -> None:
    add_brought(own, [point("measure")])
    assert "conduct" in run(own, "measure", "--help")


@pytest.mark.parametrize("name", ["demo", "token"])
def test_no_command_of_our_own_is_replaced(own: typer.Typer, name: str, capsys: pytest.CaptureFixture[str]) -> None:
    add_brought(own, [point(name)])
    assert f"COMMAND_LEFT_OUT: {name} " in capsys.readouterr().err
    assert run(own, "demo") == "own demo\n"
    assert run(own, "token", "show") == "own token\n"


@pytest.mark.parametrize("value", ["no.such.module:app", "evaluation.cli:nothing", "json:loads"])
def test_what_does_not_load_leaves_the_others_alone(
    own: typer.Typer, value: str, capsys: pytest.CaptureFixture[str]
) -> None:
    add_brought(own, [point("broken", value), point("measure")])
    assert capsys.readouterr().err.startswith(f"COMMAND_LEFT_OUT: broken ({value}): ")
    assert "conduct" in run(own, "measure", "--help")


def test_two_of_one_name_are_one(own: typer.Typer, capsys: pytest.CaptureFixture[str]) -> None:
    add_brought(own, [point("measure"), point("measure")])
    assert "COMMAND_LEFT_OUT: measure " in capsys.readouterr().err


@pytest.mark.long
def test_this_installation_brings_eval() -> None:
    assert [entry.value for entry in entry_points(group=GROUP, name="eval")] == ["evaluation.cli:app"]
    ztpm = Path(sys.executable).with_name("ztpm")
    done = subprocess.run([ztpm, "eval", "--help"], capture_output=True, text=True, timeout=60, check=True)
    assert "stops" in done.stdout
