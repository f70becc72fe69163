"""Every peer's cells answer right and wrong as they must; a checker that checks nothing is caught."""

import importlib.util
import sys

import capabilities.keys.keys
import pytest
from evaluation.harness.bench import Row
from evaluation.harness.timing import Cell, WrongAnswerError
from evaluation.tokens.bench import BENCH, PEERS
from evaluation.tokens.cell import Kind, TokenKey
from evaluation.tokens.peers import lending as tokens
from evaluation.tokens.peers import ours
from evaluation.tokens.peers import session as stream
from evaluation.tokens.peers.ours import OurTokens
from evaluation.tokens.workload import DIGITAL, REALISTIC, SMALL, WORKLOADS

from capabilities import Chain, Verifier, inspect_token
from evaluation.harness import absent, timing

pytestmark = pytest.mark.long

PACKAGES = {"tenuo": "tenuo", "aip": "aip_token", "biscuit": "biscuit_auth", "macaroons": "pymacaroons"}
CALLS = 3


def measured(prepared) -> list[Cell[TokenKey]]:
    return [one for one in prepared.cells if isinstance(one, Cell)]


@pytest.mark.parametrize("depth", [0, 1, 3])
@pytest.mark.parametrize("workload", WORKLOADS, ids=lambda workload: workload.name)
def test_our_cells(workload, depth):
    prepared = OurTokens(tokens.lend_all).prepare(workload, depth, CALLS)
    cells = measured(prepared)
    for one in cells:
        timing.prove(one)
        assert one.wrong or one.of.kind is Kind.MINT
    making = Kind.ATTENUATE if depth else Kind.MINT
    assert {(one.of.kind, one.of.proof) for one in cells} >= {
        *((kind, proof) for kind in (Kind.FIRST, Kind.NOVEL, Kind.COLD, Kind.WARM) for proof in (True, False)),
        (making, False),
    }
    assert prepared.bytes == len(tokens.lend(workload, depth, 0).token)


@pytest.mark.parametrize("name", PEERS)
def test_cells_of_peers(name):
    if importlib.util.find_spec(PACKAGES.get(name, "jwt")) is None:
        pytest.skip(f"{name} is not installed")
    peer = PEERS[name]()
    assert peer.name == name
    for workload in WORKLOADS:
        if workload.words and not peer.words:
            continue
        for depth in (0, 1, 3, 8):
            prepared = peer.prepare(workload, depth, timing.TRIES + 1)
            cells = measured(prepared)
            assert len(cells) == len(prepared.cells)
            for one in cells:
                timing.prove(one)
                assert one.wrong or one.of.kind in {Kind.MINT, Kind.ATTENUATE}
            assert prepared.bytes > 100


def test_a_peer_that_limits_numbers_alone_restates_no_words():
    assert REALISTIC.numbers(3, 7) == REALISTIC.lent(3, 7)
    with pytest.raises(TypeError):
        DIGITAL.numbers(0, 0)


def stream_cell():
    held = tokens.lend(SMALL, 1, 0)
    return stream.cell("ztpm", SMALL, 1, held, view=tokens.view())


def test_a_frame_is_asked_for_right_and_for_wrong(monkeypatch):
    pytest.importorskip("capabilities.proof.session_opening")
    one = stream_cell()
    assert set(one.wrong) == {"a value out of limits", "one bit of the MAC", "a frame twice"}
    for _ in range(20):
        timing.prove(one)
    monkeypatch.setattr(Verifier, "check_request", lambda *_, **__: None)
    with pytest.raises(WrongAnswerError):
        timing.prove(one)


# --- a checker that checks nothing is caught -------------------------------------------------------------------------------


def proven(workload=SMALL) -> None:
    for one in measured(OurTokens(tokens.lend_all).prepare(workload, 1, CALLS)):
        timing.prove(one)


def test_a_scope_that_allows_all_is_caught(monkeypatch):
    monkeypatch.setattr(Verifier, "check_request", lambda *_, **__: None)
    with pytest.raises(WrongAnswerError):
        proven()


def test_a_proof_that_nobody_checks_is_caught(monkeypatch):
    monkeypatch.setattr(ours, "check_proof", lambda *_, **__: None)
    with pytest.raises(WrongAnswerError):
        proven()


def test_a_token_that_nobody_checks_is_caught(monkeypatch):
    real = Verifier.verify
    known: list[Chain] = []

    def lenient(self, token, **other):
        found = real(self, token, **other)
        if isinstance(found, Chain):
            known.append(found)
        return found if isinstance(found, Chain) else known[-1]

    monkeypatch.setattr(Verifier, "verify", lenient)
    monkeypatch.setattr(
        Verifier,
        "check_request",
        lambda self, chain, *, values, **__: None if values[1].value <= 100_000 else "refused",
    )
    with pytest.raises(WrongAnswerError):
        proven()


# --- what "cold" and "first" mean ------------------------------------------------------------------------------------------


