"""`ztpm eval conduct`: what it measures, and that it says so when a bar is missed."""

import json
import random
import time
from dataclasses import replace
from itertools import islice

import pytest
from evaluation.cli import app
from evaluation.conduct.agents import Worker, life
from evaluation.conduct.counting import interval, quantile
from evaluation.conduct.registry import CAMPAIGNS
from evaluation.harness.campaign import Outcome, Settings
from policies.words.parameters import Parameters
from typer.testing import CliRunner

from evaluation.conduct import agents, alarms, delays, trusting

pytestmark = pytest.mark.long

QUICK = Settings(quick=True, seed=11, vectors=None, clock_ns=time.perf_counter_ns, told=lambda _: None)
BY_ID = {campaign.id: campaign for campaign in CAMPAIGNS}
LONG = {"D-very slow drift", "F-phases", "F-long phases", "F-rounds", "D-sleeper"}


def test_campaigns_have_names_of_their_own():
    assert len(BY_ID) == len(CAMPAIGNS)


@pytest.mark.parametrize("name", [name for name in BY_ID if name not in LONG])
def test_a_quick_run_meets_its_bar(name):
    outcome = BY_ID[name].run(QUICK)
    assert isinstance(outcome, Outcome)
    assert outcome.met, outcome.missed
    assert outcome.trials > 0


def test_a_run_is_its_seed():
    one, other = (BY_ID["D-tools"].run(QUICK) for _ in range(2))
    assert one == other
    assert one != BY_ID["D-tools"].run(replace(QUICK, seed=12))


@pytest.mark.parametrize("rhythm", ["independent", "rounds", "phases"])
def test_a_life_is_its_seed_and_goes_forward(rhythm):
    one, other = (list(islice(life(Worker(random.Random(3), rhythm)), 50)) for _ in range(2))
    assert one == other
    assert [report.at for report in one] == sorted(report.at for report in one)
    assert len({report.request_id for report in one}) == 50


# --- a bar that is missed is said to be ------------------------------------------------------------------------------


def test_detectors_that_alarm_too_often_are_told(monkeypatch):
    low = lambda share, run: alarms_watched(share, run)._replace(limit=alarms_watched(share, run).limit // 2)  # noqa: E731
    alarms_watched = alarms.watched
    monkeypatch.setattr(alarms, "watched", low)
    assert not alarms.detectors(QUICK).met


@pytest.mark.campaign
def test_agents_that_alarm_too_often_are_told(monkeypatch):
    monkeypatch.setattr(alarms, "life", lambda worker: life(worker, change_at=300, script=agents.turncoat))
    assert not alarms.workers(QUICK, "independent").met


def test_a_change_that_nobody_notices_is_told():
    nothing = delays.Change("nothing", "nothing changes", lambda _, __, draft: draft, 20)
    outcome = delays.noticed(QUICK, nothing)
    assert "were not noticed" in outcome.missed[0]


def test_a_change_that_is_noticed_late_is_told():
    late = replace(next(change for change in delays.CHANGES if change.name == "hasty"), bar=5)
    assert not delays.noticed(QUICK, late).met


def test_a_liar_with_influence_is_told(monkeypatch):
    monkeypatch.setattr(trusting, "PRIOR", 1_600)  # twice the floor that holds
    assert not BY_ID["T-liars"].run(QUICK).met


# --- figures ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("count", "low", "high"), [(0, 0.0, 3.689), (1, 0.0253, 5.572), (10, 4.795, 18.390), (100, 81.36, 121.63)]
)
def test_intervals_are_those_of_the_tables(count, low, high):
    assert interval(count) == pytest.approx((low, high), rel=1e-3)


@pytest.mark.parametrize(("permille", "value"), [(0, 1), (500, 5), (900, 9), (1000, 10)])
def test_quantiles(permille, value):
    assert quantile(list(range(10, 0, -1)), permille) == value


# --- the command -----------------------------------------------------------------------------------------------------


def run(*arguments):
    return CliRunner().invoke(app, ["conduct", "--json", "--quick", "--seed", "5", *arguments])


def test_the_command_says_what_was_measured():
    done = run("--only", "T-whitewash", "--only", "D-salami")
    said = json.loads(done.stdout)
    assert done.exit_code == 0
    assert (said["ok"], said["seed"], said["quick"]) == (True, 5, True)
    assert [campaign["id"] for campaign in said["campaigns"]] == ["D-salami", "T-whitewash"]


def test_the_command_fails_when_a_bar_is_missed(monkeypatch):
    monkeypatch.setattr(trusting, "THETA", 799)
    assert run("--only", "T-honest").exit_code == 1


def test_the_command_knows_no_other_campaign():
    assert run("--only", "T-nothing").exit_code == 2


@pytest.mark.campaign
def test_pictures_are_drawn(tmp_path, monkeypatch):
    pytest.importorskip("matplotlib")
    from evaluation.conduct import plots

    monkeypatch.setattr(plots, "DRAWN", 2)
    names = {path.name for path in plots.plot(tmp_path, seed=3)}
    assert names == {"trust.png", "detectors.png", "delays.png"}
    assert all(0 < (tmp_path / name).stat().st_size < 100_000 for name in names)


def test_the_stated_rate_is_the_default_sets():
    assert Parameters().behaviour_false_alarm_count == alarms.STATED
