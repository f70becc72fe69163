"""A world file as the scene of a simulated sensor: the people and loose objects that it shows."""

from __future__ import annotations

from typing import TYPE_CHECKING

from pep.pit.files import contradictions
from pep.pit.files import world_forms as forms
from pep.pit.files.old_files import renewed_shown
from pep.pit.files.plain_file import FileError, formed

if TYPE_CHECKING:
    from collections.abc import Iterator

    from pep.pit.files.faults import Fault


def shown_of(value: object) -> forms.ShownView:
    """Everybody and everything that a simulated sensor is told to show.

    Raises:
        FileError: not of the declared form, two of one name, or a body without a sound shape.
    """
    view: forms.ShownView = formed(forms.SHOWN, renewed_shown(value), place="file", elsewhere=forms.BELONGS).view
    found = tuple(_contradictions(view))
    if found:
        raise FileError.of(found)
    return view


def _contradictions(view: forms.ShownView) -> Iterator[Fault]:
    people = [(f"file.view.people.{row}", each) for row, each in enumerate(view.people)]
    objects = [(f"file.view.objects.{row}", each) for row, each in enumerate(view.objects)]
    for at, person in people:
        yield from contradictions.of_person(at, person)
    for at, thing in objects:
        yield from contradictions.of_shape(at, thing.id, thing, contradictions.INVALID)
    yield from contradictions.repeated([(at, each.id) for at, each in people] + [(at, each.id) for at, each in objects])
