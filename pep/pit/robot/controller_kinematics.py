"""Kinematics of one arm as its controller tells them, turned into the calibration that the model takes.

The controller tells Denavit-Hartenberg parameters. Where two axes are almost parallel, their common normal lies far
away, and so do the frames that the parameters mean. A frame may slide along its joint's axis and turn about it without
changing what any joint angle means: here each is put where the model has it, as nearly as its axis allows.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np
import pinocchio

from pep.pit.base.errors import ModelError
from pep.pit.robot.calibration import LINKS, MEMBERS, Calibration, Placement
from pep.pit.robot.model import JOINTS

if TYPE_CHECKING:
    from collections.abc import Sequence

    import numpy.typing as npt

    from pep.pit.robot.model import Model

    Frame = npt.NDArray[np.float64]

SAME_M: Final = 1e-6  # ours: metre and radian; what the exports of four UR3e round is a thousandth of it (CAL)
FARTHEST_M: Final = 1e4  # ours: metre; a frame beyond ten kilometres of the arm leaves no digit of a micrometre
NEAR: Final = 0.5  # ours: cosine; axes of a calibrated arm stand within a hundredth of a radian of nominal (CAL)
FLANGE_M: Final = 1e-5  # ours: metre and radian; no known controller has any offset behind the last joint (CAL)
SEED: Final = 0xC70F6907  # of std::hash in libstdc++, with which the vendor's tool signs
FACTOR: Final = 0xC6A4A7935BD1E995  # likewise: MurmurHash64A
WORD: Final = (1 << 64) - 1  # 64 bits


@dataclass(frozen=True, slots=True)
class ControllerKinematics:
    """Denavit-Hartenberg parameters of one arm, six of each: rad, m, m, rad."""

    theta_rad: tuple[float, ...]
    a_m: tuple[float, ...]
    d_m: tuple[float, ...]
    alpha_rad: tuple[float, ...]

    @property
    def signature(self) -> str:
        """Checksum that the vendor's tool writes into its file, of the same parameters to six digits."""
        rows = zip(self.theta_rad, self.d_m, self.a_m, self.alpha_rad, strict=True)
        return f"calib_{_hashed(''.join(f'{x:g}' for row in rows for x in row).encode())}"


def told_calibration(model: Model, told: ControllerKinematics) -> Calibration | None:
    """The arm's own kinematics, each joint's frame as near to the model's as its axis allows.

    Args:
        model: nominal, of the same kind of arm.
        told: by the controller.

    Returns:
        None where the controller tells the model's nominal kinematics, to a micrometre and a microradian.

    Raises:
        ModelError: `PHYSICS_FAULT`: other than six joints, numbers that are not finite or beyond all measure, or a
            flange that is not the last joint's frame.
    """
    rows = (told.theta_rad, told.a_m, told.d_m, told.alpha_rad)
    if any(len(row) != JOINTS for row in rows):
        raise ModelError("PHYSICS_FAULT", "the controller tells kinematics of other than six joints")
    if not all(abs(x) <= FARTHEST_M for row in rows for x in row):  # NaN is refused by this, too
        raise ModelError("PHYSICS_FAULT", "the controller tells kinematics that no arm has")
    if not max(abs(told.a_m[-1]), abs(told.alpha_rad[-1])) <= FLANGE_M:
        raise ModelError("PHYSICS_FAULT", "the controller tells an offset behind the last joint")
    placed = _placed(_axes(told), _nominal(model))
    joints = tuple(_placement(before, frame) for before, frame in zip((np.eye(4), *placed), placed, strict=False))
    own = Calibration(joints, told.signature)
    return None if _same(joints, model) else own


def same_arm(one: Calibration, other: Calibration) -> bool:
    """True where every joint turns about the same axis and the flange is the same.

    To a micrometre and a microradian, whichever frames spell it.
    """
    return all(np.allclose(a, b, rtol=0.0, atol=SAME_M) for a, b in zip(_lines(one), _lines(other), strict=True))


def calibration_text(calibration: Calibration) -> str:
    """File of the calibration, in the form of the vendor's tool; `Calibration.from_yaml` reads the same numbers."""
    lines = ["kinematics:"]
    for name, joint in zip(LINKS, calibration.joints, strict=True):
        lines.append(f"  {name}:")
        numbers = (*joint.offset_m, *joint.rpy_rad)
        lines += [f"    {member}: {number!r}" for member, number in zip(MEMBERS, numbers, strict=True)]
    return "\n".join([*lines, f"  hash: {calibration.signature}", ""])


