"""Robot file as frozen values: read strictly, and refused when no robot can have them."""

from __future__ import annotations

import math
from dataclasses import dataclass, fields
from importlib import resources
from typing import TYPE_CHECKING, Any, ClassVar, Final, Literal

import numpy as np

from pep.pit.base.errors import ModelError
from pep.pit.base.strict import STRICT, FormError, read_table, read_toml

if TYPE_CHECKING:
    from pydantic import ConfigDict

JOINTS: Final = 6  # a UR arm: six revolute joints in a row
SCHEMA: Final = 1
PAYLOAD: Final = "payload"  # the body of the held object
TOOL_PAIR: Final = "tool"  # in `self_pairs`: every capsule of the tool
RESERVED: Final = (PAYLOAD, TOOL_PAIR, "tcp", "elbow_point")  # the two last ones are points that a robot tracks
MASS_POINT: Final = "com_"  # and the names of its centres of mass begin with this
TURN_LIMIT_RAD: Final = 2 * math.pi  # once round; a larger number is no angle in radians
THINNEST_M: Final = 1e-4  # a tenth of a millimetre; a thinner body is a number gone wrong
SIZE_LIMIT_M: Final = 10.0  # no part of a table-top arm is longer; a larger number is a wrong unit
MASS_LIMIT_KG: Final = 1000.0  # likewise
ROUNDING: Final = 1e-6  # a flat body's moments add up exactly; files round them

Vector = tuple[float, float, float]


@dataclass(frozen=True, slots=True)
class RobotJoint:
    """One revolute joint, turning about its own z axis, and the link that it carries.

    Attributes:
        offset_m, rpy_rad: frame of the joint in that of the link before it.
        position_limit_rad: highest angle.
        inertia_kg_m2: xx, yy, zz about the centre of mass.
        position_low_rad: lowest angle, at most 0; None is the highest, negated.
        inertia_products_kg_m2: xy, xz, yz of the same tensor.
    """

    __pydantic_config__: ClassVar[ConfigDict] = STRICT
    name: str
    offset_m: Vector
    rpy_rad: Vector
    position_limit_rad: float
    speed_limit_rad_s: float
    torque_limit_nm: float
    mass_kg: float
    com_m: Vector
    inertia_kg_m2: Vector
    position_low_rad: float | None = None
    inertia_products_kg_m2: Vector = (0.0, 0.0, 0.0)

    @property
    def range_rad(self) -> tuple[float, float]:
        """Lowest and highest angle."""
        low = -self.position_limit_rad if self.position_low_rad is None else self.position_low_rad
        return low, self.position_limit_rad

    @property
    def inertia(self) -> tuple[Vector, Vector, Vector]:
        """The whole tensor about the centre of mass, row by row."""
        (xx, yy, zz), (xy, xz, yz) = self.inertia_kg_m2, self.inertia_products_kg_m2
        return (xx, xy, xz), (xy, yy, yz), (xz, yz, zz)


@dataclass(frozen=True, slots=True)
class LinkCapsule:
    """A capsule that contains a piece of a link; link 0 is the fixed base.

    Attributes:
        overhang_m: drawn in by this, the capsule is wholly inside the link (PHY-40); None where nobody measured it.
    """

    __pydantic_config__: ClassVar[ConfigDict] = STRICT
    name: str
    link: int
    a_m: Vector
    b_m: Vector
    radius_m: float
    overhang_m: float | None = None


@dataclass(frozen=True, slots=True)
class ToolCapsule:
    """A capsule that contains a piece of the tool, in the flange frame.

    Attributes:
        overhang_m: as of a link's capsule, at every opening of the fingers.
    """

    __pydantic_config__: ClassVar[ConfigDict] = STRICT
    name: str
    a_m: Vector
    b_m: Vector
    radius_m: float
    overhang_m: float | None = None


@dataclass(frozen=True, slots=True)
class RobotTool:
    """Tool on the flange.

    Attributes:
        tcp_m: the tip that counts as the tool point, in the frame of the flange.
        shape: its effect on a body that it meets; only a blunt one is granted twice the limit speed.
        width_limit_m: the fingers' stroke: they open from 0 to this.
        force_min_n, force_limit_n: of a grip; asked for less than the least, the gripper still presses with that.
        finger_speed_min_m_s, finger_speed_limit_m_s: of one finger; likewise.
        pad_m: the pads reach this far back from the tool point.
        capsules: contain every part of it at every opening.
    """

    __pydantic_config__: ClassVar[ConfigDict] = STRICT
    name: str
    mass_kg: float
    com_m: Vector
    tcp_m: Vector
    shape: Literal["blunt", "wedge", "edge", "sheet"]
    width_limit_m: float
    force_min_n: float
    force_limit_n: float
    finger_speed_min_m_s: float
    finger_speed_limit_m_s: float
    pad_m: float
    capsules: tuple[ToolCapsule, ...]


@dataclass(frozen=True, slots=True)
class SourceFile:
    """A file beside the model's own from which some of its numbers were taken."""

    __pydantic_config__: ClassVar[ConfigDict] = STRICT
    kind: Literal["calibration", "urdf"]
    sha256: str


