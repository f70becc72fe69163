"""Model of an arm out of its URDF and the meshes that it names, each enclosed in capsules.

The excess of the capsules is told. Files are opened below one folder and nowhere else. What is made is a model like the
shipped ones, a text with the source of every number beside it; a file of it stands for itself, so a refusal leaves
nothing half made.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass, replace
from pathlib import PurePosixPath
from typing import TYPE_CHECKING, Final

from pep.pit.base.errors import ModelError
from pep.pit.geometry.triangle_mesh import BYTES_LIMIT, mesh_of
from pep.pit.robot.mesh_capsules import CAPSULES_MOST, enclosed
from pep.pit.robot.model import Model, read_back
from pep.pit.robot.robot import Robot
from pep.pit.robot.self_clearance import checked, proposed, spelled
from pep.pit.robot.urdf import described
from pep.pit.robot.urdf_robot import model_of

if TYPE_CHECKING:
    from collections.abc import Iterable
    from pathlib import Path

    from pep.pit.base.motion import Floats
    from pep.pit.robot.mesh_cover import Excess, Line
    from pep.pit.robot.model import RobotTool, Vector
    from pep.pit.robot.outfit import Apart, Outfit
    from pep.pit.robot.urdf import UrdfMesh

PACKAGE: Final = "package://"
FILE: Final = "file://"
STL: Final = ".stl"
SAMPLES: Final = 20_000  # ours: configurations in which a pair that is left out was apart, or overlapped
SHOWN: Final = 200  # characters of a refused name
WHY: Final = {
    "never": "apart by 3 mm and more in every sample",
    "always": "they overlap in every sample",
    "turns": "both joints between them turn all the way round",
}


@dataclass(frozen=True, slots=True)
class FittedMesh:
    """One mesh and its capsules.

    Attributes:
        link: that it belongs to.
        file: as it was read, below the folder of meshes.
        sha256: of the file.
        triangles: shape (n, 3, 3), metre, in the frame of the model's link.
        lines: the capsules.
        excess: no point of their surface is farther from the mesh than its upper bound.
    """

    link: str
    file: str
    sha256: str
    triangles: Floats
    lines: tuple[Line, ...]
    excess: Excess


@dataclass(frozen=True, slots=True)
class RobotFit:
    """A model, and how it came about."""

    model: Model
    meshes: tuple[FittedMesh, ...]
    apart: tuple[Apart, ...]


def robot_fit(
    urdf: str, outfit: Outfit, folder: Path, *, name: str = "", most: int = CAPSULES_MOST, samples: int = SAMPLES
) -> RobotFit:
    """Model of the arm, its meshes enclosed, with all pairs but those that sampling leaves out.

    Args:
        urdf: text of the file.
        outfit: the person's outfit of it, with its tools.
        folder: of the meshes.
        name: of the model; "" for the robot's own.
        most: capsules for one mesh.
        samples: configurations that a pair that is left out was tried in.

    Raises:
        ModelError: a file that cannot be read or is no arm, or a cover that was not proven; the detail says what to do.
    """
    if not outfit.tools:
        raise ModelError("PHYSICS_FAULT", "no tool: state one in the outfit, or in a file of its own")
    fitter = _Fitter(folder, most)
    description = described(urdf, outfit, meshes=True)
    model = model_of(description, outfit, fitter.fit)
    # Of each tool: what is mounted is watched against the arm, and left out against it.
    outfit = spelled(outfit, model.capsules)
    found: dict[tuple[str, str], Apart] = {(each.inner, each.outer): each for each in outfit.apart}
    for tool in model.tools:
        robot = Robot.from_model(model, tool=tool.name)
        found = {(each.inner, each.outer): each for each in proposed(robot, samples=samples)} | found
    apart = tuple(found.values())
    pairs = {
        inner: kept
        for inner, outers in model.self_pairs.items()
        if (kept := tuple(outer for outer in outers if (inner, outer) not in found))
    }
    model = replace(model, name=name or model.name, self_pairs=pairs)
    for tool in model.tools:
        checked(Robot.from_model(model, tool=tool.name), replace(outfit, apart=apart))
    return RobotFit(model, tuple(fitter.done), apart)


class _Fitter:
    def __init__(self, folder: Path, most: int) -> None:
        self._folder, self._most = folder, most
        self.done: list[FittedMesh] = []

    def fit(self, link: str, mesh: UrdfMesh, frame: Floats) -> Iterable[Line]:
        """Capsules around the mesh, in the frame of the model's link."""
        place = self._place(link, mesh.file)
        raw = self._read(link, place)
        own = mesh_of(raw, f"{link}: {place}", mesh.scale)
        triangles = own @ frame[:3, :3].T + frame[:3, 3]
        found = enclosed(triangles, f"{link}: {place}", most=self._most)
        self.done.append(
            FittedMesh(link, str(place), hashlib.sha256(raw).hexdigest(), triangles, found.lines, found.excess)
        )
        return found.lines

    def _place(self, link: str, stated: str) -> PurePosixPath:
        """File below the folder: what follows the package's name, or the longest end of it that is there."""
        bare = stated.removeprefix(PACKAGE).removeprefix(FILE)
        parts = PurePosixPath(bare).parts
        if ".." in parts or not parts:
            raise ModelError("PHYSICS_FAULT", f"{link}: a mesh outside the folder of meshes")
        if not bare.lower().endswith(STL):
            told = f"{link}: {PurePosixPath(bare).name[:SHOWN]} is no STL"
            raise ModelError("PHYSICS_FAULT", f"{told}; export the mesh as a binary STL and name that")
        for start in range(len(parts)):
            place = PurePosixPath(*[part for part in parts[start:] if part != "/"])
            if (self._folder / place).is_file():
                return place
        raise ModelError("PHYSICS_FAULT", f"{link}: no file {bare[:SHOWN]} in the folder of meshes")

    def _read(self, link: str, place: PurePosixPath) -> bytes:
        file = self._folder / place
        if not file.resolve().is_relative_to(self._folder.resolve()):
            raise ModelError("PHYSICS_FAULT", f"{link}: a mesh outside the folder of meshes")
        with file.open("rb") as opened:
            return opened.read(BYTES_LIMIT + 1)


