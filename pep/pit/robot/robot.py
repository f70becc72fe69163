"""The robot as numbers: kinematics, limits, masses, link capsules and the motion-bound constants derived from them.

A model is data (`robots/*.toml`) and is named by the hash of its content. Everything else is computed from the data
here: the pinocchio model, and for each capsule the constants that bound how far a joint can carry it.
"""

from __future__ import annotations

import hashlib
import json
from dataclasses import dataclass, field
from functools import cached_property, lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np
import pinocchio

from pep.pit.base.errors import ModelError
from pep.pit.robot.calibration import calibrated
from pep.pit.robot.model import JOINTS, PAYLOAD, TOOL_PAIR, LinkCapsule, Model, RobotTool, Vector, read_back

if TYPE_CHECKING:
    from collections.abc import Iterable, Sequence

    from numpy.typing import NDArray

    from pep.pit.robot.calibration import Calibration
    from pep.pit.robot.gripped_object import GrippedObject


@dataclass(frozen=True, slots=True)
class Body:
    """Capsule (or, with radius 0 and one point, a tracked point) of link `link` as seen from link `reference`.

    Seen from link 0 it moves in the world. Seen from a link of the arm it moves relative to that link alone, which is
    what self-collision asks about: joints below `reference` do not matter.

    Attributes:
        overhang_m: as of a link's capsule in the model.
    """

    name: str
    link: int
    reference: int
    a_m: Vector
    b_m: Vector
    radius_m: float
    overhang_m: float | None = None


