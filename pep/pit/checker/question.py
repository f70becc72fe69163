"""Question of a proof document: the cell's numbers, the obstacles, the view's age, objects to touch."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any, Final, Literal

from pep.pit.checker.distances import CheckerBox, Core, Face, Polytope, Segment, Vec, cross, dot, minus
from pep.pit.checker.text import exact, listed, parsed, table, truth, vector, whole, word
from pep.pit.checker.verdict import Code, need

PEOPLE_MOST: Final = 32  # in one cell
REGIONS_MOST: Final = 64  # of one person
THINGS_MOST: Final = 256  # objects and zones
EXTENT_MOST_M: Final = 100.0  # farther away is a wrong unit
LEAST_M: Final = 1e-6  # one unit of the wire: the least extent of a body
CORNERS: Final = (4, 64)  # fewest and most of a polytope
SIGHTING_MOST_S: Final = 3600.0  # an older one is none
UNIT: Final = 2.1e-3  # ||q| - 1| of a box's quaternion: as in an observation, and rounding
DIVISOR: Final = 1e-9  # least divisor
LIMBS: Final = frozenset({"upper_arm", "lower_arm", "hand"})  # PHY-3: one of these was tracked, so limbs are
REGIONS: Final = LIMBS | {"head", "neck", "torso", "abdomen", "pelvis", "thigh", "shin"}

Kind = Literal["person", "fragile", "rigid", "tiered_zone", "zone", "self", "workspace"]
VIOLABLE: Final = frozenset({"person", "fragile", "rigid", "zone", "self", "workspace"})  # PHY-5, PHY-6

NUMBERS: Final = (
    "stop_deceleration_rad_s2", "stop_delay_s", "watch_age_limit_s", "reaction_s", "person_speed_m_s",
    "intrusion_tracked_m", "intrusion_untracked_m", "person_uncertainty_m", "warn_band_m", "penetration_band_m",
    "harm_ratio_body", "harm_ratio_head", "contact_area_m2", "robot_uncertainty_m", "fragile_band_m", "rigid_band_m",
    "overlap_limit_m", "contact_speed_m_s", "contact_near_m", "contact_depth_m", "tcp_speed_limit_m_s",
    "elbow_speed_limit_m_s", "momentum_limit_kg_m_s", "perception_age_limit_s", "unknown_floor",
    "retreat_joint_speed_rad_s", "retreat_speed_m_s", "retreat_tolerance_m",
)  # fmt: skip
DIVIDING: Final = frozenset(
    {
        "stop_deceleration_rad_s2", "person_speed_m_s", "warn_band_m", "penetration_band_m", "harm_ratio_body",
        "harm_ratio_head", "contact_area_m2", "fragile_band_m", "rigid_band_m", "tcp_speed_limit_m_s",
        "elbow_speed_limit_m_s", "momentum_limit_kg_m_s", "contact_speed_m_s",
    }
)  # fmt: skip


@dataclass(frozen=True, slots=True)
class Cell:
    """The cell's numbers by their names in docs/physics.md, SI units; `payload_kg` None is unknown."""

    stop_deceleration_rad_s2: float
    stop_delay_s: float
    watch_age_limit_s: float
    reaction_s: float
    person_speed_m_s: float
    intrusion_tracked_m: float
    intrusion_untracked_m: float
    person_uncertainty_m: float
    warn_band_m: float
    penetration_band_m: float
    harm_ratio_body: float
    harm_ratio_head: float
    contact_area_m2: float
    robot_uncertainty_m: float
    fragile_band_m: float
    rigid_band_m: float
    overlap_limit_m: float
    contact_speed_m_s: float
    contact_near_m: float
    contact_depth_m: float
    tcp_speed_limit_m_s: float
    elbow_speed_limit_m_s: float
    momentum_limit_kg_m_s: float
    perception_age_limit_s: float
    unknown_floor: float
    retreat_joint_speed_rad_s: float
    retreat_speed_m_s: float
    retreat_tolerance_m: float
    payload_kg: float | None
    contacts: frozenset[tuple[str, str]]


def cell_of(value: Any) -> Cell:
    """Cell of the question.

    Raises:
        Refusal: a number that is missing, negative, or 0 where it divides.
    """
    row = table(value, "question.cell", (*NUMBERS, "payload_kg", "contacts"))
    numbers = {
        name: exact(row[name], f"question.cell.{name}", low=DIVISOR if name in DIVIDING else 0.0) for name in NUMBERS
    }
    carried = None if row["payload_kg"] is None else exact(row["payload_kg"], "question.cell.payload_kg", low=0)
    place = "question.cell.contacts"
    contacts = [
        listed(pair, place, least=2, most=2) for pair in listed(row["contacts"], place, least=0, most=THINGS_MOST)
    ]
    return Cell(
        **numbers,
        payload_kg=carried,
        contacts=frozenset((word(o, place), word(by, place, among=("tool", "payload"))) for o, by in contacts),
    )


