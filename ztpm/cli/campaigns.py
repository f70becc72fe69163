"""Campaigns from the command line: which of them run, under which seed, and how far they are."""

from __future__ import annotations

import secrets
import time
from dataclasses import replace
from typing import TYPE_CHECKING, Any

from ztpm.cli.output import USAGE, console, fail

if TYPE_CHECKING:
    from collections.abc import Collection, Sequence
    from pathlib import Path

    from evaluation.tokens.campaign import Campaign, Outcome, Skipped


def run(
    campaigns: Sequence[Campaign],
    only: Collection[str] | None,
    *,
    quick: bool,
    seed: int | None,
    vectors: Path | None = None,
    as_json: bool,
) -> tuple[list[tuple[Campaign, Outcome | Skipped]], dict[str, Any]]:
    """What each campaign found, in their order, and the report of all of them.

    Ends the command with `UNKNOWN_CAMPAIGN` when `only` names none of them.

    Args:
        campaigns: all that there are.
        only: ids of those that are wanted; None or empty for all.
        quick: few trials.
        seed: of every draw; None draws a fresh one. The report has it, and people are told it first.
        vectors: the directory of vectors made by others, or None.
        as_json: no progress is shown.
    """
    from evaluation.tokens.campaign import Settings
    from evaluation.tokens.report import report

    seed = secrets.randbits(32) if seed is None else seed
    known = {campaign.id: campaign for campaign in campaigns}
    unknown = sorted(set(only or ()) - known.keys())
    if unknown:
        fail("UNKNOWN_CAMPAIGN", f"{', '.join(unknown)} is none of {', '.join(known)}", as_json=as_json, status=USAGE)
    chosen = [campaign for campaign in campaigns if not only or campaign.id in only]
    settings = Settings(quick=quick, seed=seed, vectors=vectors, clock_ns=time.perf_counter_ns, told=lambda _: None)
    if as_json:
        found = [(campaign, campaign.run(settings)) for campaign in chosen]
    else:
        console.print(f"seed {seed}")
        found = []
        with console.status("") as status:
            for campaign in chosen:
                told = lambda what, of=campaign.id: status.update(f"{of}: {what}")  # noqa: E731
                found.append((campaign, campaign.run(replace(settings, told=told))))
    return found, report(found, quick=quick, seed=seed)
