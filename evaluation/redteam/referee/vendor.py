"""Collision meshes and parameter files of the UR3e's vendor, read from a directory and pinned by size and digest."""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final

import numpy as np
import yaml

from evaluation.redteam.referee.errors import RefereeError, RefereeFault

if TYPE_CHECKING:
    from pathlib import Path

    from evaluation.redteam.referee.shapes import Floats

REPOSITORY: Final = "UniversalRobots/Universal_Robots_ROS2_Description"
COMMIT: Final = "2221ec0f"
LAYOUTS: Final = (("collision", "."), ("meshes/ur3e/collision", "config/ur3e"))
"""Places of meshes and parameter files in a directory of these files alone, and in a checkout of the repository."""

KINEMATICS: Final = "default_kinematics.yaml"
MASSES: Final = "physical_parameters.yaml"
PINS: Final = {
    # size in bytes and SHA-256 of the vendor's files at that commit
    "base.stl": (21784, "2838ae72d4b6f1421083209ebdd9ea5cecd3a19a9b3ca60f4e0ad3300beeb648"),
    "shoulder.stl": (90684, "2edd8898d06fd4dd289e27dae047598ec7fa61e1860682452b57ed70c0e836d6"),
    "upperarm.stl": (101084, "009baa2a00697891cdc191a3cd9d4eae9106ba09c6e78db8d509b1c84fbaa41f"),
    "forearm.stl": (51384, "cbb4b2d2f024d05af7dad9cbaf018a11a360693ca5b96d3de89ea7ff2480bfca"),
    "wrist1.stl": (63584, "458cbd3b36b0419e9fafd13bfd1f1cd9fd47e4c31191d6c078b239f220dcfd28"),
    "wrist2.stl": (72784, "d2b00401f97d1a1d951a1a99c7dc74589009f80b6817d1c633cc793dcec083ad"),
    "wrist3.stl": (8084, "0795382b1ff170be3ce66ab44da8f4f41fd08096661471801fc627712d9c592f"),
    KINEMATICS: (639, "c0bfd5cb5bafd9df090a71a914bbeb8812a1a3b07f03fb930d6f8fa38fff9de7"),
    MASSES: (2784, "625e41e6b47990adf7eba665ddd42fc2df3e550be0a794aab52d5fbcfbd6577a"),
}
LINKS: Final = ("base", "shoulder", "upper_arm", "forearm", "wrist_1", "wrist_2", "wrist_3")
_QUARTER: Final = np.pi / 2
_MESHES: Final = {
    # file; place in the frame of its link, metre and roll, pitch, yaw: config/ur3e/visual_parameters.yaml
    "base": (
        "base.stl",
        (0.0, 0.0, 0.0),
        (0.0, 0.0, 0.0),
    ),  # against base_link_inertia, which the controller calls Base
    "shoulder": ("shoulder.stl", (0.0, 0.0, 0.0), (0.0, 0.0, np.pi)),
    "upper_arm": ("upperarm.stl", (0.0, 0.0, 0.120), (_QUARTER, 0.0, -_QUARTER)),
    "forearm": ("forearm.stl", (0.0, 0.0, 0.027), (_QUARTER, 0.0, -_QUARTER)),
    "wrist_1": ("wrist1.stl", (0.0, 0.0, -0.104), (_QUARTER, 0.0, 0.0)),
    "wrist_2": ("wrist2.stl", (0.0, 0.0, -0.08535), (0.0, 0.0, 0.0)),
    "wrist_3": ("wrist3.stl", (0.0, 0.0, -0.0921), (_QUARTER, 0.0, 0.0)),
}
_TRIANGLE: Final = np.dtype([("normal", "<3f4"), ("corners", "<9f4"), ("attribute", "<u2")])  # binary STL
_HEADER_BYTES: Final = 84  # binary STL: 80 of text, 4 of the number of triangles


@dataclass(frozen=True, slots=True)
class VendorArm:
    """UR3e by its vendor's files.

    Attributes:
        corners_m: vertices of each link's collision mesh in the frame of the link, shape (n, 3); the meshes are convex.
        places_m: origin of each of the six joints in the frame of the link before it, shape (6, 3).
        turns: rotation of the same, shape (6, 3, 3).
        moving_kg: mass of the six links that move.
    """

    corners_m: dict[str, Floats]
    places_m: Floats
    turns: Floats
    moving_kg: float


def vendor_arm(directory: Path) -> VendorArm:
    """The arm of the files in a directory.

    Args:
        directory: a checkout of the vendor's repository, or its `collision` folder beside its two parameter files.

    Raises:
        RefereeError: `MESH_MISSING` or `MESH_WRONG`, with the file's name and where it comes from.
    """
    meshes, config = next(
        ((directory / a, directory / b) for a, b in LAYOUTS if (directory / a).is_dir()),
        (directory / LAYOUTS[0][0], directory),
    )
    corners = {}
    for link, (name, place, angles) in _MESHES.items():
        raw = _pinned(meshes / name)
        triangles = np.frombuffer(raw, dtype=_TRIANGLE, offset=_HEADER_BYTES)
        points = np.unique(triangles["corners"].reshape(-1, 3).astype(np.float64), axis=0)
        corners[link] = points @ rotation(*angles).T + np.array(place)
    joints = yaml.safe_load(_pinned(config / KINEMATICS))["kinematics"]
    rows = [joints[name] for name in ("shoulder", "upper_arm", "forearm", "wrist_1", "wrist_2", "wrist_3")]
    masses: dict[str, Any] = yaml.safe_load(_pinned(config / MASSES))["inertia_parameters"]
    return VendorArm(
        corners_m=corners,
        places_m=np.array([[row["x"], row["y"], row["z"]] for row in rows], dtype=np.float64),
        turns=np.array([rotation(row["roll"], row["pitch"], row["yaw"]) for row in rows]),
        moving_kg=sum(float(masses[f"{link}_mass"]) for link in LINKS[1:]),
    )


def rotation(roll: float, pitch: float, yaw: float) -> Floats:
    """Rotation by URDF's angles: about the fixed axes x, y and z, in this order."""
    (cr, sr), (cp, sp), (cy, sy) = ((np.cos(angle), np.sin(angle)) for angle in (roll, pitch, yaw))
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )


def _pinned(path: Path) -> bytes:
    size, digest = PINS[path.name]
    source = f"it is a file of {REPOSITORY} at commit {COMMIT}"
    try:
        raw = path.read_bytes()
    except OSError as error:
        raise RefereeError(RefereeFault.MESH_MISSING, f"{path}: {error.strerror}; {source}") from error
    if len(raw) != size:
        raise RefereeError(RefereeFault.MESH_WRONG, f"{path}: {len(raw)} bytes instead of {size}; {source}")
    if hashlib.sha256(raw).hexdigest() != digest:
        raise RefereeError(RefereeFault.MESH_WRONG, f"{path}: not the pinned digest; {source}")
    return raw
