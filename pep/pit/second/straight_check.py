"""Second engine: pinocchio moves the arm, coal measures, and the certified answer has to hold there.

It shares with the kernel the model file, the scene and the laws of an index, and nothing else: not the kinematics, not
the distances, not the speeds, not the profile's form. All pairs are asked at the witness and at a few configurations
that nobody can foresee (seeded by the command's digest).
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

import numpy as np

from pep.pit.second.compiled_sight import sight
from pep.pit.second.second_engine import DISTANCE_TOLERANCE_M, SPEED_TOLERANCE_M_S, Doubted, SecondWorld, Sight, doubted

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from pep.pit.base.motion import Floats, Profile
    from pep.pit.base.travel import Stopping
    from pep.pit.path.straight_path import Path
    from pep.pit.scene.pairs import Pairs
    from pep.pit.scene.scene import Scene
    from pep.pit.search.certify import Certified, Witness

INTERIOR: Final = 3  # configurations besides the witness
SEED_BYTES: Final = 8  # per configuration


@dataclass(frozen=True, slots=True)
class Disagreement:
    """Finding of the second engine that contradicts the first."""

    what: str


@dataclass(frozen=True, slots=True)
class Agreement:
    """The second engine found nothing above the certified answer, at so many configurations."""

    asked: int


def cross_check(
    path: Path,
    pairs: Pairs,
    scene: Scene,
    profile: Profile,
    stop: Stopping,
    *,
    certified: Certified,
    rows: NDArray[np.intp],
    seed: bytes,
) -> Agreement | Disagreement:
    """Asks pinocchio and coal about every pair at the witnesses and at the seeded configurations.

    Args:
        path: the joint path.
        pairs: pairs of bodies and obstacles; only their laws are used.
        scene: the same scene, from which coal's geometry is built anew.
        profile: the path's timing.
        stop: the stop of the motion.
        certified: the answer in question.
        rows: the pairs that `certified` speaks of.
        seed: digest of the command.
    """
    world = SecondWorld(path.robot, scene, pairs)
    watched: list[Witness] = [*certified.witnesses[:1], *certified.violated.values()]
    at = [profile.at(profile.time_of(w.s)) for w in watched]
    at += [profile.at(share * profile.duration_s) for share in fractions(seed)]  # these places cannot be foreseen
    met = np.array(at)
    q, qd = path.start + met[:, :1] * path.delta, path.delta * met[:, 1:]
    kernel, every = np.empty((len(watched), len(pairs))), np.arange(len(pairs))
    for told, witness in zip(kernel, watched, strict=True):
        told[:] = path.clearance_at(pairs, witness.key, every)
        told[witness.pair] = witness.clearance_m
    sight = look(world, q, qd, kernel, stop=stop, since=0, upper=certified.upper)
    if not sight.agrees:
        return Disagreement("clearance at the witness")
    for moving, witness in zip(sight.speed, watched, strict=False):
        if witness.index > 0 and not abs(moving[pairs.body[witness.pair]] - witness.speed_m_s) <= SPEED_TOLERANCE_M_S:
            return Disagreement("speed at the witness")
    return judged_where_near(world, sight, stop=stop, certified=certified, rows=rows)


def look(
    world: SecondWorld, q: Floats, qd: Floats, kernel: Floats, *, stop: Stopping, since: int, upper: float
) -> Sight:
    """Sight of these places; coal measures at the first ones.

    Args:
        world: the second engine.
        q: joint angles, (places, 6), rad.
        qd: their speeds, (places, 6), rad/s.
        kernel: the first engine's clearances at the first places, (measured, pairs).
        stop: the stop of the motion.
        since: the first place of which what is open counts.
        upper: the index that the first engine proved of the motion.
    """
    return Sight(q, len(kernel), *sight(world, q, qd, kernel, stop=stop, since=since, upper=upper))


def judged_where_near(
    world: SecondWorld, sight: Sight, *, stop: Stopping, certified: Certified, rows: NDArray[np.intp]
) -> Agreement | Disagreement:
    """Judgement as of `judged`, with distances only where the balls around both bodies do not settle it.

    Args:
        world: the second engine.
        sight: view of the second engine; open rows are measured in place.
        stop: the stop of the motion.
        certified: the answer in question; it counts at least as much as any motion.
        rows: the pairs that `certified` speaks of.
    """
    pairs, doubts = world.pairs, sight.open
    if len(rows) < len(pairs):
        doubts = doubts[np.isin(doubts[:, 1], rows)]
    if not len(doubts):
        return Agreement(len(sight.q))
    world.measure(sight, doubts)
    place, pair = doubts.T
    clearance, speed = sight.near[place, pair], sight.speed[place, pairs.body[pair]]
    found = doubted(pairs, stop, pair, clearance, speed, upper=certified.upper, violated=certified.violated)
    return _told(found, len(sight.q))


def judged(
    pairs: Pairs, stop: Stopping, certified: Certified, rows: NDArray[np.intp], *, clearance: Floats, speed: Floats
) -> Agreement | Disagreement:
    """Judgement of the certified answer by the measurements of `rows`, both of shape (places, rows)."""
    asked, upper, violated = np.tile(rows, len(clearance)), certified.upper, certified.violated
    found = doubted(pairs, stop, asked, clearance.ravel(), speed.ravel(), upper=upper, violated=violated)
    return _told(found, len(clearance))


def _told(found: Doubted, places: int) -> Agreement | Disagreement:
    if found.above.any():
        return Disagreement("index above the certified one")
    if found.below.any():
        return Disagreement("a violation that was not found")
    return Agreement(places)


def cross_check_rest(path: Path, pairs: Pairs, scene: Scene, clearance: Floats) -> Agreement | Disagreement:
    """Asks coal about every pair at the start of the path, where the kernel found `clearance`."""
    found, _ = SecondWorld(path.robot, scene, pairs).ask(path.q(0.0), np.zeros_like(path.delta))
    if not (np.abs(found - clearance) <= DISTANCE_TOLERANCE_M).all():
        return Disagreement("clearance at rest")
    return Agreement(1)


def fractions(seed: bytes) -> list[float]:
    """Times as fractions of the motion, from the seed."""
    stream = hashlib.sha256(b"interior" + seed).digest()
    words = [stream[k * SEED_BYTES : (k + 1) * SEED_BYTES] for k in range(INTERIOR)]
    return [int.from_bytes(word) / 256**SEED_BYTES for word in words]  # 256: values of a byte
