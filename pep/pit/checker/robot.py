"""Robot as the document's text spells it: bodies, levers, limits, and parts that must stay apart."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

from pep.pit.checker.distances import Mat, Vec, length, product
from pep.pit.checker.text import decimal, exact, listed, parsed, table, truth, vector, whole, word
from pep.pit.checker.verdict import Code, need

if TYPE_CHECKING:
    from collections.abc import Sequence

JOINTS: Final = 6  # PHY-1: six revolute joints in a row
CAPSULES_MOST: Final = 256  # of one robot; bounds the work
PAIRS_MOST: Final = 4096  # named self pairs; likewise
SIZE_MOST_M: Final = 10.0  # no part of a table-top arm is longer
PAYLOAD: Final = "payload"
ON_TOOL: Final = "tool"
SHAPES: Final = ("blunt", "wedge", "edge", "sheet")


@dataclass(frozen=True, slots=True)
class CheckerBody:
    """Capsule of link `link` as seen from link `reference`: only the joints between the two move it.

    Attributes:
        levers: per joint the farthest that an end can be from the joint's axis, metre; 0 where the joint moves it not.
        part: "tool" or "payload" where it may be meant to touch something, else "".
        overhang: drawn in by this, metre, the capsule is inside what it encloses; None where nobody measured it.
    """

    name: str
    link: int
    reference: int
    a: Vec
    b: Vec
    radius: float
    levers: tuple[float, ...]
    part: str = ""
    overhang: float | None = None


@dataclass(frozen=True, slots=True)
class CheckerGrippedObject:
    """The gripper's held object; mass None is unknown."""

    a: Vec
    b: Vec
    radius: float
    mass_kg: float | None
    blunt: bool


@dataclass(frozen=True, slots=True)
class CheckerMass:
    """A rigid body that goes with a link: its centre there, and its inertia about that; None for a point."""

    link: int
    kg: float
    com: Vec
    inertia: Mat | None


@dataclass(frozen=True, slots=True)
class CheckerRobot:
    """One arm, its tool and its held object.

    Attributes:
        offsets, turns: of each joint's frame in the one before.
        ranges: lowest and highest angle of each joint, rad.
        moving: the capsules seen from the world, in their order.
        apart: (body seen from the fixed capsule's link, fixed capsule), in the order of the fixed one's name, then of
            the moving one's.
        masses: (point mass as a body, kg).
        links: the same masses as rigid bodies.
    """

    offsets: tuple[Vec, ...]
    turns: tuple[Mat, ...]
    ranges: tuple[tuple[float, float], ...]
    speed_limits: tuple[float, ...]
    acceleration_limit: float
    payload_limit_kg: float
    link_mass_kg: float
    tool_mass_kg: float
    blunt: bool
    held: CheckerGrippedObject | None
    moving: tuple[CheckerBody, ...]
    apart: tuple[tuple[CheckerBody, CheckerBody], ...]
    masses: tuple[tuple[CheckerBody, float], ...]
    tcp: CheckerBody
    elbow: CheckerBody
    links: tuple[CheckerMass, ...]
    torque_limits: tuple[float, ...]

    def carried(self, kg: float) -> CheckerMass:
        """So much at the tool point."""
        return CheckerMass(JOINTS, kg, self.tcp.a, None)


@dataclass(frozen=True, slots=True)
class _Capsule:
    name: str
    link: int
    a: Vec
    b: Vec
    radius: float
    part: str
    overhang: float | None = None