def text_of(fit: RobotFit, *, header: Iterable[str], urdf: str = "URDF", outfit: str = "OUTFIT") -> str:
    """The model file of a fit, the source of every number beside it.

    Args:
        fit: of an arm.
        header: lines at its beginning.
        urdf: word for this source; the header says what it stands for.
        outfit: likewise.

    Raises:
        ModelError: a name by which the text would say another model.
    """
    model = fit.model
    lines = [*(_comment(line) for line in header), "", "schema = 1", f"name = {_quoted(model.name)}"]
    lines += [
        f"payload_limit_kg = {model.payload_limit_kg!r}  # {outfit}",
        f"acceleration_limit_rad_s2 = {model.acceleration_limit_rad_s2!r}  # {outfit}",
    ]
    for joint in model.joints:
        low, high = joint.range_rad
        lines += [
            "",
            "[[joints]]",
            f'name = "{joint.name}"',
            f"offset_m = {_list(joint.offset_m)}  # {urdf}",
            f"rpy_rad = {_list(joint.rpy_rad)}  # {urdf}",
            *([f"position_low_rad = {low!r}  # {urdf}"] if low != -high else []),
            f"position_limit_rad = {high!r}  # {urdf}",
            f"speed_limit_rad_s = {joint.speed_limit_rad_s!r}  # {urdf}",
            f"torque_limit_nm = {joint.torque_limit_nm!r}  # {urdf}",
            f"mass_kg = {joint.mass_kg!r}  # {urdf}",
            f"com_m = {_list(joint.com_m)}  # {urdf}",
            f"inertia_kg_m2 = {_list(joint.inertia_kg_m2)}  # {urdf}",
            f"inertia_products_kg_m2 = {_list(joint.inertia_products_kg_m2)}  # {urdf}",
        ]
    lines += ["", "# link 0 is the fixed base; endpoints in the link's frame"]
    for capsule in model.capsules:
        lines += [
            "",
            "[[capsules]]",
            f'name = "{capsule.name}"',
            f"link = {capsule.link}",
            f"a_m = {_list(capsule.a_m)}  # FIT",
            f"b_m = {_list(capsule.b_m)}  # FIT",
            f"radius_m = {capsule.radius_m!r}  # FIT",
        ]
    lines += ["", "# SMP: watched pairs. Of all other pairs of links that are no neighbours:"]
    lines += [f"#   {each.inner}, {each.outer}: {WHY[each.why]}" for each in fit.apart]
    lines.append("[self_pairs]")
    lines += [
        f"{_quoted(inner)} = [{', '.join(map(_quoted, outers))}]  # SMP" for inner, outers in model.self_pairs.items()
    ]
    for tool in model.tools:
        lines += ["", *_tool(tool, outfit)]
    text = "\n".join([*lines, ""])
    if _plain(Model.from_toml(text)) != _plain(model):
        raise ModelError("PHYSICS_FAULT", f"{model.name[:SHOWN]}: no file says exactly this model")
    return text


def _plain(model: Model) -> dict[str, object]:
    """All that a model file says, whichever way it spells a range."""
    joints = [replace(joint, position_low_rad=joint.range_rad[0]) for joint in model.joints]
    return read_back(replace(model, joints=tuple(joints), derived_from=()))


def _tool(tool: RobotTool, source: str) -> list[str]:
    lines = ["[[tools]]", f"name = {_quoted(tool.name)}", f'shape = "{tool.shape}"  # {source}']
    plain = ("mass_kg", "width_limit_m", "force_min_n", "force_limit_n", "finger_speed_min_m_s")
    named = (*plain, "finger_speed_limit_m_s", "pad_m")
    lines += [f"{name} = {getattr(tool, name)!r}  # {source}" for name in named]
    lines += [f"{name} = {_list(getattr(tool, name))}  # {source}" for name in ("com_m", "tcp_m")]
    for capsule in tool.capsules:
        lines += [
            "",
            "[[tools.capsules]]",
            f'name = "{capsule.name}"',
            f"a_m = {_list(capsule.a_m)}  # {source}",
            f"b_m = {_list(capsule.b_m)}  # {source}",
            f"radius_m = {capsule.radius_m!r}  # {source}",
        ]
        if capsule.overhang_m is not None:
            lines.append(f"overhang_m = {capsule.overhang_m!r}  # {source}")
    return lines


def _list(numbers: Vector) -> str:
    return f"[{', '.join(repr(float(number) + 0.0) for number in numbers)}]"  # no number is -0.0


def _comment(line: str) -> str:
    """One line of any characters."""
    return f"# {''.join(c if c.isprintable() else ' ' for c in line)}".rstrip()


def _quoted(name: str) -> str:
    return json.dumps(name)
