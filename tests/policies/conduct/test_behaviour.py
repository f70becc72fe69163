"""Behaviour (ABG-1 to 4): silence on stationary streams, alarms on shifted ones, contraction, restoration, bounds."""

import json
import random
from collections import Counter
from dataclasses import replace
from itertools import islice

import pytest
from evaluation.conduct.agents import BEGIN, Worker, life
from evaluation.conduct.watching import caught, false_alarms
from hypothesis import given, settings
from hypothesis import strategies as st
from policies.conduct.baseline import BLOCK, FEATURES, Act, Watch, reference, widest
from policies.conduct.behaviour import (
    AT_ONCE,
    NOTHING_KNOWN,
    BehaviourState,
    RestoreError,
    observe,
    reading,
    relearn,
    restore,
)
from policies.conduct.history import AgentHistory, Baseline
from policies.conduct.report import Report, ReportError
from policies.evidence.conduct_readings import DRIFT, Feature
from policies.words.parameters import PARAMETERS, Parameters

from evaluation.conduct import agents, thresholds
from policies.conduct import cusum

P = Parameters()
SHORT = replace(P, behaviour_learn_count=64)
T = BEGIN


def report(n, *, at=None, agent="arm", reporter="pep", reason="PERMITTED", operation="move_joint", **changes):
    permitted = reason == "PERMITTED"
    made = Report(
        reporter=reporter,
        request_id=f"r{n}",
        agent=agent,
        delegators=("ann", agent),
        at=T + 10 * n if at is None else at,
        operation=operation,
        base_tier=1,
        runtime_tier=1,
        effect="PERMIT" if permitted else "DENY",
        reason=reason,
        outcome="done" if permitted else "none",
        values=(("a", n * 7 % 100),),
        near_permille=n * 13 % 500,
    )
    return replace(made, **changes)


def after(reports, state=NOTHING_KNOWN, parameters=P, role=""):
    for one in reports:
        state = observe(state, one, parameters, now=one.at, role=role)
    return state


def word(state, agent="arm", parameters=P):
    return reading(state, agent, T, 0, parameters)


def worker(seed=1, rhythm="independent", **changes):
    return life(Worker(random.Random(seed), rhythm), **changes)


def learned(seed=1, acts=300, **changes):
    return after(islice(worker(seed, **changes), acts))


def features(state, agent="worker"):
    return {deviation.feature for deviation in word(state, agent).deviations}


def probing(count, first=0, *, agent="arm"):
    return [report(first + n, reason="NOT_GRANTED", agent=agent) for n in range(count)]


# --- the detector ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("share", cusum.SHARES)
def test_the_table_is_what_the_script_computes(share):
    assert cusum.TABLE[share] == thresholds.row(share)
    up, down, limits = cusum.TABLE[share]
    for run in (10_000, 50_000):
        limit = limits[cusum.RUNS.index(run)]
        shorter, enough = (
            thresholds.run_length(share / 1000, up=up, down=down, limit=each) for each in (limit - 1, limit)
        )
        assert shorter < run <= enough


def test_the_table_covers_what_can_be_asked_for():
    assert (tuple(cusum.TABLE), cusum.RUNS) == (thresholds.SHARES, thresholds.RUNS)
    row = PARAMETERS["behaviour_false_alarm_count"]
    assert row.low // BLOCK >= cusum.RUNS[0]
    assert row.high * max(Counter(FEATURES.values()).values()) <= cusum.RUNS[-1]


@pytest.mark.parametrize("watch", Watch)
@pytest.mark.parametrize("share", [cusum.SHARES[0], cusum.SHARES[-1]])
def test_a_rarer_false_alarm_is_a_higher_limit_up_to_the_end_of_what_a_set_may_state(watch, share):
    row, usual = PARAMETERS["behaviour_false_alarm_count"], (share,) * len(Watch)
    of = Baseline(reference([]), usual, (0,) * len(Watch))
    limits = [
        AgentHistory(baseline=of).detector(watch, None, replace(P, behaviour_false_alarm_count=count)).limit
        for count in (row.low, row.default, 400_000, row.high)
    ]
    assert limits == sorted(set(limits))


@pytest.mark.parametrize("share", [100, 350])
def test_a_detector_alarms_no_more_often_than_stated(share):
    run, trials, draw = 500, 100_000, random.Random(share)
    detector, level, alarms = cusum.watched(share, run), 0, 0
    for _ in range(trials):
        level = detector.step(level, hit=draw.random() * 1000 < share)
        if level >= detector.limit:
            alarms, level = alarms + 1, 0
    assert 0.5 * trials / run < alarms < 1.15 * trials / run  # on the edge of its share, neither too many nor deaf