def _axes(told: ControllerKinematics) -> list[Frame]:
    """Frame of each joint in the base frame, every angle zero; the joint turns about its z axis."""
    found, at = [], np.eye(4)
    for theta, a, d, alpha in zip(told.theta_rad, told.a_m, told.d_m, told.alpha_rad, strict=True):
        found.append(at @ _screw(2, theta, d))
        at = found[-1] @ _screw(0, alpha, a)
    return found


def _screw(axis: int, turn_rad: float, along_m: float) -> Frame:
    """Turn about one axis and shift along it."""
    frame = np.eye(4)
    frame[:3, :3] = pinocchio.rpy.rpyToMatrix(*(turn_rad if each == axis else 0.0 for each in range(3)))
    frame[axis, 3] = along_m
    return frame


def _nominal(model: Model) -> list[Frame]:
    found, at = [], np.eye(4)
    for joint in model.joints:
        at = at @ _frame(Placement(joint.offset_m, joint.rpy_rad))
        found.append(at)
    return found


def _placed(axes: Sequence[Frame], wanted: Sequence[Frame]) -> list[Frame]:
    """Frames of the joints, put near to the wanted ones; the last is the flange, and stays."""
    return [*(_near(axis, near) for axis, near in zip(axes[:-1], wanted[:-1], strict=True)), axes[-1]]


def _near(axis: Frame, near: Frame) -> Frame:
    """The frame, slid along its z axis and turned about it to be nearest to another one."""
    z = axis[:3, 2]
    x = near[:3, 0] - z * float(z @ near[:3, 0])
    length = float(np.linalg.norm(x))
    if not (length > NEAR and float(z @ near[:3, 2]) > NEAR):
        raise ModelError("PHYSICS_FAULT", "the controller tells axes of another arm")
    x = x / length
    frame = np.eye(4)
    frame[:3, :3] = np.column_stack((x, np.cross(z, x), z))
    frame[:3, 3] = axis[:3, 3] + z * float(z @ (near[:3, 3] - axis[:3, 3]))
    return frame


def _placement(before: Frame, frame: Frame) -> Placement:
    between = np.linalg.inv(before) @ frame
    roll, pitch, yaw = (float(x) for x in pinocchio.rpy.matrixToRpy(between[:3, :3]))
    x, y, z = (float(each) for each in between[:3, 3])
    return Placement((x, y, z), (roll, pitch, yaw))


def _frame(placement: Placement) -> Frame:
    frame = np.eye(4)
    frame[:3, :3] = pinocchio.rpy.rpyToMatrix(*placement.rpy_rad)
    frame[:3, 3] = placement.offset_m
    return frame


def _lines(calibration: Calibration) -> list[Frame]:
    """Axes of the joints, every angle zero, each by its direction and its point nearest the base; then the flange."""
    found, at = [], np.eye(4)
    for joint in calibration.joints:
        at = at @ _frame(joint)
        found.append(at)
    lines = []
    for frame in found[:-1]:
        z, point = frame[:3, 2], frame[:3, 3]
        lines.append(np.column_stack((z, point - z * float(z @ point))))
    return [*lines, found[-1]]


def _same(joints: Sequence[Placement], model: Model) -> bool:
    nominal = (Placement(joint.offset_m, joint.rpy_rad) for joint in model.joints)
    return all(np.allclose(_frame(a), _frame(b), rtol=0.0, atol=SAME_M) for a, b in zip(joints, nominal, strict=True))


def _hashed(text: bytes) -> int:
    """MurmurHash64A, as libstdc++ has it."""

    def mixed(value: int) -> int:
        return value ^ (value >> 47)  # MurmurHash64A

    found = (SEED ^ (len(text) * FACTOR)) & WORD
    for at in range(0, len(text) // 8 * 8, 8):  # words of 8 bytes
        word = int.from_bytes(text[at : at + 8], "little") * FACTOR & WORD
        found = (found ^ (mixed(word) * FACTOR & WORD)) * FACTOR & WORD
    if rest := text[len(text) // 8 * 8 :]:
        found = (found ^ int.from_bytes(rest, "little")) * FACTOR & WORD
    return mixed(mixed(found) * FACTOR & WORD)
