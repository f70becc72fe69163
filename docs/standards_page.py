"""Page docs/standards.md: published lists of risks and requirements, each row with the tests of ours that show it.

Each file of docs/standards is one list. It names every id that was looked at. An id has one row, in the same order, or
stands in a `[[left_out]]` with its reason. A row is *shown* by its tests, *partly* where it also says what they lack,
and *not covered* where it says that alone:

    [[row]]
    id = "ASI03"
    name = "identities and privileges are abused"       # our own words, never the list's
    does = "A token only narrows on its way down ..."   # one sentence: what we do about it
    shown = ["tests/pep/mcp/test_mcp.py::test_right_token_stolen_key", "AC-4-017"]
    lacks = "Code that runs as the same user as an agent can use that agent's key."

A test is named as pytest names it, with its case in brackets where that one case shows the row; a scenario of the red
team by its id. Read a test before you name it: it must show what the row says.
"""

from __future__ import annotations

import re
import textwrap
import tomllib
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Final

import msgspec

if TYPE_CHECKING:
    from collections.abc import Iterable

WIDTH: Final = 120
FOLDER: Final = Path(__file__).with_name("standards")
ORDER: Final = ("agentic_top_10", "aisvs_c9", "atlas", "sp_800_207", "iec_62443_3_3")
"""The files, in the order of the page."""
NODE: Final = re.compile(r"tests/[\w/]+/test_\w+\.py::test_\w+(?:\[[^\]|`]+\])?")
SCENARIO: Final = re.compile(r"AC-[1-5]-B?\d{3}")


class Fault(StrEnum):
    """Reason why a list is refused."""

    FORM = "FORM"
    """Not TOML, or a key that is missing, unknown or of another type."""
    ID_OF_ANOTHER_FORM = "ID_OF_ANOTHER_FORM"
    ID_UNKNOWN = "ID_UNKNOWN"
    """A row or a reason for an id that the list does not have."""
    ID_TWICE = "ID_TWICE"
    ID_WITHOUT_ROW = "ID_WITHOUT_ROW"
    ROW_OUT_OF_ORDER = "ROW_OUT_OF_ORDER"
    ROW_WITHOUT_EVIDENCE = "ROW_WITHOUT_EVIDENCE"
    """Neither a test nor a reason why there is none."""
    ROW_WITHOUT_DEED = "ROW_WITHOUT_DEED"
    """Tests, and no word about what is done."""
    NOT_A_TEST = "NOT_A_TEST"
    """Evidence that is named neither as a test nor as a scenario."""


class StandardsError(ValueError):
    """List that is refused, with its fault and the place."""

    def __init__(self, fault: Fault, place: str, detail: str = "") -> None:
        super().__init__(f"{fault}: {place}: {detail}" if detail else f"{fault}: {place}")
        self.fault, self.place = fault, place


