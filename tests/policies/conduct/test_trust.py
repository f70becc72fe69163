"""The laws of trust (CATP-1, CATP-3), as properties, and a slow twin of the score."""

import json
from dataclasses import replace
from fractions import Fraction

import pytest
from hypothesis import given
from hypothesis import strategies as st
from policies.conduct.decay import TICKS, decayed, ticks_between
from policies.conduct.report import Edge, Report, ReportError
from policies.conduct.trust import NOTHING_REPORTED, TrustState, chain_trust, observe, score, scores
from policies.conduct.trust_changes import CHARGES, charge, credit_milli
from policies.evidence.evidence import EdgeReading, TrustReading
from policies.words.parameters import Parameters
from policies.words.reason_table import Reason

from policies.conduct import counted_reports as seen_module
from policies.conduct import trust as trust_module

P = Parameters()
T = 1_700_000_000
DAY = 86_400
PRIOR, THETA = P.trust_prior_permille, P.trust_theta_permille
BEYOND, WRONG, SLIP = "NOT_NARROWER", "NOT_GRANTED", "LIMIT_EXCEEDED_BY_REQUEST"


def report(n=0, *, at=T, reason="PERMITTED", reporter="pep", parties=("ann", "orc", "arm"), **changes):
    permitted = reason == "PERMITTED"
    made = Report(
        reporter=reporter,
        request_id=f"r{n}",
        agent=parties[-1],
        delegators=tuple(parties),
        at=at,
        operation="move_joint",
        base_tier=2,
        runtime_tier=2,
        effect="PERMIT" if permitted else "DENY",
        reason=reason,
        outcome="done" if permitted else "none",
        values=(("q_urad.0", 1),),
        near_permille=None,
    )
    return replace(made, **changes)


def after(reports, state=NOTHING_REPORTED, parameters=P, now=T + 100 * DAY):
    for one in reports:
        state = observe(state, one, parameters, now=now)
    return state


EDGE = Edge("orc", "arm")


def at(state, when=T, edge=EDGE, stated=None, parameters=P):
    return score(state, edge, when, stated, parameters)


drawn = st.builds(
    report,
    n=st.integers(0, 40),
    at=st.integers(T, T + 3 * DAY),
    reason=st.sampled_from(["PERMITTED", BEYOND, WRONG, SLIP, "REPLAYED", "SIGNATURE_INVALID", "WHO_KNOWS"]),
    reporter=st.sampled_from(["pep", "pep2", "liar"]),
    parties=st.sampled_from([("ann", "orc", "arm"), ("ann", "arm"), ("ann", "orc")]),
    runtime_tier=st.sampled_from([0, 1, 2, 4, None]),
)
histories = st.lists(drawn, max_size=40)
sets = st.builds(
    Parameters,
    trust_half_life_s=st.sampled_from([60, 3_600, DAY]),
    trust_prior_weight_milli=st.sampled_from([1, 1_000, 20_000]),
    trust_good_cap_milli=st.sampled_from([0, 5_000, 40_000]),
    trust_bad_cap_milli=st.sampled_from([0, 5_000, 20_000]),
)


# --- only ever tightens ----------------------------------------------------------------------------------------------


@given(histories, sets, st.integers(T, T + 30 * DAY), st.one_of(st.none(), st.integers(0, 1000)))
def test_never_above_the_prior_nor_above_what_is_stated(history, parameters, when, stated):
    found = score(after(history, parameters=parameters), EDGE, when, stated, parameters)
    assert 0 <= found <= PRIOR
    assert stated is None or found <= stated


@given(histories, st.sampled_from([BEYOND, WRONG, SLIP]), st.integers(0, 5 * DAY))
def test_a_wrong_never_raises_trust(history, reason, later):
    before = after(history)
    worse = after([report("one more", at=T + 3 * DAY, reason=reason)], before)
    assert at(worse, T + 3 * DAY + later) <= at(before, T + 3 * DAY + later)