def test_no_token_is_used_twice_and_no_two_are_alike():
    asked: list[range] = []

    def lend(workload, depth, serials, varied):
        asked.append(serials)
        return tokens.lend_all(workload, depth, serials, varied)

    one = OurTokens(lend)
    for workload in WORKLOADS:
        one.prepare(workload, 1, CALLS)
    serials = [serial for some in asked for serial in some]
    assert len(serials) == len(set(serials)) == len(WORKLOADS) * (6 * CALLS + 1)
    made = [tokens.lend(SMALL, 1, serial, varied=True).token for serial in range(5)]
    described = [inspect_token(token, tokens.trust()) for token in made]
    for field in ("agent", "key", "hop_id", "measurement", "request_digest", "grants"):
        said = [
            str(hop[field] if field in hop else hop["attestation"].get(field, hop["scope"].get(field)))
            for token in described
            for hop in token["hops"]
        ]
        assert len(set(said)) == 10, field


def test_a_cold_call_has_a_token_of_its_own_and_one_verifier_for_all():
    cells = measured(OurTokens(tokens.lend_all).prepare(SMALL, 0, CALLS))
    (cold,) = [one for one in cells if (one.of.kind, one.of.proof) == (Kind.COLD, True)]
    calls = [cold.fresh() for _ in range(CALLS)]
    assert len({call.token for call in calls}) == len({call.proof for call in calls}) == CALLS
    assert len({id(call.verifier) for call in calls}) == 1
    with pytest.raises(StopIteration):
        cold.fresh()


@pytest.mark.parametrize(("kind", "scopes"), [(Kind.COLD, 1), (Kind.NOVEL, CALLS), (Kind.FIRST, CALLS)])
def test_cold_calls_have_the_limits_of_others_and_novel_ones_have_not(kind, scopes):
    cells = measured(OurTokens(tokens.lend_all).prepare(SMALL, 1, CALLS))
    (one,) = [each for each in cells if (each.of.kind, each.of.proof) == (kind, False)]
    described = [inspect_token(one.fresh().token, tokens.trust()) for _ in range(CALLS)]
    assert len({str(token["hops"][-1]["scope"]["grants"]) for token in described}) == scopes
    assert len({token["hops"][-1]["agent"] for token in described}) == CALLS


def test_a_first_call_finds_nothing_remembered():
    cells = measured(OurTokens(tokens.lend_all).prepare(SMALL, 0, CALLS))
    (first,) = [one for one in cells if (one.of.kind, one.of.proof) == (Kind.FIRST, True)]
    caches = [
        member
        for name, module in sys.modules.items()
        if name.startswith("capabilities")
        for member in vars(module).values()
        if hasattr(member, "cache_info")
    ]
    capabilities.keys.keys.thumbprint(bytes(range(32)))
    assert any(cache.cache_info().currsize for cache in caches)
    call = first.fresh()
    assert not any(cache.cache_info().currsize for cache in caches)
    other = first.fresh()
    assert call.verifier is not other.verifier


def test_what_forgets_is_measured_apart_from_what_remembers(monkeypatch):
    groups = []

    def measure(given, *_, **__):
        groups.extend(given)
        return [[timing.Series() for _ in group] for group in given]

    monkeypatch.setattr(timing, "measure", measure)
    plan = timing.Plan(repeats=1, rounds=1, warm_up=0)
    BENCH.run(plan, seed=1, told=lambda _: None, workloads=[SMALL], depths=[0, 1], others={})
    kinds = [{one.of.kind for one in group} for group in groups]
    assert kinds.count({Kind.FIRST}) == 2
    assert all(kind == {Kind.FIRST} or Kind.FIRST not in kind for kind in kinds)
    assert all(len({one.of.depth for one in group}) == 1 for group in groups)


def test_every_warm_call_has_a_proof_of_its_own():
    cells = measured(OurTokens(tokens.lend_all).prepare(SMALL, 0, CALLS))
    (warm,) = [one for one in cells if (one.of.kind, one.of.proof) == (Kind.WARM, True)]
    assert len({warm.fresh().proof for _ in range(20)}) == 20


def test_tokens_are_made_in_another_process():
    with tokens.elsewhere() as lend:
        held = lend(SMALL, 1, range(2))
    assert held == tokens.lend_all(SMALL, 1, range(2)) or len({one.seed for one in held}) == 2
    assert all(isinstance(tokens.check(one.token), Chain) for one in held)


# --- what cannot be measured -----------------------------------------------------------------------------------------------


def test_a_depth_that_the_profile_refuses_is_a_row_that_says_so():
    peer = OurTokens(lambda *_: tokens.Declined("TOKEN_TOO_LARGE"))
    prepared = peer.prepare(REALISTIC, 8, CALLS)
    assert prepared.bytes is None
    assert all(isinstance(one, Row) and "TOKEN_TOO_LARGE" in one.why for one in prepared.cells)


def test_the_caps_decide_what_is_declined(monkeypatch):
    monkeypatch.setattr(tokens, "DEFAULT", tokens.DEFAULT.__class__(token_bytes=1_000))
    assert tokens.lend_all(REALISTIC, 1, range(1)) == tokens.Declined("TOKEN_TOO_LARGE")


def test_a_peer_that_is_not_installed_is_a_row_that_says_so():
    def missing():
        absent.package("no_such_package_at_all", "no-such-distribution")

    plan = timing.Plan(repeats=1, rounds=1, warm_up=0)
    result = BENCH.run(plan, seed=1, told=lambda _: None, workloads=[SMALL], depths=[0], others={"gone": missing})
    (row,) = [row for row in result.rows if row.of.peer == "gone"]
    assert "no-such-distribution" in row.why
    assert "bench" in row.why
    assert (row.of.scope, row.p50_us) == (None, None)
    assert any(row.p50_us for row in result.rows)
