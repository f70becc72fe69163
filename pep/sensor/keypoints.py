"""People by keypoints: seen joints become body regions, and of what is not seen the most that it could be.

Lengths are upper bounds, so that a body of any adult is inside: the 95th percentile of men (Huston, Principles of
Biomechanics, 2009, table of standing and sitting dimensions: upper arm 0.389 m, lower arm and hand 0.517, upper leg
0.660, lower leg 0.599, mid shoulder to vertex 0.305, mid shoulder to buttocks 0.645) times 1.1, rounded up. Radii are
those of the simulated adult, or larger. docs/sensors.md says what is assumed of parts that are not seen.
"""

from __future__ import annotations

import math
from functools import partial
from itertools import combinations
from typing import TYPE_CHECKING, Final

from pep.sensor.metres import PersonSight, ball, number, place, rod
from pep.sensor.sensor_error import SensorError, SensorFault

if TYPE_CHECKING:
    from collections.abc import Mapping, Sequence

    from capabilities.statements.observation import Capsule, Sphere
    from pep.sensor.camera import Camera
    from pep.sensor.metres import Place

    Keypoint = Sequence[float] | None

CAMERA_ERROR_M: Final = 0.10
"""Error that is added to every radius.

With the cell's own 0.05 m (PHY-3) it is the 0.15 m of a single sensor that is not safety-rated.
"""
LEAST_CONFIDENCE: Final = 0.3
"""A keypoint below is not seen, as pose estimators draw it. Ours."""
COCO_17: Final = (
    "nose", "left_eye", "right_eye", "left_ear", "right_ear", "left_shoulder", "right_shoulder", "left_elbow",
    "right_elbow", "left_wrist", "right_wrist", "left_hip", "right_hip", "left_knee", "right_knee", "left_ankle",
    "right_ankle",
)  # fmt: skip
"""Order of the COCO data set's keypoints."""
BODY_25: Final = (
    "nose", "neck", "right_shoulder", "right_elbow", "right_wrist", "left_shoulder", "left_elbow", "left_wrist",
    "mid_hip", "right_hip", "right_knee", "right_ankle", "left_hip", "left_knee", "left_ankle", "right_eye", "left_eye",
    "right_ear", "left_ear", "left_big_toe", "left_small_toe", "left_heel", "right_big_toe", "right_small_toe",
    "right_heel",
)  # fmt: skip
"""Order of OpenPose's BODY_25."""

FACE: Final = frozenset({"nose", "left_eye", "right_eye", "left_ear", "right_ear"})
FEET: Final = frozenset(name for name in BODY_25 if "toe" in name or "heel" in name)
SIDES: Final = ("left", "right")

HEAD_M: Final = 0.25  # from any point of the face to the farthest of the head: the height of a head, ours
NECK_M: Final = 0.40  # from the middle of the shoulders to the vertex: 0.34, and the neck bent
SHOULDER_M: Final = 0.26  # from the middle to one shoulder: half of 0.259 of a stature of 2 m (Drillis and Contini)
TRUNK_M: Final = 0.71  # from the middle of the shoulders to that of the hips
HIP_M: Final = 0.14  # from the middle to one hip, ours
UPPER_ARM_M: Final = 0.43
LOWER_ARM_M: Final = 0.36  # to the wrist: with the hand 0.60, above 0.57
HAND_M: Final = 0.24
THIGH_M: Final = 0.73
SHIN_M: Final = 0.66
FOOT_M: Final = 0.30  # from the ankle to the toes, ours

NECK_R: Final = 0.08  # metres, as all below: placeholders of pep.pit.scene.adult_body, or larger
TORSO_R: Final = 0.19
SHOULDERS_R: Final = 0.12
PELVIS_R: Final = 0.20
UPPER_ARM_R: Final = 0.08
LOWER_ARM_R: Final = 0.06
THIGH_R: Final = 0.12
SHIN_R: Final = 0.09
LEAN_M: Final = 0.20  # farthest that hidden hips are from below the shoulders: who is seen stands or leans, ours
STEP_M: Final = 0.40  # farthest that a hidden foot is from below the hip: half of a long step of 0.8 m, ours

