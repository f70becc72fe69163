"""Pictures of motions that records of enforcement points name, and whose texts follow. Pure."""

from __future__ import annotations

import re
from typing import TYPE_CHECKING, Final

from capabilities.statements.people import picture
from capabilities.values.errors import StatementError
from ztpm_idp.domain.codes import IdpCode, Refusal
from ztpm_idp.domain.events import PictureNamed, PictureTaken
from ztpm_idp.domain.parties import RegisteredPep, Standing

if TYPE_CHECKING:
    from collections.abc import Mapping

    from ztpm_idp.domain.commands import TakePicture
    from ztpm_idp.domain.registry import Outcome
    from ztpm_idp.domain.state import State

DIGEST: Final = re.compile(r"[0-9a-f]{64}")


def named_by(record: Mapping[str, object]) -> tuple[PictureNamed, ...]:
    """The picture that a journal's record names, if it is of that kind and names one."""
    match record:
        case {"kind": "picture", "body": {"digest": str(digest)}} if DIGEST.fullmatch(digest):
            return (PictureNamed(digest),)
        case _:
            return ()


def take_picture(state: State, command: TakePicture) -> Outcome:
    """Takes the text of a picture whose digest is on record ([CON-9]); nothing happens again for one that is here.

    It does not matter which enforcement point brings it: it is the text with this digest, or it is unknown.
    """
    pep = state.parties.get(command.by)
    if not isinstance(pep, RegisteredPep) or pep.standing is not Standing.ACTIVE:
        return Refusal(IdpCode.NOT_PERMITTED, "enforcement points bring pictures")
    if state.picture is None:
        return Refusal(IdpCode.PICTURE_UNKNOWN, "no record names a picture with this digest")
    if state.picture:
        return ()
    try:
        picture.read(command.text)
    except StatementError as error:
        return Refusal(error.code, error.detail)
    return (PictureTaken(picture.digest_of(command.text), command.text),)
