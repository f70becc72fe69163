"""The campaigns on tokens: what they find when all is well, and that they see it when it is not."""

from tests.shared_data import SHARED
import dataclasses
import json
import time
from pathlib import Path

import pytest
from capabilities.values.caps import DEFAULT, Caps
from evaluation.harness.campaign import Campaign, Misses, Outcome, Settings, Skipped
from evaluation.tokens.campaigns import edges, hostile, load, registry, samples, wycheproof
from evaluation.tokens.campaigns.blocks import CONDITIONS, SIZES, STATEMENTS
from evaluation.tokens.campaigns.hostile import Later
from evaluation.tokens.peers import lending as tokens
from typer.testing import CliRunner

from capabilities import Chain, Fault, FaultCode
from evaluation import cli

pytestmark = pytest.mark.long

VECTORS = SHARED / "vectors"
needs_vectors = pytest.mark.skipif(not VECTORS.is_dir(), reason="the reference vectors are not beside this checkout")


def settings(**other) -> Settings:
    told = {"quick": True, "seed": 1, "vectors": VECTORS, "clock_ns": time.perf_counter_ns, "told": lambda _: None}
    return Settings(**{**told, **other})


# --- A3, A4 ----------------------------------------------------------------------------------------------------------------


@pytest.mark.shared
@needs_vectors
def test_a3_all_fifty():
    found = samples.run(settings())
    assert (found.trials, found.figures["passed"], found.missed) == (50, 50, ())


@pytest.mark.shared
@needs_vectors
def test_a3_sees_a_limit_that_is_too_tight(monkeypatch):
    monkeypatch.setattr(samples, "DEFAULT", dataclasses.replace(DEFAULT, datalog_facts=1))
    assert not samples.run(settings()).met


def test_a3_compares_the_policy_too():
    assert samples.agrees(0, {"Ok": 0})
    assert samples.agrees(None, {"Err": {}})
    assert not samples.agrees(1, {"Ok": 0})
    assert not samples.agrees(None, {"Ok": 0})
    assert not samples.agrees(0, {"Err": {}})


def signatures():
    return pytest.importorskip("capabilities.keys.signatures")


@pytest.mark.shared
@needs_vectors
def test_a4_nothing_invalid_is_accepted():
    signatures()
    found = wycheproof.run(settings())
    assert found.missed == ()
    assert (found.figures["invalid_accepted"], found.figures["invalid"]) == (0, 605)
    assert found.figures["accepted"] >= 88 + 103 + 1


@pytest.mark.shared
@needs_vectors
@pytest.mark.parametrize("answer", [True, False])
def test_a4_sees_a_verifier_that_always_says_the_same(answer):
    found = wycheproof.tally(VECTORS / "wycheproof", lambda *_: answer)
    assert found[wycheproof.ED25519].misses.count == (63 if answer else 88)
    assert found[wycheproof.ED25519].wrong == (63 if answer else 0)
    assert found[wycheproof.P256].misses.count > 0


@pytest.mark.parametrize("campaign", [samples.CAMPAIGN, wycheproof.CAMPAIGN])
def test_without_vectors_they_say_so(campaign):
    assert isinstance(campaign.run(settings(vectors=None)), Skipped)


# --- A6 --------------------------------------------------------------------------------------------------------------------


def test_a6_there_are_two_hundred_of_each():
    assert len({kind.name for kind in (*STATEMENTS, *CONDITIONS)}) * SIZES == 200
    assert all(len(set(kind.sizes())) == SIZES for kind in (*STATEMENTS, *CONDITIONS))
    made = list(hostile.crafted(every=1))
    assert len(made) == 400
    assert sum(one.name.startswith("holder") for one in made) == 200
    assert all(len(one.token) <= DEFAULT.token_bytes for one in made), "it would be refused for its size alone"
    assert len({one.token for one in made}) == 400


def test_a6_what_a_holder_adds_is_refused_before_any_datalog():
    mine = [one for one in hostile.crafted(every=7) if one.name.startswith("holder")]
    assert len(mine) == 29
    for one in mine:
        found = hostile.verdict(one.token)
        assert isinstance(found, Fault), one.name
        assert found.code is FaultCode.HOP_NOT_ATTESTED, one.name


def test_a6_what_an_attester_adds_beside_the_profile_is_refused():
    theirs = [one for one in hostile.crafted(every=5) if one.name.startswith("attester:")]
    assert len(theirs) == 20
    for one in theirs:
        found = hostile.verdict(one.token)
        assert isinstance(found, Fault), one.name
        assert found.code in one.reasons, one.name


def test_a6_the_blocks_that_look_honest_do_so():
    """With a harmless condition in the hostile one's place they differ from an honest token in nothing that counts."""
    honest = hostile._last_source(tokens.lend(hostile.SMALL, 2, 0).token)
    parent = tokens.lend(hostile.SMALL, 1, 0).token
    same = hostile._attested(parent, honest)
    assert isinstance(tokens.check(same), Chain)
    assert hostile.verdict(same) == Later("allowed")
    dressed = [one for one in hostile.crafted(every=10) if " a check" in one.name]
    assert len(dressed) == 10


def test_a6_sees_what_passes_and_what_is_slow(monkeypatch):
    one = hostile.Hostile("one", b"", frozenset({FaultCode.CHAIN_BROKEN}))
    monkeypatch.setattr(hostile, "crafted", lambda *, every: iter([one]))
    good, other = Fault(FaultCode.CHAIN_BROKEN, "TOK-6"), Fault(FaultCode.EXPIRED, "TOK-7")
    for verdict, took_ms, met in ((good, 1, True), (good, 101, False), (other, 1, False), (Later("allowed"), 1, False)):
        now = [0]

        def asked(_, verdict=verdict, took_ms=took_ms, now=now):
            now[0] += took_ms * 1_000_000
            return verdict

        monkeypatch.setattr(hostile, "verdict", asked)
        found = hostile.run(settings(clock_ns=lambda now=now: now[0]))
        assert found.met is met, (verdict, took_ms)
        assert found.figures["slowest_ms"] == took_ms


