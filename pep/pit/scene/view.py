"""View of the world for a decision, with the additions for its age or absence."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal

from pep.pit.base.errors import SceneError

if TYPE_CHECKING:
    from pep.pit.scene.cell import CellParameters
    from pep.pit.scene.scene import Scene


@dataclass(frozen=True, slots=True)
class View:
    """The scene that counts.

    Attributes:
        scene: the newest valid one, or the surveyed cell alone.
        perception: quality of the view.
        age_s: of the frame, None when there is none.
        stopping_age_s: addition to the reaction time.
        grown_m: distance of people from their seen place, at most.
        floor: index that the view itself forces.
        source: source of the oldest sighting, where it is stale and the frames are fresh; otherwise "".
    """

    scene: Scene
    perception: Literal["fresh", "stale", "missing"]
    age_s: float | None
    stopping_age_s: float
    grown_m: float
    floor: float
    source: str = ""


def view_of(scene: Scene | None, age_s: float | None, cell: CellParameters) -> View:
    """View for a decision.

    Fresh: as seen, the age enters the reaction time. Stale: the last valid scene, people grown by walking speed times
    age, and the floor. Missing or incomplete: what is known, and the floor; an unseen place may hold a person. A fresh
    view in which something was not seen for longer than the limit is stale, too (PHY-23).

    Raises:
        SceneError: a scene or an age that must not be reasoned about.
    """
    if scene is None or age_s is None:
        return View(cell.surveyed, "missing", None, 0.0, 0.0, cell.unknown_floor)
    wrong = scene.defect()
    if wrong is not None:
        raise SceneError("PERCEPTION_INVALID", wrong)
    if not (math.isfinite(age_s) and age_s >= 0):
        raise SceneError("PERCEPTION_INVALID", "an age that is none")
    if age_s > cell.perception_age_limit_s:
        return View(scene, "stale", age_s, age_s, cell.person_speed_m_s * age_s, cell.unknown_floor)
    if not scene.complete:
        return View(scene, "missing", age_s, age_s, 0.0, cell.unknown_floor)
    late = scene.oldest()
    if late is not None and not age_s + late.age_s <= cell.perception_age_limit_s:
        return View(scene, "stale", age_s, age_s, 0.0, cell.unknown_floor, late.source)
    return View(scene, "fresh", age_s, age_s, 0.0, 0.0)
