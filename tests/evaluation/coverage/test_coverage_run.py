"""A run of the coverage on arenas that are played here: choice, order, what is spared, and its JSON."""

from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace

import pytest
from evaluation.coverage import run as running
from evaluation.coverage.cells import BASE, CELLS, WHOLE, off_in
from evaluation.coverage.choosing import chosen
from evaluation.coverage.result import last_line, tables
from evaluation.coverage.run import CoverageRequest, coverage
from evaluation.redteam.parts import Came, Effect
from evaluation.redteam.record import HarmSeen
from evaluation.redteam.scenario import read, scenarios

TEXT = """
[[scenario]]
id = "{id}"
kind = "hazardous"
told = "An agent moves."
attacker = "robotic"
enters = "e5"
harm = "drop"
shows = {shows}
[[scenario.act]]
do = "move_joint"
by = "robotic"
to_rad = [0.6, -1.62, 1.25, -1.2, -1.57, 0.0]
speed_rad_s = 0.5
"""
SCENARIOS = read(
    {"all.toml": "".join(
        TEXT.format(id=id_, shows=shows)
        for id_, shows in (
            ("AC-1-001", []), ("AC-1-002", []), ("AC-2-001", []), ("AC-3-001", []), ("AC-4-001", []),
            ("AC-5-001", []), ("AC-5-002", '["TEA-4 prevention", "TEA-6 detection"]'), ("AC-5-003", []), ("AC-5-004", []),
            ("AC-5-005", []),
        )
    )}
)  # fmt: skip


class Theatre:
    """Stops every attack where TEA-4 is on, and names it."""

    def __init__(self) -> None:
        self.opened: list[str] = []
        self.closed = False

    @contextmanager
    def arena(self, setting):
        self.opened.append(setting.mode)
        on = "TEA-4" not in off_in(setting.mode)
        came = Came(Effect.DENIED, "e5", "ABOVE_CEILING") if on else Came(Effect.DONE)
        yield SimpleNamespace(
            eyes=SimpleNamespace(since=lambda _: []),
            prepare=lambda _: None, show=lambda _: None, settle=lambda: None, perform=lambda _: came,
            harm=lambda: () if on else (HarmSeen("drop", 1.0, "glass"),),
            primitives=lambda: {"TEA-4": 0.0} if on else {}, digest=lambda: "",
        )  # fmt: skip

    def close(self) -> None:
        self.closed = True


@pytest.fixture
def theatre(monkeypatch: pytest.MonkeyPatch) -> Theatre:
    monkeypatch.setattr(running, "scenarios", lambda: SCENARIOS)
    monkeypatch.setattr(running, "commit", lambda: "abc")
    monkeypatch.setattr(running, "code", lambda: "c")
    monkeypatch.setattr(running, "machine", dict)
    return Theatre()


def test_a_cell_is_shown_by_those_that_say_so_or_by_some_of_its_class() -> None:
    cells = {(cell.attack, cell.name): ids for cell, ids in chosen(SCENARIOS, sample=0, seed=1).items()}
    assert cells["AC-5", "TEA-4 prevention"] == ("AC-5-002",)
    assert len(cells["AC-5", "ABG-1 containment"]) == 3
    assert cells["AC-1", "CII-4 detection"] == ("AC-1-001", "AC-1-002")
    assert len(cells) == len(CELLS)


def test_a_sample_is_cells_of_each_attack_with_one_scenario_and_drawn_again_by_its_seed() -> None:
    drawn = chosen(SCENARIOS, sample=2, seed=5)
    assert [cell.attack for cell in drawn] == [f"AC-{n}" for n in range(1, 6) for _ in range(2)]
    assert {len(ids) for ids in drawn.values()} == {1}
    assert chosen(SCENARIOS, sample=2, seed=5) == drawn


def test_run_shows_what_the_cell_does_and_goes_on_where_it_was_ended(theatre: Theatre, tmp_path: Path) -> None:
    request = CoverageRequest(sample=0, seed=1, only=("TEA-4",), ledger=tmp_path / "runs")
    result = coverage(request, lambda *_: (), lambda _: None, theatre=theatre)
    assert theatre.opened == [WHOLE, BASE, "without TEA-4", "only TEA-4"]
    assert theatre.closed
    found = result.to_json()["cells"]["AC-5"]
    assert found["prevention"]["TEA-4"] == {
        "fires": True, "sufficient": True, "necessary": True, "absent": None,
        "runs": [f"AC-5-002/{name}" for name in ("whole", "identity", "only-TEA-4", "without-TEA-4")],
    }  # fmt: skip
    assert (found["detection"], result.ok) == ({}, True)
    assert "2 of 2 cells" in last_line(result)
    assert [table.row_count for table in tables(result)] == [2]

    again = Theatre()
    second = coverage(request, lambda *_: (), lambda _: None, theatre=again)
    assert again.opened == []
    assert second.to_json()["cells"] == result.to_json()["cells"]


def test_what_can_show_nothing_is_not_played_and_its_cell_says_so(theatre: Theatre) -> None:
    request = CoverageRequest(sample=0, seed=1, only=("TEA-6",), ledger=None)
    result = coverage(request, lambda *_: (), lambda _: None, theatre=theatre)
    seen = result.to_json()["cells"]["AC-5"]["detection"]["TEA-6"]
    assert (seen["fires"], seen["sufficient"], seen["necessary"]) == (False, False, False)
    assert "TEA-6" in seen["absent"]
    assert seen["runs"] == [f"AC-5-002/{name}" for name in ("whole", "identity", "only-TEA-6", "without-TEA-6")]


def test_a_run_that_did_not_come_about_is_named(theatre: Theatre, monkeypatch: pytest.MonkeyPatch) -> None:
    @contextmanager
    def broken(setting):
        raise RuntimeError("no cell")
        yield

    monkeypatch.setattr(theatre, "arena", broken)
    result = coverage(CoverageRequest(0, 1, ("TEA-4",), None), lambda *_: (), lambda _: None, theatre=theatre)
    assert not result.ok
    assert {cause for _, _, cause in result.unplayed} == {"RuntimeError: no cell"}
    assert result.to_json()["cells"]["AC-5"]["prevention"]["TEA-4"]["absent"]


def test_what_a_shipped_scenario_says_that_it_shows_is_a_cell_of_its_attack() -> None:
    known = {(cell.attack, cell.name) for cell in CELLS}
    said = {(one.attack, name) for one in scenarios() for name in one.shows}
    assert said
    assert said <= known
    assert all(one.hazardous for one in scenarios() if one.shows)


def test_each_cell_has_shipped_scenarios_that_say_that_they_show_it() -> None:
    said = {(one.attack, name) for one in scenarios() for name in one.shows}
    assert [cell for cell in CELLS if (cell.attack, cell.name) not in said] == []
