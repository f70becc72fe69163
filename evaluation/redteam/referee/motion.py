"""Motion of the arm as it was observed, and the instants at which it is judged."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from evaluation.redteam.referee.errors import RefereeError, RefereeFault
from evaluation.redteam.referee.harm import SPEED_OVER_S, STEP_M

if TYPE_CHECKING:
    from collections.abc import Sequence

    from evaluation.redteam.referee.shapes import Floats
    from evaluation.redteam.referee.world import TrueWorld

JOINTS: Final = 6
OPEN_MM: Final = 85.0  # Robotiq 2F-85: stroke
"""Opening that is taken where nothing is known of the fingers: an activated gripper stands open."""


@dataclass(frozen=True, slots=True)
class Seen:
    """One sample of the controller, in the order of its own clock.

    Attributes:
        at_s: time; the controller's stamp is better than the arrival, since it has no jitter.
        q_rad: six measured joint angles.
        gripper_mm: opening between the finger tips, or None where it is not known.
    """

    at_s: float
    q_rad: tuple[float, ...]
    gripper_mm: float | None = None


@dataclass(frozen=True, slots=True)
class Instants:
    """Instants at which a motion is judged, so close that nothing comes farther than `STEP_M` between two.

    Attributes:
        at_s: times, shape (n,).
        q_rad: angles, shape (n, 6).
        qd_rad_s: speeds, shape (n, 6).
        opening_m: between the finger tips, shape (n,).
        travelled_m: bound of the way since the beginning of any point of arm or thing towards another, shape (n,).
    """

    at_s: Floats
    q_rad: Floats
    qd_rad_s: Floats
    opening_m: Floats
    travelled_m: Floats


def instants(samples: Sequence[Seen], world: TrueWorld, *, reach_m: Floats) -> Instants:
    """Instants of a motion.

    Between two samples, each joint is taken to turn steadily.

    Args:
        samples: in order of time, at least one.
        world: whose people and things move, too.
        reach_m: for each joint, the farthest that a point beyond it can be from its axis, shape (6,).

    Raises:
        RefereeError: `SAMPLES_MALFORMED`.
    """
    at = np.array([sample.at_s for sample in samples], dtype=np.float64)
    if not len(at) or any(len(sample.q_rad) != JOINTS for sample in samples):
        raise RefereeError(RefereeFault.SAMPLES_MALFORMED, "no sample, or one that has not six angles")
    q = np.array([sample.q_rad for sample in samples], dtype=np.float64)
    known = [(sample.at_s, sample.gripper_mm) for sample in samples if sample.gripper_mm is not None]
    opening = np.array(known or [(at[0], OPEN_MM)], dtype=np.float64)
    if not (np.isfinite(at).all() and np.isfinite(q).all() and np.isfinite(opening).all()):
        raise RefereeError(RefereeFault.SAMPLES_MALFORMED, "a number that is not finite")
    if (np.diff(at) < 0).any():
        raise RefereeError(RefereeFault.SAMPLES_MALFORMED, "samples that are not in order of time")
    steps = np.abs(np.diff(q, axis=0)) @ reach_m + world.travelled_m(at)
    gone = np.concatenate([[0.0], np.cumsum(steps)])
    chosen = np.arange(np.ceil(gone[-1] / STEP_M) + 1) * STEP_M
    chosen[-1] = gone[-1]
    times = np.interp(chosen, gone, at)
    half = SPEED_OVER_S / 2
    early, late = np.maximum(times - half, at[0]), np.minimum(times + half, at[-1])
    return Instants(
        at_s=times,
        q_rad=_each(chosen, gone, q),
        qd_rad_s=(_each(late, at, q) - _each(early, at, q)) / np.maximum(late - early, 1e-9)[:, None],
        opening_m=np.clip(np.interp(times, opening[:, 0], opening[:, 1]), 0.0, OPEN_MM) / 1e3,
        travelled_m=chosen,
    )


def _each(at: Floats, known_at: Floats, known: Floats) -> Floats:
    return np.stack([np.interp(at, known_at, known[:, joint]) for joint in range(known.shape[1])], axis=1)
