"""Point clouds and OctoMaps as few boxes that cover every occupied voxel: bounded in time, memory and number."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any, Final, Literal

from pep.sensor.metres import FAR_M, IN_METRES, Place, box, length, number, place, thing
from pep.sensor.sensor_error import SensorError, SensorFault

if TYPE_CHECKING:
    from collections.abc import Sequence

    from capabilities.statements.observation import ObservedObject
    from pep.sensor.camera import Camera

    Kind = Literal["fragile", "rigid"]

POINTS: Final = 1_000_000
"""Most points of a cloud: a depth image of 1280 x 720 has 921,600."""
LEAVES: Final = 200_000
"""Most occupied leaves of an OctoMap. Ours: a cell's surfaces in voxels of 2 cm are fewer."""
CELLS: Final = 4_000_000
"""Most voxels of the space that is looked at."""
BOXES: Final = 64
"""Boxes, unless another number is asked for; half of the objects that a frame may have."""
LEAST_RETURNS: Final = 0.5
"""Least share of a cloud's points that have a distance: below it the camera is covered, and sees nothing. Ours."""


def cloud_boxes(
    points: Any,
    *,
    low_m: Sequence[float],
    high_m: Sequence[float],
    voxel_m: float = 0.05,
    camera: Camera | None = None,
    kind: Kind = "rigid",
    most: int = BOXES,
    name: str = "cloud",
) -> list[ObservedObject]:
    """Boxes around all points of a cloud that lie in a space.

    The robot's own points have to be taken out before.

    Args:
        points: N x 3, metres, at most a million; a row of NaN or (0, 0, 0) is a ray without a distance.
        low_m: corner of the space in the base frame; what is outside is left out.
        high_m: the opposite corner.
        voxel_m: side of the voxels; doubled as often as it takes for so few boxes.
        camera: in whose own frame the points are; None for the base frame.
        kind: of all that is there.
        most: boxes at most.
        name: beginning of their ids.

    Raises:
        SensorError: `TOO_LARGE`, `NOT_METRES`, `NO_DEPTH` where most rays have no distance, or `SIGHT_MALFORMED`.
    """
    import numpy as np

    found = np.asarray(points, dtype=float)
    if found.ndim != 2 or found.shape[1] != 3:
        raise SensorError(SensorFault.SIGHT_MALFORMED, f"a cloud of shape {found.shape}", "Give N rows of x, y, z.")
    if len(found) > POINTS:
        raise SensorError(
            SensorFault.TOO_LARGE, f"{len(found)} points, over {POINTS}", "Take every n-th, or a voxel filter's output."
        )
    there = found[np.isfinite(found).all(axis=1) & found.any(axis=1)]
    if not len(there) >= LEAST_RETURNS * max(1, len(found)):
        raise SensorError(
            SensorFault.NO_DEPTH, f"{len(found) - len(there)} of {len(found)} points have no distance",
            "Look whether the sensor is covered, or out of its range.",
        )  # fmt: skip
    if camera is not None:
        there = there @ np.asarray(camera.rotation, dtype=float).T + np.asarray(camera.position_m, dtype=float)
    _in_metres(there)
    space = _Space(low_m, high_m, voxel_m)
    inside = there[((there >= space.low) & (there <= space.high)).all(axis=1)]
    space.fill(inside, inside)
    return space.boxes(most, kind, name)


def octomap_boxes(
    centers: Any,
    sizes: Any,
    *,
    low_m: Sequence[float],
    high_m: Sequence[float],
    voxel_m: float = 0.05,
    kind: Kind = "rigid",
    most: int = BOXES,
    name: str = "map",
) -> list[ObservedObject]:
    """Boxes around all occupied leaves of an OctoMap that reach into a space.

    Args:
        centers: N x 3, metres in the base frame.
        sizes: N whole sides, metres.
        low_m: as of `cloud_boxes`, and so all that follow.
        high_m: likewise.
        voxel_m: likewise.
        kind: likewise.
        most: likewise.
        name: likewise.

    Raises:
        SensorError: as `cloud_boxes`; `NOT_FINITE`: a leaf has no missing distances.
    """
    import numpy as np

    middles, sides = np.asarray(centers, dtype=float), np.asarray(sizes, dtype=float)
    if middles.ndim != 2 or middles.shape[1] != 3 or sides.shape != middles.shape[:1]:
        raise SensorError(SensorFault.SIGHT_MALFORMED, "leaves of unequal number", "Give N centres and N sides.")
    if len(middles) > LEAVES:
        raise SensorError(
            SensorFault.TOO_LARGE, f"{len(middles)} leaves, over {LEAVES}", "Prune the map, or cut it to the cell."
        )
    if not (np.isfinite(middles).all() and np.isfinite(sides).all()):
        raise SensorError(SensorFault.NOT_FINITE, "a leaf has a number that is none", "Leave that leaf out.")
    if not (sides > 0).all():
        raise SensorError(SensorFault.SIGHT_MALFORMED, "a leaf without a side", "Give each leaf's whole side.")
    _in_metres(middles)
    half = sides[:, None] / 2
    space = _Space(low_m, high_m, voxel_m)
    low, high = middles - half, middles + half
    reaches = ((high > space.low) & (low < space.high)).all(axis=1)
    space.fill(low[reaches], high[reaches])
    return space.boxes(most, kind, name)