@dataclass(frozen=True, slots=True)
class CheckerView:
    """Additions for the view's age (PHY-8): reaction time (s), people's growth (metre), index floor."""

    stopping_age_s: float
    grown_m: float
    floor: float


def view_of(value: Any, cell: Cell, *, complete: bool, late_s: float) -> CheckerView:
    """View: fresh, stale beyond the age limit, or missing (no age, or the sensors did not see all).

    Stale, too, is one in which something was last seen `late_s` before and thus longer ago than that (PHY-23).
    """
    if value is None:
        return CheckerView(0.0, 0.0, cell.unknown_floor)
    age = exact(value, "question.age_s", low=0)
    if age > cell.perception_age_limit_s:
        return CheckerView(age, cell.person_speed_m_s * age, cell.unknown_floor)
    whole_view = complete and age + late_s <= cell.perception_age_limit_s
    return CheckerView(age, 0.0, 0.0 if whole_view else cell.unknown_floor)


def latest_of(scene: dict[str, Any]) -> float:
    """Age of the oldest sighting when its sensor told of it, s."""
    rows = [*_seen(scene, "people", PEOPLE_MOST), *_seen(scene, "objects", THINGS_MOST)]
    return max(map(_late, rows), default=0.0)


def _seen(scene: dict[str, Any], name: str, most: int) -> list[Any]:
    return listed(scene[name], f"scene.{name}", least=0, most=most)


def _late(row: Any) -> float:
    """Age of a sighting when its sensor told of it."""
    need(type(row) is dict and "age_s" in row, Code.MEMBER_WRONG, "scene.age_s")
    return exact(row["age_s"], "scene.age_s", low=0, high=SIGHTING_MOST_S)


@dataclass(frozen=True, slots=True)
class Obstacle:
    """Obstacle of a body, at rest in that body's reference frame.

    Attributes:
        region: of a person, else "".
        core, radius: its shape, metre.
        uncertainty: distance by which it may be nearer than stated, metre.
        detail: intrusion of an unseen limb (m) of a person, band (m) of a thing, declared tier of a zone.
        touched_by: "tool" and "payload" where a touch is declared and granted.
    """

    kind: Kind
    region: str
    core: Core
    radius: float
    uncertainty: float
    detail: float
    touched_by: frozenset[str] = frozenset()


def scene_of(text: str) -> tuple[dict[str, Any], bool]:
    """Members of the scene, and whether the sensors saw all.

    Raises:
        Refusal: not a scene.
    """
    names = ("type", "people", "objects", "zones", "workspace", "complete")
    top = table(parsed(text, "scene", floats=False), "scene", names)
    need(top["type"] == "Scene", Code.MEMBER_WRONG, "scene.type")
    return top, truth(top["complete"], "scene.complete")


def obstacles_of(scene: dict[str, Any], cell: Cell, view: CheckerView, touch: frozenset[str]) -> list[Obstacle]:
    """People (region by region), objects and zones in the scene's order, then the six faces of the workspace."""
    found: list[Obstacle] = []
    for person in listed(scene["people"], "scene.people", least=0, most=PEOPLE_MOST):
        row = table(person, "scene.people", ("type", "id", "regions", "source", "age_s"))
        word(row["source"], "scene.people")
        walked = view.grown_m + cell.person_speed_m_s * _late(row)
        spread = cell.person_uncertainty_m + cell.robot_uncertainty_m + walked
        regions = [
            listed(each, "scene.people.regions", least=2, most=2)
            for each in listed(row["regions"], "scene.people.regions", least=1, most=REGIONS_MOST)
        ]
        names = [word(name, "scene.people.regions", among=REGIONS) for name, _ in regions]
        intrusion = cell.intrusion_untracked_m if LIMBS.isdisjoint(names) else cell.intrusion_tracked_m
        for name, (_, shape) in zip(names, regions, strict=True):
            core, radius = _shape(shape, "scene.people.regions")
            need(isinstance(core, Segment), Code.MEMBER_WRONG, "scene.people.regions")
            found.append(Obstacle("person", name, core, radius, spread, intrusion))
    things = listed(scene["objects"], "scene.objects", least=0, most=THINGS_MOST)
    for thing in things:
        row = table(thing, "scene.objects", ("type", "id", "kind", "shape", "uncertainty_m", "source", "age_s"))
        word(row["source"], "scene.objects")
        fragile = word(row["kind"], "scene.objects", among=("fragile", "rigid")) == "fragile"
        name = word(row["id"], "scene.objects")
        core, radius = _shape(row["shape"], "scene.objects")
        spread = exact(row["uncertainty_m"], "scene.objects", low=0) + cell.robot_uncertainty_m
        by = frozenset(by for known, by in cell.contacts if known == name and name in touch)
        band = cell.fragile_band_m if fragile else cell.rigid_band_m
        found.append(Obstacle("fragile" if fragile else "rigid", "", core, radius, spread, band, by))
    for zone in listed(scene["zones"], "scene.zones", least=0, most=THINGS_MOST - len(things)):
        row = table(zone, "scene.zones", ("type", "id", "shape", "tier", "source"))
        word(row["source"], "scene.zones")
        core, radius = _shape(row["shape"], "scene.zones")
        tier = None if row["tier"] is None else whole(row["tier"], "scene.zones", low=1, high=4)
        detail = cell.rigid_band_m if tier is None else float(tier)
        kind: Kind = "zone" if tier is None else "tiered_zone"
        found.append(Obstacle(kind, "", core, radius, cell.robot_uncertainty_m, detail))
    return found + _faces(scene["workspace"], cell)