# --- A7 --------------------------------------------------------------------------------------------------------------------


def test_a7_valid_tokens_beside_burners(monkeypatch):
    monkeypatch.setattr(load, "QUICK", 20)
    monkeypatch.setattr(load, "BURNERS", 2)
    monkeypatch.setattr(load, "TOKENS", 2)
    found = load.run(settings())
    assert (found.trials, found.figures["refused"], found.missed) == (20, 0, ())


def test_a7_sees_a_limit_that_is_too_tight(monkeypatch):
    monkeypatch.setattr(load, "QUICK", 5)
    monkeypatch.setattr(load, "BURNERS", 0)
    monkeypatch.setattr(load, "TOKENS", 1)
    monkeypatch.setattr(load, "DEFAULT", dataclasses.replace(DEFAULT, token_bytes=100))
    found = load.run(settings())
    assert found.figures["refused"] == 5
    assert not found.met


def test_a7_the_burners_burn_and_end():
    with load.burning(2):
        children = [int(child) for child in _children()]
        assert len(children) >= 2
    assert not set(children) & {int(child) for child in _children()} or not any(map(_burns, children))


def _children() -> list[str]:
    return Path("/proc/self/task").joinpath(str(__import__("os").getpid()), "children").read_text().split()


def _burns(pid: int) -> bool:
    try:
        return b"_burn" in Path(f"/proc/{pid}/cmdline").read_bytes()
    except OSError:
        return False


# --- A9 --------------------------------------------------------------------------------------------------------------------


def test_a9_every_edge_is_exact():
    found = edges.run(settings())
    assert [miss for miss in found.missed if not miss.endswith(" ms")] == []  # times are of a quiet machine
    assert found.trials == 3 * len(list(edges.edges()))


def test_a9_every_cap_is_approached_or_listed_with_a_reason():
    approached = {edge.cap for edge in edges.edges()}
    caps = {one.name for one in dataclasses.fields(Caps)}
    assert caps - approached - edges.ELSEWHERE.keys() == set()
    assert approached & edges.ELSEWHERE.keys() == set()
    assert approached <= caps


def shifted(cap: str, by: int, monkeypatch) -> list[str]:
    """Misses when the code's cap is not the one that the campaign expects."""
    monkeypatch.setattr(edges, "_ROOMY", dataclasses.replace(edges._ROOMY, **{cap: getattr(DEFAULT, cap) + by}))
    return list(edges.run(settings()).missed)


@pytest.mark.parametrize("cap", ["grants", "parameters", "purpose_bytes", "text_bytes", "lifetime_s"])
@pytest.mark.parametrize("by", [-1, 1])
def test_a9_sees_a_cap_that_is_off_by_one(cap, by, monkeypatch):
    assert any(miss.startswith(cap) for miss in shifted(cap, by, monkeypatch))


def test_a9_sees_a_refusal_that_comes_late():
    ticks = iter(range(0, 10**15, 2_000_000))
    found = edges.run(settings(clock_ns=ticks.__next__))
    assert not found.met


# --- the command -----------------------------------------------------------------------------------------------------------


def test_the_registry():
    assert isinstance(registry.CAMPAIGNS, list)
    ids = [campaign.id for campaign in registry.CAMPAIGNS]
    assert len(set(ids)) == len(ids)
    assert {"A3", "A4", "A6", "A7", "A9"} <= set(ids)


MET = Campaign("B1", "one", "none", lambda _: Outcome(10, {"wrong": 0, "other": 1}))
MISSED = Campaign("B2", "two", "none", lambda _: Outcome(10, {"wrong": 3}, ("this",)))
ABSENT = Campaign("B3", "three", "none", lambda _: Skipped("no vectors"))


@pytest.mark.parametrize(
    ("campaigns", "code"), [([MET], 0), ([MET, ABSENT], 0), ([MET, MISSED], 1), ([ABSENT], 1), ([MISSED, MET], 1)]
)
def test_the_command_says_what_was_found(campaigns, code, monkeypatch):
    monkeypatch.setattr(registry, "CAMPAIGNS", campaigns)
    done = CliRunner().invoke(cli.app, ["tokens", "--json", "--seed", "7"])
    said = json.loads(done.stdout)
    assert (done.exit_code, said["ok"], said["seed"]) == (code, code == 0, 7)
    assert [one["id"] for one in said["campaigns"]] == [campaign.id for campaign in campaigns]
    lines = CliRunner().invoke(cli.app, ["tokens", "--quick"]).stdout.rstrip().splitlines()
    assert all(campaign.id in lines[-1] for campaign in campaigns)


def test_one_campaign_alone_and_an_unknown_one(monkeypatch):
    monkeypatch.setattr(registry, "CAMPAIGNS", [MET, MISSED])
    done = CliRunner().invoke(cli.app, ["tokens", "--json", "--only", "B1"])
    assert done.exit_code == 0
    assert [one["id"] for one in json.loads(done.stdout)["campaigns"]] == ["B1"]
    assert CliRunner().invoke(cli.app, ["tokens", "--only", "B9"]).exit_code == 2


def test_every_miss_counts_and_the_first_are_told():
    misses = Misses()
    for n in range(12):
        misses.add(str(n))
    assert misses.count == 12
    assert len(misses.told()) == 6
    assert not Outcome(1, {}, misses.told()).met