def _in_metres(points: Any) -> None:
    import numpy as np

    if len(points) and float(np.median(np.abs(points).max(axis=1))) > FAR_M:
        raise SensorError(SensorFault.NOT_METRES, f"most points are over {FAR_M:g} m away", IN_METRES)


class _Space:
    """A space in voxels, each occupied or not."""

    def __init__(self, low_m: Sequence[float], high_m: Sequence[float], voxel_m: float) -> None:
        import numpy as np

        self._voxel_m = length(voxel_m, "voxel_m")
        self._low_m: Place = place(low_m, "low_m")
        self.low, self.high = np.array(self._low_m), np.array(place(high_m, "high_m"))
        counts = np.ceil((self.high - self.low) / self._voxel_m - 1e-9)
        if not (counts >= 1).all():
            raise SensorError(SensorFault.SIGHT_MALFORMED, "the space is empty", "Give low_m below high_m.")
        if not float(np.prod(counts)) <= CELLS:
            raise SensorError(SensorFault.TOO_LARGE, f"over {CELLS} voxels", "Give larger voxels, or a smaller space.")
        self._full = np.zeros([int(count) for count in counts], dtype=bool)

    def fill(self, low: Any, high: Any) -> None:
        """Occupies every voxel between these corners, each pair of which lies in the space at least in part."""
        import numpy as np

        last = np.array(self._full.shape) - 1
        first = np.clip(np.floor((low - self.low) / self._voxel_m + 1e-9).astype(int), 0, last)
        end = np.clip(np.ceil((high - self.low) / self._voxel_m - 1e-9).astype(int) - 1, first, last)
        small = (first == end).all(axis=1)
        self._full[tuple(first[small].T)] = True
        for (x0, y0, z0), (x1, y1, z1) in zip(first[~small], end[~small], strict=True):
            self._full[x0 : x1 + 1, y0 : y1 + 1, z0 : z1 + 1] = True

    def boxes(self, most: int, kind: Kind, name: str) -> list[ObservedObject]:
        """At most so many boxes that cover all occupied voxels, or voxels twice, four times... as large."""
        if not 1 <= number(most, "most") <= 128:
            raise SensorError(SensorFault.SIGHT_MALFORMED, f"most is {most}", "Give 1 to 128.")
        full, voxel_m = self._full, self._voxel_m
        while (blocks := _blocks(full, most)) is None:
            full, voxel_m = _coarser(full), 2 * voxel_m
        return [
            thing(f"{name}-{number_}", kind, box(
                [self._low_m[d] + voxel_m * (first[d] + end[d]) / 2 for d in range(3)],
                [voxel_m * (end[d] - first[d]) / 2 for d in range(3)],
            ))
            for number_, (first, end) in enumerate(blocks)
        ]  # fmt: skip


def _blocks(full: Any, most: int) -> list[tuple[tuple[int, int, int], tuple[int, int, int]]] | None:
    """Blocks of voxels that cover all occupied ones and nothing else, or None where more are needed."""
    import numpy as np

    left = full.copy()
    found: list[tuple[tuple[int, int, int], tuple[int, int, int]]] = []
    while left.any():
        if len(found) == most:
            return None
        x, y, z = (int(each) for each in np.unravel_index(int(left.argmax()), left.shape))
        z1 = z + _run(left[x, y, z:])
        y1 = y + _run(left[x, y:, z:z1].all(axis=1))
        x1 = x + _run(left[x:, y:y1, z:z1].all(axis=(1, 2)))
        left[x:x1, y:y1, z:z1] = False
        found.append(((x, y, z), (x1, y1, z1)))
    return found


def _run(flags: Any) -> int:
    """Number of flags that are set before the first that is not."""
    return len(flags) if flags.all() else int(flags.argmin())


def _coarser(full: Any) -> Any:
    """Voxels twice as large, occupied where any of the eight is."""
    import numpy as np

    padded = np.pad(full, [(0, count % 2) for count in full.shape])
    x, y, z = (count // 2 for count in padded.shape)
    return padded.reshape(x, 2, y, 2, z, 2).any(axis=(1, 3, 5))
