"""`ztpm pit`: possible impact of a motion in a scene, and its independent check."""

from __future__ import annotations

import gc
import json
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Final, NoReturn

import typer
from rich.table import Table
from rich.text import Text

from ztpm.cli.output import DEFER, DENY, console, fail, fail_at, plain, say_json

if TYPE_CHECKING:
    from pep.pit.assessment.assessment import Assessment
    from pep.pit.base.errors import PitError
    from ztpm.pit import Arm, Asked

app = typer.Typer(help="Physical impact of one motion in one scene, out of files.", invoke_without_command=True)

PICTURES: Final = (".png", ".html")
COLOURS: Final = {0: "green", 1: "green", 2: "yellow", 3: "bold yellow", 4: "bold red"}

SceneFile = Annotated[
    Path | None, typer.Option("--scene", help="What stands and is seen (docs/schemas).", exists=True, dir_okay=False)
]
MotionFile = Annotated[
    Path | None,
    typer.Option("--motion", help="What would be sent: JSON, TOML, YAML or CSV (docs/schemas).", exists=True),
]
RobotName = Annotated[
    str, typer.Option("--robot", help="A shipped model's name, a model file, or a .urdf (else the scene's, or ur3e).")
]
OutfitFile = Annotated[
    Path | None, typer.Option("--outfit", help="With a .urdf: what it leaves open.", exists=True, dir_okay=False)
]
ToolFiles = Annotated[
    list[Path] | None,
    typer.Option("--tool-file", help="With a .urdf: tools; again for more.", exists=True, dir_okay=False),
]
CalibrationFile = Annotated[
    Path | None, typer.Option("--calibration", help="The arm's own kinematics, YAML.", exists=True, dir_okay=False)
]


@app.callback()
def pit(
    context: typer.Context,
    *,
    scene: SceneFile = None,
    motion: MotionFile = None,
    robot: RobotName = "",
    outfit: OutfitFile = None,
    tool_file: ToolFiles = None,
    calibration: CalibrationFile = None,
    picture: Annotated[Path | None, typer.Option("--picture", help="A .png (three views) or .html (turn it).")] = None,
    proof: Annotated[Path | None, typer.Option("--proof", help="Where to write the proof document.")] = None,
    as_json: Annotated[bool, typer.Option("--json", help="One JSON object.")] = False,
) -> None:
    """Tier and index of a motion in a scene, with their causes and remedies.

    Exit 0 for a tier that needs no person, 4 for one that does, 3 for one that is refused, for a violation and for a
    fault.
    """
    if context.invoked_subcommand is not None:
        return
    gc.disable()  # one question, and then the process ends: looking for garbage took an eighth of it
    if scene is None or motion is None:
        fail("USAGE", "--scene FILE and --motion FILE are needed")
    if picture is not None and picture.suffix not in PICTURES:
        fail("USAGE", "--picture ends in .png or .html")
    from ztpm.preparing import prepare_physics, waiting

    with waiting("loading the physics"):
        from pep.pit.base.errors import PitError
        from policies.evidence.evidence import ImpactFault
        from ztpm.pit import Arm, to_plain

        question = _asked(scene, motion, Arm(robot, outfit, calibration, tuple(tool_file or ())))
    prepare_physics()
    said = question.answer()
    if isinstance(said, ImpactFault):
        _fault(said.reason, said.detail)
    try:
        proven: bytes | PitError = question.proof(said)
    except PitError as error:
        proven = error
        if question.moves:  # an answer about the arm counts no more than its proof
            _fault("UNPROVEN", error.detail)
    if proof is not None:
        if isinstance(proven, PitError):
            fail(proven.reason, f"no proof to write: {proven.detail}")
        _write(proof, proven)
    if picture is not None:
        _draw(question, said, picture)
    if as_json:
        say_json(to_plain(question, said, proven))
    else:
        _tell(question, said, proven)
    raise typer.Exit(_status(said))


@app.command("verify")
def verify(
    proof: Annotated[Path, typer.Argument(help="A proof document.", exists=True, dir_okay=False)],
    *,
    scene: SceneFile = None,
    motion: MotionFile = None,
    robot: RobotName = "",
    outfit: OutfitFile = None,
    tool_file: ToolFiles = None,
    calibration: CalibrationFile = None,
    as_json: Annotated[bool, typer.Option("--json", help="One JSON object.")] = False,
) -> None:
    """Recompute every row of a proof, with the standard library alone. Exit 3 for one that does not hold.

    With --scene and --motion the proof must also be of the question that these files ask.
    """
    from pep.pit.base.errors import PitError
    from pep.pit.checker import Unverified
    from pep.pit.checker import verify as checked
    from ztpm.pit import Arm

    if (scene is None) != (motion is None):
        fail("USAGE", "--scene and --motion belong together")
    try:
        verdict = checked(proof.read_bytes())
    except OSError as error:
        fail_at(proof, error, "UNREADABLE")
    if isinstance(verdict, Unverified):
        fail(str(verdict.code), verdict.place)
    if scene is not None and motion is not None:
        question = _asked(scene, motion, Arm(robot, outfit, calibration, tuple(tool_file or ())))
        try:
            same = question.digest == verdict.question
        except PitError as error:
            _fault(error.reason, error.detail)
        if not same:
            fail("OTHER_QUESTION", "a proof of the answer to another question")
    about = {"tier": verdict.tier, "index": verdict.index, "rows": verdict.rows}
    digests = {"question": verdict.question, "model": verdict.model, "scene": verdict.scene}
    if as_json:
        say_json({"ok": True, **about, **digests})
    else:
        typer.echo(f"verified: tier {verdict.tier}, index {verdict.index:.3f}, {verdict.rows} rows recomputed")
        for name, digest in digests.items():
            typer.echo(f"{name:8} {digest}")