@given(histories, st.lists(st.integers(0, 30 * DAY), min_size=2, max_size=2))
def test_without_reports_trust_only_comes_back_and_never_above_the_prior(history, times):
    state, (sooner, later) = after(history), sorted(times)
    assert at(state, T + 3 * DAY + sooner) <= at(state, T + 3 * DAY + later) <= PRIOR


def test_what_is_forgotten_is_forgotten_whole():
    capped = after([report(n, reason=BEYOND) for n in range(50)])
    assert at(capped) == 400
    assert at(capped, T + 11 * DAY) == PRIOR


@pytest.mark.parametrize(("stated", "most"), [(650, 650), (0, 0), (1_001, 0), (True, 0), (-1, 0), (900, PRIOR)])
def test_a_static_statement_bounds_what_was_earned(stated, most):
    assert at(after([report()]), stated=stated) == most


# --- one edge, one agent ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("reason", [BEYOND, WRONG, "REPLAYED", "APPROVAL_DENIED", "MESSAGE_OUT_OF_DELEGATION"])
def test_only_the_edge_into_the_agent_that_acted_is_charged(reason):
    state = after([report(n, reason=reason) for n in range(9)])
    assert set(state.accounts) == {EDGE}
    assert at(state) < THETA
    assert at(state, edge=Edge("ann", "orc")) == PRIOR  # not the delegator
    assert at(state, edge=Edge("ann", "arm")) == PRIOR  # not the same agent on another edge
    assert at(state, edge=Edge("arm", "orc")) == PRIOR  # an edge has a direction
    assert scores(state, T, P) == {EDGE: at(state)}


def test_a_chain_is_its_weakest_edge_and_the_reading_names_every_hop():
    state = after([report(n, reason=WRONG) for n in range(5)])
    parties = ("ann", "orc", "arm", "grip")
    found = chain_trust([None, None, 750], P, parties=parties, state=state, at=T)
    assert found == TrustReading(
        640, (EdgeReading("ann", "orc", 800), EdgeReading("orc", "arm", 640), EdgeReading("arm", "grip", 750))
    )
    assert chain_trust([None, None], P, parties=parties, state=state, at=T) == TrustReading(0)
    assert chain_trust([], P, parties=("ann",)) == TrustReading(0)


@given(histories, st.dictionaries(st.sampled_from([EDGE, Edge("ann", "orc")]), st.integers(-5, 1_100)))
def test_an_enforcement_point_only_tightens_what_the_provider_says(history, snapshot):
    arguments = {"parties": ("ann", "orc", "arm"), "at": T + 3 * DAY}
    theirs = chain_trust([None, 790], P, snapshot=snapshot, **arguments)
    both = chain_trust([None, 790], P, snapshot=snapshot, state=after(history), **arguments)
    assert both.score_permille <= theirs.score_permille <= chain_trust([None, 790], P).score_permille
    assert all(b.score_permille <= t.score_permille for b, t in zip(both.edges, theirs.edges, strict=True))


# --- reporters -------------------------------------------------------------------------------------------------------


@given(histories, st.integers(1, 200))
def test_one_liar_takes_half_of_the_prior_at_most(history, lies):
    honest = after([replace(one, reporter="pep") for one in history])
    lied = after([report(f"lie {n}", at=T + 3 * DAY, reason=BEYOND, reporter="liar") for n in range(lies)], honest)
    when = T + 3 * DAY
    before, found = at(honest, when), at(lied, when)
    s0, cap = P.trust_prior_weight_milli, P.trust_bad_cap_milli
    assert found >= PRIOR * s0 // (s0 + cap) * before // PRIOR - 1  # whatever others said, by half at most
    assert lies < 4 or found <= before * 2 // 3


@given(histories, st.integers(1, 60))
def test_no_reporter_whitewashes_what_another_saw(history, praise):
    seen = after([replace(one, reporter="pep") for one in history])
    praised = after([report(f"lie {n}", at=T + 3 * DAY, reporter="liar") for n in range(praise)], seen)
    assert at(praised, T + 3 * DAY) == at(seen, T + 3 * DAY)


