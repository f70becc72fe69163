"""Output of the command: the promised JSON, the ratios of one run, the picture."""

import importlib.util
import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest
from evaluation.harness.bench import Bench, Result, Row
from evaluation.harness.machine import machine
from evaluation.harness.timing import QUICK
from evaluation.tokens.cell import TokenKey
from typer.testing import CliRunner

from evaluation import cli
from evaluation.tokens import bench as tokens

pytestmark = pytest.mark.long

RATIOS = {
    "warm_proof_d3",
    "warm_proof_d8",
    "warm_proof_d3_digital",
    "stream_d3",
    "cold_proof_d3",
    "novel_proof_d3",
    "first_proof_d3",
    "bytes_d3",
}


def row(peer: str, depth: int, kind: str, us: float, *, scope: str = "realistic", proof: bool = True) -> Row:
    return Row(TokenKey(peer, scope, depth, kind, proof), p50_us=us, min_us=us / 2, p99_us=us * 3, n=10, checks="all")


ROWS = (
    row("ztpm", 3, "warm", 1.0, proof=False),
    row("ztpm", 3, "warm", 90.0),
    row("tenuo", 3, "warm", 100.0),
    row("tenuo", 3, "warm", 1.0, scope="small"),
    row("ztpm", 3, "warm", 30.0, scope="digital"),
    row("tenuo", 3, "warm", 40.0, scope="digital"),
    row("ztpm", 8, "warm", 90.0),
    row("tenuo", 8, "warm", 200.0),
    row("ztpm", 3, "stream", 20.0),
    row("ztpm", 3, "cold", 300.0),
    row("tenuo", 3, "cold", 200.0),
    row("ztpm", 3, "novel", 400.0),
    row("ztpm", 3, "first", 1_000.0),
    row("tenuo", 3, "first", 250.0),
    Row(TokenKey("aip"), why="not installed: x"),
)
SIZES = [
    {"peer": peer, "scope": scope, "depth": depth, "bytes": size}
    for peer, scope, depth, size in (
        ("ztpm", "realistic", 3, 4_000),
        ("tenuo", "realistic", 3, 6_000),
        ("tenuo", "small", 3, 1),
        ("ztpm", "realistic", 8, None),
    )
]


def ratios(rows=ROWS, sizes=SIZES, name="p50_us"):
    return tokens.ratios(rows, {"sizes": sizes}, name)


MORE = {"sizes": SIZES, **tokens.BENCH.more(ROWS, {"sizes": SIZES})}
RESULT = Result(ROWS, ratios(), {"ztpm": "0", "tenuo": "1"}, MORE, machine(), QUICK, 1.0)


def test_ratios_are_ours_over_theirs_in_their_scope_with_proof():
    expected = {
        "warm_proof_d3": 0.9,
        "warm_proof_d8": 0.45,
        "warm_proof_d3_digital": 0.75,
        "stream_d3": 0.2,
        "cold_proof_d3": 1.5,
        "novel_proof_d3": 2.0,
        "first_proof_d3": 4.0,
        "bytes_d3": 0.667,
    }
    assert ratios() == expected
    assert ratios(name="min_us") == expected


@pytest.mark.parametrize("gone", ["ztpm", "tenuo"])
def test_a_ratio_of_what_was_not_measured_is_none(gone):
    rows = [replace(r, p50_us=None) if (r.of.peer, r.of.depth, r.of.kind) == (gone, 8, "warm") else r for r in ROWS]
    assert ratios(rows)["warm_proof_d8"] is None
    assert ratios([r for r in ROWS if r.of.peer != gone])["cold_proof_d3"] is None
    assert ratios(sizes=[s for s in SIZES if s["peer"] != gone])["bytes_d3"] is None


def invoke(monkeypatch, *arguments: str):
    monkeypatch.setattr(Bench, "run", lambda *_, **__: RESULT)
    done = CliRunner().invoke(cli.app, ["bench", "capabilities", *arguments], catch_exceptions=False)
    assert done.exit_code == 0, done.output
    return done.stdout


def test_the_ratios_are_the_last_line(monkeypatch):
    lines = invoke(monkeypatch, "--quick").rstrip().splitlines()
    assert all(name in lines[-1] for name in RATIOS)
    assert "0.90" in lines[-1]
    assert any("not installed" in line for line in lines)


def test_the_json_has_what_was_promised(monkeypatch):
    said = json.loads(invoke(monkeypatch, "--json"))
    assert said["ratios"].keys() == said["ratios_of_minima"].keys() == RATIOS
    wanted = {"peer", "scope", "depth", "kind", "proof", "p50_us", "min_us", "p99_us", "n"}
    assert all(wanted <= row.keys() for row in said["rows"])
    assert len(said["rows"]) == len(ROWS)
    assert {"processor", "cores", "python", "load"} <= said["machine"].keys()
    assert said["versions"] == {"ztpm": "0", "tenuo": "1"}


def test_the_picture(monkeypatch, tmp_path):
    if importlib.util.find_spec("matplotlib") is None:
        pytest.skip("matplotlib is not installed")
    file = tmp_path / "bench.png"
    invoke(monkeypatch, "--json", "--plot", str(file))
    assert file.read_bytes().startswith(b"\x89PNG")


@pytest.mark.campaign
@pytest.mark.timeout(420)
def test_the_command_as_a_user_runs_it():
    command = [str(Path(sys.executable).with_name("ztpm")), "eval", "bench", "capabilities", "--quick", "--json"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=400)
    assert done.returncode == 0, done.stderr
    said = json.loads(done.stdout)
    assert said["ratios"].keys() == RATIOS
    ours = {(r["scope"], r["depth"], r["kind"], r["proof"]) for r in said["rows"] if r["peer"] == "ztpm"}
    for scope in ("realistic", "small", "digital"):
        for depth in (0, 1, 3, 8):
            assert {(scope, depth, kind, True) for kind in ("first", "cold", "warm", "stream")} <= ours
            assert {(scope, depth, kind, False) for kind in ("first", "cold", "warm")} <= ours
    timed = [r for r in said["rows"] if r["p50_us"] is not None]
    assert all(0 < r["min_us"] <= r["p99_us"] and r["p50_us"] <= r["p99_us"] and r["n"] > 0 for r in timed)
    assert all(r["checks"] for r in timed if r["kind"] not in {"mint", "attenuate"})
    assert all(r["why"] for r in said["rows"] if r["p50_us"] is None)