def robot_of(text: str) -> CheckerRobot:
    """Robot of the document's text.

    Raises:
        Refusal: a text that spells none.
    """
    top = parsed(text, "model", floats=True)
    need(type(top) is dict, Code.MEMBER_WRONG, "model")
    held_row = top.pop("held", None)
    names = (
        "schema", "name", "payload_limit_kg", "acceleration_limit_rad_s2", "joints", "capsules", "self_pairs", "tools",
        "mounted_tool",
    )  # fmt: skip
    # `derived_from` says where numbers came from that all stand here; it is part of the name, not of the arm.
    top = table(top, "model", names, may=("derived_from",))
    need(top["schema"] == 1, Code.VERSION_UNKNOWN, "model.schema")
    joints = [_joint(row) for row in listed(top["joints"], "model.joints", least=JOINTS, most=JOINTS)]
    tools = [row for row in listed(top["tools"], "model.tools", least=1, most=CAPSULES_MOST) if type(row) is dict]
    mounted = [row for row in tools if row.get("name") == top["mounted_tool"]]
    need(len(mounted) == 1, Code.MEMBER_WRONG, "model.mounted_tool")
    tool = mounted[0]
    held = None if held_row is None else _held(held_row)
    own = [_capsule(row, "") for row in listed(top["capsules"], "model.capsules", least=1, most=CAPSULES_MOST)]
    # A link without geometry would answer "all clear" to every question.
    need({c.link for c in own} == set(range(JOINTS + 1)), Code.MEMBER_WRONG, "model.capsules: a link has none")
    on_tool = [_capsule(r, ON_TOOL) for r in listed(tool.get("capsules"), "model.tools", least=1, most=CAPSULES_MOST)]
    carried = [] if held is None else [_Capsule(PAYLOAD, JOINTS, held.a, held.b, held.radius, PAYLOAD)]
    capsules = [*own, *on_tool, *carried]
    need(len({c.name for c in capsules}) == len(capsules), Code.MEMBER_WRONG, "model.capsules: a name repeats")
    offsets = tuple(j.offset for j in joints)

    def point(name: str, link: int, at: Vec) -> CheckerBody:
        return _body(_Capsule(name, link, at, at, 0.0, ""), 0, offsets)

    tool_mass = decimal(tool.get("mass_kg"), "model.tools.mass_kg", low=0)
    limit = decimal(top["payload_limit_kg"], "model.payload_limit_kg", low=1e-6)  # a divisor
    masses = [(point(f"mass {k}", k + 1, j.com), j.mass) for k, j in enumerate(joints)]
    masses.append((point("mass of the tool", JOINTS, vector(tool.get("com_m"), "model.tools.com_m", _size)), tool_mass))
    if held is not None:
        ax, ay, az = held.a
        bx, by, bz = held.b
        middle = (0.5 * (ax + bx), 0.5 * (ay + by), 0.5 * (az + bz))
        masses.append((point("mass held", JOINTS, middle), limit if held.mass_kg is None else held.mass_kg))
    return CheckerRobot(
        offsets=offsets,
        turns=tuple(j.turn for j in joints),
        ranges=tuple((j.lowest, j.highest) for j in joints),
        speed_limits=tuple(j.speed_limit for j in joints),
        acceleration_limit=decimal(
            top["acceleration_limit_rad_s2"],
            "model.acceleration_limit_rad_s2",
            low=1e-6,  # ours: above 0
        ),
        payload_limit_kg=limit,
        link_mass_kg=sum(j.mass for j in joints),
        tool_mass_kg=tool_mass,
        blunt=word(tool.get("shape"), "model.tools.shape", among=SHAPES) == "blunt",
        held=held,
        moving=tuple(_body(c, 0, offsets) for c in capsules if c.link > 0),
        apart=_apart(top["self_pairs"], capsules, tools, offsets),
        masses=tuple(masses),
        tcp=point("tcp", JOINTS, vector(tool.get("tcp_m"), "model.tools.tcp_m", _size)),
        elbow=point("elbow", 2, offsets[2]),
        links=tuple(
            CheckerMass(body.link, kg, body.a, joints[k].inertia if k < JOINTS else None)
            for k, (body, kg) in enumerate(masses)
        ),
        torque_limits=tuple(j.torque_limit for j in joints),
    )


