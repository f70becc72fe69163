"""The rows of the searches and of the proof: they run, and tell what was missed."""

from __future__ import annotations

import time

import pytest
from evaluation.harness.campaign import Outcome, Settings
from evaluation.tokens.campaigns import attenuation, mutants, registry, searches

pytestmark = pytest.mark.long

SETTINGS = Settings(quick=True, seed=3, vectors=None, clock_ns=time.monotonic_ns, told=lambda _: None)


def test_they_stand_in_the_order_of_their_bars():
    ids = [campaign.id for campaign in registry.CAMPAIGNS]
    assert ids == ["A1", "A2", "A3", "A4", "A5", "A6", "A7", "A9", "Z3"]


@pytest.mark.parametrize(
    ("campaign", "name", "count"),
    [
        (searches.MUTANTS, "QUICK_MUTANTS", 300),
        (searches.ENCODINGS, "QUICK_EVERY", 4_999),
        pytest.param(searches.ATTENUATION, "QUICK_PAIRS", 1_500, marks=pytest.mark.campaign),
        pytest.param(searches.LATTICE, "QUICK_PAIRS", 0, marks=pytest.mark.campaign),
    ],
    ids=lambda value: getattr(value, "id", ""),
)
def test_a_quick_run_meets_its_bar(campaign, name, count, monkeypatch):
    monkeypatch.setattr(searches, name, count)
    found = campaign.run(SETTINGS)
    assert isinstance(found, Outcome)
    assert found.met, found.missed
    assert found.trials > 0
    first = next(iter(found.figures.values()))
    assert first == found.figures.get("texts injected", 0) == 0


@pytest.mark.parametrize(
    ("campaign", "module"),
    [(searches.MUTANTS, mutants), pytest.param(searches.ATTENUATION, attenuation, marks=pytest.mark.campaign)],
)
def test_what_is_missed_is_told(campaign, module, monkeypatch):
    """Fewer trials than were wanted are a miss."""
    real = module.run
    monkeypatch.setattr(searches, "QUICK_MUTANTS", 50)
    monkeypatch.setattr(searches, "QUICK_PAIRS", 1_500)

    def more_wanted(count, seed):
        found = real(count, seed)
        return type(found)(count + 1, found.tally)

    monkeypatch.setattr(module, "run", more_wanted)
    assert not campaign.run(SETTINGS).met
