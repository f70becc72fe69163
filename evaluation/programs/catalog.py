"""Catalog of the programs: deed, scope and cell of each, and the call that is refused."""

from __future__ import annotations

import tomllib
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Final

from msgspec import Meta

from capabilities.values import strict_json
from capabilities.values.form import Form, FormError, read
from capabilities.values.scope_json import restriction_from_json
from ztpm.stage.stage import LEFT

if TYPE_CHECKING:
    from collections.abc import Collection, Sequence

    from capabilities.values.scope import Restriction

HERE: Final = Path(__file__).parent
ROWS: Final = HERE / "programs.toml"


class CatalogError(ValueError):
    """Catalog or choice of programs that is not as it must be; the text says where."""


class RefusedCall(Form, frozen=True):
    """Call of a program that nobody is granted.

    Attributes:
        call: ur_rtde's method, as docs/programs.md lists it.
        reason: code with which it is refused.
    """

    call: str
    reason: str


class ProgramRow(Form, frozen=True):
    """One program.

    Attributes:
        file: below this folder.
        does: what it does, as public programs do it.
        scope: name of its scope, a file of `scopes`.
        cell: name of its cell, a file of `cells`.
        people, objects: what the sensor sees meanwhile, in the words of the simulated sensor.
        start_rad: where the arm stands when it begins, six joint angles.
        refused: its call that is never granted; None for a program that runs to its end.
    """

    file: str
    does: str
    scope: str
    cell: str
    people: tuple[dict[str, Any], ...] = ()
    objects: tuple[dict[str, Any], ...] = ()
    start_rad: Annotated[tuple[float, ...], Meta(min_length=6, max_length=6)] = LEFT
    refused: RefusedCall | None = None

    @property
    def name(self) -> str:
        """The file's name, which no two programs share."""
        return Path(self.file).stem

    @property
    def path(self) -> Path:
        """The program itself."""
        return HERE / self.file


class _Catalog(Form, frozen=True):
    program: tuple[ProgramRow, ...]


def catalog() -> tuple[ProgramRow, ...]:
    """Every program, in the order of the file.

    Raises:
        CatalogError: the file has another form, or two programs have one name.
    """
    try:
        rows: tuple[ProgramRow, ...] = read(_Catalog, tomllib.loads(ROWS.read_text(encoding="utf-8"))).program
    except (FormError, tomllib.TOMLDecodeError) as error:
        raise CatalogError(f"{ROWS.name}: {error}") from error
    names = [row.name for row in rows]
    if len(set(names)) < len(names):
        raise CatalogError(f"{ROWS.name}: a name twice")
    return rows


def chosen(names: Collection[str]) -> tuple[ProgramRow, ...]:
    """Programs with these names; all for none.

    Raises:
        CatalogError: there is no such program.
    """
    rows = catalog()
    unknown = sorted(set(names) - {row.name for row in rows})
    if unknown:
        raise CatalogError(f"no program {', '.join(unknown)}; there are {', '.join(row.name for row in rows)}")
    return tuple(row for row in rows if not names or row.name in names)


def by_cell(rows: Sequence[ProgramRow]) -> dict[str, list[ProgramRow]]:
    """Programs by the name of their cell, in order."""
    found: dict[str, list[ProgramRow]] = {}
    for row in rows:
        found.setdefault(row.cell, []).append(row)
    return found


def scope_of(row: ProgramRow) -> Restriction:
    """Grants and ceiling of a program's scope: all that its file states.

    Raises:
        capabilities.values.errors.CapabilityError: the file has another form.
    """
    file = HERE / "scopes" / f"{row.scope}.json"
    return restriction_from_json(strict_json.parse(file.read_bytes()))


def cell_text(name: str) -> str:
    """Draft of a cell file, without author, audience and sensors, which the cell itself has."""
    return (HERE / "cells" / f"{name}.toml").read_text(encoding="utf-8")