@dataclass(frozen=True, slots=True)
class _Joint:
    offset: Vec
    turn: Mat
    lowest: float
    highest: float
    speed_limit: float
    torque_limit: float
    mass: float
    com: Vec
    inertia: Mat


def _size(value: Any, place: str) -> float:
    return decimal(value, place, low=-SIZE_MOST_M, high=SIZE_MOST_M)


def _joint(row: Any) -> _Joint:
    names = (
        "name", "offset_m", "rpy_rad", "position_limit_rad", "speed_limit_rad_s", "torque_limit_nm", "mass_kg", "com_m",
        "inertia_kg_m2",
    )  # fmt: skip
    row = table(row, "model.joints", names, may=("position_low_rad", "inertia_products_kg_m2"))
    highest = decimal(row["position_limit_rad"], "model.joints.position_limit_rad")
    low = row.get("position_low_rad")
    roll, pitch, yaw = vector(row["rpy_rad"], "model.joints.rpy_rad", decimal)
    xx, yy, zz = vector(row["inertia_kg_m2"], "model.joints.inertia_kg_m2", decimal)
    products = row.get("inertia_products_kg_m2", [0.0, 0.0, 0.0])
    xy, xz, yz = vector(products, "model.joints.inertia_products_kg_m2", decimal)
    return _Joint(
        offset=vector(row["offset_m"], "model.joints.offset_m", _size),
        turn=product(_about_z(yaw), product(_about_y(pitch), _about_x(roll))),
        lowest=-highest if low is None else decimal(low, "model.joints.position_low_rad"),
        highest=highest,
        speed_limit=decimal(row["speed_limit_rad_s"], "model.joints.speed_limit_rad_s", low=1e-6),  # a divisor
        torque_limit=decimal(row["torque_limit_nm"], "model.joints.torque_limit_nm", low=1e-6),  # a divisor
        mass=decimal(row["mass_kg"], "model.joints.mass_kg", low=0),
        com=vector(row["com_m"], "model.joints.com_m", _size),
        inertia=((xx, xy, xz), (xy, yy, yz), (xz, yz, zz)),
    )


def _capsule(row: Any, part: str) -> _Capsule:
    place = "model.capsules"
    names = ("name", "a_m", "b_m", "radius_m")
    row = table(row, place, names if part else (*names, "link"), may=("overhang_m",))
    overhang = row.get("overhang_m")
    return _Capsule(
        name=word(row["name"], place),
        link=JOINTS if part else whole(row["link"], place, low=0, high=JOINTS),
        a=vector(row["a_m"], place, _size),
        b=vector(row["b_m"], place, _size),
        radius=decimal(row["radius_m"], place, low=1e-6, high=SIZE_MOST_M),  # a body has an extent
        part=part,
        overhang=None if overhang is None else decimal(overhang, place, low=0, high=SIZE_MOST_M),
    )


def _held(row: Any) -> CheckerGrippedObject:
    place = "model.held"
    _, ends, radius, mass, blunt = listed(row, place, least=5, most=5)  # object, ends, radius, mass, blunt
    a, b = (vector(end, place) for end in listed(ends, place, least=2, most=2))
    return CheckerGrippedObject(
        a=a,
        b=b,
        radius=exact(radius, place, low=1e-6, high=SIZE_MOST_M),  # a body has an extent
        mass_kg=None if mass is None else exact(mass, place, low=0),
        blunt=truth(blunt, place),
    )


def _body(capsule: _Capsule, reference: int, offsets: Sequence[Vec]) -> CheckerBody:
    """Body with its levers.

    From a joint's axis the next joint lies at a fixed distance, and the end no farther than the sum of the others.

    Both ends are inside the ball about their own link's origin, so one lever serves for both.
    """
    levers = [0.0] * JOINTS
    farthest = max(length(capsule.a), length(capsule.b))
    for joint in range(capsule.link, reference, -1):
        if joint == capsule.link:
            levers[joint - 1] = max(math.hypot(p[0], p[1]) for p in (capsule.a, capsule.b))
        else:
            levers[joint - 1] = math.hypot(offsets[joint][0], offsets[joint][1]) + farthest
            farthest += length(offsets[joint])
    c = capsule
    return CheckerBody(c.name, c.link, reference, c.a, c.b, c.radius, tuple(levers), c.part, c.overhang)


