"""Change of a composition: which processes are begun anew, and when a whole cell is."""

from contextlib import contextmanager, nullcontext
from types import SimpleNamespace

import pytest
from evaluation.coverage import theatre as staged
from evaluation.coverage.cells import BASE, ONLY, WHOLE, WITHOUT
from evaluation.coverage.theatre import START, Theatre
from evaluation.redteam.playing import Setting


class Arenas:
    """Arenas in place of running ones; what was begun is told."""

    def __init__(self) -> None:
        self.told: list[str] = []

    @contextmanager
    def opened(self, *, second_sensor: bool, **_):
        assert not second_sensor  # a sole sensor may be deceived
        self.told.append("cell")
        stage = SimpleNamespace(
            close=lambda: None, perception=lambda: "fresh",
            cell=SimpleNamespace(beside=nullcontext, addresses=SimpleNamespace(host="127.0.0.1")),
        )  # fmt: skip
        eyes = SimpleNamespace(close=lambda: None)
        yield SimpleNamespace(stage=stage, eyes=eyes, begin_points=lambda: self.told.append("points"))
        self.told.append("ended")

    def begun(self) -> list[str]:
        told, self.told[:] = list(self.told), []
        return told


@pytest.fixture
def arenas(monkeypatch: pytest.MonkeyPatch) -> Arenas:
    made = Arenas()
    monkeypatch.setattr(staged, "guarded_arena", made.opened)
    monkeypatch.setattr(staged, "StateRecorder", lambda host: SimpleNamespace(close=lambda: None))
    monkeypatch.setattr(staged, "START", {name: lambda cell, name=name: made.told.append(name) for name in START})
    return made


def play(theatre: Theatre, *modes: str) -> None:
    for mode in modes:
        with theatre.arena(Setting(mode, approver=False)):
            pass


def test_a_change_begins_those_anew_that_it_concerns(arenas: Arenas) -> None:
    theatre = Theatre()
    play(theatre, WHOLE)
    assert arenas.begun() == ["cell"]
    play(theatre, WITHOUT + "CII-2")
    assert arenas.begun() == ["points"]
    play(theatre, WITHOUT + "TEA-4")
    assert arenas.begun() == ["gateway", "points"]
    play(theatre, BASE)
    assert arenas.begun() == [*START, "points"]
    play(theatre, ONLY + "CATP-4")
    assert arenas.begun() == [*START, "points"]
    theatre.close()
    assert arenas.begun() == ["ended"]


def test_a_composition_that_failed_gets_a_fresh_cell(arenas: Arenas) -> None:
    theatre = Theatre()
    play(theatre, WHOLE, WHOLE)
    assert arenas.begun() == ["cell", "ended", "cell"]


def test_a_change_that_fails_ends_the_cell(arenas: Arenas, monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(cell):
        raise RuntimeError("the gateway does not start")

    theatre = Theatre()
    play(theatre, WHOLE)
    monkeypatch.setitem(staged.START, "gateway", fails)
    with pytest.raises(RuntimeError):
        play(theatre, WITHOUT + "TEA-4")
    assert arenas.begun() == ["cell", "ended"]
