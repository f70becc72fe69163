"""The claims about the boundary of tools, tried in full: `python -m tests.pep.mcp.campaign`; the figures last.

E1  one piece of evidence changed at each await point of a call: no effect begins on what has changed
E4  a server's definition of a tool changed: not called; the same said otherwise: no false alarm
E5  requests that two readers may read differently: the tool gets what was decided, in one encoding, or nothing
E6  ways to have something done that nobody permitted: none works
"""

from __future__ import annotations

import argparse
import tempfile
import time
from contextlib import contextmanager
from pathlib import Path

from tests.pep.mcp.campaign import definitions, evidence_changes, parsing, security
from tests.pep.mcp.campaign.stand import Stand
from tests.progress import Progress

SHOWN = 50
"""Failures of a part that are told."""


@contextmanager
def stood():
    """The processes, begun, and ended afterwards."""
    with tempfile.TemporaryDirectory() as folder:
        stand = Stand(Path(folder))
        try:
            yield stand.begin()
        finally:
            stand.end()


def e1(told):
    with tempfile.TemporaryDirectory() as folder:
        found = evidence_changes.run(Path(folder), told=told)
    points, beside = (
        found.tried,
        f"{found.executed} changes came after the effect had begun, {found.unseen} of them untold by the server",
    )
    return (
        points >= evidence_changes.LEAST,
        f"{points} changes at await points: {len(found.failed)} effects on changed evidence ({beside})",
        found.failed,
    )


def e4(told):
    with stood() as stand:
        found = definitions.run(stand, told=told)
    enough = (found.changes, found.same) == (definitions.CHANGES, definitions.SAME)
    alarms = sum(each.startswith("false alarm") for each in found.failed)
    figure = f"{found.changes} changed definitions: {len(found.failed) - alarms} failed; {found.same} said otherwise: {alarms} false alarms"
    return enough, figure, found.failed


def e5(told):
    with stood() as stand:
        found = parsing.run(stand, told=told)
    figure = (
        f"{found.http} requests over HTTP and {found.lines} lines over stdio, of which {found.carried} were carried out: "
        f"{len(found.failed)} failed"
    )
    return found.http >= parsing.LEAST and found.carried > 0, figure, found.failed


def e6(told):
    with stood() as stand:
        found = security.run(stand, told=told)
    return found.tried >= security.LEAST, f"{found.tried} security cases: {len(found.failed)} passed", found.failed


PARTS = {"E1": e1, "E4": e4, "E5": e5, "E6": e6}


def main(given=None):
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--only", action="append", choices=PARTS, help="this part alone; may be given again")
    given = parser.parse_args(given)
    began, progress, figures, well = time.monotonic(), Progress(), [], True
    for name in given.only or PARTS:
        try:
            enough, figure, failed = PARTS[name](progress.at)
        except Exception as error:  # noqa: BLE001 - told, and the other parts go on
            enough, figure, failed = False, f"broke off: {type(error).__name__}: {error}", []
        for each in failed[:SHOWN]:
            print(f"{name}: {each}"[:500])
        well = well and enough and not failed
        figures.append(f"{name}: {figure}{'' if enough else ': NOT WHOLE'}")
    print(f"{time.monotonic() - began:.0f} s")
    print("\n".join(figures))
    return 0 if well else 1


if __name__ == "__main__":
    raise SystemExit(main())