def test_what_several_reporters_see_adds_up():
    assert at(after([report(n, reason=WRONG, reporter=f"pep{n}") for n in range(3)])) < THETA


def test_good_work_earns_patience_up_to_the_cap_and_looking_earns_nothing():
    wrongs = [report(f"w{n}", reason=WRONG) for n in range(3)]
    assert at(after(wrongs)) < THETA
    assert at(after([*(report(n) for n in range(100)), *wrongs])) >= THETA
    assert at(after([*(report(n, runtime_tier=0) for n in range(100)), *wrongs])) < THETA
    more = [report(f"x{n}", reason=WRONG) for n in range(9)]
    assert at(after([*(report(n) for n in range(500)), *more])) < THETA


def test_recovery_is_by_work_or_by_time_and_ends_at_the_prior():
    state = after([report(n, reason=WRONG) for n in range(5)])
    assert at(state) == 640
    assert at(after([report(f"g{n}") for n in range(40)], state)) == 738
    assert at(after([report(f"g{n}") for n in range(4_000)], state)) == 738


# --- the same report, late, twice, out of order, from the future -----------------------------------------------------


@given(histories, st.randoms(use_true_random=False))
def test_simultaneous_reports_may_come_in_any_order(history, draw):
    together = {(one.reporter, one.request_id): replace(one, at=T) for one in history}
    one = list(together.values())
    other = draw.sample(one, len(one))
    assert after(one) == after(other)


@given(histories)
def test_duplicates_change_nothing(history):
    state = after(history)
    assert after(history, state) == state
    again = [replace(one, at=one.at + 1, reason=BEYOND, effect="DENY", outcome="none") for one in history]
    assert after(again, state) == state  # the same id with another word


def test_forgotten_duplicates_change_nothing_either():
    many = [report(n, at=T + n, reason=SLIP) for n in range(2 * seen_module.KEPT)]
    state = after(many)
    assert len(state.seen["pep"].kept) <= seen_module.KEPT
    assert after(many, state) == state


def test_one_reporter_cannot_take_anothers_request_ids():
    stolen = after([report(n, reporter="liar") for n in range(5)])
    assert at(after([report(n, reason=WRONG) for n in range(5)], stolen)) < THETA


@given(st.lists(st.tuples(st.integers(0, 5 * DAY), st.booleans()), min_size=1, max_size=12))
def test_late_reports_are_charged_as_if_they_had_come_in_time(events):
    # below the caps, where order could matter
    history = [report(n, at=T + when, reason=SLIP if bad else "PERMITTED") for n, (when, bad) in enumerate(events)]
    early, late = after(sorted(history, key=lambda one: one.at)), after(sorted(history, key=lambda one: -one.at))
    assert abs(at(early, T + 6 * DAY) - at(late, T + 6 * DAY)) <= 1


def test_the_future_does_not_count():
    assert observe(NOTHING_REPORTED, report(at=T + P.skew_s + 1, reason=BEYOND), P, now=T) is NOTHING_REPORTED
    assert at(after([report(at=T + P.skew_s, reason=BEYOND)], now=T)) < PRIOR


def test_memory_is_bounded(monkeypatch):
    monkeypatch.setattr(trust_module, "EDGES_MAX", 8)
    worst = [report("worst", reason=BEYOND, parties=("ann", "bad"))]
    many = [report(n, reason=SLIP, parties=("ann", f"a{n}")) for n in range(30)]
    state = after([*worst, *many])
    assert len(state.accounts) == 8
    assert Edge("ann", "bad") in state.accounts  # what was charged least is forgotten first


# --- what is charged -------------------------------------------------------------------------------------------------


def test_every_reason_has_its_charge_and_a_sentence():
    assert set(CHARGES) == set(Reason)
    assert all(row.because.endswith(".") and 0 <= row.milli <= 5_000 for row in CHARGES.values())


STRANGERS = [
    "SIGNATURE_INVALID", "PROOF_WRONG_KEY", "PROOF_STALE", "TOKEN_MALFORMED", "MESSAGE_UNAUTHENTIC", "TEXT_SUSPICIOUS",
    "REVOCATION_VIEW_STALE", "PERCEPTION_INVALID", "TRUST_TOO_LOW", "SCOPE_CONTRACTED", "REATTESTATION_NEEDED", "BUSY",
]  # fmt: skip


