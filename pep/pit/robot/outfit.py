"""A person's word beside a URDF: place and kind of the tool, and the arm's payload.

It also names the capsules of links that are no neighbours and need no watching, and why. That part is checked, not
believed: see `pep.pit.robot.urdf_robot`.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, ClassVar, Final, Literal, TypeVar

from pep.pit.base.errors import ModelError
from pep.pit.base.strict import STRICT, FormError, read_table, read_toml
from pep.pit.geometry.xml_elements import MACROS
from pep.pit.robot.model import SCHEMA, RobotTool

if TYPE_CHECKING:
    from pydantic import ConfigDict

SIZE_LIMIT: Final = 262_144  # ours: characters; the shipped tools take 3000


@dataclass(frozen=True, slots=True)
class Apart:
    """A pair of capsules that is not watched.

    Attributes:
        inner, outer: their names, the one nearer the base first; a link's name stands for all its capsules.
        why: they never come near each other; or they always overlap, since they reach over a short link between them;
            or the maker lets both joints between them turn all the way round, so that they cannot meet.
    """

    __pydantic_config__: ClassVar[ConfigDict] = STRICT
    inner: str
    outer: str
    why: Literal["never", "always", "turns"]


@dataclass(frozen=True, slots=True)
class StatedRange:
    """Range of a joint.

    The file leaves it open, or it is narrower than the file's, or of several turns.
    """

    __pydantic_config__: ClassVar[ConfigDict] = STRICT
    joint: str
    low_rad: float
    high_rad: float


@dataclass(frozen=True, slots=True)
class Outfit:
    """Everything about an arm that its URDF leaves out.

    Attributes:
        flange: the link whose frame the tool's numbers are in; its z axis is that of the last joint.
        payload_limit_kg: tool included, as the arm's maker states it.
        acceleration_limit_rad_s2: of any joint.
        tools: tools that may be mounted; the form is that of the shipped models. They may be in a file of their own.
        base: the link whose frame the controller calls its base; "" is the first link of the file. The UR description's
            `base_link` is half a turn off the controller's; there it is `base`.
        apart: pairs that are not watched.
        ranges: of joints whose range the file leaves open, or of several turns.
        left_out: joints of the file that are not read, with all that hangs on them, such as those of a gripper.
        vocabularies_left_out: prefixes of namespaces whose attributes and elements are not read.
    """

    __pydantic_config__: ClassVar[ConfigDict] = STRICT
    schema: int
    flange: str
    payload_limit_kg: float
    acceleration_limit_rad_s2: float
    tools: tuple[RobotTool, ...] = ()
    base: str = ""
    apart: tuple[Apart, ...] = ()
    ranges: tuple[StatedRange, ...] = ()
    left_out: tuple[str, ...] = ()
    vocabularies_left_out: tuple[str, ...] = ()

    @staticmethod
    def from_toml(text: str) -> Outfit:
        """Outfit that a person has written.

        Raises:
            ModelError: a file that is not strictly of this form.
        """
        outfit = _read(Outfit, text)
        if len({stated.joint for stated in outfit.ranges}) != len(outfit.ranges):
            raise ModelError("PHYSICS_FAULT", "ranges: a joint twice")
        if MACROS in outfit.vocabularies_left_out:
            raise ModelError(
                "PHYSICS_FAULT", "vocabularies_left_out: macros must be expanded, by `xacro X.xacro > X.urdf`"
            )
        return outfit

    def fitted_with(self, tools: tuple[RobotTool, ...]) -> Outfit:
        """The same outfit with further tools."""
        return replace(self, tools=(*self.tools, *tools))

    def range_of(self, joint: str) -> StatedRange | None:
        """Range that is stated of a joint."""
        return next((stated for stated in self.ranges if stated.joint == joint), None)


@dataclass(frozen=True, slots=True)
class ToolFile:
    """Tools in a file of their own, for any arm with the same flange."""

    __pydantic_config__: ClassVar[ConfigDict] = STRICT
    schema: int
    tools: tuple[RobotTool, ...]

    @staticmethod
    def from_toml(text: str) -> ToolFile:
        """Tools that a person has written.

        Raises:
            ModelError: a file that is not strictly of this form.
        """
        return _read(ToolFile, text)


_File = TypeVar("_File", Outfit, ToolFile)


def _read(form: type[_File], text: str) -> _File:
    if len(text) > SIZE_LIMIT:
        raise ModelError("PHYSICS_FAULT", "an outfit of this length")
    try:
        found = read_table(form, read_toml(text))
    except FormError as error:
        raise ModelError("PHYSICS_FAULT", str(error)) from error
    if found.schema != SCHEMA:
        raise ModelError("PHYSICS_FAULT", "unknown schema")
    return found