class Row(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One requirement.

    Attributes:
        id: as the list has it.
        name: in few words of ours.
        does: what we do about it; empty where nothing is.
        shown: tests and scenarios that show it.
        lacks: what they do not show, or why there are none.
    """

    id: str
    name: str
    does: str = ""
    shown: tuple[str, ...] = ()
    lacks: str = ""

    @property
    def verdict(self) -> str:
        """Word of `VERDICTS` for the row."""
        if not self.shown:
            return "not covered"
        return "partly" if self.lacks else "shown"


class LeftOut(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """Ids that have no row, with the reason."""

    ids: tuple[str, ...]
    why: str


class Standard(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """One published list.

    Attributes:
        title: of its section.
        edition: that the rows are of.
        read: where its ids and names were read.
        note: what a reader has to know first.
        form: pattern of every id.
        column: heading of the ids.
        ids: all that were looked at, in order.
        left_out: those without a row.
        row: the others.
    """

    title: str
    edition: str
    read: str
    note: str
    form: str
    column: str
    ids: tuple[str, ...]
    left_out: tuple[LeftOut, ...] = ()
    row: tuple[Row, ...]

    def count(self, verdict: str) -> int:
        """Number of rows with this verdict."""
        return sum(row.verdict == verdict for row in self.row)


VERDICTS: Final = ("shown", "partly", "not covered")
OPENING: Final = """# Standards, row by row

<!-- Generated from the lists in docs/standards by `python -m docs.generate`. Do not edit. -->

Five published lists of risks and requirements, and what of each is shown here by a test. It is a map for readers who
think in one of these lists. It is no claim of conformity: nobody outside has reviewed it, and a test shows a case.

* A row is *shown* when its tests show what its sentence says and nothing is known to be missing, *partly* when it also
  says what they do not show or what is not done, and *not covered* when it says that alone.
* Run a test with `uv run --extra all --group dev pytest` and its name. Those of `tests/examples` need the environment
  of `make claw`; vectors of others, solvers and browsers are skipped where they are absent.
* What concerns a robot was seen on a simulated controller. [SECURITY.md](../SECURITY.md) has every promise and every
  limit, [evaluation.md](evaluation.md) what was measured.
* Names are our own short words, and ids are the lists' own. Where a list itself was not at hand, the table says what
  was read instead: compare before you rely on a name.
"""


def read(name: str, text: str) -> Standard:
    """The list of one file, with every rule of the form kept.

    Args:
        name: of the file, for the place of a fault.
        text: its contents, TOML.

    Raises:
        StandardsError: the list breaks a rule.
    """
    try:
        standard = msgspec.convert(tomllib.loads(text), type=Standard)
    except (tomllib.TOMLDecodeError, msgspec.ValidationError) as error:
        raise StandardsError(Fault.FORM, name, str(error)) from error
    without = [id_ for each in standard.left_out for id_ in each.ids]
    having = [row.id for row in standard.row]
    for id_ in standard.ids:
        if not re.fullmatch(standard.form, id_):
            raise StandardsError(Fault.ID_OF_ANOTHER_FORM, f"{name}: {id_}")
    for told in (standard.ids, [*having, *without]):
        for id_ in told:
            if id_ not in standard.ids:
                raise StandardsError(Fault.ID_UNKNOWN, f"{name}: {id_}")
            if list(told).count(id_) > 1:
                raise StandardsError(Fault.ID_TWICE, f"{name}: {id_}")
    for id_ in standard.ids:
        if id_ not in having and id_ not in without:
            raise StandardsError(Fault.ID_WITHOUT_ROW, f"{name}: {id_}")
    if having != [id_ for id_ in standard.ids if id_ in having]:
        raise StandardsError(Fault.ROW_OUT_OF_ORDER, name)
    for row in standard.row:
        _check(row, f"{name}: {row.id}")
    return standard


def _check(row: Row, place: str) -> None:
    if not row.shown and not row.lacks.strip():
        raise StandardsError(Fault.ROW_WITHOUT_EVIDENCE, place)
    if row.shown and not row.does.strip():
        raise StandardsError(Fault.ROW_WITHOUT_DEED, place)
    for named in row.shown:
        if not NODE.fullmatch(named) and not SCENARIO.fullmatch(named):
            raise StandardsError(Fault.NOT_A_TEST, place, named)


def standards(folder: Path = FOLDER) -> tuple[Standard, ...]:
    """Every list, in the order of the page."""
    return tuple(read(name, (folder / f"{name}.toml").read_text("utf-8")) for name in ORDER)


def page(of: Iterable[Standard]) -> str:
    """The whole page."""
    every = tuple(of)
    lines = [OPENING]
    lines += ["| list | edition | read from | rows | shown | partly | not covered |"]
    lines += ["| --- | --- | --- | ---: | ---: | ---: | ---: |"]
    lines += [
        _cells(
            f"[{each.title}](#{_anchor(each.title)})",
            each.edition,
            each.read,
            str(len(each.row)),
            *(str(each.count(verdict)) for verdict in VERDICTS),
        )
        for each in every
    ]
    for each in every:
        lines += ["", *_section(each)]
    return "\n".join(lines) + "\n"


def _section(standard: Standard) -> list[str]:
    lines = [f"## {standard.title}", "", _filled(standard.note), ""]
    lines += [_cells(standard.column, "name", "how far"), _cells(*["---"] * 3)]
    lines += [_cells(f"[{row.id}](#{_anchor(_heading(row))})", row.name, row.verdict) for row in standard.row]
    if standard.left_out:
        said = "; ".join(f"{', '.join(each.ids)} ({_one_line(each.why).rstrip('.')})" for each in standard.left_out)
        lines += ["", _filled(f"Left out: {said}.")]
    for row in standard.row:
        lines += ["", f"### {_heading(row)}"]
        lines += ["", _filled(row.does)] if row.does else []
        lines += ["", "```text", *row.shown, "```"] if row.shown else []
        lines += ["", _filled(f"*{row.verdict.capitalize()}*: {row.lacks}")] if row.lacks else []
    return lines


def _heading(row: Row) -> str:
    return f"{row.id}: {row.name}"


def _filled(text: str) -> str:
    return textwrap.fill(_one_line(text), WIDTH, break_long_words=False, break_on_hyphens=False)


def _one_line(text: str) -> str:
    return " ".join(text.split())


def _cells(*cells: str) -> str:
    return f"| {' | '.join(_one_line(cell).replace('|', chr(92) + '|') for cell in cells)} |"


def _anchor(title: str) -> str:
    return re.sub(r"[^\w\- ]", "", title.lower()).replace(" ", "-")
