"""Registers as the program has written them: what it means, and not what the controller has."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pep.rtde.command.register_image import RegisterImage
from pep.rtde.wire.recipes import DOUBLE
from pep.rtde.wire.refusal import InputRefusal

if TYPE_CHECKING:
    from collections.abc import Mapping

    from pep.rtde.command.command_values import Six
    from pep.rtde.wire.codec import Value
    from pep.rtde.wire.recipes import WritableVariables


class ClientRegisters:
    """Image of all that one connection has written; blank at first."""

    def __init__(self, profile: WritableVariables) -> None:
        self._image = RegisterImage.blank(profile)
        self._later: Six | None = None  # first doubles that came since

    @property
    def command(self) -> int:
        """Id in its command register."""
        return self._image.whole(0)

    def later(self, six: Six) -> None:
        """Takes in its first six doubles, which are merged when the image is next wanted."""
        self._later = six

    def merged(self, values: Mapping[str, Value]) -> RegisterImage:
        """Image with these values merged.

        Raises:
            TypeError: a recipe is of the profile's variables, and types are the wire's, so this is a fault of ours.
        """
        six, self._later = self._later, None
        if six is not None:
            values = {**dict(zip(DOUBLE[self._image.profile.offset :], six, strict=False)), **values}
        if values:
            after = self._image.merge(values)
            if isinstance(after, InputRefusal):
                raise TypeError(after.place)
            self._image = after
        return self._image
