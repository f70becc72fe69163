"""The benchmark of a guarded act: its figures, and the command as a user runs it."""

import asyncio
import itertools
import json
import random
import subprocess
import sys
from pathlib import Path

import pytest
from evaluation.tools.bench import ActResult, ActRow, NotMeasuredError, last_line, row_of, tables
from evaluation.tools.run import _in_turns, _is_refused
from ztpm_idp.client import Denied

PARTS = {
    "proof made, by the caller",
    "token and proof checked",
    "policies decided",
    "of a record, the disk alone",
    "decision on record",
    "outcome noted",
    "a worker asked, and its answer awaited",
}
ROWS = (
    ActRow("guarded, HTTP", 100, 3_000.0, 9_000.0),
    ActRow("unguarded, HTTP", 100, 2_000.0, 6_000.0),
    ActRow("guarded, function", 100, 900.0, 1_200.0, refused=1),
    ActRow("unguarded, function", 100, 0.5, 1.0),
)


def test_ratios_are_guarded_over_unguarded():
    result = ActResult(*ROWS, parts_us={"policies decided": 40.0}, seconds=1.0, machine={})
    told = result.to_json()
    assert told["ratios"] == {"guard_http_p50": 1.5, "guard_http_p99": 1.5}
    assert told["added_us"] == {"http_p50": 1000.0, "http_p99": 3000.0, "function_p50": 899.5, "function_p99": 1199.0}
    assert [row["way"] for row in told["rows"]] == [row.way for row in ROWS]
    assert [table.row_count for table in tables(result)] == [4, 1]
    assert "1.50 at p50" in last_line(result)


def test_a_way_that_is_refused_too_often_has_no_figures():
    with pytest.raises(NotMeasuredError):
        row_of("way", [1_000] * 20, 5)
    assert row_of("way", [1_000, 3_000] * 10, 4) == ActRow("way", 20, 2.0, 3.0, refused=4)


def turns(one, other, calls=10):
    return asyncio.run(_in_turns({"one": one, "other": other}, 1, calls, random.Random(1)))


def test_two_ways_take_turns_and_each_answer_is_looked_at():
    order = []

    def way(name, answer=1):
        async def once():
            order.append(name)
            return answer

        return once

    one, other = turns(way("one"), way("other"))
    assert (one.n, other.n) == (10, 10)
    assert {frozenset(order[k : k + 2]) for k in range(0, len(order), 2)} == {frozenset({"one", "other"})}
    with pytest.raises(NotMeasuredError):
        turns(way("one"), way("other", answer=2))
    with pytest.raises(NotMeasuredError):
        asyncio.run(_is_refused(way("one")))


def test_a_refused_call_is_counted():
    answers = itertools.cycle([1] * 9 + [None])

    async def sometimes():
        if next(answers) is None:
            raise Denied("VERDICT_EXPIRED", {"decision": "DENY", "reason": "VERDICT_EXPIRED"})
        return 1

    async def fine():
        return 1

    one, other = turns(sometimes, fine)
    assert ((one.n, one.refused), (other.n, other.refused)) == ((10, 1), (10, 0))


@pytest.mark.long
@pytest.mark.timeout(200)
def test_the_command_as_a_user_runs_it():
    command = [str(Path(sys.executable).with_name("ztpm")), "eval", "bench", "tools", "--calls", "10", "--json"]
    done = subprocess.run(command, capture_output=True, text=True, timeout=180)
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout)
    assert told["ratios"].keys() == {"guard_http_p50", "guard_http_p99"}
    assert all(value > 0 for value in (*told["ratios"].values(), *told["parts_us"].values()))
    assert told["parts_us"].keys() == PARTS
    assert [row["n"] for row in told["rows"]] == [10] * 4
    assert {"processor", "cores", "python", "load"} <= told["machine"].keys()