def _asked(scene: Path, motion: Path, arm: Arm) -> Asked:
    from pep.pit.base.errors import PitError
    from ztpm.pit import asked

    try:
        return asked(scene, motion, arm)
    except PitError as error:
        _fault(error.reason, error.detail)
    except OSError as error:
        fail_at("", error, "UNREADABLE")


def _fault(reason: str, detail: str) -> NoReturn:
    """A fault is no tier, and no approval overrides it."""
    fail(reason, plain(detail))


def _status(said: Assessment) -> int:
    from policies.evidence.tiers import TierRule
    from ztpm.pit import effect

    return {TierRule.AUDIT: 0, TierRule.TRUST: 0, TierRule.ASK: DEFER, TierRule.REFUSE: DENY}[effect(said)]


def _draw(question: Asked, said: Assessment, file: Path) -> None:
    from pep.pit.base.errors import PitError
    from pep.pit.picture.picture import picture
    from ztpm.pit import advice

    try:
        shown = picture(question.robot, question.situation, question.motion, said)
    except PitError as error:
        fail(error.reason, f"nothing to draw: {error.detail}")
    if file.suffix == ".html":
        from ztpm.picture.page import page

        _write(file, page(shown, subtitle=question.said, advice=advice(said, question.motion)).encode())
        return
    from ztpm.picture.png import NoMatplotlibError, draw

    try:
        draw(shown, file, subtitle=f"{question.said}. {advice(said, question.motion)}")
    except NoMatplotlibError as error:
        fail("NOT_INSTALLED", str(error))
    except OSError as error:
        fail_at(file, error, "UNWRITABLE")


def _write(file: Path, content: bytes) -> None:
    try:
        file.write_bytes(content)
    except OSError as error:
        fail_at(file, error, "UNWRITABLE")


def _tell(question: Asked, said: Assessment, proven: bytes | PitError) -> None:
    from ztpm.pit import advice, carriage, certificate_to_plain, effect

    head = Text(f"Tier {int(said.tier)}", style=COLOURS[int(said.tier)])
    head.append(f", index {said.index:.3f}: {effect(said)}", style="not bold default")
    console.print(head)
    console.print(Text(plain(question.said)))
    if said.violations:
        console.print(Text(f"violations: {', '.join(said.violations)}", style="bold red"))
    table = Table(box=None, pad_edge=False)
    for heading in ("kind", "link", "object", "said by"):
        table.add_column(heading)
    for heading in ("t, s", "clearance, mm", "speed, m/s", "index"):
        table.add_column(heading, justify="right")
    for each in said.contributions:
        table.add_row(
            each.kind,
            plain(each.link),
            Text(plain(each.object)),
            Text(plain(each.source)),
            f"{each.at_ms / 1_000:.2f}" if each.link else "",
            f"{each.clearance_um / 1_000:.1f}" if each.link else "",
            f"{each.speed_um_s / 1e6:.2f}" if each.speed_um_s else "",
            f"{each.index_milli / 1_000:.3f}",
        )
    if said.contributions:
        console.print(table)
    console.print(Text(plain(advice(said, question.motion))))
    certificate = certificate_to_plain(said, proven)
    checked = "every row recomputed by the checker" if certificate["verified"] else certificate["why"]
    console.print(
        Text(plain(f"proof: {json.dumps(certificate['rows'])} rows, {certificate['bytes']} bytes; {checked}"))
    )
    carried = carriage(question.motion)
    if carried is not None and carried["carries"]:
        named = carried["arguments"]
        needs = f"{named['speed_rad_s']} rad/s and {named['acceleration_rad_s2']} rad/s2"
        console.print(Text(f"gateway: carries it as {carried['operation']}, which needs {needs}"))
    elif carried is not None:
        console.print(Text(plain(f"gateway: cannot carry it, {carried['why']}"), style="yellow"))
    console.print(Text(f"model {said.model_digest[:16]}, scene {said.scene_digest[:16]}, engine {said.engine}", "dim"))
