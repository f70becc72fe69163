"""A person's word beside a URDF: place and kind of the tool, and the arm's payload.

It also names the capsules of links that are no neighbours and need no watching, and why. That part is checked, not
believed: see `pep.pit.robot.urdf_robot`.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, ClassVar, Final, Literal

from pep.pit.base.errors import ModelError
from pep.pit.base.strict import STRICT, FormError, read_table, read_toml
from pep.pit.robot.model import SCHEMA, RobotTool

if TYPE_CHECKING:
    from pydantic import ConfigDict

SIZE_LIMIT: Final = 262_144  # ours: characters; the shipped tools take 3000


@dataclass(frozen=True, slots=True)
class Apart:
    """A pair of capsules that is not watched.

    Attributes:
        inner, outer: their names, the one nearer the base first.
        why: they never come near each other, or they always overlap, since they reach over a short link between them.
    """

    __pydantic_config__: ClassVar[ConfigDict] = STRICT
    inner: str
    outer: str
    why: Literal["never", "always"]


@dataclass(frozen=True, slots=True)
class Outfit:
    """Everything about an arm that its URDF leaves out.

    Attributes:
        flange: the link whose frame the tool's numbers are in; its z axis is that of the last joint.
        payload_limit_kg: tool included, as the arm's maker states it.
        acceleration_limit_rad_s2: of any joint.
        tools: tools that may be mounted; the form is that of the shipped models.
        base: the link whose frame the controller calls its base; "" is the first link of the file. The UR description's
            `base_link` is half a turn off the controller's; there it is `base`.
        apart: pairs that are not watched.
    """

    __pydantic_config__: ClassVar[ConfigDict] = STRICT
    schema: int
    flange: str
    payload_limit_kg: float
    acceleration_limit_rad_s2: float
    tools: tuple[RobotTool, ...]
    base: str = ""
    apart: tuple[Apart, ...] = ()

    @staticmethod
    def from_toml(text: str) -> Outfit:
        """Outfit that a person has written.

        Raises:
            ModelError: a file that is not strictly of this form.
        """
        if len(text) > SIZE_LIMIT:
            raise ModelError("PHYSICS_FAULT", "an outfit of this length")
        try:
            outfit = read_table(Outfit, read_toml(text))
        except FormError as error:
            raise ModelError("PHYSICS_FAULT", str(error)) from error
        if outfit.schema != SCHEMA:
            raise ModelError("PHYSICS_FAULT", "unknown schema")
        return outfit
