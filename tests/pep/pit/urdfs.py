"""URDF texts for tests: the UR3e from its own model, and random arms whose joints turn about any axis."""

import math

import numpy as np
import pinocchio
from pep.pit.robot.model import RobotTool, ToolCapsule
from pep.pit.robot.outfit import Outfit
from tests.pep.pit.scenes import ROBOT

STICK = RobotTool(
    name="stick",
    mass_kg=0.5,
    com_m=(0.0, 0.01, 0.05),
    tcp_m=(0.0, 0.0, 0.1),
    shape="edge",
    width_limit_m=0.05,
    force_min_n=1.0,
    force_limit_n=10.0,
    finger_speed_min_m_s=0.01,
    finger_speed_limit_m_s=0.1,
    pad_m=0.01,
    capsules=(ToolCapsule("stick_rod", (0.0, 0.0, 0.02), (0.0, 0.01, 0.1), 0.02),),
)
OUTFIT = Outfit(schema=1, flange="flange", payload_limit_kg=3.0, acceleration_limit_rad_s2=40.0, tools=(STICK,))
LIKE_UR3E = Outfit(
    schema=1,
    flange="wrist_3_link",
    payload_limit_kg=ROBOT.model.payload_limit_kg,
    acceleration_limit_rad_s2=ROBOT.model.acceleration_limit_rad_s2,
    tools=ROBOT.model.tools,
)


def words(numbers):
    return " ".join(repr(float(x)) for x in numbers)


def origin(xyz=(0, 0, 0), rpy=(0, 0, 0)):
    return f'<origin xyz="{words(xyz)}" rpy="{words(rpy)}"/>'


def capsule(a, b, radius):
    """A `<collision>` of a capsule between two points."""
    a, b = np.array(a, float), np.array(b, float)
    way, length = b - a, float(np.linalg.norm(b - a))
    turn = pinocchio.Quaternion.FromTwoVectors(np.array([0.0, 0, 1]), way).toRotationMatrix()
    pose = origin((a + b) / 2, pinocchio.rpy.matrixToRpy(turn))
    return f'<collision>{pose}<geometry><capsule radius="{radius!r}" length="{length!r}"/></geometry></collision>'


def inertial(mass, xyz, tensor, rpy=(0, 0, 0)):
    xx, xy, xz, yy, yz, zz = (repr(float(x)) for x in tensor)
    entries = f'ixx="{xx}" ixy="{xy}" ixz="{xz}" iyy="{yy}" iyz="{yz}" izz="{zz}"'
    return f'<inertial>{origin(xyz, rpy)}<mass value="{float(mass)!r}"/><inertia {entries}/></inertial>'


def joint(name, parent, child, pose="", axis=(0, 0, 1), kind="revolute", low=-2.0, high=2.0, speed=3.0, effort=50.0):
    more = ""
    if kind == "revolute":
        limits = f'lower="{low!r}" upper="{high!r}" velocity="{speed!r}" effort="{effort!r}"'
        more = f'<axis xyz="{words(axis)}"/><limit {limits}/>'
    return f'<joint name="{name}" type="{kind}">{pose}<parent link="{parent}"/><child link="{child}"/>{more}</joint>'


def robot(*parts, version=' version="1.1"', name="arm"):
    return f'<?xml version="1.0" encoding="utf-8"?>\n<robot name="{name}"{version}>' + "\n".join(parts) + "</robot>\n"


def ur3e():
    """The shipped model, spelled as a URDF: capsules as capsules, all joints about z."""
    model = ROBOT.model
    links = ["base_link", *(f"{j.name}_link" for j in model.joints)]
    parts = []
    for k, link in enumerate(links):
        inside = "".join(capsule(c.a_m, c.b_m, c.radius_m) for c in model.capsules if c.link == k)
        if k:
            j = model.joints[k - 1]
            (xx, xy, xz), (_, yy, yz), (_, _, zz) = j.inertia
            inside += inertial(j.mass_kg, j.com_m, (xx, xy, xz, yy, yz, zz))
        parts.append(f'<link name="{link}">{inside}</link>')
    for k, j in enumerate(model.joints):
        low, high = j.range_rad
        parts.append(
            joint(j.name, links[k], links[k + 1], origin(j.offset_m, j.rpy_rad), low=low, high=high,
                  speed=j.speed_limit_rad_s, effort=j.torque_limit_nm)
        )  # fmt: skip
    return robot(*parts, name="ur3e")


AXES = [(0, 0, 1), (0, 0, -1), (1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0)]


def turn_onto(axis, about):
    """Angles of a frame whose z is `axis`, turned about it."""
    axis = np.array(axis, float) / np.linalg.norm(axis)
    way = pinocchio.Quaternion.FromTwoVectors(np.array([0.0, 0, 1]), axis).toRotationMatrix()
    return pinocchio.rpy.matrixToRpy(way @ pinocchio.rpy.rpyToMatrix(0, 0, about))


def random_arm(rng):
    """Six joints about any axes, fixed joints between and beside them, and a flange somewhere on the last axis."""

    def number(size):
        return rng.uniform(-size, size, 3)

    def mass():
        lengths = rng.uniform(0.02, 0.1, 3)
        x, y, z = lengths**2
        m = rng.uniform(0.2, 3)
        tensor = (m * (y + z), 0, 0, m * (x + z), 0, m * (x + y))
        return inertial(m, number(0.1), tensor, number(3))

    def link(name, shapes=1):
        pieces = [capsule(p := number(0.1), p + number(0.1), float(rng.uniform(0.01, 0.05))) for _ in range(shapes)]
        return f'<link name="{name}">{mass()}{"".join(pieces)}</link>'

    parts, last = [link("l0")], "l0"
    for k in range(1, 7):
        parent = last
        if rng.random() < 0.5:  # a fixed joint on the way
            parts += [link(f"on{k}"), joint(f"fix{k}", last, f"on{k}", origin(number(0.1), number(3)), kind="fixed")]
            parent = f"on{k}"
        if rng.random() < 0.5:  # and one beside it
            parts += [link(f"by{k}"), joint(f"aside{k}", last, f"by{k}", origin(number(0.1), number(3)), kind="fixed")]
        axis = AXES[rng.integers(6)] if rng.random() < 0.5 else number(1)
        low, high = -rng.uniform(0, 3), rng.uniform(0.1, 3)
        parts.append(link(f"l{k}", int(rng.integers(1, 3))))
        parts.append(
            joint(f"j{k}", parent, f"l{k}", origin(number(0.3), number(3)), axis, low=float(low), high=float(high))
        )
        last = f"l{k}"
    unit = np.array(axis, float) / np.linalg.norm(axis)
    pose = origin(unit * rng.uniform(-0.1, 0.1), turn_onto(unit, rng.uniform(-math.pi, math.pi)))
    parts += ['<link name="flange"/>', joint("to_flange", last, "flange", pose, kind="fixed")]
    order = rng.permutation(len(parts))
    return robot(*(parts[k] for k in order))