_BONES: Final[dict[tuple[str, str], float]] = {
    **{(name, "neck"): NECK_M for name in FACE},
    **{(f"{side}_shoulder", "neck"): SHOULDER_M for side in SIDES},
    ("neck", "mid_hip"): TRUNK_M,
    **{(f"{side}_hip", "mid_hip"): HIP_M for side in SIDES},
    **{(f"{side}_elbow", f"{side}_shoulder"): UPPER_ARM_M for side in SIDES},
    **{(f"{side}_wrist", f"{side}_elbow"): LOWER_ARM_M for side in SIDES},
    **{(f"{side}_knee", f"{side}_hip"): THIGH_M for side in SIDES},
    **{(f"{side}_ankle", f"{side}_knee"): SHIN_M for side in SIDES},
}
"""Longest distances of joints that are neighbours."""
_DEEP_M: Final[dict[str, float]] = {
    **dict.fromkeys(("neck", "left_shoulder", "right_shoulder"), SHOULDERS_R),
    **dict.fromkeys(("mid_hip", "left_hip", "right_hip"), PELVIS_R / 2),
    **{f"{side}_elbow": LOWER_ARM_R for side in SIDES},
    **{f"{side}_wrist": LOWER_ARM_R / 2 for side in SIDES},
    **{f"{side}_knee": SHIN_R for side in SIDES},
    **{f"{side}_ankle": SHIN_R / 2 for side in SIDES},
}
"""Depth of each joint's middle below the surface that a camera sees; the face is taken as it is seen."""
SLACK_M: Final = 0.10
"""Error of two keypoints beyond which they are not of one body, on top of the longest body. Ours."""


def _reach_table() -> dict[frozenset[str], float]:
    """Longest distance of any two joints: the way between them along the body."""
    names = sorted({name for bone in _BONES for name in bone})
    far = dict.fromkeys(map(frozenset, combinations(names, 2)), math.inf)
    far |= {frozenset(bone): long_m for bone, long_m in _BONES.items()}
    for via in names:
        for one, other in combinations(names, 2):
            if via not in (one, other):
                way = far[frozenset((one, via))] + far[frozenset((via, other))]
                far[frozenset((one, other))] = min(far[frozenset((one, other))], way)
    return far


_REACH_M: Final = _reach_table()


def by_keypoints(
    names: Sequence[str],
    points: Sequence[Keypoint],
    *,
    floor_z_m: float,
    camera: Camera | None = None,
    on_surface: bool = True,
    error_m: float = CAMERA_ERROR_M,
    least_confidence: float = LEAST_CONFIDENCE,
    name: str = "",
) -> PersonSight:
    """Person by named keypoints.

    Args:
        names: of the keypoints, in their order.
        points: x, y, z in metres, and a confidence if there is one, for each; None for one that is not seen.
        floor_z_m: height of the floor in the base frame.
        camera: in whose own frame the points are; None for points in the base frame.
        on_surface: the points are on the body's surface, as out of a depth image; else they are middles of joints.
            Points without a camera are taken as middles.
        error_m: added to every radius.
        least_confidence: below it a keypoint is not seen.
        name: the person's id; "" for one who is known again by place.

    Raises:
        SensorError: with the place and the next step; `NO_DEPTH`, `NOT_FINITE`, `NOT_METRES`, `NO_BODY` or
            `SIGHT_MALFORMED`.
    """
    if len(points) != len(names):
        raise SensorError(
            SensorFault.SIGHT_MALFORMED, f"{len(points)} keypoints, not {len(names)}", "Give all, None for unseen ones."
        )
    seen: dict[str, Place] = {}
    for joint, point in zip(names, points, strict=True):
        at = _seen(point, joint, least_confidence)
        if at is not None and joint not in FEET:
            seen[joint] = _in_base(at, joint, camera, on_surface=on_surface)
    _in_metres(seen)
    return _Body(_of_one_body(seen), number(floor_z_m, "floor_z_m"), number(error_m, "error_m")).sight(name)