def _faces(value: Any, cell: Cell) -> list[Obstacle]:
    """Faces of the workspace: per axis the upper one, then the lower one."""
    if value is None:
        return []
    row = table(value, "scene.workspace", ("type", "low_m", "high_m"))
    low, high = vector(row["low_m"], "scene.workspace"), vector(row["high_m"], "scene.workspace")
    need(all(a < b for a, b in zip(low, high, strict=True)), Code.MEMBER_WRONG, "scene.workspace")
    faces: list[Obstacle] = []
    for axis in range(3):
        for sign, offset in ((1.0, high[axis]), (-1.0, -low[axis])):
            x, y, z = (sign if axis == k else 0.0 for k in range(3))
            core = Face((x, y, z), offset)
            faces.append(Obstacle("workspace", "", core, 0.0, cell.robot_uncertainty_m, cell.rigid_band_m))
    return faces


def _place(value: Any, place: str) -> float:
    return exact(value, place, low=-EXTENT_MOST_M, high=EXTENT_MOST_M)


def _shape(value: Any, place: str) -> tuple[Core, float]:
    """Core and radius of a shape."""
    need(type(value) is dict, Code.MEMBER_WRONG, place)
    match value.get("type"):
        case "Capsule":
            row = table(value, place, ("type", "a_m", "b_m", "radius_m"))
            core = Segment(vector(row["a_m"], place, _place), vector(row["b_m"], place, _place))
            return core, exact(row["radius_m"], place, low=LEAST_M, high=EXTENT_MOST_M)
        case "Sphere":
            row = table(value, place, ("type", "center_m", "radius_m"))
            center = vector(row["center_m"], place, _place)
            return Segment(center, center), exact(row["radius_m"], place, low=LEAST_M, high=EXTENT_MOST_M)
        case "Convex":
            row = table(value, place, ("type", "vertices_m", "radius_m"))
            least, most = CORNERS
            rows = listed(row["vertices_m"], place, least=least, most=most)
            corners = tuple(vector(each, place, _place) for each in rows)
            need(_span(corners), Code.MEMBER_WRONG, place)
            return Polytope(corners), exact(row["radius_m"], place, low=0, high=EXTENT_MOST_M)
        case _:
            row = table(value, place, ("type", "center_m", "half_m", "quaternion"))
            need(row["type"] == "Box", Code.MEMBER_WRONG, place)
            half = vector(row["half_m"], place, _place)
            need(min(half) >= LEAST_M, Code.MEMBER_WRONG, place)
            w, x, y, z = (_place(each, place) for each in listed(row["quaternion"], place, least=4, most=4))
            norm = math.sqrt(w * w + x * x + y * y + z * z)
            need(abs(norm - 1) <= UNIT, Code.MEMBER_WRONG, place)
            w, x, y, z = w / norm, x / norm, y / norm, z / norm
            # The box's own axes in the base frame: unit vectors turned by the quaternion.
            axes = (
                (w * w + x * x - y * y - z * z, 2 * (x * y + w * z), 2 * (x * z - w * y)),
                (2 * (x * y - w * z), w * w - x * x + y * y - z * z, 2 * (y * z + w * x)),
                (2 * (x * z + w * y), 2 * (y * z - w * x), w * w - x * x - y * y + z * z),
            )
            return CheckerBox(vector(row["center_m"], place, _place), half, axes), 0.0


def _span(corners: tuple[Vec, ...]) -> bool:
    """True where these points are corners of a body."""
    away = [minus(corner, corners[0]) for corner in corners]
    far = max(away, key=lambda way: dot(way, way))
    normal = max((cross(far, way) for way in away), key=lambda found: dot(found, found))
    return max(abs(dot(normal, way)) for way in away) > LEAST_M * math.sqrt(dot(normal, normal)) > 0