def _apart(
    named: Any, capsules: Sequence[_Capsule], tools: Sequence[dict[str, Any]], offsets: Sequence[Vec]
) -> tuple[tuple[CheckerBody, CheckerBody], ...]:
    """Pairs that must stay apart: those of the model, and the held object with all that moves otherwise."""
    place = "model.self_pairs"
    need(type(named) is dict and 0 < len(named) <= CAPSULES_MOST, Code.MEMBER_WRONG, place)
    by_name = {c.name: c for c in capsules}
    elsewhere = _names_of(tools)
    on_tool = [c.name for c in capsules if c.part == ON_TOOL]
    wanted: list[tuple[str, str]] = []
    for inner, others in named.items():
        for outer in listed(others, place, least=0, most=PAIRS_MOST):
            for name in on_tool if word(outer, place) == ON_TOOL else [outer]:
                need({inner, name} <= by_name.keys() | elsewhere, Code.MEMBER_WRONG, place)
                if {inner, name} <= by_name.keys():
                    wanted.append((inner, name))
    if PAYLOAD in by_name:
        wanted += [(c.name, PAYLOAD) for c in capsules if c.link < JOINTS]
    need(len(wanted) <= PAIRS_MOST, Code.TOO_LARGE, place)
    pairs: list[tuple[CheckerBody, CheckerBody]] = []
    bodies: dict[tuple[str, int], CheckerBody] = {}
    for inner, outer in sorted(wanted):
        fixed = by_name[inner]
        need(fixed.link < by_name[outer].link, Code.MEMBER_WRONG, place)
        key = (outer, fixed.link)
        if key not in bodies:
            bodies[key] = _body(by_name[outer], fixed.link, offsets)
        pairs.append((bodies[key], _body(fixed, fixed.link, offsets)))
    return tuple(pairs)


def _names_of(tools: Sequence[dict[str, Any]]) -> set[str]:
    """Names of the capsules of all tools, mounted or not."""
    place = "model.tools"
    rows = [row for tool in tools for row in listed(tool.get("capsules"), place, least=1, most=CAPSULES_MOST)]
    return {word(row.get("name"), place) for row in rows if type(row) is dict}


def _about_x(angle: float) -> Mat:
    c, s = math.cos(angle), math.sin(angle)
    return ((1.0, 0.0, 0.0), (0.0, c, -s), (0.0, s, c))


def _about_y(angle: float) -> Mat:
    c, s = math.cos(angle), math.sin(angle)
    return ((c, 0.0, s), (0.0, 1.0, 0.0), (-s, 0.0, c))


def _about_z(angle: float) -> Mat:
    c, s = math.cos(angle), math.sin(angle)
    return ((c, -s, 0.0), (s, c, 0.0), (0.0, 0.0, 1.0))


def bends(body: CheckerBody, ways: Sequence[float]) -> tuple[float, float, float]:
    """Bounds over the whole path: second and third derivative of the body's ends, second of its spin (PHY-9).

    With S_k the sum of |dq| up to joint k: sum of lever_k (S_k^n - S_(k-1)^n); for the spin sum of |dq_k| S_(k-1)^2.
    """
    second = third = spin = inner = 0.0
    for joint in range(body.reference, body.link):
        way = abs(ways[joint])
        outer = inner + way
        second += body.levers[joint] * (outer**2 - inner**2)
        third += body.levers[joint] * (outer**3 - inner**3)
        spin += way * inner**2
        inner = outer
    return second, third, spin
