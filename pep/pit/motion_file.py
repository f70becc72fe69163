"""A motion file: one motion of the closed set, in SI units that its members name.

The form of each motion is made of its own dataclass: a new one is a row of `KINDS`. Joint angles, whose fields name no
unit, are spelt with `_rad`.
"""

from __future__ import annotations

import hashlib
from dataclasses import MISSING, fields
from functools import reduce
from operator import or_
from types import MappingProxyType
from typing import TYPE_CHECKING, Annotated, Any, Final, Literal, get_type_hints

from pydantic import Field, TypeAdapter, create_model

from pep.pit.files import formed
from pep.pit.motion import GripperMove, Joints, Motion, MoveJ, OutputSet, SpeedJ
from pep.pit.strict import STRICT

if TYPE_CHECKING:
    from collections.abc import Mapping

KINDS: Final[Mapping[str, type[Motion]]] = MappingProxyType(
    {
        "move_j": MoveJ,
        "speed_j": SpeedJ,
        "gripper": GripperMove,
        "output": OutputSet,
    }
)
"""Every motion that a file may state, under the word that its `kind` says."""
FORM: Final = "ztpm-motion/1"
_RADIANS: Final = "_rad"


def _spelling(kind: type[Motion]) -> dict[str, str]:
    """How a file spells each field."""
    hints = get_type_hints(kind)

    def unitless(name: str) -> bool:
        return hints[name] == Joints and _RADIANS not in name

    return {f.name: f.name + _RADIANS if unitless(f.name) else f.name for f in fields(kind)}


def _form(word: str, kind: type[Motion]) -> Any:
    hints, spelt = get_type_hints(kind), _spelling(kind)
    heading: dict[str, Any] = {"form": Literal[FORM], "frame": Literal["base"], "kind": Literal[word]}
    members: dict[str, Any] = {
        spelt[f.name]: (hints[f.name], ... if f.default is MISSING else f.default) for f in fields(kind)
    }
    return create_model(kind.__name__, __config__=STRICT, __doc__=kind.__doc__, **heading, **members)


_ONE_OF: Any = reduce(or_, (_form(word, kind) for word, kind in KINDS.items()))
ADAPTER: Final[TypeAdapter[Any]] = TypeAdapter(Annotated[_ONE_OF, Field(discriminator="kind")])
"""The strict form of the whole file."""


def motion_of(value: object) -> Motion:
    """The motion that a file's value states.

    Raises:
        FileError: not one of the declared forms; `FRAMES_MISMATCH` for any frame but the base's.
    """
    stated = formed(ADAPTER, value, place="motion")
    kind = KINDS[stated.kind]
    return kind(**{name: getattr(stated, spelt) for name, spelt in _spelling(kind).items()})


def seed_of(motion: Motion) -> bytes:
    """SHA-256 of the motion, exact to the last bit of each number."""
    return hashlib.sha256(repr(motion).encode()).digest()
