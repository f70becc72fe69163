"""`ztpm robot`: a model of an arm out of its URDF and the meshes of its links."""

from __future__ import annotations

import os
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from ztpm.cli.output import console, fail, fail_at, plain, say_json

if TYPE_CHECKING:
    from pep.pit.robot.robot_fit import RobotFit

app = typer.Typer(help="Robots: a model of an arm out of its URDF and meshes.", no_args_is_help=True)


@app.callback()
def robot() -> None:
    """Robots: a model of an arm out of its URDF and meshes."""


@app.command("fit")
def fit(
    urdf: Annotated[Path, typer.Argument(help="The arm's URDF, macros expanded.", exists=True, dir_okay=False)],
    *,
    outfit: Annotated[
        Path, typer.Option("--outfit", help="What the URDF leaves open (TOML).", exists=True, dir_okay=False)
    ],
    out: Annotated[Path, typer.Option("--out", help="The model file to write (TOML); there must be none.")],
    tool_file: Annotated[
        list[Path] | None,
        typer.Option("--tool-file", help="Tools of the arm (TOML); again for more.", exists=True, dir_okay=False),
    ] = None,
    meshes: Annotated[
        Path | None,
        typer.Option("--meshes", help="Folder of the meshes (default: the URDF's).", exists=True, file_okay=False),
    ] = None,
    name: Annotated[str, typer.Option("--name", help="Name of the model (default: the URDF's).")] = "",
    capsules: Annotated[int, typer.Option("--capsules", min=1, max=8, help="At most so many for one mesh.")] = 3,
    picture: Annotated[Path | None, typer.Option("--picture", help="A .png of the meshes in their capsules.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="One JSON object.")] = False,
) -> None:
    """Enclose an arm's meshes in capsules, prove it, tell the excess, and write a model file.

    `ztpm pit --robot` and a gateway's `robot` take the file.
    """
    from pep.pit.base.errors import PitError
    from pep.pit.robot.robot_fit import robot_fit, text_of
    from ztpm.pit import outfit_of
    from ztpm.pit import text_of as text_in

    if out.exists() or (picture is not None and picture.suffix != ".png"):
        fail("USAGE", f"{out} is there already" if out.exists() else "--picture ends in .png")
    try:
        found = robot_fit(
            text_in(urdf),
            outfit_of(outfit, tool_file or ()),
            urdf.parent if meshes is None else meshes,
            name=name,
            most=capsules,
        )
        text = text_of(found, header=_header(found, urdf, outfit))
    except PitError as error:
        fail("UNREADABLE", plain(error.detail))
    except OSError as error:
        fail_at("", error, "UNREADABLE")
    if picture is not None:
        _draw(found, picture)
    _write(out, text)
    if as_json:
        say_json(_plain(found, out))
    else:
        _tell(found, out)


def _header(found: RobotFit, urdf: Path, outfit: Path) -> list[str]:
    sha256 = found.model.derived_from[0].sha256
    return [
        f"The {found.model.name}, made by `ztpm robot fit`. A person looks through it before a robot moves by it.",
        "",
        "Sources",
        f"  URDF   {urdf.name}, SHA-256 {sha256}",
        f"  OUTFIT {outfit.name} and its files of tools",
        "  FIT    capsules around the URDF's shapes and meshes; every point of a mesh is proven to lie in one. No",
        "         point of their surface is farther from the mesh than:",
        *(
            f"           {mesh.link}: {1e3 * mesh.excess.most_m:.1f} mm ({mesh.file}, SHA-256 {mesh.sha256})"
            for mesh in found.meshes
        ),
        "  SMP    sampled: pairs of capsules that are left out, and why, stand below",
        "",
        "Units: metre, radian, second, kilogram, newton.",
    ]


def _draw(found: RobotFit, file: Path) -> None:
    from ztpm.picture.fit_png import draw_fit
    from ztpm.picture.png import NoMatplotlibError

    try:
        draw_fit(found, file)
    except NoMatplotlibError as error:
        fail("NOT_INSTALLED", str(error))
    except OSError as error:
        fail_at(file, error, "UNWRITABLE")


def _write(out: Path, text: str) -> None:
    """Writes the whole file or none."""
    begun = out.with_name(f".{out.name}.{os.getpid()}")
    try:
        begun.write_text(text, encoding="utf-8")
        os.link(begun, out)  # never over another file
    except OSError as error:
        fail_at(out, error, "UNWRITABLE")
    finally:
        begun.unlink(missing_ok=True)


def _plain(found: RobotFit, out: Path) -> dict[str, object]:
    return {
        "ok": True,
        "model": str(out),
        "name": found.model.name,
        "tools": [tool.name for tool in found.model.tools],
        "meshes": [
            {
                "link": mesh.link,
                "file": mesh.file,
                "sha256": mesh.sha256,
                "triangles": len(mesh.triangles),
                "capsules": len(mesh.lines),
                "excess_mm": {"least": 1e3 * mesh.excess.least_m, "most": 1e3 * mesh.excess.most_m},
            }
            for mesh in found.meshes
        ],
        "apart": [{"inner": each.inner, "outer": each.outer, "why": each.why} for each in found.apart],
    }


def _tell(found: RobotFit, out: Path) -> None:
    from rich.table import Table
    from rich.text import Text

    table = Table(box=None, pad_edge=False)
    for heading in ("link", "mesh"):
        table.add_column(heading)
    for heading in ("triangles", "capsules", "excess at most, mm"):
        table.add_column(heading, justify="right")
    for mesh in found.meshes:
        numbers = (str(len(mesh.triangles)), str(len(mesh.lines)), f"{1e3 * mesh.excess.most_m:.1f}")
        table.add_row(Text(plain(mesh.link)), Text(plain(mesh.file)), *numbers)
    console.print(table)
    console.print(Text(plain(f"{len(found.apart)} pairs of capsules are left out; {out} says which, and why")))
    console.print(Text(plain(f"{out}: the model {found.model.name}; look through it before a robot moves by it")))
