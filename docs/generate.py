"""Writes the generated pages, docs/schemas and files of deploy: `python -m docs.generate`.

The catalog gives docs/primitives.md, the command line docs/cli.md, the lists of docs/standards their page, and the
forms of files the schemas, and the services of a cell (ztpm/cell/service_files.py) the units and a compose file.

With `--check` nothing is written, and a difference fails.
"""

from __future__ import annotations

import argparse
import difflib
import json
import sys
import textwrap
from pathlib import Path
from typing import TYPE_CHECKING, Final

from policies import CATALOG, PARAMETERS, REASONS, Reason
from policies.evidence.tiers import RULES
from policies.primitives.catalog_row import Attack, Defence, Domain

if TYPE_CHECKING:
    from collections.abc import Iterable

    from policies.primitives.catalog_row import CatalogRow

WIDTH: Final = 120
PAGE: Final = Path(__file__).with_name("primitives.md")
COMMANDS: Final = Path(__file__).with_name("cli.md")
STANDARDS: Final = Path(__file__).with_name("standards.md")
SCHEMAS: Final = Path(__file__).with_name("schemas")
DEPLOY: Final = Path(__file__).parents[1] / "deploy"

OPENING: Final = """# The 25 primitives

<!-- Generated from policies/primitives/catalog.py, policies/words/parameters.py and policies/words/reason_table.py by
`python -m docs.generate`. Do not edit. -->

A primitive is one thing that must hold before an agent's act may have an effect. It looks at the evidence for one
request and says *holds*, *fails* or *defers* (a person may answer). A policy names primitives; `policies.decide`
combines what they say by deny-overrides.

## Where the meanings come from

The ids are the paper's ("When Agents Control Robots: A Zero Trust Policy Model for Agentic Cyber-Physical Systems").
The figure in which the paper draws them is not legible in our source. USED of the ids occur in its text and tables,
and the meanings below agree with every sentence and cell that uses them. The others have meanings that are **ours**,
taken from the paragraphs on their domains: OURS. All names are ours. Where the paper's authors mean something else by
an id, they are right and this page is to be mended.

## The table

"Points" are the enforcement points at which a primitive has evidence: e1 operator to orchestrator, e2 agent to agent,
e3 context admission, e4 tool call, e5 pre-actuation. A policy that names a primitive elsewhere is refused when it is
loaded.
"""

COMMON: Final = """## What all have in common

* **[POL-1]** Evidence that was not collected never permits: the primitive fails with `EVIDENCE_MISSING`.
* **[POL-2]** A fault of verification keeps its reason, whichever primitive meets it, and the finding is of the
  primitive that owns the reason.
* **[POL-3]** A fault of physics is no tier. It fails with its own reason, and no approval overrides it.
* **[POL-4]** Raising the tier never makes an answer milder; nor does any check that fails. A policy for which it
  would is refused when it is loaded.
* **[POL-5]** A DENY of any policy denies; a DEFER stands over a PERMIT; a policy that errors denies; where no policy
  that may permit concerns a request, it is denied.
* **[POL-6]** The runtime tier is the maximum of the tool's registered base tier and the computed one, and at least 3
  while the view of the cell is not fresh.
* **[POL-7]** A stop is asked for no grant, limit, trust, tier or physics.
* **[POL-12]** A reading with a value that is not of exactly the type which it declares denies with
  `EVIDENCE_MALFORMED` and the value's place, before any policy is asked.
* **[POL-8]** Trust in an edge is at most the policy's prior; a chain is as trusted as its weakest edge.
* **[POL-9]** Tier 4 is denied, and may be asked for only while a person's prior leave (an opening) for this agent,
  object and operation is in force.
* **[POL-10]** An approval turns a DEFER into a PERMIT when it resolves every reason of it, and lifts no DENY. It counts
  for the sponsor, policies and model that were shown, at the same tier, at an index not above what was shown by more
  than the slack, from the start that was shown, with no contribution that was not shown; while uses are left, before
  its end, on word of the identity provider as fresh as motion needs; by one person, at tier 4 by two, at most one of
  them the sponsor, with the opening that was named still in force; where the cell is not freshly seen, by people who
  all attest to seeing it clear. The PERMIT consumes one use.
* **[POL-11]** An approved act at tier 3, or in an unseen cell, is denied above the approved speed, and at tier 3
  above the approved contact.
"""


def _cells(cells: Iterable[str]) -> str:
    return f"| {' | '.join(cells)} |"


def _table(heading: tuple[str, ...], rows: Iterable[Iterable[str]]) -> list[str]:
    return [_cells(heading), _cells("---" for _ in heading), *(_cells(row) for row in rows), ""]


def _codes(reasons: Iterable[Reason]) -> str:
    return ", ".join(f"`{reason}`" for reason in reasons) or "none yet"


