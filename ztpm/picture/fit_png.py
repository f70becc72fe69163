"""Picture of a fit: each mesh of an arm in its capsules, drawn by matplotlib."""

from __future__ import annotations

import importlib
import math
from typing import TYPE_CHECKING, Any, Final

import numpy as np

from pep.pit.picture.surface import capsule, normals_of
from ztpm.picture.png import INK, PAPER, SOFT, plots_in_space

if TYPE_CHECKING:
    from pathlib import Path

    from pep.pit.robot.robot_fit import FittedMesh, RobotFit

COLUMNS: Final = 4
CELL_INCH: Final = 4.0
AROUND: Final = 24
"""Corners of a capsule's ring."""
SIZE_M: Final = 0.03
"""Length of a capsule's triangles."""
EYE: Final = np.array([0.5, -0.75, 0.43])
MESH, CAPSULE = (0.36, 0.40, 0.44), (0.18, 0.50, 0.76, 0.22)
ROOM: Final = 1.08
"""Share of the largest extent that a view shows."""


def draw_fit(found: RobotFit, file: Path) -> None:
    """Draws all meshes of a fit in their capsules, and writes them to `file`.

    Raises:
        NoMatplotlibError: without matplotlib.
        OSError: the file cannot be written.
    """
    plots = plots_in_space()
    rows = max(1, math.ceil(len(found.meshes) / COLUMNS))
    figure = plots.figure(figsize=(COLUMNS * CELL_INCH, rows * CELL_INCH), facecolor=PAPER)
    for number, mesh in enumerate(found.meshes, start=1):
        axes = figure.add_subplot(rows, COLUMNS, number, projection="3d", computed_zorder=False, proj_type="ortho")
        _draw(axes, mesh)
        count = len(mesh.lines)
        several = "capsule" if count == 1 else "capsules"
        told = f"{mesh.link}: {count} {several}, excess at most {1e3 * mesh.excess.most_m:.0f} mm"
        axes.set_title(told, fontsize=10, color=SOFT, parse_math=False)
    figure.suptitle(f"{found.model.name}: meshes in their capsules", fontsize=15, color=INK, parse_math=False)
    figure.savefig(file, dpi=110, format="png", metadata={"Software": None})
    plots.close(figure)


def _draw(axes: Any, mesh: FittedMesh) -> None:
    collection = importlib.import_module("mpl_toolkits.mplot3d.art3d").Poly3DCollection
    around = [capsule(tuple(a), tuple(b), radius, SIZE_M, around=AROUND) for a, b, radius in mesh.lines]
    every = np.concatenate([mesh.triangles, *around]).reshape(-1, 3)
    middle, half = 0.5 * (every.min(axis=0) + every.max(axis=0)), 0.5 * ROOM * float(np.ptp(every, axis=0).max())
    shade = 0.55 + 0.45 * np.clip(normals_of(mesh.triangles) @ (EYE / np.linalg.norm(EYE)), 0, 1)
    axes.add_collection3d(collection(mesh.triangles, facecolors=shade[:, None] * MESH, edgecolors="none", zorder=1))
    for triangles in around:
        axes.add_collection3d(collection(triangles, facecolors=CAPSULE, edgecolors="none", zorder=2))
    for place, axis in zip(middle, "xyz", strict=True):
        getattr(axes, f"set_{axis}lim")(place - half, place + half)
    axes.set_box_aspect((1, 1, 1), zoom=1.6)
    axes.set_axis_off()
