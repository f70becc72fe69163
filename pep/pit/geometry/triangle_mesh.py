"""Triangle meshes out of STL files, read strictly: closed surfaces of a body, in metres.

A body is enclosed by what is known of its surface. A hole in it, a corner that is no number or a length in another unit
would make less of a body than there is, so a mesh with one of them is refused, and what to do is said.
"""

from __future__ import annotations

import struct
from typing import TYPE_CHECKING, Final

import numpy as np

from pep.pit.base.errors import ModelError

if TYPE_CHECKING:
    from numpy.typing import NDArray

    from pep.pit.base.motion import Floats

TRIANGLES_LIMIT: Final = 100_000  # ours: a vendor's collision mesh of a link has 150 to 3000
BYTES_LIMIT: Final = 32 * 1_048_576  # ours: so many triangles in the longer, textual form
SIZE_LIMIT_M: Final = 3.0  # ours: no link of a table-top arm is longer; a longer one is in millimetres
SIZE_LEAST_M: Final = 1e-3  # ours: a smaller body is in another unit, or a flat picture
HEADER: Final = 80  # STL: bytes before the number of triangles
ROW: Final = np.dtype([("normal", "<3f4"), ("corners", "<9f4"), ("attribute", "<u2")])  # STL
SIDES: Final = 2  # triangles at each edge of a closed surface
FACET: Final = np.array(
    b"facet normal n n n outer loop vertex x x x vertex x x x vertex x x x endloop endfacet".split()
)
"""Words of a facet in the textual form.

Here x stands for a corner's number, and n for one of the normal, which is not read.
"""
WORDS: Final = len(FACET)


def mesh_of(raw: bytes, name: str, scale: tuple[float, float, float] = (1.0, 1.0, 1.0)) -> Floats:
    """Corners (n, 3, 3), metre, of an STL file's triangles.

    Args:
        raw: the file.
        name: in a refusal.
        scale: metres per unit of the file along its axes, each above 0.

    Raises:
        ModelError: no STL, no closed surface, or one that is too large, too small or of too many triangles.
    """
    if len(raw) > BYTES_LIMIT:
        _refuse(name, f"more than {BYTES_LIMIT} bytes", "export its convex hull, or decimate it")
    corners = _binary(raw, name) if _is_binary(raw) else _textual(raw, name)
    if not np.isfinite(corners).all():
        _refuse(name, "a corner that is no number", "export it again")
    found = corners.reshape(-1, 3, 3) * np.array(scale)
    size = float(np.ptp(found.reshape(-1, 3), axis=0).max())
    if not size <= SIZE_LIMIT_M:
        _refuse(
            name,
            f"{size:.3g} m long, beyond {SIZE_LIMIT_M} m",
            'if it is in millimetres, say scale="0.001 0.001 0.001"',
        )
    if not size >= SIZE_LEAST_M:
        _refuse(name, f"{size:.3g} m long, below {SIZE_LEAST_M} m", "say its scale in metres per unit")
    return _closed(found, name)


def _is_binary(raw: bytes) -> bool:
    """True where the length is that of the stated number of triangles; files of both forms may begin with `solid`."""
    if len(raw) < HEADER + 4:
        return False
    (count,) = struct.unpack_from("<I", raw, HEADER)
    return len(raw) == HEADER + 4 + int(count) * ROW.itemsize


def _binary(raw: bytes, name: str) -> Floats:
    (count,) = struct.unpack_from("<I", raw, HEADER)
    _counted(int(count), name)
    rows = np.frombuffer(raw, dtype=ROW, count=count, offset=HEADER + 4)
    return np.asarray(rows["corners"], dtype=float)


def _textual(raw: bytes, name: str) -> Floats:
    if not raw.lstrip().startswith(b"solid"):
        _refuse(name, "no STL, or one that was cut off", "export it again, as a binary STL")
    body = raw.partition(b"\n")[2]
    words = body[: body.rfind(b"endsolid")].split() if b"endsolid" in body else []
    if len(words) % WORDS or not words:
        _refuse(name, "no STL, or one that was cut off", "export it again, as a binary STL")
    count = len(words) // WORDS
    _counted(count, name)
    facets = np.array(words).reshape(count, WORDS)
    numeric = np.isin(FACET, (b"x", b"n"))
    try:
        numbers = facets[:, FACET == b"x"].astype(float)
    except ValueError:
        numbers = None
    if numbers is None or (facets[:, ~numeric] != FACET[~numeric]).any():
        _refuse(name, "no STL of one solid", "export it again, as a binary STL")
    return np.asarray(numbers)


def _counted(count: int, name: str) -> None:
    if count > TRIANGLES_LIMIT:
        _refuse(
            name, f"{count} triangles, beyond {TRIANGLES_LIMIT}", "export its convex hull, or decimate it, and fit that"
        )
    if count < 4:
        _refuse(name, "fewer than four triangles", "export the whole body")


def _closed(triangles: Floats, name: str) -> Floats:
    """Triangles with an area, when each edge is shared by two of them."""
    _, number = np.unique(triangles.reshape(-1, 3), axis=0, return_inverse=True)
    corner: NDArray[np.intp] = number.reshape(-1, 3)
    real = (corner != np.roll(corner, 1, axis=1)).all(axis=1)
    corner = corner[real]
    edges = np.sort(np.concatenate([corner[:, [0, 1]], corner[:, [1, 2]], corner[:, [2, 0]]]), axis=1)
    _, sides = np.unique(edges, axis=0, return_counts=True)
    open_edges = int((sides != SIDES).sum())
    if open_edges or not len(sides):
        _refuse(
            name, f"{open_edges} edges that two triangles do not share: a hole", "close it, or export its convex hull"
        )
    return np.asarray(triangles[real])


def _refuse(name: str, what: str, remedy: str) -> None:
    raise ModelError("PHYSICS_FAULT", f"{name}: {what}; {remedy}")