@dataclass(frozen=True, eq=False)
class Robot:
    """One arm with one tool and its held object, ready for questions. Immutable; safe to share.

    Attributes:
        model: the file.
        tool: the tool that it carries.
        model_digest: SHA-256 (hex) of the file's content, the tool's name and what it holds.
        held: the held object, or None.
        bodies: first the moving capsules seen from the world, then those seen from other links, then the tracked
            points.
        world_bodies: number of `bodies` that are moving capsules seen from the world.
        self_pairs: (index of a body, capsule of that body's reference link) that must stay apart.
        reach: shape (bodies, 6), metre: bound on the distance of a body's endpoints from each joint's axis, 0 where the
            joint does not move it.
        pinocchio: kinematics and dynamics built from the same data (tool and what it holds included, the cell's payload
            not).
    """

    model: Model
    tool: RobotTool
    model_digest: str
    capsules: tuple[LinkCapsule, ...]
    bodies: tuple[Body, ...]
    world_bodies: int
    self_pairs: tuple[tuple[int, LinkCapsule], ...]
    reach: NDArray[np.float64]
    rotations: NDArray[np.float64] = field(repr=False)
    offsets: NDArray[np.float64] = field(repr=False)
    pinocchio: Any = field(repr=False)
    held: GrippedObject | None = None

    @staticmethod
    def load(name: str, *, tool: str = "robotiq_2f85", calibration: Calibration | None = None) -> Robot:
        """The robot shipped under `name` with one of its tools, as nominal or as one arm is calibrated.

        Raises:
            ModelError: no such model or tool, a model that fails validation, or a calibration too far from it.
        """
        return _load(name, tool, calibration)

    @staticmethod
    def from_toml(text: str, *, tool: str) -> Robot:
        """The robot that a model file spells.

        Raises:
            ModelError: a file that is not strictly of the declared form, or whose geometry or dynamics cannot be.
        """
        return _assemble(Model.from_toml(text), tool)

    @staticmethod
    def from_model(model: Model, *, tool: str) -> Robot:
        """The robot of a model that was validated.

        Raises:
            ModelError: no such tool, or self-collision pairs the wrong way round.
        """
        return _assemble(model, tool)

    def holding(self, held: GrippedObject | None) -> Robot:
        """The same arm and tool with `held` in it, or with nothing.

        Raises:
            ModelError: a held object that cannot be.
        """
        return self if held == self.held else _holding(self, None if held is None else held.checked())

    @property
    def content(self) -> str:
        """Text with the SHA-256 `model_digest`: every property of the robot, every float exact."""
        return _content(self.model, self.tool, self.held)

    @cached_property
    def position_ranges_rad(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """Lowest and highest angle of each joint, each of shape (6,)."""
        low, high = _fixed([j.range_rad for j in self.model.joints]).T
        return low, high

    def beyond_rad(self, q: Iterable[float]) -> list[float]:
        """Angle of each joint at `q` (6,), rad, beyond its range: above it more than 0, below it less."""
        ranges = zip(q, self._ranges, strict=True)
        return [
            0.0 if low <= angle <= high else (angle - high if angle > high else angle - low)
            for angle, (low, high) in ranges
        ]

    @cached_property
    def _ranges(self) -> list[tuple[float, float]]:
        return [joint.range_rad for joint in self.model.joints]

    @cached_property
    def speed_limits_rad_s(self) -> NDArray[np.float64]:
        """Joint speed limits."""
        return _fixed([j.speed_limit_rad_s for j in self.model.joints])

    @cached_property
    def torque_limits_nm(self) -> NDArray[np.float64]:
        """Joint torque limits."""
        return _fixed([j.torque_limit_nm for j in self.model.joints])

    @cached_property
    def moving_mass_kg(self) -> float:
        """Mass of links 1 to 6."""
        return sum(j.mass_kg for j in self.model.joints)

    def body_index(self, name: str) -> int:
        """Index of the body with this name seen from the world.

        Raises:
            KeyError: no such body.
        """
        return self._index_of[name]

    @cached_property
    def _index_of(self) -> dict[str, int]:
        return {body.name: index for index, body in reversed([*enumerate(self.bodies)]) if body.reference == 0}


def _fixed(numbers: Sequence[object]) -> NDArray[np.float64]:
    """Array that cannot be changed."""
    array = np.array(numbers)
    array.setflags(write=False)
    return array


@lru_cache(maxsize=64)  # shipped models and the calibrations of one site
def _load(name: str, tool: str, calibration: Calibration | None) -> Robot:
    if calibration is not None:
        return _assemble(calibrated(_load(name, tool, None).model, calibration), tool)
    return _assemble(Model.shipped(name), tool)


@lru_cache(maxsize=64)  # the objects that one cell holds in a day; a robot takes a millisecond to build
def _holding(robot: Robot, held: GrippedObject | None) -> Robot:
    return _assemble(robot.model, robot.tool.name, held)


def _assemble(model: Model, tool_name: str, held: GrippedObject | None = None) -> Robot:
    tool = next((t for t in model.tools if t.name == tool_name), None)
    if tool is None:
        raise ModelError("PHYSICS_FAULT", f"no tool named {tool_name}")
    on_tool = tuple(LinkCapsule(c.name, JOINTS, c.a_m, c.b_m, c.radius_m, c.overhang_m) for c in tool.capsules)
    payload = () if held is None else (LinkCapsule(PAYLOAD, JOINTS, *held.ends_m, held.shape.radius_m),)
    capsules = (*model.capsules, *on_tool, *payload)
    bodies = [Body(c.name, c.link, 0, c.a_m, c.b_m, c.radius_m, c.overhang_m) for c in capsules if c.link > 0]
    world_bodies = len(bodies)
    pairs = _self_pairs(model, capsules, {c.name for c in on_tool}, bodies)
    bodies += [Body(f"com_{j.name}", k + 1, 0, j.com_m, j.com_m, 0) for k, j in enumerate(model.joints)]
    bodies.append(Body("com_tool", JOINTS, 0, tool.com_m, tool.com_m, 0))
    if held is not None:
        bodies.append(Body("com_payload", JOINTS, 0, held.center_m, held.center_m, 0))
    bodies.append(Body("tcp", JOINTS, 0, tool.tcp_m, tool.tcp_m, 0))
    bodies.append(Body("elbow_point", 2, 0, model.joints[2].offset_m, model.joints[2].offset_m, 0))
    rotations = np.array([pinocchio.rpy.rpyToMatrix(*j.rpy_rad) for j in model.joints])
    offsets = np.array([j.offset_m for j in model.joints])
    reach = np.array([_reach(b, offsets) for b in bodies])
    for array in (rotations, offsets, reach):
        array.setflags(write=False)
    return Robot(
        model=model,
        tool=tool,
        model_digest=hashlib.sha256(_content(model, tool, held).encode()).hexdigest(),
        capsules=capsules,
        bodies=tuple(bodies),
        world_bodies=world_bodies,
        self_pairs=pairs,
        reach=reach,
        rotations=rotations,
        offsets=offsets,
        pinocchio=_pinocchio(model, tool, held, rotations),
        held=held,
    )


def _self_pairs(
    model: Model, capsules: tuple[LinkCapsule, ...], on_tool: set[str], bodies: list[Body]
) -> tuple[tuple[int, LinkCapsule], ...]:
    """Pairs (moving body, capsule at rest in that body's reference frame); adds the bodies that it needs."""
    by_name = {c.name: c for c in capsules}
    index = {(b.name, b.reference): i for i, b in enumerate(bodies)}
    wanted: list[tuple[LinkCapsule, LinkCapsule]] = []
    for inner_name, outer_names in model.self_pairs.items():
        for outer_name in outer_names:
            for name in sorted(on_tool) if outer_name == TOOL_PAIR else [outer_name]:
                inner, outer = by_name.get(inner_name), by_name.get(name)
                if inner is None or outer is None:  # a capsule of a tool that is not mounted
                    continue
                if inner.link >= outer.link:
                    raise ModelError("PHYSICS_FAULT", f"pair {inner_name}, {name}: the first must sit nearer the base")
                wanted.append((inner, outer))
    if PAYLOAD in by_name:  # of any length, so anything that does not move with it may come to touch it
        wanted += [(inner, by_name[PAYLOAD]) for inner in capsules if inner.link < JOINTS]
    pairs: list[tuple[int, LinkCapsule]] = []
    for inner, outer in wanted:
        key = (outer.name, inner.link)
        if key not in index:
            index[key] = len(bodies)
            bodies.append(Body(outer.name, outer.link, inner.link, outer.a_m, outer.b_m, outer.radius_m))
        pairs.append((index[key], inner))
    return tuple(pairs)


def _reach(body: Body, offsets: NDArray[np.float64]) -> NDArray[np.float64]:
    """Bound per joint on the distance of the body's endpoints from the joint's axis, at any joint angles.

    Own joint: the exact distance. Joint k further in: the next joint's origin lies at a fixed distance from axis k, and
    the endpoint is at most the sum of the remaining offsets away from that origin (triangle inequality).
    """
    reach = np.zeros(JOINTS)
    ends = np.array([body.a_m, body.b_m])
    beyond = float(np.linalg.norm(ends, axis=1).max())
    for k in range(body.link, body.reference, -1):
        if k == body.link:
            reach[k - 1] = float(np.hypot(ends[:, 0], ends[:, 1]).max())
        else:
            reach[k - 1] = float(np.hypot(offsets[k, 0], offsets[k, 1])) + beyond
            beyond += float(np.linalg.norm(offsets[k]))
    return reach


def _content(model: Model, tool: RobotTool, held: GrippedObject | None) -> str:
    content = read_back(model) | {"mounted_tool": tool.name}
    if held is not None:
        ends = [[x.hex() for x in map(float, end)] for end in held.ends_m]
        mass = None if held.mass_kg is None else float(held.mass_kg).hex()
        content["held"] = [held.object, ends, float(held.shape.radius_m).hex(), mass, held.blunt]
    return json.dumps(content, sort_keys=True, separators=(",", ":"))


def _pinocchio(model: Model, tool: RobotTool, held: GrippedObject | None, rotations: NDArray[np.float64]) -> Any:
    built = pinocchio.Model()
    built.name = model.name
    parent = 0
    for joint, rotation in zip(model.joints, rotations, strict=True):
        parent = built.addJoint(
            parent,
            pinocchio.JointModelRZ(),
            pinocchio.SE3(rotation, np.array(joint.offset_m)),
            joint.name,
            np.array([joint.torque_limit_nm]),
            np.array([joint.speed_limit_rad_s]),
            *(np.array([limit]) for limit in joint.range_rad),
        )
        inertia = pinocchio.Inertia(joint.mass_kg, np.array(joint.com_m), np.array(joint.inertia))
        built.appendBodyToJoint(parent, inertia, pinocchio.SE3.Identity())
    # The tool's inertia about its own centre is published nowhere and small; as a point mass it loads the joints.
    point = pinocchio.Inertia(tool.mass_kg, np.array(tool.com_m), np.zeros((3, 3)))
    built.appendBodyToJoint(parent, point, pinocchio.SE3.Identity())
    if held is not None:  # likewise
        mass = model.payload_limit_kg if held.mass_kg is None else held.mass_kg
        part = pinocchio.Inertia(mass, np.array(held.center_m), np.zeros((3, 3)))
        built.appendBodyToJoint(parent, part, pinocchio.SE3.Identity())
    flange = pinocchio.Frame("flange", parent, 0, pinocchio.SE3.Identity(), pinocchio.FrameType.OP_FRAME)
    built.addFrame(flange)
    return built