@pytest.mark.parametrize("reason", STRANGERS)
def test_nobody_is_charged_for_strangers_the_house_or_the_consequences(reason):
    state = after([report(n, reason=reason) for n in range(50)])
    assert state.accounts == {}
    assert at(state) == PRIOR


@pytest.mark.parametrize(
    ("effect", "outcome", "reason", "good", "bad"),
    [
        ("PERMIT", "done", "PERMITTED", 1_000, 0),
        ("PERMIT", "none", "PERMITTED", 0, 0),
        ("PERMIT", "failed", "EFFECT_FAILED", 0, 0),
        ("PERMIT", "failed", "CANCELLED", 0, 0),
        ("PERMIT", "failed", "NOT_WHAT_WAS_DECIDED", 0, 1_000),
        ("PERMIT", "refused", "VERDICT_EXPIRED", 0, 0),
        ("DEFER", "none", "TIER_NEEDS_APPROVAL", 0, 0),
        ("DEFER", "none", "NOT_GRANTED", 0, 0),
        ("DENY", "none", "NOT_GRANTED", 0, 1_000),
        ("DENY", "none", "SOMETHING_NEW", 0, 50),
    ],
)
def test_what_each_end_of_a_request_counts(effect, outcome, reason, good, bad):
    one = report(effect=effect, outcome=outcome, reason=reason)
    assert (credit_milli(one), charge(one).milli) == (good, bad)


# --- the twin --------------------------------------------------------------------------------------------------------


def twin(history, when, parameters):
    """The score as one would say it: every report by itself, real numbers, no account."""
    told = {}
    for one in history:
        told.setdefault((one.reporter, one.request_id), one)
    ordered = sorted((one for one in told.values() if one.edge == EDGE), key=lambda one: one.at)
    against, s0 = Fraction(0), Fraction(parameters.trust_prior_weight_milli)
    for reporter in {one.reporter for one in ordered}:
        good = bad = 0.0
        last = T
        for one in (one for one in ordered if one.reporter == reporter):
            fade = 2 ** (-(one.at - last) / parameters.trust_half_life_s)
            good = min(good * fade + credit_milli(one), parameters.trust_good_cap_milli)
            bad = min(bad * fade + charge(one).milli, parameters.trust_bad_cap_milli)
            last = one.at
        fade = 2 ** (-(when - last) / parameters.trust_half_life_s)
        against += Fraction(bad * fade) * s0 / (s0 + Fraction(good * fade))
    return float(parameters.trust_prior_permille * s0 / (s0 + against))


@given(st.lists(drawn, max_size=25), st.integers(0, 10 * DAY))
def test_the_score_is_what_its_twin_says(history, later):
    in_order = sorted({(one.reporter, one.request_id): one for one in history}.values(), key=lambda one: one.at)
    when = T + 3 * DAY + later
    assert abs(at(after(in_order), when) - twin(in_order, when, P)) <= 1


@given(st.integers(0, 10**14), st.integers(0, 40 * TICKS), st.integers(0, 40 * TICKS))
def test_decay_is_a_decay(amount, one, other):
    sooner, later = sorted((one, other))
    assert 0 <= decayed(amount, later) <= decayed(amount, sooner) <= amount
    assert abs(decayed(amount, one) - amount * 2 ** (-one / TICKS)) <= 1 + amount * 1e-12
    assert abs(decayed(decayed(amount, one), other) - decayed(amount, one + other)) <= 2


