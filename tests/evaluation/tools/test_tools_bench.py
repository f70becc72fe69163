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
from evaluation.tools import mcp_bench
from evaluation.tools.mcp_bench import Fronts, McpResult
from evaluation.tools.turns import check_refused, finished, in_turns
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
    return asyncio.run(in_turns({"one": one, "other": other}, 1, calls, random.Random(1)))


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
        asyncio.run(check_refused(way("one")))


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


def command(bench, calls=10):
    """Printed object of the command, as a user runs it."""
    argv = [str(Path(sys.executable).with_name("ztpm")), "eval", "bench", bench, "--calls", str(calls), "--json"]
    done = subprocess.run(argv, capture_output=True, text=True, timeout=280)
    assert done.returncode == 0, done.stderr
    told = json.loads(done.stdout)
    assert all(value > 0 for value in told["ratios"].values())
    assert {row["n"] for row in told["rows"]} == {calls}
    assert {"processor", "cores", "python", "load"} <= told["machine"].keys()
    return told


@pytest.mark.campaign
@pytest.mark.long
@pytest.mark.timeout(300)
def test_the_command_as_a_user_runs_it():
    told = command("tools")
    assert told["ratios"].keys() == {"guard_http_p50", "guard_http_p99"}
    assert all(value > 0 for value in told["parts_us"].values())
    assert told["parts_us"].keys() == PARTS
    assert len(told["rows"]) == 4


FRONTS = [
    ActRow(way, 100, p50, 9_000.0) for way, p50 in (("gateway", 6_000.0), ("proxy", 4_000.0), ("itself", 2_000.0))
]


def test_a_gateway_is_told_over_a_proxy_and_over_the_server_itself():
    guarded, bare = ActRow("guarded, stdio", 100, 3_000.0, 9_000.0), ActRow("unguarded, stdio", 100, 2_000.0, 3_000.0)
    result = McpResult(
        Fronts(*FRONTS), Fronts(*FRONTS), guarded, bare, record_us=300.0, seconds=1.0, machine={}, versions={}
    )
    told = result.to_json()
    assert {name: told["ratios"][name] for name in sorted(told["ratios"])} == {
        "gateway_http_direct": 3.0, "gateway_http_p50": 1.5, "gateway_http_p99": 1.0, "gateway_stdio_direct": 3.0,
        "gateway_stdio_p50": 1.5, "gateway_stdio_p99": 1.0, "guard_stdio_p50": 1.5, "guard_stdio_p99": 3.0,
        "proxy_http_direct": 2.0, "proxy_stdio_direct": 2.0,
    }  # fmt: skip
    assert told["record"] == {"us": 300.0, "share_of_guard_stdio_p50": 0.1}
    assert len(told["rows"]) == 8
    assert "1.50 over HTTP, 1.50 over stdio" in mcp_bench.last_line(result)


def test_an_error_in_the_groups_of_the_client_is_told_alone():
    async def work():
        raise ExceptionGroup("client", [ExceptionGroup("transport", [NotMeasuredError("another answer")])])

    with pytest.raises(NotMeasuredError):
        finished(work())


@pytest.mark.campaign
@pytest.mark.timeout(300)
def test_the_command_of_fronts_as_a_user_runs_it():
    pytest.importorskip("fastmcp.server", reason="the extra `fastmcp` is not installed")
    told = command("mcp")
    assert {"gateway_http_p50", "gateway_stdio_p50", "guard_stdio_p50"} < told["ratios"].keys()
    assert len(told["rows"]) == 8
    assert told["versions"].keys() == {"fastmcp-slim", "mcp"}
