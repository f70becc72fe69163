"""`ztpm cell sign|show`: the signed cell file, made and looked at."""

from __future__ import annotations

import time
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

import typer

from ztpm.cli.cell_draft import refuse, situation_at, world_in
from ztpm.cli.output import beside, fail, fail_at, instant, plain, say_json
from ztpm.cli.provider.person import Json, open_key

if TYPE_CHECKING:
    from capabilities.statements.cell import Cell
    from pep.pit.files.scene_file import Situation

app = typer.Typer(no_args_is_help=True, help="Cell files: what stands in a cell, signed by a person.")

WORLD_FILES: Final = (".toml", ".json")
PICTURES: Final = (".html", ".png")


@app.command("sign")
def sign(
    draft: Annotated[Path, typer.Argument(help="The draft, TOML or JSON; its words stand in docs/world.md.")],
    key: Annotated[Path, typer.Option("--key", help="The operator's private key. Its passphrase: ZTPM_PASSPHRASE.")],
    out: Annotated[Path, typer.Option("--out", help="The cell file to make; one that exists is left as it is.")],
    days: Annotated[int, typer.Option(help="How long it is in force.", min=1, max=366)] = 365,
    *,
    as_json: Json = False,
) -> None:
    """Sign the survey of a cell.

    The robot's gateway takes it when `cell_signer_key` names the signing key. `robot` is not signed: the gateway's
    configuration has its own.
    """
    from capabilities.keys import keys
    from capabilities.statements import cell
    from ztpm.base.layout import LayoutError, write_private

    stated = _drafted(draft, world_in(draft), days=days)
    signer = open_key(key)
    try:
        write_private(out, cell.sign(stated, signer).encode() + b"\n")
    except LayoutError as error:
        fail("EXISTS", str(error))
    except OSError as error:
        fail_at(out, error, "UNWRITABLE")
    made = {"file": str(out), "signer_key": keys.b64u(keys.public_raw(signer)), "not_after": stated.not_after}
    if as_json:
        say_json({"ok": True, **made})
    else:
        typer.echo(f'{out}: signed. In the gateway\'s configuration: cell_signer_key = "{made["signer_key"]}"')


@app.command("show")
def show(
    source: Annotated[Path, typer.Argument(help="A signed cell file, or a world file (.toml, .json).")],
    signer: Annotated[
        str, typer.Option("--signer", help="Of a signed one: the signer's public key, base64url, as `cell_signer_key`.")
    ] = "",
    picture: Annotated[Path | None, typer.Option("--picture", help="A .html (turn it) or .png (three views).")] = None,
    robot: Annotated[str, typer.Option("--robot", help="Arm in the picture (default: the file's, else ur3e).")] = "",
    *,
    as_json: Json = False,
) -> None:
    """Show a cell as the text that `ztpm cell sign` takes, and draw it.

    The signature of a cell file is checked first. Exit 3 for one that a gateway refuses.
    """
    from capabilities.statements import cell
    from pep.pit.files.cell_draft import value_of_cell
    from pep.pit.files.world_file import Use, renewed, use_of
    from ztpm.cell.world_text import toml_of

    if picture is not None and picture.suffix not in PICTURES:
        fail("USAGE", "--picture ends in .html or .png")
    signed: Cell | None = None
    if source.suffix in WORLD_FILES:
        value = world_in(source)
        situation, shown = situation_at(source, value), renewed(value)
        if use_of(value) is Use.DRAFT:
            shown = value_of_cell(_drafted(source, value, days=1), robot=situation.robot)
    else:
        signed = _opened(source, signer)
        shown, situation = value_of_cell(signed), _situation(signed)
    made: Any = shown
    if picture is not None:
        _draw(situation, robot, made, picture)
    if as_json:
        claims = {} if signed is None else {"cell": cell.to_claims(signed)}
        say_json({"ok": True, **claims, "file": made, "picture": None if picture is None else str(picture)})
        return
    typer.echo(toml_of(made), nl=False)
    if signed is not None:
        times = f"in force from {instant(signed.not_before)} until {instant(signed.not_after)}"
        beside().print(f"signed for {plain(signed.author)}, {times}", markup=False)


def _drafted(file: Path, value: object, *, days: int) -> Cell:
    """Cell that a draft spells; without one the command ends."""
    from pep.pit.files.cell_draft import statement_of
    from pep.pit.files.plain_file import FileError

    try:
        return statement_of(value, at=int(time.time()), days=days)
    except FileError as error:
        refuse(error, file)


def _opened(source: Path, signer: str) -> Cell:
    """Signed cell whose signature was checked, and which is in force; without it the command ends."""
    from capabilities.keys import keys
    from capabilities.statements import cell
    from capabilities.values.caps import DEFAULT
    from capabilities.values.errors import BadKeyError, StatementError
    from pep.pit import CellParameters, SurveyError, surveyed

    try:
        trusted = keys.check_raw(keys.unb64u(signer))
        text = source.read_text("utf-8-sig").strip()
    except BadKeyError as error:
        fail(str(error.code), "--signer is no public key")
    except (OSError, UnicodeDecodeError) as error:
        fail_at(source, error, "UNREADABLE")
    try:
        stated = cell.open(text, frozenset({trusted}), DEFAULT)
        surveyed(stated, CellParameters())
    except (StatementError, SurveyError) as error:
        fail(str(error.code), error.detail)
    if not stated.not_before <= time.time() < stated.not_after:
        fail("EXPIRED", f"in force from {stated.not_before} until {stated.not_after}")
    return stated


def _situation(signed: Cell) -> Situation:
    from pep.pit import CellParameters, surveyed
    from pep.pit.files.scene_file import Situation

    return Situation(surveyed(signed, CellParameters()), None, None, None, frozenset())


def _draw(situation: Situation, robot: str, value: dict[str, Any], file: Path) -> None:
    from pep.pit.base.errors import PitError
    from ztpm.picture.cell_picture import cell_picture, said_of
    from ztpm.picture.png import NoMatplotlibError
    from ztpm.pit import DEFAULT_ROBOT, Arm

    try:
        robot = robot or situation.robot or DEFAULT_ROBOT
        shown = cell_picture(Arm(robot).robot(situation.cell.tool).holding(situation.held), situation, value)
        if file.suffix == ".html":
            from ztpm.picture.page import page

            file.write_bytes(page(shown, subtitle=said_of(value), advice="").encode())
        else:
            from ztpm.picture.png import draw

            draw(shown, file, subtitle=said_of(value))
    except PitError as error:
        fail("USAGE", plain(f"nothing to draw: {error.detail}"))
    except NoMatplotlibError as error:
        fail("NOT_INSTALLED", str(error))
    except OSError as error:
        fail_at(file, error, "UNWRITABLE")