@given(st.integers(0, 128), st.integers(0, 128))
@settings(max_examples=30, deadline=None)
def test_a_share_is_above_what_was_seen_and_grows_with_it(hits, more):
    hits, most = sorted((hits, more))
    found, above = cusum.share_above(hits, 128), cusum.share_above(most, 128)
    assert found is None or found * 128 > hits * 1000
    assert above is None or (found is not None and found <= above)


@pytest.mark.parametrize(("hits", "trials", "share"), [(0, 128, 30), (13, 128, 200), (0, 0, None), (128, 128, None)])
def test_shares_by_clopper_and_pearson(hits, trials, share):
    assert cusum.share_above(hits, trials) == share


# --- learning --------------------------------------------------------------------------------------------------------


def test_nobody_knows_a_stranger():
    found = word(NOTHING_KNOWN, "nobody")
    assert (found.deviations, found.deviated_at, found.contracted, found.samples) == ((), None, False, 0)


def test_samples_grow_until_the_baseline_is_learned():
    reports = list(islice(worker(), 300))
    assert word(after(reports[:255]), "worker").samples == 255
    assert after(reports[:255]).careers["worker"].baseline is None
    assert word(after(reports[:256]), "worker").samples == 256
    assert after(reports[:256]).careers["worker"].baseline is not None
    assert word(after(reports), "worker").samples == 256


def test_the_baseline_stands_still():
    before = learned(acts=256).careers["worker"].baseline
    assert learned(acts=2_000).careers["worker"].baseline == before


@pytest.mark.long
@pytest.mark.parametrize("rhythm", ["independent", "rounds"])
def test_honest_agents_are_left_alone(rhythm):
    alarms = Counter()
    for seed in range(4):
        found, _ = false_alarms(islice(worker(seed, rhythm), 2_500), P)
        alarms.update(found)
    assert all(times <= 2 for times in alarms.values())  # 10,000 acts: one of each feature is what is stated


# --- detection -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("script", "feature", "patience"),
    [
        (agents.tool_changer, Feature.TOOLS, 40),
        (agents.mix_changer, Feature.TOOLS, 100),
        (agents.elsewhere, Feature.PARAMETERS, 60),
        (agents.salami, Feature.PARAMETERS, 40),
        (agents.flooder, Feature.RATE, 120),
        (agents.prober, Feature.REFUSALS, 80),
        (agents.at_the_edge, Feature.NEAR_BOUNDARY, 80),
        (agents.drifter(2_000), Feature.ESCALATION, 400),
    ],
    ids=lambda value: getattr(value, "__name__", ""),
)
def test_a_change_is_noticed_by_its_feature(script, feature, patience):
    for seed in range(3):
        found = caught(script, P, seed=seed, change_at=300, patience=patience)
        assert found is not None
        assert feature in found.features


def test_a_drift_is_contained_before_a_limit_is_crossed():
    runs = [caught(agents.drifter(500), P, seed=seed, change_at=300, patience=1_000) for seed in range(4)]
    assert all(run is not None and DRIFT & set(run.features) for run in runs)
    assert sum(run.crossed for run in runs) <= 1


@pytest.mark.parametrize(
    ("script", "parameters"),
    [(agents.prober, P), (agents.at_the_edge, replace(P, behaviour_near_max_permille=250))],
    ids=["probing", "edge"],
)
def test_nobody_learns_to_be_bad(script, parameters):
    assert caught(script, parameters, seed=5, change_at=0, patience=255) is not None  # before it has a baseline


def test_whoever_always_uses_all_that_was_lent_is_left_alone():
    state = after(replace(one, near_permille=1_000) for one in islice(worker(), 600))
    assert word(state, "worker").deviations == ()


@pytest.mark.parametrize(("reason", "noticed"), [("PARAMETERS_WRONG", False), ("NOT_GRANTED", True)])
def test_a_beginner_may_get_numbers_wrong_but_not_ask_for_what_was_not_lent(reason, noticed):
    assert word(after([report(n, reason=reason) for n in range(12)])).contracted is noticed
    assert not word(after([report(n, reason=reason) for n in range(5)])).contracted


def test_a_bad_youth_does_not_loosen_the_ceilings():
    bad = [report(n, reason="PARAMETERS_WRONG" if n % 3 == 0 else "PERMITTED", near_permille=None) for n in range(300)]
    loose = replace(P, behaviour_refused_max_permille=500)
    assert not word(after(bad, parameters=loose)).deviations  # one in three would be learned
    assert Feature.REFUSALS in features(after(bad), "arm")