def _seen(point: Keypoint, joint: str, least: float) -> Place | None:
    if point is None:
        return None
    numbers = [number(each, joint) for each in point]
    if len(numbers) == 4:
        confidence = numbers.pop()
        if not 0 <= confidence <= 1:
            raise SensorError(
                SensorFault.SIGHT_MALFORMED, f"the confidence of {joint} is {confidence:g}", "Give 0 to 1."
            )
        if confidence < least:
            return None
    if not any(numbers):
        raise SensorError(SensorFault.NO_DEPTH, f"{joint} is (0, 0, 0)", "Say None for a keypoint without depth.")
    return place(numbers, joint)


def _in_base(at: Place, joint: str, camera: Camera | None, *, on_surface: bool) -> Place:
    if camera is None:
        return at
    return camera.behind(at, _DEEP_M.get(joint, 0.0)) if on_surface else camera.in_base(at)


def _in_metres(seen: Mapping[str, Place]) -> None:
    """Refuses a body that is far too small to be one in metres."""
    spans = [math.dist(one, other) for one, other in combinations(seen.values(), 2)]
    if len(seen) >= 4 and max(spans) < HEAD_M / 5:
        raise SensorError(
            SensorFault.NOT_METRES, f"all {len(seen)} keypoints are within {max(spans):.4f} m", "Give metres."
        )


def _of_one_body(seen: Mapping[str, Place]) -> dict[str, Place]:
    """Keypoints that can be of one body: those that are too far from most others are taken as not seen."""
    kept = dict(seen)
    while True:
        odd = [
            pair
            for pair in combinations(kept, 2)
            if math.dist(kept[pair[0]], kept[pair[1]]) > _REACH_M[frozenset(pair)] + SLACK_M
        ]
        if not odd:
            return kept
        faults = {joint: sum(joint in pair for pair in odd) for joint in kept}
        for joint, count in faults.items():
            if count == max(faults.values()):
                del kept[joint]


coco_17: Final = partial(by_keypoints, COCO_17)
"""Person by the 17 keypoints of COCO (YOLO pose, MMPose, Detectron2, MoveNet); the rest as of `by_keypoints`."""
body_25: Final = partial(by_keypoints, BODY_25)
"""Person by the 25 keypoints of OpenPose; the rest as of `by_keypoints`."""


