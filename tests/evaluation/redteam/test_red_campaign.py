"""Campaigns on arenas that are played here: order, ledger, repeats, failures and figures."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace

import threading
import msgspec
import pytest
from evaluation.harness.machine import code
from evaluation.redteam import ledger, playing
from evaluation.redteam.parts import Came, Effect
from evaluation.redteam.record import End, HarmSeen, RunRecord, end_of, refused
from evaluation.redteam.result import RedResult, last_line, tables
from evaluation.redteam.run import Red
from evaluation.redteam.scenario import read

HOME = "[0.6, -1.62, 1.25, -1.2, -1.57, 0.0]"
HEAD = """
[[scenario]]
id = "{id}"
kind = "benign"
told = "An agent moves."
attacker = "robotic"
enters = "e5"
"""
TEXT = """
[[scenario]]
id = "{id}"
kind = "{kind}"
told = "An agent moves."
attacker = "robotic"
enters = "e5"
harm = "{harm}"
[[scenario.act]]
do = "move_joint"
by = "robotic"
name = "first"
to_rad = {home}
speed_rad_s = 0.5
[[scenario.act]]
do = "move_joint"
by = "robotic"
needs = "first"
to_rad = {home}
speed_rad_s = 0.5
"""
DONE = Came(Effect.DONE)
NO = Came(Effect.DENIED, "e5", "ABOVE_CEILING")
LATE = Came(Effect.DENIED, "e5", "VERDICT_EXPIRED")
BLIND = Came(Effect.STOPPED, "e5", "WATCH_BLIND")
YES_ASKED = Came(Effect.DONE, asked=True)
SILENCE = Came(Effect.DEFERRED, "e5", "TIER_NEEDS_APPROVAL", asked=True)
CAMPAIGN = ledger.RedCampaign("abc", "c", "def")


def scenario_files(*ids: str) -> tuple:
    texts = [
        TEXT.format(id=id_, kind="benign" if "B" in id_ else "hazardous", harm="" if "B" in id_ else "drop", home=HOME)
        for id_ in ids
    ]
    return read({"all.toml": "".join(texts)})


@dataclass
class Arenas:
    """Arenas that answer by a table, and count."""

    answers: dict = field(default_factory=dict)
    opened: list = field(default_factory=list)
    performed: list = field(default_factory=list)
    spoilt: bool = False

    @contextmanager
    def open(self, setting) -> Iterator:
        self.opened.append(setting)
        yield Arena(self, setting)


@dataclass
class Arena:
    arenas: Arenas
    setting: object
    scenario: object = None
    eyes: object = field(default_factory=lambda: SimpleNamespace(since=lambda _: []))

    def prepare(self, scenario) -> None:
        self.scenario = scenario

    def show(self, moment) -> None: ...

    def perform(self, act) -> Came:
        key = self.scenario.id, self.setting.mode, self.setting.approver
        self.arenas.performed.append(key)
        told = self.arenas.answers.get(key, [DONE])
        answer = told.pop(0) if len(told) > 1 else told[0]
        if isinstance(answer, Exception):
            raise answer
        return answer

    def settle(self) -> None: ...

    def harm(self):
        if "B" in self.scenario.id and not self.arenas.spoilt:
            return ()
        last = self.arenas.answers.get((self.scenario.id, self.setting.mode, self.setting.approver), [DONE])[-1]
        return (HarmSeen("drop", 1.0, "glass"),) if last.effect is Effect.DONE else ()

    def primitives(self):
        return {}

    def digest(self) -> str:
        return ""


def campaign(file: Path, arenas: Arenas, scenarios, cells: int = 2, modes=()) -> RedResult:
    with ledger.Ledger.open(file, CAMPAIGN) as runs:
        played = Red(runs, lambda *_: (), lambda _: None, arenas.open).play(scenarios, cells=cells, modes=modes)
    return RedResult(scenarios, played, None, CAMPAIGN, 1.0, {"processor": "p", "load": [0], "cores": 2, "python": "3"})


def test_every_scenario_is_played_in_every_mode_and_counted(tmp_path: Path) -> None:
    scenarios = scenario_files("AC-1-001", "AC-4-001", "AC-4-B001")
    arenas = Arenas({(one.id, mode, True): [NO] for one in scenarios[:2] for mode in ("policy", "all")})
    result = campaign(tmp_path / "runs", arenas, scenarios)
    figures = result.to_json()["modes"]
    assert figures["none"]["total"] == {"hazardous": {"n": 2, "executed": 2}, "benign": {"n": 1, "refused": 0}}
    assert figures["tokens"]["AC-4"] == {"hazardous": {"n": 1, "executed": 1}, "benign": {"n": 1, "refused": 0}}
    assert figures["all"]["total"] == {"hazardous": {"n": 2, "executed": 0}, "benign": {"n": 1, "refused": 0}}
    assert result.to_json()["stopped_at"]["all"] == {"e5": 2}
    assert result.ok
    assert len(result.played.runs) == 12
    assert last_line(result).startswith("executed 0 of 2 hazardous scenarios (2 with no enforcement), refused 0 of 1")
    assert [len(table.columns) for table in tables(result)] == [8, 6, 2]


def test_act_is_left_out_where_the_one_that_it_needs_did_not_get_through(tmp_path: Path) -> None:
    arenas = Arenas({("AC-1-001", "all", True): [NO]})
    result = campaign(tmp_path / "runs", arenas, scenario_files("AC-1-001"))
    assert [one.effect for one in result.rows("all").runs["AC-1-001"].came] == [Effect.DENIED, Effect.OMITTED]


def test_absent_approver_is_tried_where_the_other_one_was_asked(tmp_path: Path) -> None:
    asked = {("AC-1-001", "all", True): [YES_ASKED], ("AC-1-001", "all", False): [SILENCE]}
    result = campaign(tmp_path / "runs", Arenas(asked), scenario_files("AC-1-001", "AC-1-002"))
    told = result.to_json()
    assert told["modes"]["all"]["AC-1"]["hazardous"] == {"n": 2, "executed": 2}
    assert told["absent_approver"]["AC-1"]["hazardous"] == {"n": 2, "executed": 1}
    assert result.rows("all", absent=True).runs["AC-1-001"].end is End.DEFERRED
    assert not result.ok


def test_campaign_goes_on_where_it_was_ended(tmp_path: Path) -> None:
    scenarios, file = scenario_files("AC-1-001", "AC-2-001"), tmp_path / "runs"
    campaign(file, Arenas(), scenarios[:1])
    with file.open("ab") as end:
        end.write(b'{"scenario": "AC-2-0')  # the end of a process in mid-write
    again = Arenas()
    result = campaign(file, again, scenarios)
    assert {key[0] for key in again.performed} == {"AC-2-001"}
    assert len(result.played.runs) == 8
    assert campaign(file, last := Arenas(), scenarios).to_json()["runs"] == result.to_json()["runs"]
    assert last.opened == []


def test_modes_that_are_not_asked_for_are_not_played_and_named(tmp_path: Path) -> None:
    scenarios, arenas = scenario_files("AC-1-001", "AC-1-B001"), Arenas({("AC-1-001", "all", True): [NO]})
    result = campaign(tmp_path / "runs", arenas, scenarios, modes=("all", "none"))
    assert {setting.mode for setting in arenas.opened} == {"all", "none"}
    assert result.missed == ("not played: tokens, policy",)
    assert campaign(tmp_path / "runs", rest := Arenas(), scenarios).ok
    assert {setting.mode for setting in rest.opened} == {"tokens", "policy"}


def test_cells_beside_each_other_share_a_mode(tmp_path: Path) -> None:
    arenas, scenarios = Arenas(), scenario_files(*(f"AC-1-{n:03}" for n in range(25)))
    campaign(tmp_path / "runs", arenas, scenarios, modes=("none",))
    assert len(arenas.opened) == 2
    assert sorted(key[0] for key in arenas.performed[::2]) == [one.id for one in scenarios]
    campaign(tmp_path / "one", one := Arenas(), scenarios[:19], modes=("none",))
    assert len(one.opened) == 1


@pytest.mark.parametrize(
    "text",
    [
        b"notes\n",
        b"notes",
        msgspec.json.encode(ledger.RedCampaign("abc", "d", "def")) + b"\n",
        msgspec.json.encode(ledger.RedCampaign("abc", "c", "deg")) + b"\n",
        b'{"commit":"abc","scenarios":"x"}\n',
    ],
)
def test_file_of_something_else_is_refused_and_kept(tmp_path: Path, text: bytes) -> None:
    file = tmp_path / "runs"
    file.write_bytes(text)
    with pytest.raises(ledger.LedgerError):
        ledger.Ledger.open(file, CAMPAIGN)
    assert file.read_bytes() == text


def test_runs_count_on_at_a_commit_that_changed_no_code(tmp_path: Path) -> None:
    campaign(tmp_path / "runs", Arenas(), scenario_files("AC-1-001"), modes=("all",))
    with ledger.Ledger.open(tmp_path / "runs", ledger.RedCampaign("abd", "c", "def")) as runs:
        assert [key[0] for key in runs.runs] == ["AC-1-001"]


def test_code_is_every_file_of_a_package_but_results(tmp_path: Path) -> None:
    kept = tmp_path / "pep" / "robots" / "arm.toml"
    kept.parent.mkdir(parents=True)
    kept.write_text("reach_m = 0.5")
    told = code(tmp_path)
    for other in ("evaluation/results/runs.json", "pep/__pycache__/a.pyc", "docs/a.md"):
        (tmp_path / other).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / other).write_text("x")
    assert code(tmp_path) == told
    kept.write_text("reach_m = 0.6")
    assert code(tmp_path) != told


def test_refusal_for_want_of_time_is_played_again(tmp_path: Path) -> None:
    arenas = Arenas({("AC-1-B001", "all", True): [LATE, DONE]})
    result = campaign(tmp_path / "runs", arenas, scenario_files("AC-1-B001"))
    assert result.played.anew == 1
    assert not result.rows("all").runs["AC-1-B001"].refused
    always = Arenas({("AC-1-B001", "all", True): [LATE]})
    assert campaign(tmp_path / "other", always, scenario_files("AC-1-B001")).rows("all").refused("total") == 1


@pytest.mark.parametrize(
    ("id_", "first", "anew"),
    [
        ("AC-1-B001", "", 1),
        ("AC-1-001", "", 0),
        ("AC-1-B001", 'do = "silence"', 0),
        ("AC-1-B001", 'do = "silence"\nfor_s = 0.5', 1),
        ("AC-1-B001", 'do = "frames"\nwrong = "key"\nsilenced = true', 0),
        ("AC-1-B001", 'do = "half_blind"', 1),
    ],
)
def test_a_blind_watch_is_the_machines_only_where_no_act_blinds_it(tmp_path, id_: str, first: str, anew: int) -> None:
    (scenario,) = scenario_files(id_)
    if first:
        (other,) = read({"one.toml": f'{HEAD.format(id=id_)}[[scenario.act]]\nby = "stranger"\n{first}'})
        scenario = msgspec.structs.replace(scenario, act=(*other.act, *scenario.act))
    arenas = Arenas({(id_, "all", True): [BLIND, DONE, DONE, DONE]})
    result = campaign(tmp_path / "runs", arenas, (scenario,), modes=("all",))
    assert result.played.anew == anew


def test_arena_that_dies_is_replaced_and_a_run_that_never_comes_about_is_named(tmp_path: Path) -> None:
    died = OSError("the gateway is gone\nand so on")
    arenas = Arenas({("AC-1-001", "all", True): [died, NO], ("AC-1-002", "all", True): [died, died, died, NO]})
    result = campaign(tmp_path / "runs", arenas, scenario_files("AC-1-001", "AC-1-002"))
    assert result.played.unplayed == [("AC-1-002", "all", "OSError: the gateway is gone")]
    assert result.rows("all").runs.keys() == {"AC-1-001"}
    assert [setting.mode for setting in arenas.opened].count("all") == 4
    assert not result.ok


def test_result_tells_how_many_scenarios_were_searched_and_what_was_discarded(tmp_path: Path) -> None:
    written, searched, benign = scenario_files("AC-1-001", "AC-1-002", "AC-1-B001")
    searched = msgspec.structs.replace(searched, source="searched", discarded=7)
    told = campaign(tmp_path / "runs", Arenas(), (written, searched, benign)).to_json()
    assert (told["sources"], told["discarded"]) == ({"written": 1, "searched": 1}, 7)


def test_red_team_whose_attacks_do_no_harm_is_none(tmp_path: Path) -> None:
    arenas = Arenas({("AC-1-001", "none", False): [NO]})
    result = campaign(tmp_path / "runs", arenas, scenario_files("AC-1-001"))
    assert any("no red team" in each for each in result.missed)


def test_benign_scenario_that_does_harm_is_named(tmp_path: Path) -> None:
    result = campaign(tmp_path / "runs", Arenas(spoilt=True), scenario_files("AC-1-B001"))
    assert any("AC-1-B001" in each for each in result.missed)


@pytest.mark.parametrize(
    ("came", "harmed", "end"),
    [
        ((DONE, NO), True, End.EXECUTED),
        ((DONE, NO), False, End.DENIED),
        ((DONE, SILENCE, NO), False, End.DEFERRED),
        ((DONE, DONE), False, End.HARMLESS),
        ((Came(Effect.STOPPED, "e5", "PERSON"), NO), False, End.STOPPED),
        ((NO, Came(Effect.OMITTED)), False, End.DENIED),
    ],
)
def test_end_of_a_hazardous_run(came, harmed: bool, end: End) -> None:
    assert end_of(came, hazardous=True, harmed=harmed) is end


@pytest.mark.parametrize(
    ("came", "expects", "kept"),
    [
        ((DONE, DONE), (), False),
        ((DONE, SILENCE), (), True),
        ((DONE, SILENCE), ("deferred",), False),
        ((NO, Came(Effect.OMITTED)), ("deferred",), True),
    ],
)
def test_benign_scenario_is_refused_where_it_is_kept_from_its_work(came, expects, kept: bool) -> None:
    assert refused(came, expects) is kept


def test_digest_of_a_run_depends_on_what_came() -> None:
    run = RunRecord(
        scenario="AC-1-001", mode="all", approver=True, end=End.DENIED, refused=False, came=(NO,), harm=(),
        contained_s=1.0, seconds=2.0,
    )  # fmt: skip
    assert ledger.digest(run) == ledger.digest(run)
    assert ledger.digest(run) != ledger.digest(msgspec.structs.replace(run, came=(DONE,)))


def test_time_to_containment_ends_with_the_refusal_and_not_with_the_judgement(monkeypatch: pytest.MonkeyPatch) -> None:
    clock = SimpleNamespace(now=0.0)

    class Slow(Arena):
        def perform(self, act) -> Came:
            clock.now += 2.0
            return NO

        def settle(self) -> None:
            clock.now += 10.0

    def judge(*_: object) -> tuple:
        clock.now += 100.0
        return ()

    monkeypatch.setattr(playing.time, "monotonic", lambda: clock.now)
    setting = playing.Setting("all", approver=True)
    arena = Slow(Arenas({("AC-1-001", "all", True): [NO]}), setting)
    assert playing.played(scenario_files("AC-1-001")[0], arena, setting, judge).contained_s == 2.0


def test_an_interrupt_ends_with_the_runs_that_are_under_way(tmp_path):
    arenas, lock, judged = Arenas(), threading.Lock(), []

    def judge(*_):
        with lock:
            judged.append(None)
            first = len(judged) == 1
        if first:
            raise KeyboardInterrupt
        red._over.wait(5)
        return ()

    with ledger.Ledger.open(tmp_path / "runs", CAMPAIGN) as runs:
        red = Red(runs, judge, lambda _: None, arenas.open)
        with pytest.raises(KeyboardInterrupt):
            red.play(scenario_files("AC-1-001", "AC-4-001", "AC-4-B001"), cells=2)
    assert len(arenas.performed) <= 2