@pytest.mark.parametrize("reason", ["SIGNATURE_INVALID", "REVOCATION_VIEW_STALE", "SCOPE_CONTRACTED", "BUSY"])
def test_refusals_that_nobody_is_charged_for_say_nothing(reason):
    assert word(after([report(n, reason=reason, near_permille=None) for n in range(100)])).deviations == ()


def test_a_stop_counts_for_nothing():
    state = after([report(n, operation="stop", at=T, reason="NOT_GRANTED", near_permille=1000) for n in range(500)])
    assert word(state).samples == 0
    assert word(state).deviations == ()


def test_one_agents_deviation_is_not_anothers():
    state = after([*probing(60, agent="bad"), *(report(n, reporter="pep2") for n in range(100))])
    assert word(state, "bad").contracted
    assert word(state, "arm").deviations == ()


def test_a_young_agent_is_compared_with_its_role():
    reports = list(islice(worker(1, agent="old"), 300))
    young = [report(n, reporter="pep2", operation="run_program") for n in range(30)]
    assert features(after([*reports, *young], role="mover"), "arm") == {Feature.TOOLS}
    assert features(after([*reports, *young]), "arm") == set()
    mixed = after(reports, role="mover")
    assert features(after(young, mixed, role="looker"), "arm") == set()


# --- contraction and restoration -------------------------------------------------------------------------------------


def test_probing_contracts_at_once():
    state = after(probing(60))
    assert features(state, "arm") == {Feature.REFUSALS}
    assert Feature.REFUSALS in AT_ONCE
    assert word(state).contracted
    assert word(state).deviated_at >= word(state).deviations[0].since >= T
    assert word(state).deviations[0].score_milli >= 1_000


def test_new_tools_contract_at_the_second_alarm():
    first = second = None
    state = NOTHING_KNOWN
    for n, one in enumerate(islice(worker(2, change_at=300, script=agents.tool_changer), 400)):
        state = observe(state, one, P, now=one.at)
        found = word(state, "worker")
        first = first or (n if found.deviations else None)
        second = second or (n if found.contracted else None)
    assert 300 <= first < second


def test_alarms_far_apart_do_not_contract():
    apart = replace(P, behaviour_repeat_count=1)
    flood = list(islice(worker(2, change_at=300, script=agents.flooder), 450))
    assert features(after(flood, parameters=apart)) == {Feature.RATE}
    assert not word(after(flood, parameters=apart), "worker").contracted
    assert word(after(flood), "worker").contracted


def test_deviations_stay_until_a_person_restores_them():
    state = after(probing(60))
    calm = after([report(n) for n in range(60, 700)], state)
    assert word(calm).contracted
    assert word(calm).deviations == word(state).deviations
    restored = restore(calm, "arm", by="ann", at=T)
    found = word(restored)
    assert (found.deviations, found.deviated_at, found.contracted) == ((), None, False)
    assert restored.careers["arm"].levels == (0,) * len(Watch)
    assert (restored.careers["arm"].restored_by, restored.careers["arm"].restored_at) == ("ann", T)
    assert word(after(probing(60, 1_000), restored)).contracted


def test_restoring_starts_the_detectors_afresh():
    state = after(probing(3))
    assert any(state.careers["arm"].levels)
    assert not any(restore(state, "arm", by="ann", at=T).careers["arm"].levels)


def test_nothing_is_learned_from_an_agent_that_deviates():
    state = after([*probing(60), *(report(n) for n in range(60, 700))])
    assert state.careers["arm"].baseline is None
    restored = restore(state, "arm", by="ann", at=T)
    assert after([report(n) for n in range(1_000, 1_300)], restored).careers["arm"].baseline is not None


def test_a_person_may_let_the_work_be_learned_anew():
    state = learned(acts=300)
    assert restore(state, "worker", by="ann", at=T).careers["worker"].baseline is not None
    anew = relearn(state, "worker", by="ann", at=T)
    assert anew.careers["worker"] == AgentHistory(restored_by="ann", restored_at=T)


@pytest.mark.parametrize("verb", [restore, relearn])
@pytest.mark.parametrize("by", ["arm", "other agent", "pep", "", None])
def test_neither_agents_nor_enforcement_points_restore(verb, by):
    state = after([*probing(60), report(1, agent="other agent", reporter="pep2")])
    with pytest.raises(RestoreError):
        verb(state, "arm", by=by, at=T)
    with pytest.raises(RestoreError):
        verb(state, "nobody", by="ann", at=T)


# --- the same report, late, twice, from the future -------------------------------------------------------------------