class _Body:
    """Regions of one body, part by part."""

    def __init__(self, joints: Mapping[str, Place], floor_z_m: float, error_m: float) -> None:
        self._at = joints
        self._floor_z_m = floor_z_m
        self._error_m = error_m
        self._unseen: list[str] = []
        self._regions: list[tuple[str, Capsule | Sphere]] = []

    def sight(self, name: str) -> PersonSight:
        """The person, whole."""
        upper, upper_slack = self._upper()
        lower, lower_slack = self._lower(upper)
        if not lower[2] > self._floor_z_m - SLACK_M:
            raise SensorError(
                SensorFault.NO_BODY, "the hips are below the floor", "Check floor_z_m and the extrinsics."
            )
        self._head(upper, upper_slack)
        middle = _between(upper, lower)
        slack = max(upper_slack, lower_slack)
        self._add("torso", upper, middle, TORSO_R + slack)
        self._add("abdomen", middle, lower, TORSO_R + slack)
        hips = [self._at[f"{side}_hip"] for side in SIDES if f"{side}_hip" in self._at] or [lower]
        self._add("pelvis", hips[0], hips[-1], PELVIS_R + lower_slack)
        self._arms(upper)
        for side in SIDES:
            self._leg(side, lower)
        return PersonSight(tuple(self._regions), name, unseen=tuple(self._unseen))

    def _add(self, region: str, a_m: Place, b_m: Place, radius_m: float) -> None:
        radius_m += self._error_m
        self._regions.append((region, ball(a_m, radius_m) if a_m == b_m else rod(a_m, b_m, radius_m)))

    def _upper(self) -> tuple[Place, float]:
        """Middle of the shoulders, and how far off it may be."""
        shoulders = [self._at[name] for name in ("left_shoulder", "right_shoulder") if name in self._at]
        if len(shoulders) == 2:
            return _between(*shoulders), 0.0
        if "neck" in self._at:
            return self._at["neck"], 0.0
        if not shoulders:
            raise SensorError(
                SensorFault.NO_BODY,
                "no shoulder or neck is seen, or the keypoints are not of one body",
                "Tell the person by `person_at`, where only their place is known.",
            )
        return shoulders[0], SHOULDER_M

    def _lower(self, upper: Place) -> tuple[Place, float]:
        """Middle of the hips, and how far off it may be."""
        hips = [self._at[name] for name in ("left_hip", "right_hip") if name in self._at]
        if len(hips) == 2:
            return _between(*hips), 0.0
        if "mid_hip" in self._at:
            return self._at["mid_hip"], 0.0
        if hips:
            return hips[0], HIP_M
        self._unseen.append("hips")
        return (upper[0], upper[1], max(self._floor_z_m, upper[2] - TRUNK_M)), LEAN_M

    def _head(self, upper: Place, slack: float) -> None:
        face = [self._at[name] for name in FACE if name in self._at]
        if face:
            x, y, z = (sum(each) / len(face) for each in zip(*face, strict=True))
            self._regions.append(("head", ball((x, y, z), HEAD_M + self._error_m)))
            self._add("neck", upper, (x, y, z), NECK_R + slack)
            return
        self._unseen.append("head")
        self._regions.append(("head", ball(upper, NECK_M + slack + self._error_m)))

    def _arms(self, upper: Place) -> None:
        """Both arms; while any part of one is not seen, the seen parts count as trunk.

        Physics takes the arms of a person without arm regions for unseen, and lets them reach 0.85 m from every region
        (PHY-3). One region of an arm would end that for the other arm as well. The trunk's limits are below an arm's,
        for a robot of which half the moving mass and the tool have 2 kg or more.
        """
        arms = {side: [self._at.get(f"{side}_{part}") for part in ("shoulder", "elbow", "wrist")] for side in SIDES}
        hidden = [side for side, parts in arms.items() if None in parts]
        self._unseen += [f"{side}_arm" for side in hidden]
        for shoulder, elbow, wrist in arms.values():
            regions = ("torso",) * 3 if hidden else ("upper_arm", "lower_arm", "hand")
            if shoulder is not None:
                self._add("torso", upper, shoulder, SHOULDERS_R)
            if elbow is not None:
                self._add(regions[0], shoulder or elbow, elbow, UPPER_ARM_R)
            if elbow is not None and wrist is not None:
                self._add(regions[1], elbow, wrist, LOWER_ARM_R)
            if wrist is not None:
                self._add(regions[2], wrist, wrist, HAND_M)

    def _leg(self, side: str, lower: Place) -> None:
        hip, knee, ankle = (self._at.get(f"{side}_{part}") for part in ("hip", "knee", "ankle"))
        start = hip or lower
        if knee is not None:
            self._add("thigh", start, knee, THIGH_R)
        if ankle is not None:
            self._add("shin", knee or start, ankle, SHIN_R if knee else THIGH_R + _bulge_m(math.dist(start, ankle)))
            self._add("shin", ankle, ankle, FOOT_M)
            if knee is None:
                self._unseen.append(f"{side}_knee")
            return
        self._unseen.append(f"{side}_leg")
        top = knee or start
        self._add("shin", top, (top[0], top[1], self._floor_z_m), (SHIN_R if knee else THIGH_R) + STEP_M)


def _bulge_m(apart_m: float) -> float:
    """Longest distance of a hidden knee from the line between hip and ankle that are so far apart."""
    half = (THIGH_M + SHIN_M + apart_m) / 2
    squared = half * (half - THIGH_M) * (half - SHIN_M) * (half - apart_m)
    if apart_m <= math.sqrt(THIGH_M**2 - SHIN_M**2):
        return SHIN_M
    return 2 * math.sqrt(max(0.0, squared)) / apart_m


def _between(one: Place, other: Place) -> Place:
    x, y, z = ((a + b) / 2 for a, b in zip(one, other, strict=True))
    return x, y, z
