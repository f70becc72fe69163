"""`ztpm cell new|draft|check`: world files before a person signs them."""

from __future__ import annotations

import textwrap
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NoReturn

import typer

from ztpm.cli.output import FAILURE, USAGE, beside, console, fail, fail_at, plain, say_json
from ztpm.cli.provider.person import Json
from ztpm.codes.code_table import step_of

if TYPE_CHECKING:
    from collections.abc import Iterable

    from pep.pit.base.errors import PitError
    from pep.pit.files.faults import Fault
    from pep.pit.files.scene_file import Situation
    from pep.pit.robot.robot import Robot

Out = Annotated[Path | None, typer.Option("--out", help="File to make (default: standard output).", show_default=False)]
Model = Annotated[str, typer.Option("--robot", help="A shipped model: ur3e, ur5e, ur10e or ur16e.")]
Tool = Annotated[str, typer.Option("--tool", help="Its tool: robotiq_2f85 or robotiq_hande.")]


def new(*, robot: Model = "ur3e", tool: Tool = "robotiq_2f85", out: Out = None) -> None:
    """Begin a draft of a cell file, with every word explained.

    The other commands of `ztpm cell` check it, show it, and sign it.
    """
    from ztpm.cell.world_text import begun

    _write(begun(_shipped(robot, tool)), out)


def draft(
    seen: Annotated[Path, typer.Argument(help="A scene, or a simulated sensor's scene.", exists=True, dir_okay=False)],
    *,
    cell: Annotated[
        Path | None, typer.Option("--cell", help="The draft that they are added to.", exists=True, dir_okay=False)
    ] = None,
    robot: Model = "ur3e",
    tool: Tool = "robotiq_2f85",
    out: Out = None,
) -> None:
    """Draft a cell file of what is seen: each loose object becomes one that stands there.

    People are left out. What the seen scene, or --cell, does not state of the cell is as `ztpm cell new` begins it.
    """
    from pep.pit.files.cell_draft import drafted
    from ztpm.cell.world_text import begun_value, toml_of

    stated = world_in(seen if cell is None else cell)
    shown = situation_at(seen, world_in(seen)).scene
    if shown is None:
        fail("USAGE", f"{seen}: nothing is seen there; a scene has a `view`")
    base = begun_value(_shipped(robot, tool))["cell"] | {"objects": []} | _cell_in(stated)
    made = toml_of(drafted(base, shown))
    _write(f"# Drafted of what {seen.name} shows. Measure each object before it is signed.\n{made}", out)
    if shown.people:
        beside().print(f"People are left out ({len(shown.people)}): nobody is a fixed part of a cell.", markup=False)


def check(
    source: Annotated[Path, typer.Argument(help="A world file: a draft, or a scene.", exists=True, dir_okay=False)],
    *,
    strict: Annotated[bool, typer.Option("--strict", help="Warnings are failures.")] = False,
    as_json: Json = False,
) -> None:
    """Check a world file: every fault with its thing and the words that exist, and what looks odd.

    A file with a cell alone is checked as `ztpm cell sign` takes it. Exit 2 for faults, 1 for warnings with --strict.
    """
    from pep.pit.files.world_file import checked

    found = checked(world_in(source))
    warnings = [
        {"code": str(each.code), "name": each.name, "detail": each.what, "next": step_of(str(each.code))}
        for each in found.remarks
    ]
    if found.faults:
        told = _plain_faults(found.faults)
        lines = "\n".join(f"  {each['place']}: {each['detail']}" for each in told)
        count = "1 fault" if len(told) == 1 else f"{len(told)} faults"
        more = {"use": str(found.use), "faults": told, "warnings": warnings}
        fail(told[0]["code"], plain_lines(f"{source}: {count}\n{lines}"), status=USAGE, more=more)
    failed = strict and bool(warnings)
    if as_json:
        say_json({"ok": not failed, "use": str(found.use), "faults": [], "warnings": warnings})
    else:
        console.print(plain(f"{source}: a {found.use}, without faults"), markup=False)
        for each in warnings:
            said = plain(f"{each['code']}: '{each['name'][:48]}' is odd: {each['detail']}. {each['next']}")
            console.print(textwrap.fill(said, console.width, subsequent_indent="  "), markup=False)
    if failed:
        raise typer.Exit(FAILURE)


def world_in(file: Path) -> object:
    """Plain value of a world file; without one the command ends."""
    from pep.pit.base.errors import PitError
    from pep.pit.files.plain_file import FILE_LIMIT_BYTES, value_of

    try:
        with file.open("rb") as opened:
            raw = opened.read(FILE_LIMIT_BYTES + 1)
        if len(raw) <= FILE_LIMIT_BYTES:
            raw.decode("utf-8")  # a file that is no text ends as it does at every command
        return value_of(raw, file)
    except (OSError, UnicodeDecodeError) as error:
        fail_at(file, error, "UNREADABLE")
    except PitError as error:
        refuse(error, file)


def situation_at(file: Path, value: object) -> Situation:
    """Situation in a world file's value; without it the command ends."""
    from pep.pit.base.errors import PitError
    from pep.pit.files.world_file import situation_in

    try:
        return situation_in(value)
    except PitError as error:
        refuse(error, file)


def refuse(error: PitError, file: Path) -> NoReturn:
    """Ends the command at a world file that is refused."""
    from pep.pit.files.plain_file import FileError

    if not isinstance(error, FileError):
        fail("USAGE", plain(f"{file}: {error.detail}"))
    told = _plain_faults(error.faults)
    others = f" ({len(told) - 1} more: `ztpm cell check {file}`)" if len(told) > 1 else ""
    place = "" if told[0]["place"] == file.name else f"{told[0]['place']}: "
    said = plain(f"{file}: {place}{told[0]['detail']}{others}")
    fail(told[0]["code"], said, status=USAGE, more={"faults": told})


def plain_lines(text: str) -> str:
    """Several lines of foreign text, each made safe for a terminal."""
    return "\n".join(map(plain, text.split("\n")))


def _plain_faults(found: Iterable[Fault]) -> list[dict[str, str]]:
    """Faults with the codes of cell files: a contradiction has its own, any other is of a malformed file."""
    from pep.pit import SurveyFault
    from pep.pit.files.cell_draft import MALFORMED

    codes = [(each.reason if each.reason in set(SurveyFault) else MALFORMED, each) for each in found]
    return [{"code": code, "place": each.place, "detail": each.what, "next": step_of(code)} for code, each in codes]


def _shipped(name: str, tool: str) -> Robot:
    from pep.pit.base.errors import PitError
    from pep.pit.robot.robot import Robot

    try:
        return Robot.load(name, tool=tool)
    except PitError as error:
        fail("USAGE", plain(error.detail))


def _cell_in(value: object) -> dict[str, Any]:
    """The cell that a file states, as a plain value; empty for one without."""
    from pep.pit.files.world_file import renewed

    stated: Any = renewed(value)
    cell = stated.get("cell") if isinstance(stated, dict) else None
    return cell if isinstance(cell, dict) else {}


def _write(text: str, out: Path | None) -> None:
    """Writes a file that is new, or to standard output."""
    if out is None:
        typer.echo(text, nl=False)
        return
    try:
        with out.open("x", encoding="utf-8") as made:
            made.write(text)
    except FileExistsError:
        fail("EXISTS", f"{out} is there already")
    except OSError as error:
        fail_at(out, error, "UNWRITABLE")
    typer.echo(f"{out}: written. Next: ztpm cell check {out}")