@given(st.lists(st.integers(0, 30), max_size=40))
@settings(max_examples=30, deadline=None)
def test_duplicates_change_nothing(numbers):
    state = after(map(report, numbers))
    assert after(map(report, numbers), state) == state
    assert state.careers.get("arm", AgentHistory()).acts == len(set(numbers))


def test_the_future_does_not_count():
    assert observe(NOTHING_KNOWN, report(1, at=T + P.skew_s + 1), P, now=T) is NOTHING_KNOWN
    ahead = NOTHING_KNOWN
    for n in range(60):
        ahead = observe(ahead, report(n, at=T + P.skew_s, reason="NOT_GRANTED"), P, now=T)
    assert word(ahead).deviated_at == T  # a clock that runs ahead does not put off re-attestation


def test_a_backlog_is_no_flood():
    reports = list(islice(worker(3), 1_200))
    prompt = after(reports[:600])
    late = [
        replace(one, reporter="pep2", request_id=f"l{n}", at=reports[300].at) for n, one in enumerate(reports[600:])
    ]
    state = NOTHING_KNOWN
    for one in late:
        prompt = observe(prompt, one, P, now=reports[-1].at)
    assert Feature.RATE not in features(prompt)
    assert state is NOTHING_KNOWN


def test_memory_is_bounded():
    wild = random.Random(1)
    state = NOTHING_KNOWN
    for n in range(1_500):
        values = tuple((f"v{wild.randrange(10_000)}", n) for _ in range(64))
        one = report(n, operation=f"op{wild.randrange(10_000)}", values=values)
        state = observe(state, one, P, now=one.at)
        if n == 127:
            assert len(json.dumps(state.careers["arm"].to_json())) < 150_000  # the longest that it gets
    assert len(json.dumps(state.careers["arm"].to_json())) < 20_000


# --- written and read ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("acts", [0, 5, 130, 300, 330])
def test_a_state_is_plain_json_and_comes_back_the_same(acts):
    state = after(islice(worker(4, change_at=300, script=agents.turncoat), acts), role="mover")
    body = json.loads(json.dumps(state.to_json()))
    assert BehaviourState.from_json(body) == state
    assert json.dumps(state.to_json()) == json.dumps(BehaviourState.from_json(body).to_json())


def spoilt(body):
    """Every way to lose a field of a career, or to give it another type."""
    for name in body["careers"][0][1]:
        for wrong in ("a", -1, 1.5, [None], {"x": 1}):
            career = dict(body["careers"][0][1])
            if career[name] == wrong or (name in {"role", "restored_by"} and wrong == "a"):
                continue
            yield {**body, "careers": [["worker", {**career, name: wrong}]]}
        yield {**body, "careers": [["worker", {k: v for k, v in body["careers"][0][1].items() if k != name}]]}


@pytest.mark.parametrize("acts", [20, 330])
def test_what_is_no_state_is_refused(acts):
    state = after(islice(worker(4, change_at=300, script=agents.turncoat), acts))
    body = json.loads(json.dumps(state.to_json()))
    for wrong in [None, {}, {**body, "more": 1}, {**body, "careers": [["worker"]]}, *spoilt(body)]:
        with pytest.raises(ReportError):
            BehaviourState.from_json(wrong)


@pytest.mark.parametrize(
    "act",
    [
        None,
        ["move"],
        ["", [], None, None, None, None, None],
        ["move", [["a"]], None, None, None, None, None],
        ["move", [["a", 1.0]], None, None, None, None, None],
        ["move", [], -1, None, None, None, None],
        ["move", [], None, 1, None, None, None],
        ["move", [], None, None, None, None, 1.5],
    ],
)
def test_what_is_no_act_is_refused(act):
    with pytest.raises(ReportError):
        Act.from_json(act)


def test_the_widest_of_two_references_holds_what_is_usual_for_either():
    one = reference([Act("move", (("a", n),), n, None, None, None, 9) for n in range(100)])
    other = reference([Act("grip", (("b", n),), 10 * n, None, None, None, 3) for n in range(100)])
    both = widest(one, other)
    assert both == widest(other, one)
    assert (both.known, both.quick_s, both.high, set(both.ranges)) == ({"move", "grip"}, 3, 750, {"move", "grip"})
    every = len(Watch)
    shares = (0,) * 5 + (50,) * (every - 5)
    joined = Baseline(one, (30,) * every, (1,) * every).joined(Baseline(other, shares, (2,) * every))
    assert joined == Baseline(both, shares, (2,) * every)


def test_every_feature_has_its_questions():
    assert set(FEATURES) == set(Watch)
    assert set(FEATURES.values()) == set(Feature)