def _section(row: CatalogRow) -> list[str]:
    """The clause of one primitive and what belongs to it."""
    lines = [f"### {row.id} {row.name}", "", f"**[{row.clause}]** {row.must_hold}", ""]
    lines.append(f"* Points: {' '.join(sorted(row.points))}. Evidence: {', '.join(row.evidence)}.")
    if row.meaning_is_ours:
        lines.append("* The meaning of this id is ours.")
    if row.counters:
        counters = ", ".join(f"{attack} ({defence})" for attack, defence in row.counters)
        lines.append(f"* Counters: {counters}.")
    lines.append(f"* Decided by `{row.decides.__module__}.{row.decides.__name__}`; reasons: {_codes(row.reasons)}.")
    if row.parameters:
        lines.append(f"* Parameters: {', '.join(f'`{p.name}`' for p in row.parameters)}.")
    return [*lines, ""]


def _wrapped(line: str) -> list[str]:
    """A line of prose in lines of the usual width; tables and headings stay whole."""
    if line.startswith(("|", "#", "<!--")) or len(line) <= WIDTH:
        return [line]
    indent = "  " if line.startswith("* ") else ""
    return textwrap.wrap(line, WIDTH, subsequent_indent=indent, break_long_words=False, break_on_hyphens=False)


def _refilled(text: str) -> str:
    """The same paragraphs in lines of the usual width."""
    paragraphs = text.split("\n\n")
    return "\n\n".join(
        p if p.startswith(("#", "<!--")) else textwrap.fill(" ".join(p.split()), WIDTH) for p in paragraphs
    )


def page() -> str:
    """The whole page."""
    ours = [row.id for row in CATALOG if row.meaning_is_ours]
    opening = OPENING.replace("USED", str(len(CATALOG) - len(ours)))
    lines = [_refilled(opening.replace("OURS", f"{', '.join(ours[:-1])} and {ours[-1]}")), ""]
    lines += _table(
        ("id", "name", "points", "class", "reasons"),
        (
            (
                row.id,
                row.name,
                " ".join(sorted(row.points)),
                f"`{row.decides.__name__}`",
                _codes(row.reasons),
            )
            for row in CATALOG
        ),
    )
    lines += [COMMON]
    lines += ["## Tiers", ""]
    lines += _table(
        ("tier", "name", "asks for"),
        ((str(int(t)), t.name.lower().replace("_", " "), rule) for t, rule in RULES.items()),
    )
    lines += [
        "## Attacks",
        "",
        "The coverage that the paper claims. It is shown by tests only for what is written.",
        "",
    ]
    lines += _table(
        ("attack", *(str(defence) for defence in Defence)),
        (
            (
                attack,
                *(", ".join(row.id for row in CATALOG if (attack, defence) in row.counters) for defence in Defence),
            )
            for attack in Attack
        ),
    )
    for domain in Domain:
        lines += [f"## {domain.name}: {domain}", ""]
        for row in CATALOG:
            if row.domain is domain:
                lines += _section(row)
    lines += [
        "## Parameters",
        "",
        "A set states them under `[parameters]`; a policy may state another value beside a primitive.",
        "",
    ]
    lines += _table(
        ("name", "default", "unit", "range", "meaning", "source"),
        (
            (f"`{p.name}`", str(p.default), p.unit, f"{p.low} to {p.high}", p.meaning, p.source)
            for p in PARAMETERS.values()
        ),
    )
    lines += [
        "## Reasons",
        "",
        "The text is fixed: it is all that a stranger is told. The holder of a token also gets the detail.",
        "",
    ]
    lines += _table(
        ("code", "text", "remedy", "primitives"),
        ((f"`{reason}`", row.text, row.remedy, ", ".join(row.owners)) for reason, row in REASONS.items()),
    )
    return "\n".join(wrapped for line in "\n".join(lines).split("\n") for wrapped in _wrapped(line))


def generated() -> dict[Path, str]:
    """Every generated file and its whole text."""
    from docs import command_page, standards_page
    from pep.pit.files import schemas
    from ztpm.cell.service_files import shipped
    from ztpm.cli import app

    files = {
        "world": schemas.world_schema(),
        "motion": schemas.motion_schema(),
        "trajectory": schemas.trajectory_schema(),
    }
    pages = {PAGE: page(), COMMANDS: command_page.page(app), STANDARDS: standards_page.page(standards_page.standards())}
    services = {DEPLOY / name: text for name, text in shipped().items()}
    return (
        pages
        | services
        | {SCHEMAS / f"{name}.schema.json": json.dumps(schema, indent=2) + "\n" for name, schema in files.items()}
    )


def main(arguments: list[str]) -> int:
    """0 when the files are (or now are) what the code says, 1 when `--check` finds a difference."""
    parser = argparse.ArgumentParser(prog="python -m docs.generate", description=__doc__)
    parser.add_argument("--check", action="store_true", help="write nothing; print the difference and fail on one")
    checking = parser.parse_args(arguments).check
    different = False
    for file, wanted in generated().items():
        if not checking:
            file.parent.mkdir(exist_ok=True)
            file.write_text(wanted, encoding="utf-8")
            continue
        found = file.read_text("utf-8") if file.exists() else ""
        different |= found != wanted
        lines = found.splitlines(keepends=True), wanted.splitlines(keepends=True)
        sys.stdout.writelines(difflib.unified_diff(*lines, f"found/{file.name}", f"wanted/{file.name}"))
    return int(different)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
