"""Results of the campaigns, as JSON, as a table and as one line."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from rich.table import Table

from evaluation.harness.campaign import Outcome, Skipped

if TYPE_CHECKING:
    from collections.abc import Sequence

    from evaluation.harness.campaign import Campaign


def report(found: Sequence[tuple[Campaign, Outcome | Skipped]], *, quick: bool, seed: int) -> dict[str, Any]:
    """One JSON object; `ok` when nothing that ran was missed and something ran."""
    ran = [outcome for _, outcome in found if isinstance(outcome, Outcome)]
    return {
        "ok": bool(ran) and all(outcome.met for outcome in ran),
        "quick": quick,
        "seed": seed,
        "campaigns": [_described(campaign, outcome) for campaign, outcome in found],
    }


def _described(campaign: Campaign, outcome: Outcome | Skipped) -> dict[str, Any]:
    head = {"id": campaign.id, "title": campaign.title, "bar": campaign.bar}
    match outcome:
        case Outcome():
            return {
                **head,
                "met": outcome.met,
                "trials": outcome.trials,
                "figures": dict(outcome.figures),
                "missed": list(outcome.missed),
            }
        case Skipped(why):
            return {**head, "met": None, "skipped": why}


def table(found: Sequence[tuple[Campaign, Outcome | Skipped]]) -> Table:
    """One row for each, and its misses below it."""
    rows = Table(box=None, pad_edge=False)
    for heading in ("", "what", "trials", "figures", "bar", ""):
        rows.add_column(heading, justify="right" if heading == "trials" else "left", overflow="fold")
    for campaign, outcome in found:
        match outcome:
            case Outcome():
                verdict = "met" if outcome.met else "missed"
                trials = f"{outcome.trials:,}"
                rows.add_row(campaign.id, campaign.title, trials, _figures(outcome), campaign.bar, verdict)
                for miss in outcome.missed:
                    rows.add_row("", "", "", miss, "", "")
            case Skipped(why):
                rows.add_row(campaign.id, campaign.title, "", why, campaign.bar, "skipped")
    return rows


def line(found: Sequence[tuple[Campaign, Outcome | Skipped]]) -> str:
    """The first figure of each, in one line."""
    said = []
    for campaign, outcome in found:
        match outcome:
            case Outcome():
                name, value = next(iter(outcome.figures.items()))
                mark = "" if outcome.met else " MISSED"
                said.append(f"{campaign.id} {name} {value} of {outcome.trials:,}{mark}")
            case Skipped():
                said.append(f"{campaign.id} skipped")
    return "; ".join(said)


def _figures(outcome: Outcome) -> str:
    return ", ".join(f"{name} {value}" for name, value in outcome.figures.items())