def test_decay_never_rises_from_tick_to_tick():
    left = [decayed(10**15, ticks) for ticks in range(2 * TICKS + 1)]
    assert all(after < before for before, after in zip(left, left[1:], strict=False))
    assert (left[0], left[TICKS], left[2 * TICKS]) == (10**15, 10**15 // 2, 10**15 // 4)


@given(st.integers(0, T), st.integers(0, T), st.integers(0, T), st.integers(60, DAY))
def test_ticks_add_up(one, other, third, half_life):
    one, other, third = sorted((one, other, third))
    parts = ticks_between(one, other, half_life_s=half_life) + ticks_between(other, third, half_life_s=half_life)
    assert parts == ticks_between(one, third, half_life_s=half_life)
    assert ticks_between(third, one, half_life_s=half_life) == 0


# --- written and read ------------------------------------------------------------------------------------------------


@given(histories)
def test_a_state_is_plain_json_and_comes_back_the_same(history):
    state = after(history)
    assert TrustState.from_json(json.loads(json.dumps(state.to_json()))) == state
    assert json.dumps(after(history).to_json()) == json.dumps(state.to_json())


@given(drawn)
def test_a_report_is_plain_json_and_comes_back_the_same(one):
    assert Report.from_json(json.loads(json.dumps(one.to_json()))) == one


BAD_REPORTS = {
    "no reporter": {"reporter": ""},
    "a lone surrogate": {"reporter": "\ud800"},
    "long text": {"operation": "x" * 257},
    "another leaf": {"delegators": ("ann", "orc")},
    "nobody delegates": {"delegators": ("arm",)},
    "twice in a chain": {"delegators": ("arm", "orc", "arm")},
    "a time that is no integer": {"at": 1.5},
    "a truth as time": {"at": True},
    "before the epoch": {"at": -1},
    "tier 5": {"runtime_tier": 5},
    "another effect": {"effect": "MAYBE"},
    "another outcome": {"outcome": "unknown"},
    "done without a permit": {"effect": "DENY", "outcome": "done"},
    "a fraction as value": {"values": (("a", 1.0),)},
    "too many values": {"values": tuple((f"v{n}", n) for n in range(65))},
    "beyond the bound": {"near_permille": 1_001},
}


@pytest.mark.parametrize("changes", BAD_REPORTS.values(), ids=BAD_REPORTS)
def test_a_report_out_of_bounds_does_not_exist(changes):
    with pytest.raises(ReportError):
        report(**changes)
    body = report().to_json() | {
        name: list(map(list, value)) if name == "values" else list(value) if name == "delegators" else value
        for name, value in changes.items()
    }
    with pytest.raises(ReportError):
        Report.from_json(body)


@pytest.mark.parametrize(
    "body",
    [
        None,
        [],
        {},
        {**report().to_json(), "more": 1},
        {**report().to_json(), "values": [["a"]]},
        {**report().to_json(), "values": [["a", 1, 2]]},
        {**report().to_json(), "values": [3]},
        {**report().to_json(), "delegators": "ann"},
        {**report().to_json(), "effect": ["PERMIT"]},
    ],
)
def test_what_is_no_report_is_refused(body):
    with pytest.raises(ReportError):
        Report.from_json(body)


GOOD_STATE = after([report(1, reason=WRONG)]).to_json()


@pytest.mark.parametrize(
    "body",
    [
        None,
        {},
        {**GOOD_STATE, "more": 1},
        {**GOOD_STATE, "accounts": [["ann", "arm", "pep", 1, 1]]},
        {**GOOD_STATE, "accounts": [["ann", "arm", "pep", 1, 1, -1]]},
        {**GOOD_STATE, "accounts": [["ann", "arm", "pep", 1, 1, 1.0]]},
        {**GOOD_STATE, "accounts": [["ann", "arm", 7, 1, 1, 1]]},
        {**GOOD_STATE, "seen": [["pep"]]},
        {**GOOD_STATE, "seen": [["pep", [-2, []]]]},
        {**GOOD_STATE, "seen": [["pep", [5, [[5, "r"]]]]]},
        {**GOOD_STATE, "seen": [["pep", [-1, [[2, "a"], [1, "b"]]]]]},
        {**GOOD_STATE, "seen": [["pep", [-1, [[1, 2]]]]]},
    ],
)
def test_what_is_no_state_is_refused(body):
    with pytest.raises(ReportError):
        TrustState.from_json(body)
