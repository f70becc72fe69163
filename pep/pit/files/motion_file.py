"""A motion file: one motion of the closed set, in SI units that its members name.

The form of each motion is made of its own dataclass: a new one is a row of `KINDS`, which adds the units that its
fields do not name.
"""

from __future__ import annotations

import hashlib
from dataclasses import MISSING, dataclass, fields
from functools import reduce
from operator import or_
from types import MappingProxyType
from typing import TYPE_CHECKING, Annotated, Any, Final, Literal, get_args, get_type_hints

from pydantic import Field, TypeAdapter, create_model

from pep.pit.base.motion import (
    BlendedPath,
    GripperMove,
    JointLeg,
    JointPath,
    JointTrajectory,
    LineLeg,
    LinePath,
    MoveJ,
    MoveL,
    OutputSet,
    ServoJ,
    SpeedJ,
    SpeedL,
)
from pep.pit.base.strict import STRICT
from pep.pit.files.plain_file import formed

if TYPE_CHECKING:
    from collections.abc import Mapping

    from pep.pit.base.motion import Motion

FORM: Final = "ztpm-motion/1"
_RAD: Final = "_rad"
_POSE: Final = "_m_rad"  # position, m, then rotation vector, rad


@dataclass(frozen=True, slots=True)
class MotionForm:
    """A motion that a file may state, and the units of those of its fields that do not name one."""

    made: type[Any]
    units: Mapping[str, str]


KINDS: Final[Mapping[str, MotionForm]] = MappingProxyType(
    {
        "move_j": MotionForm(MoveJ, {"start": _RAD, "target": _RAD}),
        "move_l": MotionForm(MoveL, {"start": _RAD, "target": _POSE, "stated_start": _POSE}),
        "joint_trajectory": MotionForm(JointTrajectory, {"points": _RAD, "speeds": "_rad_s"}),
        "joint_path": MotionForm(JointPath, {"start": _RAD}),
        "line_path": MotionForm(LinePath, {"start": _RAD}),
        "path": MotionForm(BlendedPath, {"start": _RAD}),
        "speed_j": MotionForm(SpeedJ, {"start": _RAD}),
        "speed_l": MotionForm(SpeedL, {"start": _RAD, "twist": "_m_s_rad_s"}),
        "servo_j": MotionForm(ServoJ, {"start": _RAD, "target": _RAD}),
        "gripper": MotionForm(GripperMove, {"q": _RAD}),
        "output": MotionForm(OutputSet, {}),
    }
)
"""Every motion, under the word of a file's `kind`."""
_LEGS: Final = (MotionForm(JointLeg, {"target": _RAD}), MotionForm(LineLeg, {"target": _POSE}))
"""Forms of the legs of a motion."""


def _form(kind: MotionForm, heading: Mapping[str, Any]) -> Any:
    hints = get_type_hints(kind.made)
    members: dict[str, Any] = {
        f.name + kind.units.get(f.name, ""): (_told(hints[f.name]), ... if f.default is MISSING else f.default)
        for f in fields(kind.made)
    }
    return create_model(kind.made.__name__, __config__=STRICT, __doc__=kind.made.__doc__, **heading, **members)


def _told(hint: Any) -> Any:
    """Type of a field as a file spells it: unchanged, or, for legs, their forms."""
    members = {member for part in get_args(hint) for member in (get_args(part) or (part,))}
    forms: list[Any] = [_form(kind, {}) for kind in _LEGS if kind.made in members]
    if not forms:
        return hint
    form: Any = reduce(or_, forms)
    return tuple[form, ...]


_ONE_OF: Any = reduce(
    or_,
    (
        _form(kind, {"form": Literal[FORM], "frame": Literal["base"], "kind": Literal[word]})
        for word, kind in KINDS.items()
    ),
)
ADAPTER: Final[TypeAdapter[Any]] = TypeAdapter(Annotated[_ONE_OF, Field(discriminator="kind")])
"""The strict form of the whole file."""


def motion_of(value: object) -> Motion:
    """The motion that a file's value states.

    Raises:
        FileError: not one of the declared forms; `FRAMES_MISMATCH` for any frame but the base's.
    """
    stated = formed(ADAPTER, value, place="motion")
    made: Motion = _made(KINDS[stated.kind], stated)
    return made


def _made(kind: MotionForm, stated: Any) -> Any:
    def plain(part: Any) -> Any:
        if not isinstance(part, tuple):
            return part
        legs = [next((leg for leg in _LEGS if type(each).__name__ == leg.made.__name__), None) for each in part]
        return tuple(each if leg is None else _made(leg, each) for leg, each in zip(legs, part, strict=True))

    given = {f.name: plain(getattr(stated, f.name + kind.units.get(f.name, ""))) for f in fields(kind.made)}
    return kind.made(**given)


def word_of(motion: Motion) -> str:
    """Word of a file for this kind of motion."""
    return next(word for word, kind in KINDS.items() if isinstance(motion, kind.made))


def seed_of(motion: Motion) -> bytes:
    """SHA-256 of the motion, exact to the last bit of each number."""
    return hashlib.sha256(repr(motion).encode()).digest()
