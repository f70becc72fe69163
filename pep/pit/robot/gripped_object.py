"""Object in the gripper, as a body of the robot: a capsule or ball with its mass.

Its frame is the flange's.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, Final, assert_never

from pep.pit.base.errors import ModelError
from pep.pit.base.strict import STRICT
from pep.pit.geometry.shape import Capsule, Sphere

if TYPE_CHECKING:
    from pydantic import ConfigDict

    from pep.pit.geometry.shape import Vector

SIZE_LIMIT_M: Final = 2.0  # a table-top arm holds nothing longer; a larger number is a wrong unit


@dataclass(frozen=True, slots=True)
class GrippedObject:
    """An object in the gripper.

    Attributes:
        object: its id in the scene; "" when nobody knows which it is.
        shape: in the frame of the flange, metre.
        mass_kg: more than 0; None is unknown and counts as the robot's whole payload.
        blunt: it is known to have no edges; otherwise a blow with it counts as one with an edge.
    """

    __pydantic_config__: ClassVar[ConfigDict] = STRICT
    object: str
    shape: Capsule | Sphere
    mass_kg: float | None
    blunt: bool = False

    @property
    def ends_m(self) -> tuple[Vector, Vector]:
        """Both ends of the shape's axis, in the frame of the flange."""
        match self.shape:
            case Capsule(a, b, _):
                return a, b
            case Sphere(center, _):
                return center, center
            case _:
                assert_never(self.shape)

    @property
    def center_m(self) -> Vector:
        """Middle of the shape, which counts as the centre of its mass."""
        (ax, ay, az), (bx, by, bz) = self.ends_m
        return (0.5 * (ax + bx), 0.5 * (ay + by), 0.5 * (az + bz))

    def checked(self) -> GrippedObject:
        """The same object, after checks that it is possible.

        Raises:
            ModelError: a number that is not finite, a size or mass that cannot be.
        """
        numbers = [*self.ends_m[0], *self.ends_m[1]]
        sound = all(abs(n) <= SIZE_LIMIT_M for n in numbers) and 0 < self.shape.radius_m <= SIZE_LIMIT_M
        weighs = self.mass_kg is None or (math.isfinite(self.mass_kg) and self.mass_kg > 0)
        if not (sound and weighs):
            raise ModelError("PHYSICS_FAULT", "a held object that cannot be")
        return self