@dataclass(frozen=True, slots=True)
class Model:
    """A robot file, read strictly.

    Attributes:
        self_pairs: names of capsules that must stay apart: one nearer the base, and those farther out.
        derived_from: files from which numbers were taken since; a model file itself states none.
    """

    __pydantic_config__: ClassVar[ConfigDict] = STRICT
    schema: int
    name: str
    payload_limit_kg: float
    acceleration_limit_rad_s2: float
    joints: tuple[RobotJoint, ...]
    capsules: tuple[LinkCapsule, ...]
    self_pairs: dict[str, tuple[str, ...]]
    tools: tuple[RobotTool, ...]
    derived_from: tuple[SourceFile, ...] = ()

    @staticmethod
    def from_toml(text: str) -> Model:
        """Model that a file spells.

        Raises:
            ModelError: a file that is not strictly of the declared form, or whose geometry or dynamics cannot be.
        """
        try:
            model = read_table(Model, read_toml(text))
        except FormError as error:
            raise ModelError("PHYSICS_FAULT", str(error)) from error
        if model.derived_from:
            raise ModelError("PHYSICS_FAULT", "a model file is derived from no other")
        return validated(model)

    @staticmethod
    def shipped(name: str) -> Model:
        """Model shipped under this name.

        Raises:
            ModelError: there is none.
        """
        if not name.isidentifier():
            raise ModelError("PHYSICS_FAULT", "a model's name is an identifier")
        folder = resources.files("pep.pit") / "robots"
        source = folder / f"{name}.toml"
        if not source.is_file():
            known = ", ".join(
                sorted(each.name.removesuffix(".toml") for each in folder.iterdir() if ".toml" in each.name)
            )
            raise ModelError("PHYSICS_FAULT", f"no model named {name}; shipped are {known}")
        return Model.from_toml(source.read_text(encoding="utf-8"))


def validated(model: Model) -> Model:
    """The model, when every moving link has geometry and mass and every number can be a UR arm's."""

    def need(holds: bool, what: str) -> None:  # noqa: FBT001 - local assertion with an error of its own
        if not holds:
            raise ModelError("PHYSICS_FAULT", what)

    need(model.schema == SCHEMA, "unknown schema")
    need(len(model.joints) == JOINTS, "six joints are needed")
    need(0 < model.payload_limit_kg <= MASS_LIMIT_KG, "payload limit")
    need(model.acceleration_limit_rad_s2 > 0, "acceleration limit")
    for joint in model.joints:
        low, high = joint.range_rad
        need(low <= 0 <= high and low < high, f"{joint.name}: position limits")
        need(joint.speed_limit_rad_s > 0, f"{joint.name}: speed limit")
        need(joint.torque_limit_nm > 0, f"{joint.name}: torque limit")
        need(0 < joint.mass_kg <= MASS_LIMIT_KG, f"{joint.name}: mass")
        need(_possible(joint), f"{joint.name}: inertia")
        need(max(map(abs, (*joint.offset_m, *joint.com_m))) <= SIZE_LIMIT_M, f"{joint.name}: size")
        need(max(map(abs, joint.rpy_rad)) <= TURN_LIMIT_RAD, f"{joint.name}: orientation")
    # A link without geometry would answer "all clear" to every question.
    need({c.link for c in model.capsules} == set(range(JOINTS + 1)), "every link needs a capsule")
    names = [c.name for c in model.capsules] + [c.name for t in model.tools for c in t.capsules]
    need(len(set(names)) == len(names), "capsule names repeat")
    taken = [name for name in names if name in RESERVED or name.startswith(MASS_POINT)]
    need(not taken, f"a capsule has a name that means something else: {taken[:1]}")
    need(len({j.name for j in model.joints}) == JOINTS, "joint names repeat")
    need(len({t.name for t in model.tools}) == len(model.tools) > 0, "tool names repeat or none is given")
    parts: list[LinkCapsule | ToolCapsule] = [*model.capsules, *(c for t in model.tools for c in t.capsules)]
    for part in parts:
        need(THINNEST_M <= part.radius_m <= SIZE_LIMIT_M, f"{part.name}: radius")
        need(max(map(abs, (*part.a_m, *part.b_m))) <= SIZE_LIMIT_M, f"{part.name}: size")
        need(part.overhang_m is None or 0 <= part.overhang_m <= SIZE_LIMIT_M, f"{part.name}: overhang")
    for tool in model.tools:
        need(len(tool.capsules) > 0 and 0 < tool.mass_kg <= MASS_LIMIT_KG, f"{tool.name}: geometry or mass")
        need(max(map(abs, (*tool.com_m, *tool.tcp_m))) <= SIZE_LIMIT_M, f"{tool.name}: size")
        need(0 < tool.width_limit_m <= SIZE_LIMIT_M and 0 < tool.pad_m <= SIZE_LIMIT_M, f"{tool.name}: fingers")
        need(0 < tool.force_min_n <= tool.force_limit_n, f"{tool.name}: force")
        need(0 < tool.finger_speed_min_m_s <= tool.finger_speed_limit_m_s, f"{tool.name}: finger speed")
    known = {*names, TOOL_PAIR}
    pairs = [(a, b) for a, others in model.self_pairs.items() for b in others]
    need(len(pairs) > 0, "self-collision pairs are needed")
    need(all(a in known and b in known for a, b in pairs), "a self-collision pair names an unknown capsule")
    return model


def _possible(joint: RobotJoint) -> bool:
    """True where some body has this tensor: principal moments are positive, none above the sum of the others."""
    if not max(map(abs, (*joint.inertia_kg_m2, *joint.inertia_products_kg_m2))) <= MASS_LIMIT_KG * SIZE_LIMIT_M**2:
        return False
    least, middle, most = np.linalg.eigvalsh(np.array(joint.inertia)).tolist()
    return bool(least > 0 and most <= (least + middle) * (1 + ROUNDING))


def read_back(model: Model) -> dict[str, Any]:
    """The model as plain JSON values; every float prints in its shortest exact form."""

    def plain(value: object) -> Any:
        match value:
            case dict():
                return {k: plain(v) for k, v in value.items()}
            case tuple():
                return [plain(v) for v in value]
            case None | str() | int() | float():
                return value
            case _:
                return {f.name: plain(getattr(value, f.name)) for f in fields(value)}  # type: ignore[arg-type]

    return dict(plain(model))
